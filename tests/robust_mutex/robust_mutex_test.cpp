// SPDX-License-Identifier: Apache-2.0
// The robust mutex between real processes, one of which is killed.

#include "robust_mutex/robust_mutex.hpp"

#include <atomic>
#include <chrono>
#include <elf.h>
#include <linux/futex.h>
#include <new>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/user.h>
#include <sys/wait.h>
#include <unistd.h>

#include <doctest/doctest.h>

namespace {

using lot::RobustMutex;
using Outcome = RobustMutex::Outcome;
using namespace std::chrono_literals;

/// What two processes share: the lock, a counter that it guards, and a flag to wait for.
struct Shared {
  pthread_mutex_t memory;
  long counter = 0;
  std::atomic<int> stage{0};
};

/// A Shared of one case. A case that hangs is ended by SIGALRM, in the children as well.
class Fixture {
 public:
  Fixture() {
    alarm(60);
    void* at =
        mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    REQUIRE(at != MAP_FAILED);
    shared = new (at) Shared;
    RobustMutex::construct(shared->memory);
  }
  ~Fixture() {
    munmap(shared, sizeof(Shared));
    alarm(0);
  }
  Fixture(const Fixture&) = delete;
  Fixture& operator=(const Fixture&) = delete;

 protected:
  /// Runs body in a child process, which then exits with 0 for true.
  template <class Body>
  pid_t in_child(Body&& body) {
    const pid_t pid = fork();
    REQUIRE(pid >= 0);
    if (pid == 0) {
      alarm(60);  // is not inherited
      _exit(body() ? 0 : 1);
    }
    return pid;
  }

  /// The same as the first process of a PID namespace, whose thread id is 1. Calls then(its pid).
  template <class Body, class Then>
  pid_t in_namespace(Body&& body, Then&& then) {
    return in_child([&] {
      if (unshare(CLONE_NEWPID) != 0 && unshare(CLONE_NEWUSER | CLONE_NEWPID) != 0) return false;
      const pid_t pid = fork();
      if (pid == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        _exit(body() ? 0 : 1);
      }
      then(pid);
      return pid > 0 && status_of(pid) == 0;
    });
  }

  static int status_of(pid_t pid) {
    int status = -1;
    REQUIRE(waitpid(pid, &status, 0) == pid);
    return status;
  }

  void wait_for_stage(int stage) const {
    while (shared->stage != stage) usleep(200);
  }

  Shared* shared = nullptr;
};

/// Adds to a counter that only the lock guards; false if the lock ever says anything but Locked.
bool count(Shared& shared, int rounds) {
  RobustMutex mutex(shared.memory);
  for (int i = 0; i < rounds; ++i) {
    if (mutex.lock_for(30s) != Outcome::Locked) return false;
    const long seen = shared.counter;
    if (i % 64 == 0) usleep(1);  // let the other one run into the lock
    shared.counter = seen + 1;
    mutex.unlock();
  }
  return true;
}

}  // namespace

TEST_SUITE_BEGIN("robust_mutex");

TEST_CASE_FIXTURE(Fixture, "two processes that count under the lock lose no count") {
  const int rounds = 5000;
  const pid_t child = in_child([&] { return count(*shared, rounds); });
  CHECK(count(*shared, rounds));
  CHECK(status_of(child) == 0);
  CHECK(shared->counter == 2 * rounds);
}

TEST_CASE_FIXTURE(Fixture, "a free lock is locked at once, also by a timeout of nothing") {
  RobustMutex mutex(shared->memory);
  CHECK((mutex.try_lock() == Outcome::Locked));
  mutex.unlock();
  CHECK((mutex.lock_for(0ns) == Outcome::Locked));
  mutex.unlock();
}

TEST_CASE_FIXTURE(Fixture,
                  "a lock that another process holds is busy, at once or after the timeout") {
  const pid_t child = in_child([this] {
    RobustMutex mutex(shared->memory);
    if (mutex.try_lock() != Outcome::Locked) return false;
    shared->stage = 1;
    wait_for_stage(2);
    mutex.unlock();
    return true;
  });
  wait_for_stage(1);
  RobustMutex mutex(shared->memory);
  CHECK((mutex.try_lock() == Outcome::Busy));
  const auto begin = std::chrono::steady_clock::now();
  CHECK((mutex.lock_for(30ms) == Outcome::Busy));
  CHECK((std::chrono::steady_clock::now() - begin >= 30ms));
  CHECK((mutex.lock_for(0ns) == Outcome::Busy));
  shared->stage = 2;
  CHECK((mutex.lock_for(30s) == Outcome::Locked));
  mutex.unlock();
  CHECK(status_of(child) == 0);
}

