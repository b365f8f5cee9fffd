// SPDX-License-Identifier: Apache-2.0

// Rings whose sequence numbers wrap while they are used: 2^42 is followed by 0, and nothing
// happens.

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <deque>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "first_sequence.hpp"
#include "lockfree_ring/words.hpp"
#include "support/in_blocks.hpp"
#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "support/neighbour.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;
using lot::Wait;

struct Number {
  std::uint64_t value;
};

[[maybe_unused]] const bool has_janitor = start_janitor();

constexpr std::uint64_t kWrap = lot::ring::kSequenceMask + 1;

/// Rings begin so many messages before the wrap (or another number), for the time of a scope.
struct BeforeTheWrap {
  explicit BeforeTheWrap(std::uint64_t messages, std::uint64_t end = kWrap) {
    begin_rings_at(end - messages);
  }
  ~BeforeTheWrap() { begin_rings_at(0); }
};

/// Ground for a queue of that depth.
struct Room : Ground {
  explicit Room(std::uint32_t depth) {
    if (depth < 10000) return;
    size_bytes = 128 << 20;
    blocks = depth + 4096;
  }
};

/// The sequence of the newest message of the only ring.
std::uint64_t newest(lot::segment::Segment& s) {
  for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
    if (lot::ring::writer_state(s.channels()[c].writer.load()) != lot::ring::State::Live) continue;
    const auto ring = s.ring(c);
    std::uint64_t most = lot::ring::sequence(ring.slots[0].load());
    for (std::uint32_t i = 1; i < ring.places(); ++i) {
      const auto here = lot::ring::sequence(ring.slots[i].load());
      if (lot::ring::distance(here, most) > 0) most = here;
    }
    return most;
  }
  return 0;
}

constexpr std::uint32_t kDepths[] = {1, 2, 3, 64, 65536};

}  // namespace

TEST_SUITE_BEGIN("sequences");

TEST_CASE("two processes hand messages over across the wrap, each depth and each way of waiting") {
  const Watchdog watchdog(90);
  for (const std::uint32_t depth : kDepths) {
    for (const auto wait : {Wait::Spin, Wait::Adaptive, Wait::Park}) {
      if (depth == 65536 && wait != Wait::Adaptive) continue;
      lot::PusherOptions how{Policy::Block, depth, 60s};
      how.fast_lane = depth != 64;
      CAPTURE(depth);
      CAPTURE(static_cast<int>(wait));
      const std::uint64_t before = depth + 100;
      const std::uint64_t count = 2 * before;
      const Room options(depth);
      Steps joined, done;
      Child reader([&] {
        lot::ShmEngine engine(options);
        auto puller = engine.subscribe<Number>("/t", {wait, 0});
        joined.tell();
        for (std::uint64_t n = 0; n < count; ++n) {
          const auto seen = puller.borrow();
          must(seen->value == n && seen.missed() == 0, "each number");
        }
        done.tell();
        must(joined.next() == '!', "the end");
      });
      REQUIRE(joined.next() == '.');
      const BeforeTheWrap start(before);
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Number>("/t", how);
      REQUIRE(pusher.wait_for_readers(1, 20s));
      for (std::uint64_t n = 0; n < count; ++n) {
        REQUIRE(pusher.push(pusher.loan(n)) == Status::Ok);
      }
      CHECK(done.next() == '.');
      lot::segment::Segment s(engine.path());
      CHECK(newest(s) == before - 1);  // it has wrapped
      joined.tell('!');
      CHECK(reader.wait() == 0);
    }
  }
}

TEST_CASE("a reader sleeps before each message on both sides of the wrap, and is woken each time") {
  const Watchdog watchdog(90);
  for (const std::uint32_t depth : kDepths) {
    for (const auto policy : {Policy::Overwrite, Policy::Block}) {
      CAPTURE(depth);
      CAPTURE(static_cast<int>(policy));
      const Room options(depth);
      const BeforeTheWrap start(5);
      lot::ShmEngine engine(options);
      lot::PusherOptions how{policy, depth, 10s};
      how.fast_lane = depth != 64;
      auto pusher = engine.advertise<Number>("/t", how);
      std::atomic<pid_t> thread{0};
      std::atomic<std::uint64_t> next{0};
      std::thread reader([&] {
        auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
        thread = gettid();
        while (next < 10) {
          const auto seen = puller.pull();
          if (!seen || seen->value != next || puller.missed() != 0) break;
          ++next;
        }
      });
      lot::segment::Segment s(engine.path());
      const auto is_marked = [&] {
        const auto ring = s.ring(0);
        bool any = false;
        for (std::uint32_t i = 0; i < ring.places(); ++i) {
          any = any || (ring.slots[i].load() & lot::ring::kSleeper) != 0;
        }
        return any;
      };
      for (std::uint64_t n = 0; n < 10; ++n) {
        const bool sleeps =
            eventually([&] { return next == n && is_marked() && asleep(getpid(), thread); });
        CHECK(sleeps);
        must_go(pusher.push(pusher.loan(n)));
      }
      reader.join();
      CHECK(next == 10);
      CHECK(newest(s) == 4);
    }
  }
}

