// SPDX-License-Identifier: Apache-2.0
// The lock between real processes, one of which is killed.

#include "robust_mutex/robust_mutex.hpp"

#include <atomic>
#include <chrono>
#include <csignal>
#include <functional>
#include <new>
#include <sys/mman.h>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "futex/futex.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using lot::RobustMutex;
using Outcome = RobustMutex::Outcome;
namespace lock = lot::lock;

constexpr std::uint32_t kProcesses = 8;

/// What processes share: the lock, a counter that it guards, a stage to wait for, and who is dead.
struct Shared {
  RobustMutex::Word word{0};
  long counter = 0;
  std::atomic<int> stage{0};
  std::atomic<bool> dead[kProcesses] = {};
};

/// Says of others what the test says of them.
class Owner final : public lot::LockOwner {
 public:
  Owner(Shared& shared, std::uint32_t participant, std::uint32_t incarnation = 1)
      : shared_(shared), name_(lock::make_name(participant, incarnation)) {}

  std::uint32_t name() const noexcept override { return name_; }
  /// The process was taken for dead.
  void lose_name() { name_ = 0; }
  bool is_gone(std::uint32_t name) noexcept override {
    ++asked;
    if (when_asked) when_asked();
    const std::uint32_t k = lock::participant(name);
    return k >= kProcesses || shared_.dead[k];
  }

  int asked = 0;
  std::function<void()> when_asked;

 private:
  Shared& shared_;
  std::atomic<std::uint32_t> name_;
};

class Fixture {
 public:
  Fixture() = default;
  ~Fixture() { munmap(shared, sizeof(Shared)); }
  Fixture(const Fixture&) = delete;
  Fixture& operator=(const Fixture&) = delete;

 protected:
  RobustMutex mutex(Owner& owner) { return {shared->word, owner}; }

  void await(int stage) const {
    while (shared->stage != stage) std::this_thread::sleep_for(200us);
  }

  /// A process k that holds the lock until it is killed.
  Child holder(std::uint32_t k, Outcome expected = Outcome::Locked) {
    shared->stage = 0;
    Child child([=, this] {
      Owner owner(*shared, k);
      must(mutex(owner).lock_for(30s) == expected, "the lock");
      shared->stage = 1;
      for (;;) pause();
    });
    await(1);
    return child;
  }
  void kill(Child& child, std::uint32_t k) {
    child.kill9();
    shared->dead[k] = true;
  }

  /// Adds to a counter that only the lock guards; false if the lock ever says anything but Locked.
  bool count(Owner& owner, int rounds) {
    for (int i = 0; i < rounds; ++i) {
      if (mutex(owner).lock_for(30s) != Outcome::Locked) return false;
      const long seen = shared->counter;
      if (i % 64 == 0) std::this_thread::sleep_for(1us);  // let the other one run into the lock
      shared->counter = seen + 1;
      mutex(owner).unlock();
    }
    return true;
  }

  const Watchdog watchdog{60};
  Shared* const shared = [] {
    void* at =
        mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    REQUIRE(at != MAP_FAILED);
    return new (at) Shared;
  }();
  Owner me{*shared, 1};
};

}  // namespace

TEST_SUITE_BEGIN("robust_mutex");

TEST_CASE_FIXTURE(Fixture, "two processes that count under the lock lose no count") {
  const int rounds = 5000;
  Child child([&] {
    Owner other(*shared, 2);
    must(count(other, rounds), "the lock");
  });
  CHECK(count(me, rounds));
  CHECK(child.wait() == 0);
  CHECK(shared->counter == 2 * rounds);
  CHECK(shared->word == 0);
}

TEST_CASE_FIXTURE(Fixture, "two threads of one process, which have one name, lose no count") {
  const int rounds = 5000;
  std::atomic<bool> counted{false};
  std::thread other([&] { counted = count(me, rounds); });
  CHECK(count(me, rounds));
  other.join();
  CHECK(counted);
  CHECK(shared->counter == 2 * rounds);
}

