// SPDX-License-Identifier: Apache-2.0

// The check of the order of private locks finds inversions that are planted here. This file is
// compiled with the check in every build; in release the library is not.

#include <chrono>
#include <csignal>
#include <mutex>
#include <string>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/detail/mutex.hpp"

namespace {

using lot::detail::Condition;
using lot::detail::Mutex;
using lot::detail::Rank;

/// What a process says that f() ends by abort(); empty: f() returns.
template <class F>
std::string complaint_of(F&& f) {
  int ends[2];
  REQUIRE(pipe(ends) == 0);
  const pid_t child = fork();
  if (child == 0) {
    std::signal(SIGABRT, SIG_DFL);  // doctest's handler would speak, too
    dup2(ends[1], STDERR_FILENO);
    f();
    _exit(0);
  }
  close(ends[1]);
  std::string text;
  char piece[256];
  for (ssize_t n; (n = read(ends[0], piece, sizeof(piece))) > 0;) {
    text.append(piece, static_cast<std::size_t>(n));
  }
  close(ends[0]);
  int status = 0;
  REQUIRE(waitpid(child, &status, 0) == child);
  CHECK(text.empty() == (WIFEXITED(status) && WEXITSTATUS(status) == 0));
  CHECK((text.empty() || (WIFSIGNALED(status) && WTERMSIG(status) == SIGABRT)));
  return text;
}

bool names(const std::string& text, const char* first, const char* second) {
  const auto at = text.find(std::string("holds the lock ") + first + ' ');
  return at != std::string::npos && text.find(std::string("the lock ") + second, at) != text.npos;
}

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("a thread that takes private locks in their order may go on, however it unlocks them") {
  Mutex outer(Rank::Settle), middle(Rank::Pools), inner(Rank::Process);
  CHECK(complaint_of([&] {
          for (int i = 0; i < 3; ++i) {
            outer.lock();
            middle.lock();
            inner.lock();
            middle.unlock();
            outer.unlock();
            inner.unlock();
          }
        }).empty());
}

TEST_CASE("a thread that waits for an outer lock while it has an inner one ends with both names") {
  Mutex outer(Rank::Settle), inner(Rank::Pools);
  CHECK(names(complaint_of([&] {
                const std::lock_guard first(inner);
                const std::lock_guard second(outer);
              }),
              "Pools", "Settle"));
}

TEST_CASE("a thread that waits for a second lock of one rank ends, for two threads may cross") {
  Mutex one(Rank::Pools), another(Rank::Pools);
  CHECK(names(complaint_of([&] {
                const std::lock_guard first(one);
                const std::lock_guard second(another);
              }),
              "Pools", "Pools"));
}

TEST_CASE("a thread may try any lock, and what it gets counts") {
  Mutex outer(Rank::Topics), middle(Rank::Reap), inner(Rank::Pools);
  CHECK(complaint_of([&] {
          const std::lock_guard first(inner);
          const std::unique_lock second(outer, std::try_to_lock);
          if (!second) _exit(1);
        }).empty());
  CHECK(names(complaint_of([&] {
                const std::unique_lock first(inner, std::try_to_lock);
                const std::lock_guard second(middle);
              }),
              "Pools", "Reap"));
}

TEST_CASE("each thread has locks of its own") {
  Mutex outer(Rank::Settle), inner(Rank::Pools);
  CHECK(complaint_of([&] {
          const std::lock_guard first(inner);
          std::thread([&] { const std::lock_guard second(outer); }).join();
        }).empty());
}

TEST_CASE("a thread that sleeps on a Condition does not have its lock, and has it when it wakes") {
  Mutex mutex(Rank::Ahead), outer(Rank::Settle), inner(Rank::Process);
  Condition condition;
  bool is_set = false;
  const auto sleep = [&](std::unique_lock<Mutex>& lock) {
    std::thread other([&] {
      const std::lock_guard guard(mutex);
      is_set = true;
      condition.notify_all();
    });
    condition.wait(lock, [&] { return is_set; });
    other.join();
  };
  CHECK(complaint_of([&] {
          const std::lock_guard holds(outer);
          std::unique_lock lock(mutex);
          sleep(lock);
          const std::lock_guard more(inner);
        }).empty());
  CHECK(names(complaint_of([&] {
                std::unique_lock lock(mutex);
                sleep(lock);
                const std::lock_guard second(outer);
              }),
              "Ahead", "Settle"));
  CHECK(names(complaint_of([&] {
                std::unique_lock lock(mutex);
                const std::lock_guard holds(inner);
                sleep(lock);  // it would wake, and wait for its lock with an inner one
              }),
              "Process", "Ahead"));
}

TEST_CASE("a Condition that is not set in time says so, with its lock") {
  Mutex mutex(Rank::Ahead);
  Condition condition;
  std::unique_lock lock(mutex);
  CHECK(!condition.wait_for(lock, std::chrono::milliseconds(1), [] { return false; }));
  CHECK(lock.owns_lock());
  CHECK(condition.wait_for(lock, std::chrono::milliseconds(1), [] { return true; }));
}

TEST_CASE("a thread that unlocks what it does not have ends") {
  Mutex mutex(Rank::Pools);
  CHECK(complaint_of([&] { mutex.unlock(); }).find("does not hold") != std::string::npos);
}