namespace {

struct Setting {
  std::uint32_t depth;
  std::uint32_t blocks;
  Policy policy;
};

struct Trace {
  std::vector<std::uint64_t> seen;  ///< numbers, missed counts and statuses, in their order
  std::uint64_t published = 0;
  std::uint64_t last = 0;  ///< sequence of the last message
};

/// Lets a publisher and readers do what chance tells them.
Trace run(const Setting& setting, std::uint64_t its_seed) {
  std::mt19937_64 random(its_seed);
  Trace trace;
  auto& seen = trace.seen;
  auto& next = trace.published;
  Room options(setting.depth);
  if (setting.blocks != 0) options.blocks = setting.blocks;
  lot::ShmEngine engine(options);
  lot::PusherOptions how{setting.policy, setting.depth, 1s};
  how.fast_lane = setting.blocks == 0 && its_seed % 2 == 0;
  auto pusher = engine.advertise<Number>("/t", how);
  std::deque<lot::ShmPuller<Number>> readers;
  std::deque<lot::ShmSharedPtr<const Number>> kept;
  const std::uint64_t depth = setting.depth;
  const std::uint64_t histories[] = {0, 1, 2, depth - 1, depth, depth + 1, ~std::uint64_t{0} - 1};
  const auto push = [&](std::uint64_t count) {
    for (std::uint64_t n = 0; n < count; ++n) {
      auto message = pusher.try_loan(next);
      if (!message || pusher.try_push(std::move(message)) != Status::Ok) break;
      ++next;
    }
    seen.push_back(next);
  };
  push(1);
  for (int step = 0; step < 60; ++step) {
    const std::uint64_t r = random();
    const std::uint64_t what = r % 8;
    if (what < 3) {
      push(r / 8 % (2 * depth + 2));
    } else if (what == 3 && readers.size() < 5) {
      readers.push_back(engine.subscribe<Number>("/t", {Wait::Park, histories[r / 8 % 7]}));
    } else if (what == 4 && !readers.empty()) {
      readers.erase(readers.begin() + static_cast<std::ptrdiff_t>(r / 8 % readers.size()));
    } else if (!readers.empty()) {
      auto& reader = readers[r / 8 % readers.size()];
      for (std::uint64_t n = r / 64 % (depth + 2); n > 0; --n) {
        const auto look = reader.try_borrow();
        seen.push_back(static_cast<std::uint64_t>(reader.status()));
        if (!look) break;
        if (n == 1) push(r / 8 % 3 * depth);  // the borrow holds
        seen.push_back(look->value);
        seen.push_back(look.missed());
        if (n % 16 == 1) kept.push_back(look.keep());
      }
      if (kept.size() > 4) kept.resize(4);
      for (const auto& k : kept) seen.push_back(k->value);
    }
  }
  lot::segment::Segment s(engine.path());
  trace.last = newest(s);
  return trace;
}

}  // namespace

TEST_CASE("whatever readers and a publisher do, across the wrap they see what they see elsewhere") {
  const Watchdog watchdog(90);
  const std::uint64_t start = seed();
  std::mt19937_64 random(start);
  const Setting settings[] = {
      {1, 0, Policy::Overwrite},     {2, 0, Policy::Overwrite},  {3, 0, Policy::Overwrite},
      {7, 0, Policy::Overwrite},     {64, 0, Policy::Overwrite}, {64, 48, Policy::Overwrite},
      {65536, 0, Policy::Overwrite}, {1, 0, Policy::Block},      {2, 0, Policy::Block},
      {3, 0, Policy::Block},         {7, 0, Policy::Block},      {64, 0, Policy::Block},
      {65536, 0, Policy::Block}};
  for (const Setting& setting : settings) {
    for (int round = 0; round < (setting.depth < 1000 ? 4 : 1); ++round) {
      const std::uint64_t its_seed = random();
      CAPTURE(setting.depth);
      CAPTURE(setting.blocks);
      CAPTURE(static_cast<int>(setting.policy));
      CAPTURE(round);
      const Trace elsewhere = run(setting, its_seed);
      const std::uint64_t published = elsewhere.published;
      const auto compare = [&](std::uint64_t before, std::uint64_t end) {
        CAPTURE(before);
        CAPTURE(end);
        const BeforeTheWrap wrap(before, end);
        const Trace here = run(setting, its_seed);
        CHECK(here.seen == elsewhere.seen);
        CHECK(here.published == published);
        CHECK(here.last == (end - before + published - 1) % kWrap);
      };
      compare(1, kWrap);
      compare(published / 2 + 1, kWrap);
      compare(published, kWrap);
      compare(published / 2 + 1, kWrap / 2);               // where the sign of a distance turns
      compare(published / 2 + 1, std::uint64_t{1} << 32);  // and a word of 32 bits ends
    }
  }
}

