// SPDX-License-Identifier: Apache-2.0
// The one strategy of all waits, step by step: with a clock that only the steps move on, and with
// words that change at times that a case sets.

#include <algorithm>
#include <chrono>
#include <functional>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "waiting/waiting.hpp"

namespace {

using namespace std::chrono_literals;
using lot::Wait;
using lot::futex::Clock;
using lot::futex::Deadline;
using lot::waiting::Sleep;
using lot::waiting::SpinHabit;
using lot::waiting::YieldHabit;
using Time = Clock::time_point;

constexpr Time kStart{1h};
constexpr Deadline kForever;

/// A word, and the value that it had when the waiter armed itself.
struct Watched {
  const unsigned& word;
  unsigned value;
};

/// A machine with one waiter. Its time passes in the steps of the wait, and in nothing else.
struct Machine {
  struct Event {
    Time at;
    std::function<void()> happens;  ///< empty: the sleep ends without a reason
  };
  static inline Time clock;
  static inline std::vector<Event> events;  ///< in the order of their times
  static inline std::string steps;          ///< what the waiter has done
  static inline bool locked;

  static void start() {
    clock = kStart;
    events.clear();
    steps.clear();
    locked = true;
  }
  static void step(const std::string& name, bool with_lock) {
    CHECK_MESSAGE(locked == with_lock, name);
    steps += (steps.empty() ? "" : " ") + name;
  }
  /// Lets the time pass, and what happens in it.
  static void pass(Clock::duration time) {
    clock += time;
    while (!events.empty() && events.front().at <= clock) next_event();
  }
  static void next_event() {
    const Event event = events.front();
    events.erase(events.begin());
    if (event.happens) event.happens();
  }

  static Time now() { return clock; }
  static void pause() {
    CHECK_FALSE(locked);
    pass(1us);
  }
  static void yield() {
    step("yield", false);
    pass(5us);
  }
  /// As the kernel: sleeps only while the word has the value.
  static bool sleep(const Watched& watched, const Deadline& until) {
    step("sleep", false);
    if (until && clock >= *until) return watched.word != watched.value;
    while (watched.word == watched.value) {
      const bool comes = !events.empty() && (!until || events.front().at <= *until);
      if (!comes) {
        REQUIRE_MESSAGE(until, "it would sleep for ever");
        clock = *until;
        return false;
      }
      clock = std::max(clock, events.front().at);
      const bool reason = events.front().happens != nullptr;
      next_event();
      if (!reason) return true;
    }
    return true;
  }
};

/// Waits until `there` is true. A message that comes sets it, and changes the word.
struct Waiter : lot::waiting::Steps<Waiter> {
  static constexpr unsigned kPollsPerClock = 4;

  bool there = false;
  unsigned word = 0;
  SpinHabit* spin = nullptr;
  YieldHabit* yield = nullptr;
  Clock::duration again = 0ns;  ///< it sleeps so long at most; 0: as long as it likes
  bool marks_at_last = false;   ///< its look after the deadline leaves a mark
  bool armed_in_vain = false;   ///< arm() asks for a look each time
  std::function<void()> after_mark;
  unsigned polls = 0;

  Waiter() { Machine::start(); }
  void comes() {
    there = true;
    ++word;
  }
  void comes_at(Time at) {
    Machine::events.push_back({at, [this] { comes(); }});
  }

  bool look() {
    Machine::step("look", true);
    return there;
  }
  bool poll(Time /*now*/) {
    CHECK(Machine::locked);
    ++polls;
    return there;
  }
  bool last_look() {
    if (marks_at_last) Machine::step("mark", true);
    return look();
  }
  std::optional<Sleep<Watched>> arm() {
    Machine::step("arm", true);
    if (there || armed_in_vain) {
      Machine::pass(1us);
      return std::nullopt;
    }
    const unsigned value = word;
    if (after_mark) std::exchange(after_mark, nullptr)();
    return {{{word, value}, again == 0ns ? kForever : Machine::clock + again}};
  }
  SpinHabit* spins() const { return spin; }
  YieldHabit* yields() const { return yield; }
  void settle() const { Machine::step("settle", true); }
  static void unlock() { Machine::locked = false; }
  static void lock() { Machine::locked = true; }
  static void before_sleep() { Machine::step("about", false); }
};

/// With the first look, which is the caller's.
bool wait(Waiter& waiter, const Deadline& deadline) {
  const bool found = waiter.look() || lot::waiting::wait<Machine>(waiter, deadline);
  CHECK(Machine::locked);
  return found;
}

}  // namespace

TEST_CASE("what is there already sets nothing up") {
  Waiter waiter;
  waiter.comes();
  CHECK(wait(waiter, kForever));
  CHECK(Machine::steps == "look");
}

