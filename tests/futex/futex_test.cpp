// SPDX-License-Identifier: Apache-2.0
// Sleeping on words that another process changes. A lost wake is an endless sleep: the watchdog of
// Fixture ends it.

#include "futex/futex.hpp"

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <new>
#include <optional>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/patience.hpp"

#include "support/sandbox.hpp"

namespace {

namespace futex = lot::futex;
using namespace std::chrono_literals;
using Word = std::atomic<std::uint32_t>;
using lot::detail::FutexWaits;

struct Shared {
  Word words[4] = {};
  std::atomic<std::uint64_t> slot{0};
};

/// Words that a child process shares. A case that hangs is ended by SIGALRM, in the child as well.
class Fixture {
 public:
  Fixture() {
    alarm(60);
    void* at =
        mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    REQUIRE(at != MAP_FAILED);
    shared = new (at) Shared;
  }
  ~Fixture() {
    munmap(shared, sizeof(Shared));
    alarm(0);
  }
  Fixture(const Fixture&) = delete;
  Fixture& operator=(const Fixture&) = delete;

 protected:
  template <class Body>
  pid_t in_child(Body&& body) {
    const pid_t pid = fork();
    REQUIRE(pid >= 0);
    if (pid == 0) {
      alarm(60);  // is not inherited
      body();
      _exit(0);
    }
    return pid;
  }

  static int status_of(pid_t pid) {
    int status = -1;
    REQUIRE(waitpid(pid, &status, 0) == pid);
    return status;
  }

  Shared* shared = nullptr;
};

void wait_until(Word& word, std::uint32_t value) {
  for (std::uint32_t seen; (seen = word) != value;) futex::wait(&word, seen, std::nullopt);
}

/// A thread that does nothing, as long as this object is there.
struct Idle {
  Idle() {
    while ((id = asked.load()) == 0) std::this_thread::yield();
  }
  ~Idle() {
    ends = true;
    thread.join();
  }
  std::atomic<std::uint32_t> asked{0};
  std::atomic<bool> ends{false};
  std::uint32_t id = 0;
  std::thread thread{[this] {
    asked = static_cast<std::uint32_t>(gettid());
    while (!ends) usleep(100);
  }};
};

/// Until it spins and yields no more, and so often again.
void wait_out(lot::detail::Patience& patience, std::uint32_t thread, int times) {
  for (int n = 0; n < 200; ++n) patience.wait(thread);
  for (int n = 0; n < times; ++n) patience.wait(thread);
}

void set(Word& word, std::uint32_t value) {
  word = value;
  futex::wake_all(&word);
}

}  // namespace

TEST_SUITE_BEGIN("futex");

TEST_CASE_FIXTURE(Fixture, "two processes wake each other, again and again") {
  const std::uint32_t rounds = 2000;
  Word& ping = shared->words[0];
  Word& pong = shared->words[1];
  const pid_t child = in_child([&] {
    for (std::uint32_t i = 1; i <= rounds; ++i) {
      wait_until(ping, i);
      set(pong, i);
    }
  });
  for (std::uint32_t i = 1; i <= rounds; ++i) {
    set(ping, i);
    wait_until(pong, i);
  }
  CHECK(status_of(child) == 0);
}

