// SPDX-License-Identifier: Apache-2.0

// The kernel's notice of a death, by processes that end in every way.

#include "liveness/death_notice.hpp"

#include <csignal>
#include <cstdint>
#include <new>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "futex/futex.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"
#include "support/sandbox.hpp"

namespace {

using namespace lot::testing;
using lot::liveness::DeathNotice;
using lot::test::raw;
namespace seat = lot::liveness::seat;

struct Shared {
  Shared() {
    raw(before) = 0x1111111111111111;
    raw(behind) = 0x2222222222222222;
  }
  DeathNotice::Seat before, seat, behind;
  std::atomic<int> stage{0};
};

class Fixture {
 public:
  Fixture() {
    void* at =
        mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    REQUIRE(at != MAP_FAILED);
    shared = new (at) Shared;
  }
  ~Fixture() {
    CHECK(raw(shared->before) == 0x1111111111111111);
    CHECK(raw(shared->behind) == 0x2222222222222222);
    munmap(shared, sizeof(Shared));
  }
  Fixture(const Fixture&) = delete;
  Fixture& operator=(const Fixture&) = delete;

 protected:
  /// A process that has claimed the word, and then does that.
  template <class F>
  Child claimer(F&& then) {
    shared->stage = 0;
    Child child([&] {
      DeathNotice mine;
      must(mine.claim(shared->seat, raw(shared->seat)), "the seat");
      must(stands(), "its notice");
      shared->stage = 1;
      then(mine);
    });
    await(1);
    return child;
  }
  static void stay(DeathNotice&) {
    for (;;) pause();
  }
  void await(int stage) const {
    while (shared->stage < stage) std::this_thread::sleep_for(200us);
  }
  bool stands() const { return seat::stands(raw(shared->seat)); }
  std::uint32_t incarnation() const { return seat::incarnation(raw(shared->seat)); }
  bool is_told() const { return (raw(shared->seat) & seat::kDied) != 0; }

  const Watchdog watchdog{60};
  Shared* shared = nullptr;
};

}  // namespace

TEST_SUITE_BEGIN("death_notice");

TEST_CASE_FIXTURE(Fixture, "a process stands until it is killed; its sleepers are woken") {
  for (int round = 0; round < 50; ++round) {
    Child child = claimer(stay);
    const std::uint64_t seen = raw(shared->seat);
    REQUIRE(seat::stands(seen));
    CHECK(seat::incarnation(seen) == static_cast<std::uint32_t>(round) + 1);
    std::thread sleeper([&] {
      while (raw(shared->seat) == seen) {
        lot::futex::wait(lot::futex::low_half(shared->seat.word()), seat::notice(seen), {});
      }
    });
    if (round % 2 == 0) std::this_thread::sleep_for(1ms);
    child.kill9();
    sleeper.join();
    CHECK(is_told());
    CHECK_FALSE(stands());
    CHECK(incarnation() == seat::incarnation(seen));
  }
}

TEST_CASE_FIXTURE(Fixture, "a process that ends its notice takes it back") {
  Child child = claimer([](DeathNotice& mine) { mine.end(); });
  CHECK(child.wait() == 0);
  CHECK(raw(shared->seat) == seat::make(1, 0));
}

TEST_CASE_FIXTURE(Fixture, "a process that ends without a word, or by exec, is told of") {
  CHECK(claimer([](DeathNotice&) { _exit(0); }).wait() == 0);
  CHECK(is_told());
  CHECK(claimer([](DeathNotice&) { execl("/bin/true", "true", nullptr); }).wait() == 0);
  CHECK(is_told());
  claimer([](DeathNotice&) { raise(SIGSEGV); }).wait();
  CHECK(is_told());
}

TEST_CASE_FIXTURE(Fixture, "the death of a thread of the application is no death") {
  Child child = claimer([&](DeathNotice& mine) {
    std::thread([] { pthread_exit(nullptr); }).join();
    must(stands(), "its notice");
    shared->stage = 2;
    stay(mine);
  });
  await(2);
  CHECK(stands());
}

TEST_CASE_FIXTURE(Fixture, "a seat that has changed is not claimed, and a death leaves it alone") {
  raw(shared->seat) = 7;
  Child child([&] {
    DeathNotice mine;
    must(!mine.claim(shared->seat, 0), "a seat that somebody else has");
    shared->stage = 1;
    stay(mine);
  });
  await(1);
  child.kill9();
  CHECK(raw(shared->seat) == 7);
}

