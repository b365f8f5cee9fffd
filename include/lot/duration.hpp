// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <type_traits>

namespace lot {

namespace detail {

/// The same time in nanoseconds, or the nearest that nanoseconds can tell. Not a number: the least.
template <class Rep, class Period>
constexpr std::chrono::nanoseconds to_nanoseconds(std::chrono::duration<Rep, Period> time) {
  using std::chrono::nanoseconds;
  if constexpr (std::is_same_v<std::chrono::duration<Rep, Period>, nanoseconds>) {
    return time;
  } else {
    constexpr long double kOne = 1e9L * Period::num / Period::den;
    constexpr long double kBeyond = 9223372036854775808.0L;  // 2^63
    const long double count = static_cast<long double>(time.count()) * kOne;
    if (count >= kBeyond) return nanoseconds::max();
    if (!(count > -kBeyond)) return nanoseconds::min();
    return nanoseconds(static_cast<nanoseconds::rep>(count));
  }
}

}  // namespace detail

/// A length of time, as every function takes it that waits: a std::chrono::duration of any unit,
/// also of floating point.
///
///     puller.pull(20ms);
///     puller.pull(std::chrono::duration<double>(0.02));
///     puller.pull(std::chrono::hours::max());  // for ever
///
/// It is nanoseconds that do not overflow: a longer time (292 years) becomes nanoseconds::max(),
/// which means for ever. Nothing and less than nothing mean: do not wait.
class Duration : public std::chrono::nanoseconds {
 public:
  constexpr Duration() noexcept : std::chrono::nanoseconds(0) {}
  template <class Rep, class Period>
  constexpr Duration(std::chrono::duration<Rep, Period> time)  // NOLINT: implicit
      : std::chrono::nanoseconds(detail::to_nanoseconds(time)) {}
};

/// A time to wait until: of the steady clock, in any unit. It does not overflow either: the last
/// time_point means for ever, and one that has passed, be it from before the machine was started,
/// means: do not wait.
class Deadline : public std::chrono::steady_clock::time_point {
 public:
  template <class Unit>
  constexpr Deadline(  // NOLINT: implicit
      std::chrono::time_point<std::chrono::steady_clock, Unit> time)
      : std::chrono::steady_clock::time_point(detail::to_nanoseconds(time.time_since_epoch())) {}
};

}  // namespace lot