TEST_CASE("a subscription that was there first is told what the wrap has taken before it looked") {
  const Watchdog watchdog(60);
  for (const std::uint32_t depth : kDepths) {
    for (const std::uint64_t before : {1U, 4U, depth, depth + 3}) {
      CAPTURE(depth);
      CAPTURE(before);
      const Room options(depth);
      lot::ShmEngine engine(options);
      auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
      const BeforeTheWrap start(before);
      auto pusher = engine.advertise<Number>("/t", {Policy::Overwrite, depth, 1s});
      const std::uint64_t count = depth + 5;
      for (std::uint64_t n = 0; n < count; ++n) must_go(pusher.push(pusher.loan(n)));
      auto first = puller.pull(10s);
      REQUIRE(first);
      CHECK(first->value == 5);
      CHECK(puller.missed() == 5);
      for (std::uint64_t n = 6; n < count; ++n) CHECK(puller.pull(10s)->value == n);
      CHECK(puller.missed_total() == 5);
    }
  }
}

TEST_CASE("a sender that waits for room at the wrap goes on with each message that is read") {
  const Watchdog watchdog(60);
  for (const std::uint32_t depth : {1U, 2U, 3U, 64U}) {
    CAPTURE(depth);
    const Room options(depth);
    const BeforeTheWrap start(depth + 3);
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
    auto pusher = engine.advertise<Number>("/t", {Policy::Block, depth, 60s});
    CHECK(puller.publishers() == 1);
    const std::uint64_t count = depth + 12;
    std::atomic<pid_t> thread{0};
    std::atomic<std::uint64_t> pushed{0};
    std::thread sender([&] {
      thread = gettid();
      while (pushed < count && pusher.push(pusher.loan(pushed.load())) == Status::Ok) ++pushed;
    });
    for (std::uint64_t n = 0; n < count; ++n) {
      // It has filled the queue, and not one message more.
      CHECK(eventually([&] {
        return pushed == std::min(n + depth, count) &&
               (pushed == count || asleep(getpid(), thread));
      }));
      const auto seen = puller.pull(10s);
      REQUIRE(seen);
      CHECK(seen->value == n);
    }
    sender.join();
    CHECK(puller.missed_total() == 0);
    lot::segment::Segment s(engine.path());
    CHECK(newest(s) == 8);
  }
}

TEST_CASE("the last message before the wrap is borrowed while its publisher runs far ahead") {
  const Watchdog watchdog(60);
  for (const std::uint32_t depth : {1U, 2U, 3U, 64U}) {
    CAPTURE(depth);
    Room options(depth);
    options.blocks = depth + 40;  // so that what is free is used again soon
    const BeforeTheWrap start(1);
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Number>("/t", in_blocks({Policy::Overwrite, depth, 1s}));
    auto puller = engine.subscribe<Number>("/t");
    must_go(pusher.push(pusher.loan(std::uint64_t{77})));
    auto look = puller.borrow(10s);
    REQUIRE(look);
    for (std::uint64_t n = 0; n < 1000; ++n) {
      must_go(pusher.push(pusher.loan(n)));
      REQUIRE(look->value == 77);
    }
    const auto kept = look.keep();
    look.end();
    for (std::uint64_t n = 1000; n < 2000; ++n) must_go(pusher.push(pusher.loan(n)));
    CHECK(kept->value == 77);
    const auto seen = puller.pull(10s);
    CHECK(seen->value == 2000 - depth);
    CHECK(puller.missed() == 2000 - depth);
  }
}

TEST_CASE("a publisher that is killed just behind the wrap: all is read, then it is gone") {
  const Watchdog watchdog(60);
  for (const std::uint64_t behind : {0U, 1U, 2U, 5U}) {
    CAPTURE(behind);
    const Room options(8);
    Steps advertised, published;
    const BeforeTheWrap start(3);
    Child publisher([&] {
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Number>("/t", {Policy::Overwrite, 8, 1s});
      advertised.tell();
      must(pusher.wait_for_readers(1, 10s), "the reader");
      for (std::uint64_t n = 0; n < 3 + behind; ++n) must_go(pusher.push(pusher.loan(n)));
      published.tell();
      pause();
    });
    REQUIRE(advertised.next() == '.');
    {
      lot::ShmEngine engine(options);
      auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
      REQUIRE(published.next() == '.');
      publisher.kill9();
      for (std::uint64_t n = 0; n < 3 + behind; ++n) {
        const auto seen = puller.pull(10s);
        REQUIRE(seen);
        CHECK(seen->value == n);
      }
      CHECK(eventually([&] {
        return puller.try_pull() == nullptr && puller.status() == Status::PublisherGone;
      }));
      CHECK(puller.missed_total() == 0);
    }
    CHECK(files_of(options) == 0);
  }
}

TEST_SUITE_END();
