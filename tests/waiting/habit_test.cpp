// SPDX-License-Identifier: Apache-2.0
#include "waiting/habit.hpp"

#include <chrono>

#include <doctest/doctest.h>

namespace {

using namespace std::chrono_literals;
using lot::Wait;
using lot::waiting::Habit;
using lot::waiting::SpinHabit;
using lot::waiting::YieldHabit;

constexpr auto kShort = 10us;
constexpr auto kLong = 100us;

unsigned spins_of(SpinHabit& habit, unsigned waits) {
  unsigned spins = 0;
  for (unsigned i = 0; i < waits; ++i) spins += habit.worthwhile() ? 1 : 0;
  return spins;
}

/// Where there is one core, adaptive waiting parks, and there is nothing to learn.
bool has_one_core() { return !lot::waiting::has_several_cores(); }

}  // namespace

TEST_CASE("Wait::Spin always spins, Wait::Park never does, whatever came of it") {
  SpinHabit spin(Wait::Spin);
  SpinHabit park(Wait::Park);
  for (int i = 0; i < 100; ++i) {
    CHECK(spin.worthwhile());
    CHECK_FALSE(spin.enough(1h));
    spin.spun(1h);
    CHECK_FALSE(park.worthwhile());
  }
}

TEST_CASE("Wait::Adaptive spins until that was in vain four times, then now and then") {
  if (has_one_core()) return;
  SpinHabit habit(Wait::Adaptive);
  CHECK_FALSE(habit.enough(kShort));
  CHECK(habit.enough(kLong));
  for (int i = 0; i < 4; ++i) {
    CHECK(spins_of(habit, 100) == 100);
    habit.spun(kLong);
  }
  const unsigned spins = spins_of(habit, 16'000);
  CHECK(spins > 500);  // of 1000 on average
  CHECK(spins < 2'000);
}

TEST_CASE("one spin that pays makes it a habit again") {
  if (has_one_core()) return;
  SpinHabit habit(Wait::Adaptive);
  for (int i = 0; i < 10; ++i) habit.spun(kLong);
  CHECK(spins_of(habit, 1000) < 500);
  habit.spun(kShort);
  CHECK(spins_of(habit, 1000) == 1000);
  for (int i = 0; i < 3; ++i) habit.spun(kLong);
  habit.spun(kShort);
  for (int i = 0; i < 3; ++i) habit.spun(kLong);
  CHECK(spins_of(habit, 1000) == 1000);  // never four in a row
}

TEST_CASE("habits do not fall into one rhythm") {
  if (has_one_core()) return;
  SpinHabit a(Wait::Adaptive);
  SpinHabit b(Wait::Adaptive);
  for (int i = 0; i < 4; ++i) {
    a.spun(kLong);
    b.spun(kLong);
  }
  unsigned together = 0;
  unsigned even = 0;
  unsigned odd = 0;
  for (int i = 0; i < 64'000; ++i) {
    const bool one = a.worthwhile();
    const bool other = b.worthwhile();
    together += one && other ? 1 : 0;
    (i % 2 == 0 ? even : odd) += one ? 1 : 0;
  }
  CHECK(together > 100);  // of 250 on average
  CHECK(even > 1'000);    // of 2000
  CHECK(odd > 1'000);
}

TEST_CASE("what was in vain four times is tried now and then, until it is of use again") {
  Habit habit;
  const auto tries = [&habit] {
    unsigned n = 0;
    for (unsigned i = 0; i < 1000; ++i) n += habit.worthwhile() ? 1 : 0;
    return n;
  };
  for (int i = 0; i < 4; ++i) {
    CHECK(tries() == 1000);
    habit.tried(false);
  }
  const unsigned seldom = tries();
  CHECK(seldom > 0);
  CHECK(seldom < 300);
  habit.tried(true);
  CHECK(tries() == 1000);
}

TEST_CASE("the core is let go seldom where nothing is found afterwards") {
  YieldHabit habit;
  unsigned yields = 0;
  for (int i = 0; i < 1000; ++i) {
    if (!habit.worthwhile()) continue;
    CHECK_FALSE(habit.found(false, 1us));
    ++yields;
  }
  CHECK(yields >= 4);
  CHECK(yields < 300);
}
