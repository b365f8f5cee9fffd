// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <numeric>

#include "lot/value.hpp"

namespace lot::description {

/// Says how many periods `to` make as long a time as `count` periods `from`. False: that is no
/// whole number, or too large; `rounded` says that any real number will do.
/// REQUIRES: the numbers of both are positive.
inline bool convert(const detail::Number& count, detail::Period from, detail::Period to,
                    bool rounded, detail::Number& result) {
  if (rounded || count.is_real) {
    long double real = 0;
    if (count.is_real) {
      real = count.real;
    } else {
      real = count.is_negative ? static_cast<long double>(static_cast<std::int64_t>(count.whole))
                               : static_cast<long double>(count.whole);
    }
    result = detail::Number::of(real * static_cast<long double>(from.numerator) /
                                static_cast<long double>(from.denominator) *
                                static_cast<long double>(to.denominator) /
                                static_cast<long double>(to.numerator));
    return true;
  }
  // count * (a / b) * (d / c), and nothing can be reduced any more
  std::int64_t a = from.numerator;
  std::int64_t b = from.denominator;
  std::int64_t c = to.numerator;
  std::int64_t d = to.denominator;
  for (std::int64_t* above : {&a, &d}) {
    for (std::int64_t* below : {&b, &c}) {
      const std::int64_t common = std::gcd(*above, *below);
      *above /= common;
      *below /= common;
    }
  }
  const std::uint64_t size = count.is_negative ? ~count.whole + 1 : count.whole;
  std::int64_t below = 0;
  std::uint64_t above = 0;
  if (size == 0) {
    result = detail::Number();
    return true;
  }
  if (__builtin_mul_overflow(b, c, &below) || size % static_cast<std::uint64_t>(below) != 0) {
    return false;
  }
  if (__builtin_mul_overflow(a, d, &above) ||
      __builtin_mul_overflow(size / static_cast<std::uint64_t>(below), above, &above)) {
    return false;
  }
  if (count.is_negative && above > (std::uint64_t{1} << 63)) return false;
  result.is_negative = count.is_negative;
  result.whole = count.is_negative ? ~above + 1 : above;
  return true;
}

}  // namespace lot::description
