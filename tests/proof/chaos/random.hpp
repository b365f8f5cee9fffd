// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>

namespace lot::chaos {

/// splitmix64: numbers that follow from a seed alone, on every machine.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}
  /// Numbers of their own for each combination of parts: what one life does never depends on how
  /// many numbers another has drawn.
  template <class... Parts>
  static Random of(std::uint64_t seed, Parts... parts) {
    ((seed = mix(seed ^ mix(static_cast<std::uint64_t>(parts)))), ...);
    return Random(seed);
  }
  static constexpr std::uint64_t mix(std::uint64_t z) {
    z += 0x9e3779b97f4a7c15U;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9U;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebU;
    return z ^ (z >> 31);
  }

  std::uint64_t next() { return mix(state_++); }
  /// 0 .. n - 1
  std::uint64_t below(std::uint64_t n) { return next() % n; }
  unsigned pick(std::size_t n) { return static_cast<unsigned>(below(n)); }
  bool chance(unsigned percent) { return below(100) < percent; }
  std::chrono::nanoseconds between(std::chrono::nanoseconds least, std::chrono::nanoseconds most) {
    return least +
           std::chrono::nanoseconds(below(static_cast<std::uint64_t>((most - least).count()) + 1));
  }

 private:
  std::uint64_t state_;
};

}  // namespace lot::chaos