TEST_CASE_FIXTURE(Fixture, "one wake reaches all sleepers of the word") {
  pid_t children[3];
  for (pid_t& child : children) {
    child = in_child([this] {
      ++shared->words[1];
      wait_until(shared->words[0], 1);
    });
  }
  while (shared->words[1] != 3) usleep(200);
  usleep(10'000);  // most likely asleep by now; right in any case
  set(shared->words[0], 1);
  for (const pid_t child : children) CHECK(status_of(child) == 0);
}

TEST_CASE_FIXTURE(Fixture, "a word that has another value already is not slept on") {
  shared->words[0] = 5;
  CHECK(futex::wait(&shared->words[0], 4, std::nullopt));
  CHECK(futex::wait_any({{&shared->words[1], 0}, {&shared->words[0], 4}}, std::nullopt));
  CHECK(futex::wait_any({{&shared->words[0], 4}}, std::nullopt));
}

TEST_CASE_FIXTURE(Fixture, "a sleep ends when its deadline has passed, and not before") {
  for (const std::size_t count : {0UL, 1UL, 2UL, futex::kMaxWords, 3 * futex::kMaxWords}) {
    CAPTURE(count);  // 0: one word, by wait()
    const FutexWaits waits(count, {&shared->words[0], 0});
    const auto deadline = futex::Clock::now() + 20ms;
    auto sleep = [&] {
      return count == 0 ? futex::wait(&shared->words[0], 0, deadline)
                        : futex::wait_any(waits, deadline);
    };
    while (sleep()) {  // a sleep may end for nothing
    }
    CHECK((futex::Clock::now() >= deadline));
  }
}

TEST_CASE_FIXTURE(Fixture, "a deadline that lies in the past ends the sleep at once") {
  const auto deadline = futex::Clock::now() - 1s;
  const FutexWaits waits{{&shared->words[0], 0}, {&shared->words[1], 0}};
  CHECK_FALSE(futex::wait(&shared->words[0], 0, deadline));
  CHECK_FALSE(futex::wait_any(waits, deadline));
}

TEST_CASE_FIXTURE(Fixture, "a deadline before the epoch has passed, however many words there are") {
  const futex::Clock::time_point epoch;
  const auto all_say_no = [&] {
    bool none = true;
    for (const auto at : {futex::Clock::time_point::min(), epoch - 24h * 30, epoch - 1ns, epoch}) {
      none = none && !futex::wait(&shared->words[0], 0, at);
      for (const std::size_t count : {1UL, 2UL, futex::kMaxWords, 3 * futex::kMaxWords}) {
        none = none && !futex::wait_any(FutexWaits(count, {&shared->words[0], 0}), at);
      }
    }
    return none;
  };
  CHECK(all_say_no());
  const pid_t child = in_child([&] {
    if (!lot::testing::forget_futex_waitv()) _exit(1);
    if (!all_say_no()) _exit(2);
  });
  CHECK(status_of(child) == 0);
}

TEST_CASE_FIXTURE(Fixture, "the last deadline that there is never passes") {
  for (const std::size_t count : {1UL, 2UL, futex::kMaxWords, 3 * futex::kMaxWords}) {
    CAPTURE(count);
    set(shared->words[1], 0);
    const pid_t child = in_child([this] {
      usleep(5'000);
      set(shared->words[1], 1);
    });
    FutexWaits waits(count, {&shared->words[0], 0});
    waits[waits.size() - 1] = {&shared->words[1], 0};
    while (shared->words[1] == 0) CHECK(futex::wait_any(waits, futex::Clock::time_point::max()));
    CHECK(status_of(child) == 0);
  }
}

TEST_CASE_FIXTURE(Fixture, "a wake that comes in time beats the deadline") {
  const pid_t child = in_child([this] {
    usleep(5'000);
    set(shared->words[0], 1);
  });
  const auto deadline = futex::Clock::now() + 60s;
  while (shared->words[0] == 0) CHECK(futex::wait(&shared->words[0], 0, deadline));
  CHECK(status_of(child) == 0);
}

TEST_CASE_FIXTURE(Fixture, "a sleep on many words is ended by a wake on any of them") {
  const std::uint32_t rounds = 500;
  Word* words = shared->words;
  Word& answer = words[3];
  const pid_t child = in_child([&] {
    for (std::uint32_t i = 1; i <= rounds; ++i) {
      set(words[i % 3], i);
      wait_until(answer, i);
    }
  });
  for (std::uint32_t i = 1; i <= rounds; ++i) {
    Word& expected = words[i % 3];
    for (;;) {
      const FutexWaits waits{{&words[0], words[0]}, {&words[1], words[1]}, {&words[2], words[2]}};
      if (expected == i) break;
      futex::wait_any(waits, std::nullopt);
    }
    set(answer, i);
  }
  CHECK(status_of(child) == 0);
}

TEST_CASE_FIXTURE(Fixture, "a wake on the second word ends the sleep") {
  const pid_t child = in_child([this] {
    usleep(10'000);
    set(shared->words[1], 1);
  });
  const FutexWaits waits{{&shared->words[0], 0}, {&shared->words[1], 0}};
  while (shared->words[1] == 0) CHECK(futex::wait_any(waits, std::nullopt));
  CHECK(status_of(child) == 0);
}

TEST_CASE_FIXTURE(Fixture, "of more words than the kernel takes, each one ends the sleep") {
  for (const std::size_t count : {futex::kMaxWords + 1, 3 * futex::kMaxWords}) {
    for (const std::size_t changed : {std::size_t{0}, count / 2, count - 1}) {
      CAPTURE(count);
      CAPTURE(changed);
      FutexWaits waits(count, {&shared->words[0], 0});
      waits[changed] = {&shared->words[1], 1};  // has changed to 0 already
      CHECK(futex::wait_any(waits, std::nullopt));

      waits[changed] = {&shared->words[2], 0};
      set(shared->words[2], 0);
      const pid_t child = in_child([this] {
        usleep(10'000);
        set(shared->words[2], 1);
      });
      while (shared->words[2] == 0) futex::wait_any(waits, std::nullopt);
      CHECK(status_of(child) == 0);
    }
  }
}

TEST_CASE_FIXTURE(Fixture, "where the kernel has no futex_waitv, each word ends the sleep too") {
  for (const std::size_t count : {std::size_t{2}, futex::kMaxWords, 3 * futex::kMaxWords}) {
    CAPTURE(count);
    set(shared->words[2], 0);
    set(shared->words[3], 0);
    const pid_t child = in_child([&] {
      if (!futex::waits_for_many() || !lot::testing::forget_futex_waitv()) _exit(1);
      if (futex::waits_for_many()) _exit(3);
      FutexWaits waits(count, {&shared->words[0], 0});
      const auto deadline = futex::Clock::now() + 20ms;
      while (futex::wait_any(waits, deadline)) {  // looks again now and then
      }
      if (futex::Clock::now() < deadline) _exit(2);
      waits[waits.size() - 1] = {&shared->words[2], 0};
      set(shared->words[3], 1);
      while (shared->words[2] == 0) futex::wait_any(waits, std::nullopt);
    });
    wait_until(shared->words[3], 1);
    usleep(5'000);  // most likely asleep by now; right in any case
    set(shared->words[2], 1);
    CHECK(status_of(child) == 0);
  }
}

TEST_CASE_FIXTURE(Fixture, "the low half of a slot is the half that small numbers change") {
  shared->slot = 0x1122334455667788;
  std::uint32_t low = 0;
  std::memcpy(&low, futex::low_half(shared->slot), sizeof(low));
  CHECK(low == 0x55667788);

  const pid_t child = in_child([this] {
    usleep(5'000);
    ++shared->slot;
    futex::wake_all(futex::low_half(shared->slot));
  });
  while (shared->slot == 0x1122334455667788) {
    futex::wait(futex::low_half(shared->slot), 0x55667788, std::nullopt);
  }
  CHECK(status_of(child) == 0);
}

TEST_CASE_FIXTURE(Fixture, "a thread can be lent to, though one before it in its place has ended") {
  // A loan that nobody gives back takes a millisecond, a nap much less.
  constexpr int kWaits = 20;
  std::uint32_t probe = 0;
  if (syscall(SYS_futex, &probe, 13 /* FUTEX_LOCK_PI2 */, 0, nullptr, nullptr, 0) != 0) {
    MESSAGE("skipped: no FUTEX_LOCK_PI2 here");
    return;
  }
  bool waits_for_the_ended = false;
  SUBCASE("and is not waited for any more") {}
  SUBCASE("and is waited for once more") { waits_for_the_ended = true; }
  std::uint32_t ended = 0;
  {
    const Idle idle;
    ended = idle.id;
    lot::detail::Patience patience;
    wait_out(patience, ended, kWaits);
  }
  if (waits_for_the_ended) {
    lot::detail::Patience patience;
    wait_out(patience, ended, kWaits);
  }
  for (;;) {
    const Idle idle;
    if ((idle.id - ended) % 256 != 0 || idle.id == ended) continue;
    lot::detail::Patience patience;
    wait_out(patience, idle.id, 1);
    const auto begin = futex::Clock::now();
    for (int n = 0; n < kWaits; ++n) patience.wait(idle.id);
    CHECK((futex::Clock::now() - begin >= kWaits * 1ms));
    break;
  }
}

TEST_CASE_FIXTURE(Fixture, "a wake without a sleeper does nothing") {
  futex::wake_all(&shared->words[0]);
  CHECK_FALSE(futex::wait(&shared->words[0], 0, futex::Clock::now() + 1ms));
}

TEST_SUITE_END();
