// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "tool/activity.hpp"
#include "tool/sight.hpp"

namespace lot::tool {

/// A segment that the tool looks at again and again.
struct Watched {
  Sight sight;
  std::unique_ptr<PaceMeter> meter;  ///< these are of a sound one only
  Sizes sizes;
  Observation seen;
  std::vector<Activity> topics;
  std::vector<Activity> processes;
};

/// Follows the segments that `where` names, from outside: those that come, go, and take the place
/// of another one.
///
/// Threads: one.
class Watch {
 public:
  explicit Watch(Where where) : where_(std::move(where)) {}

  /// Notes which messages have come. The oftener it is called, the better are the rates.
  void look();
  /// True when the rate of each queue is known.
  bool has_enough() const;
  /// Observes all segments anew.
  void refresh();

  const std::vector<Watched>& segments() const { return segments_; }
  /// Which segments came and went in the last seconds, and what keeps the tool from looking: lines
  /// for people.
  std::vector<std::string> news() const;

 private:
  struct News {
    std::string text;
    std::chrono::steady_clock::time_point at;
  };

  Watched observed(Sight now);
  void tell(const std::string& text);

  Where where_;
  std::vector<Watched> segments_;
  std::vector<News> news_;
  std::string problem_;
  bool has_looked_ = false;
};

}  // namespace lot::tool