TEST_CASE("the waiter spins, yields, arms itself and sleeps, in this order") {
  Waiter waiter;
  SpinHabit spin(Wait::Adaptive);
  YieldHabit yield;
  waiter.spin = &spin;
  waiter.yield = &yield;
  waiter.comes_at(kStart + 1s);
  CHECK(wait(waiter, kForever));
  const std::string after_spin = "settle yield look arm about sleep look";
  if (!lot::waiting::has_several_cores()) {
    CHECK(Machine::steps == "look " + after_spin);
    return;
  }
  CHECK(waiter.polls == 52);  // one each us, and it is enough after 50, of which four share a clock
  std::string spun = "look ";
  for (unsigned n = 0; n < waiter.polls / Waiter::kPollsPerClock; ++n) spun += "settle ";
  CHECK(Machine::steps == spun + after_spin);
}

TEST_CASE("what comes in the spin needs no mark and no sleep") {
  if (!lot::waiting::has_several_cores()) return;
  Waiter waiter;
  SpinHabit spin(Wait::Adaptive);
  waiter.spin = &spin;
  waiter.comes_at(kStart + 2us);
  CHECK(wait(waiter, kForever));
  CHECK(waiter.polls == 2);
  CHECK(Machine::steps == "look");
}

TEST_CASE("what comes in the yield needs no mark and no sleep") {
  Waiter waiter;
  YieldHabit yield;
  waiter.yield = &yield;
  waiter.comes_at(kStart + 2us);
  CHECK(wait(waiter, kForever));
  CHECK(Machine::steps == "look settle yield look");
}

TEST_CASE("what comes before the mark is seen when the mark stands") {
  Waiter waiter;
  waiter.comes_at(kStart + 2us);
  YieldHabit yield;
  for (int i = 0; i < 4; ++i) yield.found(false, 0ns);
  REQUIRE(waiter.look() == false);
  Machine::pass(2us);  // it comes now, behind the caller's look
  CHECK(lot::waiting::wait<Machine>(waiter, kForever));
  CHECK(Machine::steps == "look arm look");
}

TEST_CASE("what comes behind the look of the mark has changed the word: the sleep ends at once") {
  Waiter waiter;
  waiter.after_mark = [&waiter] { waiter.comes(); };
  CHECK(wait(waiter, kForever));
  CHECK(Machine::steps == "look arm about sleep look");
  CHECK(Machine::clock == kStart);
}

TEST_CASE("a wake without a reason, and another waiter that was faster, lead to the next sleep") {
  Waiter waiter;
  Machine::events.push_back({kStart + 1s, nullptr});
  Machine::events.push_back({kStart + 2s, [&waiter] { ++waiter.word; }});
  waiter.comes_at(kStart + 3s);
  CHECK(wait(waiter, kStart + 1min));
  CHECK(Machine::steps == "look arm about sleep look arm about sleep look arm about sleep look");
  CHECK(Machine::clock == kStart + 3s);
}

TEST_CASE("without a deadline it sleeps until it is woken, however long") {
  Waiter waiter;
  waiter.comes_at(kStart + 1000h);
  CHECK(wait(waiter, kForever));
  CHECK(Machine::steps == "look arm about sleep look");
}

TEST_CASE("a waiter that wants to look now and then arms itself anew each time") {
  Waiter waiter;
  waiter.again = 1s;
  Machine::events.push_back(
      {kStart + 2500ms, [&waiter] { waiter.there = true; }});  // no word tells
  CHECK(wait(waiter, kForever));
  CHECK(Machine::steps == "look arm about sleep look arm about sleep look arm about sleep look");
  CHECK(Machine::clock == kStart + 3s);
}

TEST_CASE("the deadline ends the sleep, and the last look comes after it") {
  for (const Clock::duration again : {Clock::duration(0ns), Clock::duration(1h)}) {
    Waiter waiter;
    waiter.again = again;
    CHECK_FALSE(wait(waiter, kStart + 1s));
    CHECK(Machine::steps == "look arm about sleep look");
    CHECK(Machine::clock == kStart + 1s);
  }
  Waiter waiter;
  Machine::events.push_back({kStart + 1s, [&waiter] { waiter.there = true; }});  // no word tells
  CHECK(wait(waiter, kStart + 1s));
}

TEST_CASE("a time to look again before the deadline does not end the wait") {
  Waiter waiter;
  waiter.again = 700ms;
  CHECK_FALSE(wait(waiter, kStart + 1s));
  CHECK(Machine::steps == "look arm about sleep look arm about sleep look");
  CHECK(Machine::clock == kStart + 1s);
}

TEST_CASE("a deadline that has passed costs no sleep, no yield and no spin") {
  for (const Time deadline : {Time::min(), Time{}, kStart}) {
    Waiter waiter;
    CHECK_FALSE(wait(waiter, deadline));
    CHECK(Machine::steps == "look arm look");
  }
  for (const Wait wait_as : {Wait::Spin, Wait::Adaptive, Wait::Park}) {
    Waiter waiter;
    SpinHabit spin(wait_as);
    YieldHabit yield;
    waiter.spin = &spin;
    waiter.yield = &yield;
    CHECK_FALSE(wait(waiter, kStart));
    CHECK(waiter.polls == 0);
    CHECK(Machine::steps.find("sleep") == std::string::npos);
    CHECK(Machine::steps.find("yield") == std::string::npos);
    CHECK(Machine::clock == kStart);
  }
}

