// SPDX-License-Identifier: Apache-2.0
// What the self-test mutates: each operator has a mutant here that the check below catches. The
// lines that say "survives" have one that it does not catch.
#include <algorithm>
#include <array>
#include <chrono>
#include <optional>
#include <vector>

#include <lot_mutant.hpp>

namespace sample {

using namespace std::chrono_literals;

constexpr int kLimit = 7;
constexpr std::chrono::milliseconds kPause{100};

int never(int a) {
  if (a > 3) return 1;
  return 0;
}

bool operand(int a, int b) { return a == 1 && b == 2; }

int bound(int n) {
  int sum = 0;
  for (int i = 0; i < n; ++i) sum += i * 2 + 1;
  return sum;
}

int extreme(int a, int b) { return std::min(a + 1, b); }

std::chrono::milliseconds period(bool twice) { return twice ? 2 * kPause : 5ms; }

struct Log {
  std::vector<int> entries;
  void add(int what) { entries.push_back(what); }
  int size{0};
};

void steps(Log& log) {
  log.add(1);
  log.add(2);
}

std::optional<int> found(const std::array<int, 3>& all, int what) {
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

bool negated(int a) {
  const bool other = a != 4;
  return !other;
}

void in_vain(Log& log) {
  log.size = 0;  // survives: drop, constant
}

}  // namespace sample

int main() {
  using namespace sample;
  int wrong = 0;
  auto must = [&](bool holds) { wrong += !holds; };
  must(never(4) == 1);
  must(never(3) == 0);
  must(operand(1, 2) && !operand(0, 2) && !operand(1, 0));
  must(bound(4) == 16 && bound(0) == 0);
  must(extreme(4, 7) == 5 && extreme(4, 2) == 2);
  must(period(true) == 200ms && period(false) == 5ms);
  Log log;
  must(log.size == 0);
  steps(log);
  must(log.entries == std::vector<int>{1, 2});
  must(found({5, 6, 7}, 6) == 6 && !found({5, 6, 7}, 8));
  int four = 2;
  must(doubled(four) == 4);
  must(limited(5) == 5 && limited(9) == 7);
  must(negated(4) && !negated(5));
  in_vain(log);
  return wrong != 0;
}
