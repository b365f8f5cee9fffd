// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <functional>
#include <linux/futex.h>
#include <pthread.h>
#include <sched.h>
#include <sys/syscall.h>
#include <thread>
#include <unistd.h>

namespace lot::test {

/// Three threads on one core: one that is inside of something, one that keeps the core with a
/// real-time priority, and one with a higher priority that wants in.
///
/// The first thread can only go on when the last one lends it its priority: then the one in between
/// does not get a turn before it has left. Where the last one sleeps instead, it gets all of them
/// (but for what the kernel leaves to ordinary threads, 0.05 s of each second).
class LentPriority {
 public:
  /// Why it can not be tried here, or null.
  static const char* lacking() {
    std::uint32_t futex = 0;
    constexpr int kLockPi2 = 13;
    if (syscall(SYS_futex, &futex, kLockPi2 | FUTEX_PRIVATE_FLAG, 0, nullptr, nullptr, 0) != 0) {
      return "no FUTEX_LOCK_PI2 here";
    }
    bool may = false;
    std::thread([&] { may = become(kHigh); }).join();
    return may ? nullptr : "no real-time priority here";
  }

  /// Turns that the thread in between had while the last one waited.
  static std::uint64_t turns_in_between(const std::function<void()>& enter,
                                        const std::function<void()>& leave,
                                        const std::function<void()>& want_in) {
    std::atomic<bool> inside{false};
    std::atomic<bool> wanted{false};
    std::atomic<bool> done{false};
    std::atomic<std::uint64_t> turns{0};
    std::uint64_t at_first = 0;
    std::uint64_t at_last = 0;
    cpu_set_t before;
    pthread_getaffinity_np(pthread_self(), sizeof before, &before);
    cpu_set_t one;  // threads that start from here share it
    CPU_ZERO(&one);
    CPU_SET(sched_getcpu(), &one);
    pthread_setaffinity_np(pthread_self(), sizeof one, &one);
    std::thread low([&] {
      enter();
      inside.store(true);
      while (!wanted.load()) sched_yield();
      at_last = turns.load();
      leave();
    });
    while (!inside.load()) sched_yield();
    std::thread high([&] {
      become(kHigh);
      while (turns.load() == 0) usleep(1000);
      at_first = turns.load();
      wanted.store(true);
      want_in();
      done.store(true);
    });
    std::thread between([&] {
      become(kBetween);
      while (!done.load()) turns.fetch_add(1);
    });
    high.join();
    between.join();
    low.join();
    pthread_setaffinity_np(pthread_self(), sizeof before, &before);
    return at_last - at_first;
  }

 private:
  static constexpr int kBetween = 1;
  static constexpr int kHigh = 2;
  static bool become(int priority) {
    sched_param p{};
    p.sched_priority = priority;
    return pthread_setschedparam(pthread_self(), SCHED_FIFO, &p) == 0;
  }
};

}  // namespace lot::test
