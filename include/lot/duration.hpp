// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <ratio>
#include <type_traits>

namespace lot {

namespace detail {

/// The same time in nanoseconds, or the nearest that nanoseconds can tell: 0.3 s as a double is a
/// little less, and 300'000'000 of them. Not a number: the least.
template <class Rep, class Period>
constexpr std::chrono::nanoseconds to_nanoseconds(std::chrono::duration<Rep, Period> time) {
  using std::chrono::nanoseconds;
  if constexpr (std::is_same_v<std::chrono::duration<Rep, Period>, nanoseconds>) {
    return time;
  } else {
    using Count = nanoseconds::rep;
    constexpr std::intmax_t kSecond = std::nano::den;
    constexpr bool kIsWhole = std::is_integral_v<Rep> && sizeof(Rep) <= sizeof(Count) &&
                              kSecond % Period::den == 0 &&
                              Period::num <= nanoseconds::max().count() / kSecond;
    if constexpr (kIsWhole) {
      constexpr Count kOne = Period::num * (kSecond / Period::den);
      constexpr Count kMost = nanoseconds::max().count() / kOne;
      constexpr Count kLeast = nanoseconds::min().count() / kOne;
      const Rep count = time.count();
      if (count > 0) {
        if (static_cast<std::uintmax_t>(count) > std::uintmax_t{kMost}) return nanoseconds::max();
      } else if (static_cast<std::intmax_t>(count) < kLeast) {
        return nanoseconds::min();
      }
      return nanoseconds(static_cast<Count>(count) * kOne);
    } else {
      constexpr long double kBeyond = 9223372036854775808.0L;  // 2^63
      const long double count =
          static_cast<long double>(time.count()) * (1e9L * Period::num) / Period::den;
      if (count >= kBeyond - 0.5L) return nanoseconds::max();
      if (!(count > -kBeyond)) return nanoseconds::min();
      const auto whole = static_cast<Count>(count);
      const long double rest = count - static_cast<long double>(whole);
      return nanoseconds(whole + (rest >= 0.5L ? 1 : 0) - (rest <= -0.5L ? 1 : 0));
    }
  }
}

}  // namespace detail

/// A length of time, as every function takes it that waits: a std::chrono::duration of any unit,
/// also of floating point.
///
///     frame = puller.pull(20ms);
///     frame = puller.pull(std::chrono::duration<double>(0.02));
///     frame = puller.pull(std::chrono::hours::max());  // for ever
///
/// It is nanoseconds that do not overflow: a longer time (292 years) becomes nanoseconds::max(),
/// which means for ever, and what falls between two is the nearer one. Nothing and less than
/// nothing mean: do not wait.
///
/// Threads: a value, as an integer.
/// Errors:  none: no conversion throws.
/// Memory:  eight bytes of the program's own.
/// Crash:   it leaves nothing.
class Duration : public std::chrono::nanoseconds {
 public:
  /// Nothing: do not wait.
  constexpr Duration() noexcept : std::chrono::nanoseconds(0) {}
  /// The same time in nanoseconds. Throws nothing.
  template <class Rep, class Period>
  constexpr Duration(std::chrono::duration<Rep, Period> time)  // NOLINT: implicit
      : std::chrono::nanoseconds(detail::to_nanoseconds(time)) {}
};

/// A time to wait until: of the steady clock, in any unit. It does not overflow either: the last
/// time_point means for ever, and one that has passed, be it from before the machine was started,
/// means: do not wait.
///
/// Threads: a value, as an integer.
/// Errors:  none: no conversion throws.
/// Memory:  eight bytes of the program's own.
/// Crash:   it leaves nothing.
class Deadline : public std::chrono::steady_clock::time_point {
 public:
  /// The same point in nanoseconds. Throws nothing.
  template <class Unit>
  constexpr Deadline(  // NOLINT: implicit
      std::chrono::time_point<std::chrono::steady_clock, Unit> time)
      : std::chrono::steady_clock::time_point(detail::to_nanoseconds(time.time_since_epoch())) {}
};

}  // namespace lot
