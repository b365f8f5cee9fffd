// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>

#include "lot/lot.hpp"

#include "job.hpp"
#include "life.hpp"

namespace lot::chaos {

/// Comes to a topic that carries one type now, and another one later: publishes, reads or looks on
/// there for a while, goes, and comes again with the same type or with the other one.
///
/// Where it is refused, a living process must use the other type, or one that has just died. An
/// observer must learn that its topic has got the other type.
class Retyper final : public Job {
 public:
  Retyper(Life& life, ShmEngine& engine) : life_(life), engine_(engine) {}

  void turn() override;
  void quiet() override;
  bool settle() override;

 private:
  using Clock = std::chrono::steady_clock;

  void come();
  /// Lets the end do something. It goes when its topic has got the other type.
  template <class F>
  void let(F&& something);
  void note_refusal(const char* what);
  void note_look(bool others_published);
  /// Whether a living process publishes with the other type.
  bool others_publish() const;
  /// Whether one publishes or reads: observers do not count.
  bool others_are_there() const;
  bool any_lives_with(NodeRecord::Ends NodeRecord::*ends) const;

  Life& life_;
  ShmEngine& engine_;
  std::uint32_t topic_ = kFirstShape;
  bool observes_ = false;
  std::unique_ptr<Job> end_;
  Clock::time_point until_;                  ///< the end stays
  std::optional<Clock::time_point> untold_;  ///< since when it should have learnt of the other type
};

}  // namespace lot::chaos
