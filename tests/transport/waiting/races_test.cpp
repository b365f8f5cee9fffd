// SPDX-License-Identifier: Apache-2.0
// What threads of one process share while they wait. ThreadSanitizer judges: payloads and reasons
// are plain memory.
#include <atomic>
#include <csignal>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "support/both_engines.hpp"
#include "support/must_go.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::Status;
using lot::WaitSet;

struct Number {
  int value = 0;
};

using Fixture = BothEngines;
constexpr int kThreads = 3;
constexpr int kEach = 1500;

/// Now and then the reader is slow, so that the queue is full, and then the writers are.
void dawdle(int n) {
  if (n % 64 == 0) std::this_thread::sleep_for(300us);
}

}  // namespace

TEST_SUITE_BEGIN("races");

TEST_CASE_FIXTURE(Fixture, "threads that push into one full queue wait without a data race") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", {Policy::Block, 2, 1h, engine});
    auto puller = shm.subscribe<Number>("/t");
    std::vector<std::thread> threads;
    std::atomic<int> refused{0};
    for (int t = 0; t < kThreads; ++t) {
      threads.emplace_back([&] {
        for (int n = 0; n < kEach; ++n) refused += pusher.push(pusher.loan()) != Status::Ok;
      });
    }
    for (int n = 0; n < kThreads * kEach; ++n) {
      CHECK(puller.pull(1h));
      dawdle(n);
    }
    for (std::thread& thread : threads) thread.join();
    CHECK(refused == 0);
  });
}

TEST_CASE_FIXTURE(Fixture, "threads that put and pop on one handle wait without a data race") {
  with_each_engine([&](QueueEngine engine) {
    for (const lot::Wait wait : {lot::Wait::Adaptive, lot::Wait::Park}) {
      lot::ShmEngine shm(options);
      lot::QueueOptions small;
      small.engine = engine;
      small.depth = 2;
      small.wait = wait;
      auto items = shm.queue<Number>("items", small);
      std::vector<std::thread> threads;
      std::atomic<long> sum{0};
      for (int t = 0; t < kThreads; ++t) {
        threads.emplace_back([&] {
          for (int n = 1; n <= kEach / 3; ++n) must_go(items.put({n}));
        });
        threads.emplace_back([&] {
          for (int n = 1; n <= kEach / 3; ++n) {
            sum += items.wait_and_pop().value;
            dawdle(n);
          }
        });
      }
      for (std::thread& thread : threads) thread.join();
      CHECK(sum == kThreads * (kEach / 3) * (kEach / 3 + 1L) / 2);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "what a thread wrote before stop() is there when run() has returned") {
  for (const lot::Wait wait : {lot::Wait::Park, lot::Wait::Spin}) {
    WaitSet set(wait);
    for (int round = 1; round <= 50; ++round) {
      int reason = 0;
      std::thread stopper([&] {
        if (round % 2 == 0) std::this_thread::sleep_for(200us);
        reason = round;
        set.stop();
      });
      set.run();
      CHECK(reason == round);
      stopper.join();
    }
  }
}

TEST_CASE_FIXTURE(Fixture, "of two stop() before one run(), what preceded the first is seen") {
  WaitSet set;
  for (int round = 1; round <= 50; ++round) {
    int first = 0, second = 0;
    // Relaxed, and so of no help to what is written: it only keeps the steps in their order.
    std::atomic<int> stops{0};
    const auto wait_for = [&stops](int n) {
      while (stops.load(std::memory_order_relaxed) != n) std::this_thread::yield();
    };
    std::thread one([&] {
      first = round;
      set.stop();
      stops.store(1, std::memory_order_relaxed);
    });
    std::thread two([&] {
      wait_for(1);
      second = round;
      set.stop();
      stops.store(2, std::memory_order_relaxed);
    });
    wait_for(2);
    set.run();
    CHECK(first + second == 2 * round);
    one.join();
    two.join();
  }
}

TEST_CASE_FIXTURE(Fixture, "what a signal handler writes before stop() is there after run()") {
  static WaitSet* set;
  static int reason;
  WaitSet mine;
  set = &mine;
  struct sigaction action {};
  struct sigaction before {};
  action.sa_handler = [](int) {
    ++reason;
    set->stop();
  };
  sigaction(SIGUSR1, &action, &before);
  for (int round = 1; round <= 20; ++round) {
    std::thread other([] { pthread_kill(pthread_self(), SIGUSR1); });
    mine.run();
    CHECK(reason == round);
    other.join();
  }
  sigaction(SIGUSR1, &before, nullptr);
}

TEST_SUITE_END();
