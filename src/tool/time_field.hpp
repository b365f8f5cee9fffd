// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <optional>
#include <string>

#include "lot/value.hpp"

namespace lot::tool {

/// A time that the messages of a topic have in a field, such as `header.stamp`.
///
/// Which clock it is of: a time point says so. A duration, and a struct of seconds and nanoseconds,
/// count from the epoch of the clock that is nearer to the first of them: 1970 is far away.
///
/// Threads: one.
class TimeField {
 public:
  enum class Clock { Unknown, System, Steady };
  /// What the two clocks say at one moment.
  struct Now {
    std::chrono::nanoseconds system;
    std::chrono::nanoseconds steady;
    static Now now();
  };

  explicit TimeField(std::string path) : path_(std::move(path)) {}

  /// The messages have this type from now on. Throws lot::Error: EINVAL where it has no such field,
  /// or no time in it; EBADMSG for a damaged description.
  void begin(const Description& description);
  /// How long ago the time in the message was; below zero: it lies ahead. Nothing: the time is
  /// zero, as where a program has not set it. Throws as Value. REQUIRES: begin().
  std::optional<std::chrono::nanoseconds> age(const Value& message, const Now& now);
  /// Of the times in messages of this type.
  Clock clock() const noexcept { return clock_; }

 private:
  std::string path_;
  Clock clock_ = Clock::Unknown;
  bool has_parts_ = false;  ///< it is a struct of two numbers, which are these fields
  std::size_t seconds_ = 0;
  std::size_t nanoseconds_ = 0;
};

}  // namespace lot::tool
