// SPDX-License-Identifier: Apache-2.0
// Many that sleep on one word: a wake of two reaches them all, since each passes it on. No rouser
// is there.
#include <atomic>
#include <cstdint>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/stop_word.hpp"

#include "support/asleep.hpp"
#include "waiting/waiting.hpp"

namespace {

using namespace lot::testing;
using lot::detail::FutexWait;
using lot::detail::FutexWaits;
namespace futex = lot::futex;
using lot::waiting::Kernel;

struct Fixture {
  const Watchdog watchdog{100};
  std::atomic<std::uint32_t> word{0};
  std::vector<std::thread> threads;

  ~Fixture() { join(); }
  void join() {
    for (std::thread& thread : threads) thread.join();
    threads.clear();
  }
  /// A thread that sleeps until the word has changed, and passes nothing on: it is as good as
  /// stopped.
  void sleeps_deaf() {
    threads.emplace_back([this] {
      while (word == 0) futex::wait(&word, 0, std::nullopt);
    });
    await_asleep(&word, 0, threads.size());
  }
  std::size_t asleep() const { return asleep_on(&word, word); }
};

const futex::Deadline kPast = futex::Clock::time_point();
const futex::Deadline kForever;

/// Waits until the word has changed.
struct Waiter : lot::waiting::Steps<Waiter> {
  Waiter(const std::atomic<std::uint32_t>& of, bool shared) : word(of), is_shared(shared) {}
  bool look() const { return word != 0; }
  std::optional<lot::waiting::Sleep<FutexWaits&>> arm() {
    waits.clear();
    waits.push_back({&word, 0, is_shared});
    return {{waits, kForever}};
  }
  const std::atomic<std::uint32_t>& word;
  bool is_shared;
  FutexWaits waits;
};

}  // namespace

TEST_SUITE_BEGIN("sleepers");

TEST_CASE_FIXTURE(Fixture, "a wake of two reaches all that sleep, since each passes it on") {
  constexpr std::size_t kSleepers = 60;
  for (std::size_t i = 0; i < kSleepers; ++i) {
    threads.emplace_back([this, is_shared = i != 0] {
      Waiter waiter(word, is_shared);
      CHECK(lot::waiting::wait(waiter, kForever));
    });
  }
  await_asleep(&word, 0, kSleepers);
  word = 1;
  CHECK(futex::wake(&word, futex::kWakes) == futex::kWakes);
  join();
}

TEST_CASE_FIXTURE(Fixture, "threads that help to sleep on many words pass a wake-up on") {
  constexpr std::size_t kSleepers = 6;
  const std::uint32_t never = 0;
  for (std::size_t i = 0; i < kSleepers; ++i) {
    threads.emplace_back([&] {
      FutexWaits waits(2 * futex::kMaxWords, {&never, 0});
      waits.push_back({&word, 0, true});
      while (word == 0) Kernel::sleep(waits, kForever);
    });
  }
  await_asleep(&word, 0, kSleepers);
  word = 1;
  CHECK(futex::wake(&word, futex::kWakes) == futex::kWakes);
  join();
}

TEST_CASE_FIXTURE(Fixture, "a sleeper passes on what it was woken for, whatever ended its sleep") {
  for (int i = 0; i < 4; ++i) sleeps_deaf();
  const std::uint32_t other = 0;
  FutexWaits waits{{&other, 0}, {&word, 0, true}};

  SUBCASE("the time is up, and the word has its value") {
    CHECK_FALSE(Kernel::sleep(waits, kPast));
    CHECK(asleep() == 4);
  }
  SUBCASE("the time is up, and the word has changed") {
    word = 1;
    Kernel::sleep(waits, kPast);
    CHECK(asleep() == 2);
  }
  SUBCASE("a stop has come, and the word has changed") {
    lot::detail::StopWord stop;
    stop.set();
    lot::waiting::add(waits, &stop);
    word = 1;
    CHECK(Kernel::sleep(waits, kForever));
    CHECK(asleep() == 2);
  }
  SUBCASE("another word was the reason") {
    word = 1;
    waits[0].value = 1;
    CHECK(Kernel::sleep(waits, kForever));
    CHECK(asleep() == 2);
  }
  SUBCASE("the word is not shared") {
    waits[1].is_shared = false;
    word = 1;
    Kernel::sleep(waits, kPast);
    CHECK(asleep() == 4);
  }
  word = 1;
  futex::wake_all(&word);
  join();
}

TEST_CASE("a sleeper that finds its own mark has no others to wake") {
  const std::uint32_t word = 0, other = 0;
  FutexWaits waits;
  const auto arm = [&waits](const void* at, std::uint32_t value, bool found) {
    waits.clear();
    waits.push_back_marked(at, value, found);
    REQUIRE(waits.size() == 1);
    return waits[0].is_shared;
  };
  CHECK_FALSE(arm(&word, 5, false));  // it leaves the mark
  CHECK_FALSE(arm(&word, 5, true));
  CHECK(arm(&word, 7, true));  // of the next value another one has left it
  CHECK(arm(&word, 7, true));
  CHECK_FALSE(arm(&word, 9, false));
  CHECK(arm(&other, 9, true));

  FutexWaits of_another;
  of_another.push_back_marked(&word, 9, true);
  CHECK(of_another[0].is_shared);
}

TEST_SUITE_END();
