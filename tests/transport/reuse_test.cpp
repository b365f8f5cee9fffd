// SPDX-License-Identifier: Apache-2.0

// PusherOptions::history: what all readers have read is loaned again, and readers lose nothing.

#include <cstdint>
#include <set>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/both_engines.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::Status;

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr std::size_t kBytes = std::size_t{1} << 20;
constexpr std::uint64_t kFrames = 200;

struct Frame {
  std::uint64_t number;
  unsigned char data[kBytes];
};

lot::PusherOptions keeping(std::uint32_t history, QueueEngine engine = QueueEngine::Ring,
                           Policy policy = Policy::Overwrite) {
  lot::PusherOptions options;
  options.depth = 4;
  options.policy = policy;
  options.engine = engine;
  options.history = history;
  return options;
}
lot::PullerOptions past(std::uint64_t history) {
  lot::PullerOptions options;
  options.history = history;
  return options;
}

/// Returns where the frame lies.
const void* push(lot::ShmPusher<Frame>& pusher, std::uint64_t number) {
  auto frame = pusher.loan();
  const void* const place = frame.get();
  frame->number = number;
  frame->data[0] = frame->data[kBytes - 1] = static_cast<unsigned char>(number);
  must(pusher.push(std::move(frame)) == Status::Ok, "pushed");
  return place;
}
bool is_whole(const Frame& frame, std::uint64_t number) {
  return frame.number == number && frame.data[0] == static_cast<unsigned char>(number) &&
         frame.data[kBytes - 1] == static_cast<unsigned char>(number);
}

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE_FIXTURE(BothEngines, "a frame that its readers have read is the next one's memory") {
  with_each_engine([&](QueueEngine engine_kind) {
    for (const Policy policy : {Policy::Overwrite, Policy::Block, Policy::Refuse}) {
      for (const std::uint32_t history : {0U, 1U, 2U}) {
        CAPTURE(static_cast<int>(policy));
        CAPTURE(history);
        lot::ShmEngine engine(options);
        auto pusher = engine.advertise<Frame>("/frames", keeping(history, engine_kind, policy));
        auto one = engine.subscribe<Frame>("/frames");
        auto two = engine.subscribe<Frame>("/frames");
        std::set<const void*> places;
        for (std::uint64_t n = 0; n < kFrames; ++n) {
          places.insert(push(pusher, n));
          for (auto* reader : {&one, &two}) {
            const auto frame = reader->try_borrow();
            REQUIRE(frame);
            REQUIRE(is_whole(*frame, n));
          }
        }
        // One that is loaned while the newest stay.
        CHECK(places.size() <= history + 1);
        CHECK(one.missed_total() == 0);
        CHECK(two.missed_total() == 0);
      }
    }
  });
}

TEST_CASE_FIXTURE(BothEngines, "by default history is the whole queue, for later readers") {
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Frame>("/frames", keeping(lot::PusherOptions::kAll));
  auto reader = engine.subscribe<Frame>("/frames");
  std::set<const void*> places;
  for (std::uint64_t n = 0; n < kFrames; ++n) {
    places.insert(push(pusher, n));
    REQUIRE(reader.try_borrow());
  }
  CHECK(places.size() == 5);
  auto late = engine.subscribe<Frame>("/frames", past(4));
  for (std::uint64_t n = kFrames - 4; n < kFrames; ++n) {
    const auto frame = late.try_pull();
    REQUIRE(frame);
    CHECK(is_whole(*frame, n));
  }
}

TEST_CASE_FIXTURE(BothEngines, "a reader that lags has the whole queue, and what it keeps stays") {
  with_each_engine([&](QueueEngine engine_kind) {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/frames", keeping(0, engine_kind));
    auto quick = engine.subscribe<Frame>("/frames");
    auto slow = engine.subscribe<Frame>("/frames");
    std::vector<lot::ShmSharedPtr<const Frame>> kept;
    std::uint64_t next = 0;
    for (std::uint64_t n = 0; n < kFrames; ++n) {
      push(pusher, n);
      REQUIRE(quick.try_borrow());
      if (n % 4 != 3) continue;
      for (; next <= n; ++next) {
        auto frame = slow.try_pull();
        REQUIRE(frame);
        REQUIRE(is_whole(*frame, next));
        if (next % 40 == 0) kept.push_back(std::move(frame));
      }
    }
    CHECK(slow.missed_total() == 0);
    for (std::size_t i = 0; i < kept.size(); ++i) CHECK(is_whole(*kept[i], 40 * i));
    CHECK(kept.size() == kFrames / 40);
  });
}

TEST_CASE_FIXTURE(BothEngines, "a late reader gets the history that stayed, without a gap") {
  with_each_engine([&](QueueEngine engine_kind) {
    for (const std::uint32_t history : {0U, 1U, 3U}) {
      CAPTURE(history);
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Frame>("/frames", keeping(history, engine_kind));
      auto reader = engine.subscribe<Frame>("/frames");
      for (std::uint64_t n = 0; n < 10; ++n) {
        push(pusher, n);
        REQUIRE(reader.try_borrow());
      }
      const auto loan = pusher.loan();  // takes back what was read
      auto late = engine.subscribe<Frame>("/frames", past(4));
      for (std::uint64_t n = 10 - history; n < 10; ++n) {
        const auto frame = late.try_pull();
        REQUIRE(frame);
        CHECK(is_whole(*frame, n));
      }
      CHECK_FALSE(late.try_pull());
      CHECK(late.missed_total() == 0);
    }
  });
}

TEST_CASE_FIXTURE(BothEngines, "between processes, of which one is killed, each frame is counted") {
  with_each_engine([&](QueueEngine engine_kind) {
    Steps ready;
    const auto read_all = [&] {
      lot::ShmEngine engine(options);
      auto reader = engine.subscribe<Frame>("/frames");
      ready.tell();
      std::uint64_t received = 0;
      for (std::uint64_t number = 0; number + 1 < kFrames; ++received) {
        const auto frame = reader.borrow(20s);
        must(static_cast<bool>(frame), "a frame");
        number = frame->number;
        must(is_whole(*frame, number), "whole");
        must(received + reader.missed_total() == number, "received, or told as missed");
      }
    };
    Child victim(read_all);
    Child stays(read_all);
    REQUIRE(ready.next() == '.');
    REQUIRE(ready.next() == '.');
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/frames", keeping(0, engine_kind));
    for (std::uint64_t n = 0; n < kFrames; ++n) {
      push(pusher, n);
      if (n == kFrames / 2) victim.kill9();
    }
    CHECK(stays.wait() == 0);
  });
}

TEST_SUITE_END();