TEST_CASE_FIXTURE(Fixture, "a free lock is locked at once, also by a timeout of nothing") {
  CHECK((mutex(me).try_lock() == Outcome::Locked));
  mutex(me).unlock();
  CHECK((mutex(me).lock_for(0ns) == Outcome::Locked));
  mutex(me).unlock();
  CHECK(me.asked == 0);
}

TEST_CASE_FIXTURE(Fixture, "without a name a process gets no lock, neither a free nor a dead one") {
  Owner nobody(*shared, ~std::uint32_t{0}, 0);
  REQUIRE(nobody.name() == 0);
  CHECK((mutex(nobody).try_lock() == Outcome::Busy));
  CHECK((mutex(nobody).lock_for(30s) == Outcome::Busy));
  Child child = holder(2);
  kill(child, 2);
  const std::uint32_t before = shared->word;
  CHECK((mutex(nobody).try_lock() == Outcome::Busy));
  CHECK(shared->word == before);
  CHECK((mutex(me).try_lock() == Outcome::OwnerDied));
}

TEST_CASE_FIXTURE(Fixture, "a waiter that loses its name gets no lock in the old one") {
  Child child = holder(2);
  Owner late(*shared, 3);
  late.when_asked = [&] { late.lose_name(); };
  SUBCASE("it stops waiting") {
    CHECK((mutex(late).lock_for(30s) == Outcome::Busy));
    CHECK(late.asked == 1);
  }
  SUBCASE("what it has got goes back") {
    kill(child, 2);
    CHECK((mutex(late).lock_for(30s) == Outcome::Busy));
    CHECK((mutex(me).try_lock() == Outcome::Locked));
    mutex(me).unlock();
  }
}

TEST_CASE_FIXTURE(Fixture, "another process's lock is busy, at once or after a timeout") {
  Child child([this] {
    Owner other(*shared, 2);
    must(mutex(other).try_lock() == Outcome::Locked, "the lock");
    shared->stage = 1;
    await(2);
    mutex(other).unlock();
  });
  await(1);
  CHECK((mutex(me).try_lock() == Outcome::Busy));
  const auto begin = std::chrono::steady_clock::now();
  CHECK((mutex(me).lock_for(30ms) == Outcome::Busy));
  CHECK((std::chrono::steady_clock::now() - begin >= 30ms));
  CHECK((mutex(me).lock_for(0ns) == Outcome::Busy));
  shared->stage = 2;
  CHECK((mutex(me).lock_for(30s) == Outcome::Locked));
  mutex(me).unlock();
  CHECK(child.wait() == 0);
}

TEST_CASE_FIXTURE(Fixture, "after a holder was killed the next one is told, once") {
  for (std::uint32_t k = 2; k < 5; ++k) {
    Child child = holder(k);
    CHECK((mutex(me).try_lock() == Outcome::Busy));
    child.kill9();
    CHECK((mutex(me).lock_for(20ms) == Outcome::Busy));  // nobody knows yet
    shared->dead[k] = true;
    CHECK((mutex(me).lock_for(30s) == Outcome::OwnerDied));
    mutex(me).unlock();
    CHECK((mutex(me).try_lock() == Outcome::Locked));
    mutex(me).unlock();
  }
}

TEST_CASE_FIXTURE(Fixture, "a try takes the lock of a dead one, too") {
  Child child = holder(2);
  kill(child, 2);
  CHECK((mutex(me).try_lock() == Outcome::OwnerDied));
  mutex(me).unlock();
  CHECK((mutex(me).try_lock() == Outcome::Locked));
  mutex(me).unlock();
}

TEST_CASE_FIXTURE(Fixture, "a waiter that sleeps already is told when the holder is dead") {
  Child child = holder(2);
  Child waiter([this] {
    Owner other(*shared, 3);
    shared->stage = 2;
    must(mutex(other).lock_for(30s) == Outcome::OwnerDied, "the dead one's lock");
    mutex(other).unlock();
  });
  await(2);
  std::this_thread::sleep_for(20ms);  // most likely asleep by now; right in any case
  kill(child, 2);
  CHECK(waiter.wait() == 0);
  CHECK((mutex(me).try_lock() == Outcome::Locked));
  mutex(me).unlock();
}

