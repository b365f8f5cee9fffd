// SPDX-License-Identifier: Apache-2.0

// Words of which only a part is compared look the same again after a while: a reader's futex after
// 1024 messages, a hold word's tag after 8192 (docs/limits.md). Who was held up for so long must
// not be taken in. And words that look different each time keep nobody for longer than it waits.

#include <atomic>
#include <cstdint>
#include <functional>
#include <thread>
#include <unistd.h>
#include <utility>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "futex/futex.hpp"
#include "lockfree_ring/words.hpp"
#include "refcount/ownership.hpp"
#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "support/neighbour.hpp"
#include "support/raw.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Wait;

struct Number {
  std::uint64_t value;
};

[[maybe_unused]] const bool has_janitor = start_janitor();

thread_local bool held_up = false;  ///< before this thread's next sleep
thread_local bool wide_awake = false;
std::atomic<bool> arrived{false};
std::atomic<bool> released{false};

}  // namespace

// The linker (--wrap) sends the callers of futex::wait_any() to the second of these.
bool really_wait(const lot::detail::FutexWaits&, const lot::futex::Deadline&) asm(
    "__real__ZN3lot5futex8wait_anyERKNS_6detail10FutexWaitsERKSt8optionalINSt6chrono10"
    "time_pointINS6_3_V212steady_clockENS6_8durationIlSt5ratioILl1ELl1000000000EEEEEEE");
bool wait_held_up(const lot::detail::FutexWaits&, const lot::futex::Deadline&) asm(
    "__wrap__ZN3lot5futex8wait_anyERKNS_6detail10FutexWaitsERKSt8optionalINSt6chrono10"
    "time_pointINS6_3_V212steady_clockENS6_8durationIlSt5ratioILl1ELl1000000000EEEEEEE");

bool wait_held_up(const lot::detail::FutexWaits& waits, const lot::futex::Deadline& deadline) {
  if (held_up) {
    held_up = false;
    arrived = true;
    while (!released) usleep(100);
  }
  return wide_awake || really_wait(waits, deadline);
}

TEST_SUITE_BEGIN("repeats");

TEST_CASE("a reader that is held up before it sleeps does not sleep over 1024 messages") {
  const Watchdog watchdog(60);
  const Ground options;
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Number>("/t", {Policy::Overwrite, 1, 1s});
  const lot::ShmSharedPtr<Number> message = engine.make<Number>();  // the same block each time
  arrived = released = false;
  std::atomic<pid_t> slow_thread{0}, quick_thread{0};
  std::atomic<int> slow_got{0}, quick_got{0};
  std::thread slow([&] {
    auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
    slow_thread = gettid();
    while (slow_got < 2 && puller.pull()) {
      held_up = ++slow_got == 1;
    }
  });
  std::thread quick([&] {
    auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
    quick_thread = gettid();
    while (quick_got < 1026 && puller.pull()) quick_got += 1 + static_cast<int>(puller.missed());
  });
  CHECK(eventually([&] { return pusher.readers() == 2; }));
  must_go(pusher.push(message));
  CHECK(eventually([&] { return arrived.load(); }));  // its mark stands
  for (int n = 0; n < 1024; ++n) must_go(pusher.push(message));
  CHECK(eventually([&] { return quick_got == 1025 && asleep(getpid(), quick_thread); }));
  released = true;
  CHECK(eventually([&] { return slow_got == 2; }, 20s));  // there is a message that it has not read
  must_go(pusher.push(message));
  slow.join();
  quick.join();
}

TEST_CASE("a pull ends in time, though its words change each time before it sleeps") {
  const Watchdog watchdog(60);
  const Ground options;
  lot::ShmEngine engine(options);
  const auto pusher = engine.advertise<Number>("/t");
  auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
  wide_awake = true;  // as a process does it that writes where it should not
  CHECK(!puller.pull(20ms));
  wide_awake = false;
  CHECK(puller.status() == lot::Status::Timeout);
}

namespace {

/// An atomic that lets something happen between one load and what follows it.
template <class T>
struct Interrupted : std::atomic<T> {
  T load(std::memory_order order) const {
    const T value = std::atomic<T>::load(order);
    if (meanwhile) std::exchange(meanwhile, nullptr)();
    return value;
  }
  mutable std::function<void()> meanwhile;
};

struct InterruptedAtomics : lot::detail::HardwareAtomics {
  template <class T>
  using Atomic = Interrupted<T>;
};

}  // namespace

TEST_CASE("a weak lock that is held up while its block lives through up to 8191 messages fails") {
  namespace hold = lot::refcount::hold;
  for (const int messages : {1, 2, 4095, 4096, 8190, 8191}) {
    CAPTURE(messages);
    lot::refcount::BlockWords<InterruptedAtomics> block{};
    lot::refcount::Ownership<InterruptedAtomics>::Hold word{};
    const lot::refcount::Ownership<InterruptedAtomics> home(5);
    REQUIRE(home.claim(block, word));
    const std::uint32_t generation =
        lot::refcount::generation_of(block.life.load(std::memory_order_relaxed));
    lot::test::raw(block.life).meanwhile = [&] {  // another thread of the home process
      for (int n = 0; n < messages; ++n) {
        REQUIRE(home.release(block, word, hold::kPointer));
        REQUIRE(home.reclaim(block, word, 0));
      }
    };
    CHECK(home.acquire_weak(block, word, generation) == lot::refcount::Left::Gone);
    // The new message is exclusively its maker's.
    CHECK(hold::pointers(word.load(std::memory_order_relaxed)) == 1);
  }
}

TEST_SUITE_END();