TEST_CASE("a deadline that passes in the spin: one more look, and no mark") {
  Waiter waiter;
  SpinHabit spin(Wait::Spin);
  waiter.spin = &spin;
  CHECK_FALSE(wait(waiter, kStart + 10us));
  CHECK(waiter.polls == 12);
  CHECK(Machine::steps == "look settle settle settle settle look");
}

TEST_CASE("a waiter whose last look leaves a mark leaves it wherever the deadline passes") {
  for (const Wait wait_as : {Wait::Spin, Wait::Park}) {
    for (const Clock::duration time : {Clock::duration(0ns), Clock::duration(10us)}) {
      Waiter waiter;
      SpinHabit spin(wait_as);
      waiter.spin = &spin;
      waiter.marks_at_last = true;
      CHECK_FALSE(wait(waiter, kStart + time));
      const bool has_slept = Machine::steps.find("sleep") != std::string::npos;
      CHECK((has_slept || Machine::steps.find("mark look") != std::string::npos));
    }
  }
}

TEST_CASE("Wait::Spin never sleeps") {
  Waiter waiter;
  SpinHabit spin(Wait::Spin);
  waiter.spin = &spin;
  waiter.comes_at(kStart + 10ms);
  CHECK(wait(waiter, kForever));
  CHECK(waiter.polls == 10'000);
  CHECK(Machine::steps.find("arm") == std::string::npos);
}

TEST_CASE("a waiter that is asked to look again and again ends at the deadline") {
  Waiter waiter;
  waiter.armed_in_vain = true;
  CHECK_FALSE(wait(waiter, kStart + 3us));
  CHECK(Machine::steps == "look arm look arm look arm look");
}

TEST_CASE("spins and yields that were in vain four times come seldom") {
  if (!lot::waiting::has_several_cores()) return;
  SpinHabit spin(Wait::Adaptive);
  YieldHabit yield;
  unsigned spins = 0;
  unsigned yields = 0;
  for (int i = 0; i < 1000; ++i) {
    Waiter waiter;
    waiter.spin = &spin;
    waiter.yield = &yield;
    waiter.comes_at(kStart + 1s);
    CHECK(wait(waiter, kForever));
    spins += waiter.polls != 0 ? 1 : 0;
    yields += Machine::steps.find("yield") != std::string::npos ? 1 : 0;
    if (i < 4) CHECK((spins == yields && spins == static_cast<unsigned>(i) + 1));
  }
  CHECK(spins > 4);
  CHECK(spins < 300);
  CHECK(yields > 4);
  CHECK(yields < 300);
}

TEST_CASE("what a step throws leaves the wait") {
  struct Fails : Waiter {
    std::optional<Sleep<Watched>> arm() { throw std::runtime_error("damaged"); }
  } waiter;
  CHECK_THROWS_AS(lot::waiting::wait<Machine>(waiter, kForever), std::runtime_error);
  CHECK(Machine::locked);
}

TEST_CASE("a stop ends the spin, and no look comes after it") {
  if (!lot::waiting::has_several_cores()) return;
  lot::detail::StopWord stop;
  Waiter waiter;
  SpinHabit spin(Wait::Spin);
  waiter.spin = &spin;
  Machine::events.push_back({kStart + 10us, [&stop] { stop.set(); }});
  CHECK_FALSE(lot::waiting::wait<Machine>(waiter, kForever, &stop));
  CHECK(waiter.polls == 12);  // it looks at the stop when it looks at the clock
  CHECK(Machine::steps == "settle settle settle settle");
  CHECK(Machine::locked);
}

TEST_CASE("a stop before the sleep keeps the waiter from sleeping") {
  lot::detail::StopWord stop;
  Waiter waiter;
  waiter.after_mark = [&stop] { stop.set(); };
  CHECK_FALSE(lot::waiting::wait<Machine>(waiter, kForever, &stop));
  CHECK(Machine::steps == "arm");
  CHECK(Machine::locked);
}

TEST_CASE("a stop that comes in the sleep ends the wait without a look") {
  lot::detail::StopWord stop;
  Waiter waiter;
  waiter.again = 1s;
  Machine::events.push_back({kStart + 500ms, [&stop] { stop.set(); }});
  CHECK_FALSE(lot::waiting::wait<Machine>(waiter, kStart + 1min, &stop));
  CHECK(Machine::steps == "arm about sleep");
  CHECK(Machine::locked);

  stop.take();
  Waiter leaves;  // what has come as well
  Machine::events.push_back({kStart + 500ms, [&] {
                               stop.set();
                               leaves.comes();
                             }});
  CHECK_FALSE(lot::waiting::wait<Machine>(leaves, kForever, &stop));
  CHECK(Machine::steps == "arm about sleep");
}

TEST_CASE("the word of a stop is slept on beside those of the waiter, where it can be") {
  lot::detail::StopWord stop;
  const std::uint32_t word = 0;
  lot::detail::FutexWaits words{{&word, 0}};
  lot::waiting::add(words, nullptr);
  CHECK(words.size() == 1);
  lot::waiting::add(words, &stop);
  REQUIRE(words.size() == 2);
  stop.set();
  CHECK(lot::futex::wait_any(words, std::nullopt));  // at once
}