TEST_CASE_FIXTURE(Fixture,
                  "after a holder was killed the next one is told, and then all is normal") {
  RobustMutex mutex(shared->memory);
  for (int death = 0; death < 3; ++death) {
    shared->stage = 0;
    const pid_t holder = in_child([this] {
      if (RobustMutex(shared->memory).lock_for(30s) != Outcome::Locked) return false;
      shared->stage = 1;
      for (;;) pause();
    });
    wait_for_stage(1);
    CHECK((mutex.try_lock() == Outcome::Busy));
    REQUIRE(kill(holder, SIGKILL) == 0);
    CHECK((mutex.lock_for(30s) == Outcome::OwnerDied));
    CHECK(WIFSIGNALED(status_of(holder)));
    mutex.unlock();
    CHECK((mutex.try_lock() == Outcome::Locked));
    mutex.unlock();
    CHECK(status_of(in_child([this] { return count(*shared, 10); })) == 0);
  }
}

TEST_CASE_FIXTURE(Fixture, "a waiter that sleeps already is told when the holder is killed") {
  const pid_t holder = in_child([this] {
    if (RobustMutex(shared->memory).lock_for(30s) != Outcome::Locked) return false;
    shared->stage = 1;
    for (;;) pause();
  });
  wait_for_stage(1);
  const pid_t waiter = in_child([this] {
    RobustMutex mutex(shared->memory);
    shared->stage = 2;
    const bool told = mutex.lock_for(30s) == Outcome::OwnerDied;
    mutex.unlock();
    return told;
  });
  wait_for_stage(2);
  usleep(20'000);  // most likely asleep by now; right in any case
  REQUIRE(kill(holder, SIGKILL) == 0);
  CHECK(status_of(waiter) == 0);
  CHECK(WIFSIGNALED(status_of(holder)));
  CHECK((RobustMutex(shared->memory).try_lock() == Outcome::Locked));
  RobustMutex(shared->memory).unlock();
}

TEST_CASE_FIXTURE(Fixture, "who watches is woken when the holder is killed, and when it unlocks") {
  RobustMutex mutex(shared->memory);
  CHECK_FALSE(mutex.watch());  // nobody holds it
  for (const bool killed : {true, false}) {
    CAPTURE(killed);
    shared->stage = 0;
    const pid_t holder = in_child([this, killed] {
      RobustMutex mine(shared->memory);
      if (mine.lock_for(30s) == Outcome::Busy) return false;
      shared->stage = 1;
      wait_for_stage(2);
      usleep(20'000);  // the other one is most likely asleep by now; right in any case
      if (killed) kill(getpid(), SIGKILL);
      mine.unlock();
      return true;
    });
    wait_for_stage(1);
    const auto watched = mutex.watch();
    REQUIRE(watched);
    shared->stage = 2;
    const auto until = lot::futex::Clock::now() + 10s;
    while (mutex.looks_held() && lot::futex::wait(watched->word, watched->value, until)) {
    }
    REQUIRE_FALSE(mutex.looks_held());
    CHECK_FALSE(mutex.watch());
    CHECK(WIFSIGNALED(status_of(holder)) == killed);
  }
  CHECK((mutex.try_lock() == Outcome::Locked));  // the one after the dead one has made it good
  mutex.unlock();
}

TEST_CASE_FIXTURE(Fixture, "one that was told and is killed itself leaves the same to the next") {
  auto die_holding = [this](Outcome expected) {
    return in_child([this, expected] {
      if (RobustMutex(shared->memory).lock_for(30s) != expected) return false;
      kill(getpid(), SIGKILL);
      return false;
    });
  };
  CHECK(WIFSIGNALED(status_of(die_holding(Outcome::Locked))));
  CHECK(WIFSIGNALED(status_of(die_holding(Outcome::OwnerDied))));
  CHECK(WIFSIGNALED(status_of(die_holding(Outcome::OwnerDied))));
  RobustMutex mutex(shared->memory);
  CHECK((mutex.try_lock() == Outcome::OwnerDied));
  mutex.unlock();
  CHECK((mutex.lock_for(30s) == Outcome::Locked));
  mutex.unlock();
}

TEST_CASE_FIXTURE(Fixture, "a waiter that is killed in another PID namespace frees no holder") {
  const auto nothing = [](pid_t) {};
  if (status_of(in_namespace([] { return getpid() == 1; }, nothing)) != 0) {
    MESSAGE("skipped: no PID namespaces here");
    return;
  }
  const pid_t holder = in_namespace(
      [this] {
        RobustMutex mutex(shared->memory);
        if (mutex.lock_for(30s) != Outcome::Locked) return false;
        shared->stage = 1;
        wait_for_stage(3);
        mutex.unlock();
        return true;
      },
      nothing);
  wait_for_stage(1);
  const pid_t waiter = in_namespace(
      [this] {
        shared->stage = 2;
        return RobustMutex(shared->memory).lock_for(30s) == Outcome::Locked;
      },
      [this](pid_t pid) {
        wait_for_stage(2);
        usleep(20'000);  // most likely asleep by now; right in any case
        kill(pid, SIGKILL);
      });
  CHECK(status_of(waiter) != 0);
  CHECK((RobustMutex(shared->memory).try_lock() == Outcome::Busy));
  shared->stage = 3;
  CHECK(status_of(holder) == 0);
  CHECK((RobustMutex(shared->memory).lock_for(30s) == Outcome::Locked));
  RobustMutex(shared->memory).unlock();
}

TEST_CASE_FIXTURE(Fixture,
                  "who unlocks wakes others when the kernel no longer counts it as owner") {
  const pid_t holder = in_child([this] {
    ptrace(PTRACE_TRACEME, 0, nullptr, nullptr);
    raise(SIGSTOP);
    RobustMutex mutex(shared->memory);
    if (mutex.lock_for(30s) != Outcome::Locked) return false;
    shared->stage = 1;
    wait_for_stage(2);
    mutex.unlock();
    return true;
  });
  const pid_t waiter = in_child([this] {
    wait_for_stage(1);
    RobustMutex mutex(shared->memory);
    if (mutex.lock_for(30s) != Outcome::Locked) return false;
    mutex.unlock();
    return true;
  });
  int status = 0;
  REQUIRE(waitpid(holder, &status, 0) == holder);
  robust_list_head* list = nullptr;
  std::size_t size = 0;
  REQUIRE(syscall(SYS_get_robust_list, holder, &list, &size) == 0);
  const auto* const pending = &list->list_op_pending;  // in the holder's memory
  unsigned wakes = 0;
  while (ptrace(PTRACE_SYSCALL, holder, nullptr, nullptr) == 0 &&
         waitpid(holder, &status, 0) == holder && WIFSTOPPED(status)) {
    CHECK(ptrace(PTRACE_PEEKDATA, holder, pending, nullptr) == 0);
    user_regs_struct registers{};
    iovec where{&registers, sizeof registers};
    REQUIRE(ptrace(PTRACE_GETREGSET, holder, NT_PRSTATUS, &where) == 0);
#if defined(__x86_64__)
    wakes += registers.orig_rax == SYS_futex;
#elif defined(__aarch64__)
    wakes += registers.regs[8] == SYS_futex;
#endif
    if (shared->stage == 1 &&
        (shared->memory.__data.__lock & static_cast<int>(FUTEX_WAITERS)) != 0) {
      shared->stage = 2;
    }
  }
  CHECK(WIFEXITED(status));
  CHECK(WEXITSTATUS(status) == 0);
  CHECK(wakes > 0);  // its entry and its exit
  CHECK(status_of(waiter) == 0);
}

TEST_CASE_FIXTURE(Fixture, "three that sleep are let in one after the other") {
  RobustMutex mutex(shared->memory);
  CHECK((mutex.lock_for(30s) == Outcome::Locked));
  pid_t waiters[3];
  for (pid_t& waiter : waiters) {
    waiter = in_child([this] {
      ++shared->stage;
      RobustMutex mine(shared->memory);
      if (mine.lock_for(30s) != Outcome::Locked) return false;
      usleep(1'000);
      mine.unlock();
      return true;
    });
  }
  wait_for_stage(3);
  usleep(20'000);  // most likely asleep by now; right in any case
  mutex.unlock();
  for (const pid_t waiter : waiters) CHECK(status_of(waiter) == 0);
  CHECK(shared->memory.__data.__lock == 0);
}

TEST_SUITE_END();
