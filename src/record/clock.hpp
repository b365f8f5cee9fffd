// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>

namespace lot::record {

/// The time of a recording: the system's at the begin, and from there on that of the steady clock.
/// A system clock that jumps does not change it.
///
/// Threads: any number may use one.
class Clock {
 public:
  using Steady = std::chrono::steady_clock;

  Clock() = default;
  /// At `steady` it was `begin`, in nanoseconds since 1970.
  Clock(std::uint64_t begin, Steady::time_point steady) : begin_(begin), steady_(steady) {}

  /// Nanoseconds since 1970; 0 for what was before that.
  std::uint64_t at(Steady::time_point time) const {
    const auto between = [](Steady::duration span) {
      const auto whole = std::chrono::duration_cast<std::chrono::nanoseconds>(span);
      return static_cast<std::uint64_t>(whole.count());
    };
    if (time >= steady_) return begin_ + between(time - steady_);
    return begin_ - std::min(begin_, between(steady_ - time));
  }
  std::uint64_t now() const { return at(Steady::now()); }
  /// How far the system's clock is ahead of it now.
  std::int64_t system_ahead() const { return static_cast<std::int64_t>(system() - now()); }

 private:
  static std::uint64_t system() {
    const auto since = std::chrono::system_clock::now().time_since_epoch();
    return static_cast<std::uint64_t>(
        std::chrono::duration_cast<std::chrono::nanoseconds>(since).count());
  }

  std::uint64_t begin_ = system();
  Steady::time_point steady_ = Steady::now();
};

}  // namespace lot::record
