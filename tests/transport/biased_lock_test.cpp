// SPDX-License-Identifier: Apache-2.0
#include "transport/biased_lock.hpp"

#include <atomic>
#include <chrono>
#include <ctime>
#include <mutex>
#include <pthread.h>
#include <sched.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "support/lent_priority.hpp"

using lot::transport::BiasedLock;
using namespace std::chrono_literals;

namespace {

#if defined(__SANITIZE_THREAD__)
constexpr bool kHasBias = false;  // ThreadSanitizer does not know of membarrier
#elif defined(__has_feature)
constexpr bool kHasBias = !__has_feature(thread_sanitizer);
#else
constexpr bool kHasBias = true;
#endif

}  // namespace

TEST_SUITE("transport") {
  TEST_CASE("a lock that one thread had to itself excludes the threads that come later") {
    alarm(100);
    constexpr int kRounds = 200;
    constexpr long kEach = 2000;
    for (int round = 0; round < kRounds; ++round) {
      BiasedLock lock;
      long plain = 0;  // not atomic: two threads inside at once lose counts, and TSan sees them
      std::atomic<bool> go{false};
      std::vector<std::thread> others;
      for (int t = 0; t < 2; ++t) {
        others.emplace_back([&] {
          while (!go.load(std::memory_order_acquire)) {
          }
          for (long i = 0; i < kEach; ++i) {
            const std::lock_guard guard(lock);
            plain = plain + 1;
          }
        });
      }
      for (long i = 0; i < kEach; ++i) {  // the others come while the owner is at it
        if (i == kEach / 4) go.store(true, std::memory_order_release);
        const std::lock_guard guard(lock);
        plain = plain + 1;
      }
      for (auto& t : others) t.join();
      REQUIRE(plain == 3 * kEach);
    }
    alarm(0);
  }

  TEST_CASE("an owner that has the lock to itself again needs no locked operation again") {
    BiasedLock lock;
    const auto visit = [&] { const std::lock_guard guard(lock); };
    visit();
    if (!kHasBias) {
      CHECK_FALSE(lock.is_biased());
      return;
    }
    REQUIRE(lock.is_biased());
    for (int round = 0; round < 3; ++round) {
      CAPTURE(round);
      std::thread(visit).join();
      CHECK_FALSE(lock.is_biased());
      for (std::uint32_t n = 1; n < BiasedLock::kReturn; ++n) visit();
      std::thread(visit).join();  // one that comes in between begins it anew
      for (std::uint32_t n = 1; n < BiasedLock::kReturn; ++n) visit();
      CHECK_FALSE(lock.is_biased());
      visit();
      CHECK(lock.is_biased());
    }
    for (std::uint32_t n = 0; n < 2 * BiasedLock::kReturn; ++n) std::thread(visit).join();
    CHECK_FALSE(lock.is_biased());  // the others never become the owner
  }

  TEST_CASE("a lock whose owner has it to itself now and then excludes the threads that come") {
    alarm(100);
    constexpr long kVisits = 300;
    BiasedLock lock;
    long plain = 0;  // as above
    long owners = 0;
    std::atomic<int> at_work{2};
    std::vector<std::thread> others;
    { const std::lock_guard guard(lock); }
    for (int t = 0; t < 2; ++t) {
      others.emplace_back([&] {
        for (long i = 0; i < kVisits; ++i) {
          std::this_thread::sleep_for(200us);  // the owner gets its way meanwhile
          const std::lock_guard guard(lock);
          plain = plain + 1;
        }
        --at_work;
      });
    }
    while (at_work != 0) {
      const std::lock_guard guard(lock);
      plain = plain + 1;
      ++owners;
    }
    for (auto& t : others) t.join();
    CHECK(plain == owners + 2 * kVisits);
    alarm(0);
  }

  TEST_CASE("the owner may be gone when other threads take the lock") {
    BiasedLock lock;
    int inside = 0;
    const auto visit = [&] {
      const std::lock_guard guard(lock);
      ++inside;
    };
    std::thread(visit).join();
    std::thread(visit).join();
    visit();
    CHECK(inside == 3);
  }

  TEST_CASE("a thread with a real-time priority, on the owner's core, lets the owner out") {
    alarm(100);
    cpu_set_t before;
    REQUIRE(pthread_getaffinity_np(pthread_self(), sizeof before, &before) == 0);
    cpu_set_t one;  // threads that start from here share it
    CPU_ZERO(&one);
    CPU_SET(sched_getcpu(), &one);
    REQUIRE(pthread_setaffinity_np(pthread_self(), sizeof one, &one) == 0);
    BiasedLock lock;
    std::atomic<bool> inside{false};
    std::atomic<bool> came{false};
    double seconds = -1;  // of processor time
    std::thread owner([&] {
      { const std::lock_guard first(lock); }  // which makes it the owner
      const std::lock_guard guard(lock);
      inside.store(true);
      while (!came.load()) std::this_thread::yield();
    });
    std::thread hurried([&] {
      sched_param priority{};
      priority.sched_priority = 1;
      const bool may = pthread_setschedparam(pthread_self(), SCHED_FIFO, &priority) == 0;
      while (!inside.load()) std::this_thread::sleep_for(1ms);
      came.store(true);
      const std::lock_guard guard(lock);
      timespec used{};
      clock_gettime(CLOCK_THREAD_CPUTIME_ID, &used);
      if (may) seconds = static_cast<double>(used.tv_sec) + static_cast<double>(used.tv_nsec) / 1e9;
    });
    owner.join();
    hurried.join();
    pthread_setaffinity_np(pthread_self(), sizeof before, &before);
    if (seconds < 0) MESSAGE("skipped: no real-time priority here");
    // Who only spins uses what the kernel leaves to such threads, 0.95 s of the first one.
    CHECK(seconds < 0.5);
    alarm(0);
  }

  TEST_CASE("a thread that waits for the lock lends its priority to the one that has it") {
    if (const char* reason = lot::test::LentPriority::lacking()) {
      MESSAGE("skipped: " << std::string(reason));
      return;
    }
    alarm(100);
    BiasedLock lock;
    const auto visit = [&] { const std::lock_guard guard(lock); };
    visit();
    std::thread(visit).join();  // without a bias from now on
    CHECK(lot::test::LentPriority::turns_in_between([&] { lock.lock(); }, [&] { lock.unlock(); },
                                                    visit) == 0);
    alarm(0);
  }
}