TEST_CASE_FIXTURE(Fixture, "one that was told and is killed itself leaves the same to the next") {
  Child first = holder(2);
  kill(first, 2);
  Child second = holder(3, Outcome::OwnerDied);
  kill(second, 3);
  Child third = holder(4, Outcome::OwnerDied);
  kill(third, 4);
  CHECK((mutex(me).try_lock() == Outcome::OwnerDied));
  mutex(me).unlock();
  CHECK((mutex(me).lock_for(30s) == Outcome::Locked));
  mutex(me).unlock();
}

TEST_CASE_FIXTURE(Fixture, "a waiter that is killed leaves at most a mark") {
  CHECK((mutex(me).try_lock() == Outcome::Locked));
  Child waiter([this] {
    Owner other(*shared, 2);
    mutex(other).lock_for(30s);
  });
  CHECK(eventually([this] { return (shared->word & lock::kSleepers) != 0; }));
  kill(waiter, 2);
  mutex(me).unlock();
  CHECK(shared->word == 0);
}

TEST_CASE_FIXTURE(Fixture, "a late judge takes no lock from the next owner of an index") {
  Owner former(*shared, 2, 7);
  Owner next(*shared, 2, 8);
  CHECK((mutex(former).try_lock() == Outcome::Locked));
  shared->dead[2] = true;
  me.when_asked = [&] {  // the former one is dead; until we act on it, its index has come again
    me.when_asked = nullptr;
    CHECK((mutex(next).try_lock() == Outcome::OwnerDied));
    mutex(next).unlock();
    CHECK((mutex(next).try_lock() == Outcome::Locked));
  };
  CHECK((mutex(me).try_lock() == Outcome::Busy));
  CHECK(lock::name(shared->word) == next.name());
}

TEST_CASE_FIXTURE(Fixture, "a thread that ends with the lock is no death") {
  std::thread([this] { CHECK((mutex(me).try_lock() == Outcome::Locked)); }).join();
  CHECK((mutex(me).try_lock() == Outcome::Busy));
  CHECK((mutex(me).lock_for(10ms) == Outcome::Busy));
  mutex(me).unlock();
  CHECK((mutex(me).try_lock() == Outcome::Locked));
}

TEST_CASE_FIXTURE(Fixture, "a damaged word: none is taken over, another's stays locked") {
  for (const std::uint32_t word : {lock::kSleepers, 0x1ffU, 0xffffffffU, 9U << 9}) {
    CAPTURE(word);
    shared->word = word;
    CHECK((mutex(me).try_lock() == Outcome::OwnerDied));
    mutex(me).unlock();
    CHECK(shared->word == 0);
  }
  CHECK((mutex(me).try_lock() == Outcome::Locked));
  Owner other(*shared, 2);
  shared->word = other.name();
  mutex(me).unlock();
  CHECK(shared->word == other.name());
}

TEST_CASE_FIXTURE(Fixture, "three that sleep are let in one after the other") {
  CHECK((mutex(me).lock_for(30s) == Outcome::Locked));
  std::vector<Child> waiters;
  for (std::uint32_t k : {2U, 3U, 4U}) {
    waiters.emplace_back([this, k] {
      Owner other(*shared, k);
      ++shared->stage;
      must(mutex(other).lock_for(30s) == Outcome::Locked, "the lock");
      std::this_thread::sleep_for(1ms);
      mutex(other).unlock();
    });
  }
  await(3);
  std::this_thread::sleep_for(20ms);  // most likely asleep by now; right in any case
  mutex(me).unlock();
  for (Child& waiter : waiters) CHECK(waiter.wait() == 0);
  CHECK(shared->word == 0);
}

TEST_SUITE_END();