TEST_CASE_FIXTURE(Fixture, "an overtaken process has no notice, nor by the same thread id") {
  Child child([&] {
    DeathNotice mine;
    must(!mine.claim(shared->seat, 1), "a seat that somebody else has");
    // Its witness thread is the next thread of this process, here and in the other namespace.
    raw(shared->seat) = seat::make(1, static_cast<std::uint32_t>(getpid() + 1) | seat::kSleepers);
    shared->stage = 1;
    stay(mine);
  });
  await(1);
  const std::uint64_t before = raw(shared->seat);
  child.kill9();
  CHECK(raw(shared->seat) == before);
}

TEST_CASE_FIXTURE(Fixture, "what another process has written there is set right, and still told") {
  Child child = claimer([&](DeathNotice& mine) {
    while (seat::notice(raw(shared->seat)) != 12345) std::this_thread::sleep_for(100us);
    must(mine.renew(), "the same incarnation");
    must(seat::notice(raw(shared->seat)) != 12345, "its notice");
    shared->stage = 2;
    stay(mine);
  });
  raw(shared->seat) = seat::make(incarnation(), 12345);
  await(2);
  CHECK(stands());
  child.kill9();
  CHECK(is_told());
}

TEST_CASE_FIXTURE(Fixture, "a seat that another process has taken is left to it") {
  Child child = claimer([&](DeathNotice& mine) {
    while (seat::notice(raw(shared->seat)) != 12345) std::this_thread::sleep_for(100us);
    must(!mine.renew(), "another incarnation");
    mine.end();
  });
  const std::uint64_t others = seat::make(incarnation() + 1, 12345);
  raw(shared->seat) = others;
  CHECK(child.wait() == 0);
  CHECK(raw(shared->seat) == others);
}

TEST_CASE_FIXTURE(Fixture, "a seat is claimed again once it was given up") {
  Child child = claimer([&](DeathNotice& mine) {
    mine.end();
    must(raw(shared->seat) == seat::make(1, 0), "given up");
    must(!mine.claim(shared->seat, 0), "an older look");
    must(mine.claim(shared->seat, raw(shared->seat)), "the seat again");
    shared->stage = 2;
    stay(mine);
  });
  await(2);
  CHECK(stands());
  CHECK(incarnation() == 2);
  child.kill9();
  CHECK(is_told());
}

TEST_CASE_FIXTURE(Fixture, "a forked child neither keeps the notice nor gives it") {
  Child child = claimer([&](DeathNotice& mine) {
    if (fork() == 0) {
      shared->stage = 2;
      _exit(0);
    }
    int status;
    wait(&status);
    must(stands(), "its notice");
    if (fork() == 0) {  // outlives its parent
      while (!is_told()) std::this_thread::sleep_for(1ms);
      _exit(0);
    }
    shared->stage = 3;
    stay(mine);
  });
  await(3);
  CHECK(seat::stands(raw(shared->seat)));
  child.kill9();
  CHECK(is_told());
}

TEST_CASE_FIXTURE(Fixture, "two of one process, as of two segments or library copies") {
  DeathNotice::Seat& second = shared->before;
  raw(second) = 0;
  Child child = claimer([&](DeathNotice& mine) {
    DeathNotice other;
    must(other.claim(second, 0), "the second seat");
    shared->stage = 2;
    stay(mine);
  });
  await(2);
  CHECK(seat::stands(raw(shared->seat)));
  CHECK(seat::stands(raw(second)));
  child.kill9();
  CHECK(is_told());
  CHECK((raw(second) & seat::kDied) != 0);
  raw(second) = 0x1111111111111111;
}

TEST_CASE_FIXTURE(Fixture, "without a list of the kernel's the byte speaks alone") {
  Child child([&] {
    must(refuse(SYS_set_robust_list, EPERM), "a filter");
    DeathNotice mine;
    must(mine.claim(shared->seat, 0), "the seat");
    must(seat::notice(raw(shared->seat)) == seat::kUnwitnessed, "that there is no notice");
  });
  CHECK(child.wait() == 0);
  CHECK(raw(shared->seat) == seat::make(1, 0));
}

TEST_SUITE_END();
