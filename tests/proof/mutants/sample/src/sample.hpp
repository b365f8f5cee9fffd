// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <optional>
#include <vector>

/// What the self-test mutates: each operator has mutants here, which sample.cpp catches. A
/// line that says "survives" has some that it does not catch.
namespace sample {

using namespace std::chrono_literals;

constexpr int kLimit = 7;
constexpr std::chrono::milliseconds kPause{100};

inline int never(int a) {
  if (a > 3) return 1;
  return 0;
}

inline bool operand(int a, int b) { return a == 1 && b == 2; }

inline int bound(int n) {
  int sum = 0;
  for (int i = 0; i < n; ++i) sum += i * 2 + 1;
  return sum;
}

inline int extreme(int a, int b) { return std::min(a + 1, b); }

inline std::chrono::milliseconds period(bool twice) { return twice ? 2 * kPause : 5ms; }

struct Log {
  std::vector<int> entries;
  void add(int what) { entries.push_back(what); }
  int size{0};
};

inline void steps(Log& log) {
  log.add(1);
  log.add(2);
}

inline std::optional<int> found(const std::array<int, 3>& all, int what) {
  for (int one : all) {
    if (one == what) {
      return one;
    }
  }
  return std::nullopt;
}

constexpr int doubled(int a) { return a + a; }
static_assert(doubled(2) == 4);

template <class T>
T limited(T a) {
  return a < kLimit ? a : kLimit;  // survives: bound, constant
}

inline bool negated(int a) {
  const bool other = a != 4;
  return !other;
}

inline std::size_t fixed() {
  const int size = 3;  // refused: constant
  return std::array<int, size>{}.size();
}

inline void in_vain(Log& log) {
  log.size = 0;  // survives: drop, constant
}

inline void unused(Log& log) {
  log.add(3);  // survives: drop, constant
}

}  // namespace sample
