// SPDX-License-Identifier: Apache-2.0
#include "transport/biased_lock.hpp"

#include <atomic>
#include <memory>
#include <mutex>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

using lot::transport::BiasedLock;

TEST_SUITE("transport") {
  TEST_CASE("a lock that one thread had to itself excludes those who come later") {
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

  TEST_CASE("the owner may be gone when others take the lock") {
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
}
