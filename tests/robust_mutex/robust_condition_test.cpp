// SPDX-License-Identifier: Apache-2.0
// The condition between real processes, some of which are killed.

#include "robust_mutex/robust_condition.hpp"

#include <chrono>
#include <csignal>
#include <new>
#include <sys/mman.h>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using Condition = lot::RobustCondition<>;
using lot::RobustMutex;
using Outcome = RobustMutex::Outcome;

/// A number that only grows, what guards it and what says that it has grown.
struct Shared {
  RobustMutex::Word lock{0};
  std::atomic<std::uint32_t> word{0};
  long number = 0;
};

/// Each child is a participant of its own, and dead once it has been waited for.
class Owner final : public lot::LockOwner {
 public:
  std::uint32_t name() const noexcept override {
    return lot::lock::make_name(static_cast<std::uint32_t>(getpid()) % 256,
                                static_cast<std::uint32_t>(getpid()));
  }
  bool is_gone(std::uint32_t name) noexcept override {
    return kill(static_cast<pid_t>(lot::lock::incarnation(name)), 0) != 0;
  }
};

class Fixture {
 public:
  Fixture() {
    void* at =
        mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    REQUIRE(at != MAP_FAILED);
    shared = new (at) Shared;
  }
  ~Fixture() { munmap(shared, sizeof(Shared)); }
  Fixture(const Fixture&) = delete;
  Fixture& operator=(const Fixture&) = delete;

 protected:
  RobustMutex mutex() { return {shared->lock, owner_}; }
  Condition condition() { return Condition(shared->word); }

  /// Sleeps until the number is at least `least`; false when the lock was lost or time is up.
  bool wait_for(long least, std::chrono::nanoseconds patience = 30s) {
    const auto until = lot::futex::Clock::now() + patience;
    for (;;) {
      if (mutex().lock_for(30s) == Outcome::Busy) return false;
      const bool there = shared->number >= least;
      const std::uint32_t seen = there ? 0 : condition().announce();
      mutex().unlock();
      if (there) return true;
      if (!condition().sleep_until(seen, until)) return false;
    }
  }
  void grow() {
    mutex().lock_for(30s);
    ++shared->number;
    const bool wake = condition().changed();
    mutex().unlock();
    if (wake) condition().wake_all();
  }
  bool somebody_waits() const { return (shared->word.load() & 1) != 0; }

  const Watchdog watchdog{60};
  Shared* shared = nullptr;

 private:
  Owner owner_;
};

}  // namespace

TEST_SUITE_BEGIN("robust_condition");

TEST_CASE_FIXTURE(Fixture, "all waiters hear of a change, each time") {
  std::vector<Child> waiters;
  for (int i = 0; i < 4; ++i) {
    waiters.emplace_back([this] {
      for (long n = 1; n <= 500; ++n) must(wait_for(n), "the change");
    });
  }
  for (int n = 0; n < 500; ++n) {
    grow();
    if (n % 16 == 0) std::this_thread::sleep_for(1ms);  // lets them fall asleep
  }
  for (Child& waiter : waiters) CHECK(waiter.wait() == 0);
}

TEST_CASE_FIXTURE(Fixture, "a change without a waiter needs no wake") {
  mutex().lock_for(30s);
  CHECK(!condition().changed());
  mutex().unlock();
}

TEST_CASE_FIXTURE(Fixture, "a change between looking and sleeping is not slept through") {
  mutex().lock_for(30s);
  const std::uint32_t seen = condition().announce();
  mutex().unlock();
  grow();
  CHECK(condition().sleep_until(seen, {}));
}

TEST_CASE_FIXTURE(Fixture, "a deadline passes") {
  CHECK(!wait_for(1, 20ms));
  CHECK(somebody_waits());  // its mark stays, and costs one needless wake
  grow();
  CHECK(!somebody_waits());
}

TEST_CASE_FIXTURE(Fixture, "killed waiters leave nothing that a change trips over") {
  for (int round = 0; round < 20; ++round) {
    Child waiter([this] { wait_for(1'000'000); });
    REQUIRE(eventually([this] { return somebody_waits(); }));
    waiter.kill9();
    Child other([this, round] { must(wait_for(round + 1), "the change"); });
    grow();
    CHECK(other.wait() == 0);
  }
}

TEST_CASE_FIXTURE(Fixture, "killed between the change and the wake: the repair wakes all") {
  std::vector<Child> waiters;
  for (int i = 0; i < 3; ++i) {
    waiters.emplace_back([this] { must(wait_for(1), "the change"); });
  }
  REQUIRE(eventually([this] { return somebody_waits(); }));
  std::this_thread::sleep_for(20ms);  // most likely all asleep by now; right in any case
  Child changer([this] {
    mutex().lock_for(30s);
    ++shared->number;
    must(condition().changed(), "somebody waits");
    mutex().unlock();
    raise(SIGKILL);
  });
  CHECK(changer.wait() == 128 + SIGKILL);
  CHECK(!somebody_waits());
  condition().renew();
  condition().wake_all();
  for (Child& waiter : waiters) CHECK(waiter.wait() == 0);
}

TEST_CASE_FIXTURE(Fixture, "killed while it has the mutex: the next one is told, and wakes all") {
  Child waiter([this] { must(wait_for(1), "the change"); });
  REQUIRE(eventually([this] { return somebody_waits(); }));
  Child changer([this] {
    mutex().lock_for(30s);
    ++shared->number;
    raise(SIGKILL);
  });
  CHECK(changer.wait() == 128 + SIGKILL);
  CHECK((mutex().lock_for(30s) == Outcome::OwnerDied));
  mutex().unlock();
  condition().renew();
  condition().wake_all();
  CHECK(waiter.wait() == 0);
}

TEST_SUITE_END();
