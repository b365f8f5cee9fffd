// SPDX-License-Identifier: Apache-2.0

// A time of a push that is written while readers ask for it. In a file of its own, for
// ThreadSanitizer, which bears no fork in a process with threads.

#include <atomic>
#include <chrono>
#include <cstdint>
#include <thread>
#include <utility>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/both_engines.hpp"
#include "support/in_blocks.hpp"

namespace {

using namespace lot::testing;
using lot::QueueEngine;
using lot::Status;
using Clock = std::chrono::steady_clock;

struct Ball {
  std::uint64_t number;
};

lot::PusherOptions stamping(QueueEngine engine) {
  lot::PusherOptions options;
  options.engine = engine;
  options.stamp = true;
  return options;
}

void push(lot::ShmPusher<Ball>& pusher, std::uint64_t number) {
  auto message = pusher.loan();
  message->number = number;
  must(pusher.push(std::move(message)) == Status::Ok, "pushed");
}

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE_FIXTURE(BothEngines, "a reader asks for an envelope while its message is pushed again") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto out = shm.advertise<Ball>("/t", in_blocks(stamping(engine)));
    auto in = shm.subscribe<Ball>("/t");
    push(out, 5);
    const auto ball = in.try_pull();
    REQUIRE(ball != nullptr);
    const auto before = Clock::now();
    std::atomic<bool> is_done{false};
    std::thread pushes([&] {
      for (int n = 0; n < 2000; ++n) must(out.push(ball) == Status::Ok, "pushed");
      is_done.store(true, std::memory_order_release);
    });
    auto last = *in.envelope().pushed;
    bool is_later = true;
    while (!is_done.load(std::memory_order_acquire)) {
      const auto now = *in.envelope().pushed;
      is_later = is_later && now >= last;
      last = now;
    }
    pushes.join();
    CHECK(is_later);
    CHECK(*in.envelope().pushed >= before);
  });
}

TEST_CASE_FIXTURE(BothEngines, "a reader asks for the envelope of a message that dies meanwhile") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    lot::PusherOptions shallow = stamping(engine);
    shallow.depth = 1;
    auto out = shm.advertise<Ball>("/t", shallow);
    auto in = shm.subscribe<Ball>("/t");
    push(out, 0);
    const auto before_next = [&] {  // the message is let go of at once
      const auto ball = in.try_pull();
      must(ball != nullptr, "a ball");
      return Clock::now();
    }();
    std::atomic<bool> is_done{false};
    std::thread pushes([&] {
      for (std::uint64_t n = 1; n < 2000; ++n) push(out, n);
      is_done.store(true, std::memory_order_release);
    });
    bool is_its_own = true;  // never the time of a later message in the block
    while (!is_done.load(std::memory_order_acquire)) {
      const auto pushed = in.envelope().pushed;
      is_its_own = is_its_own && (!pushed || *pushed <= before_next);
    }
    pushes.join();
    CHECK(is_its_own);
  });
}

TEST_SUITE_END();
