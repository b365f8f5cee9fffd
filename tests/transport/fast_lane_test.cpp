// SPDX-License-Identifier: Apache-2.0

// Small messages that travel in the slots of their queue (docs/fast-lane.md): whole, in order, each
// missed one counted, by all policies, kinds of queues and both engines. What must hold at each
// instruction stands in the model: the scenarios "..._in_slots".

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <optional>
#include <poll.h>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "lockfree_ring/ring.hpp"
#include "segment/segment.hpp"
#include "support/both_engines.hpp"
#include "support/error_of.hpp"
#include "support/processes.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::Status;
using lot::Wait;

constexpr std::uint32_t kDepth = 4;

struct Ball {
  std::uint64_t number;
  std::uint64_t again;
};
struct Refers {
  lot::ShmRef<const Ball> ball;
};

/// A message of so many bytes.
template <std::size_t kBytes>
struct Sized {
  std::array<std::uint8_t, kBytes> bytes;

  void fill(std::uint64_t number) { bytes.fill(static_cast<std::uint8_t>(number * 7 + 1)); }
  bool is(std::uint64_t number) const {
    return std::all_of(bytes.begin(), bytes.end(), [&](std::uint8_t b) {
      return b == static_cast<std::uint8_t>(number * 7 + 1);
    });
  }
};

lot::PusherOptions pushing(QueueEngine engine, Policy policy = Policy::Overwrite,
                           std::uint32_t depth = kDepth) {
  lot::PusherOptions options;
  options.engine = engine;
  options.policy = policy;
  options.depth = depth;
  options.block_for = 10s;
  options.fast_lane = true;
  return options;
}
lot::QueueOptions queueing(QueueEngine engine, bool redeliver) {
  lot::QueueOptions options;
  options.engine = engine;
  options.depth = kDepth;
  options.redeliver = redeliver;
  options.fast_lane = true;
  return options;
}
lot::PullerOptions with_history(std::uint64_t history) {
  lot::PullerOptions options;
  options.history = history;
  return options;
}

Status push(lot::ShmPusher<Ball>& pusher, std::uint64_t number) {
  auto ball = pusher.loan();
  *ball = {number, ~number};
  return pusher.push(std::move(ball));
}
bool is(const Ball& ball, std::uint64_t number) {
  return ball.number == number && ball.again == ~number;
}

/// Bytes from slot to slot of the one ring that has a publisher; 0: its messages are in blocks.
/// Rings that have ended may stay a while beside it: the warden collects them.
std::size_t stride_in(const std::string& path) {
  lot::segment::Segment s(path);
  for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
    const auto writer = s.channels()[c].writer.load(std::memory_order_acquire);
    if (lot::ring::writer_state(writer) != lot::ring::State::Live) continue;
    const auto ring = s.ring(c);
    return ring.in_slots() ? ring.slots.stride() : 0;
  }
  FAIL("no ring has a publisher");
  return 0;
}

template <std::size_t kBytes>
void carries(lot::ShmEngine& shm, QueueEngine engine, Policy policy, bool stamp,
             std::size_t stride) {
  CAPTURE(kBytes);
  CAPTURE(stamp);
  auto options = pushing(engine, policy);
  options.stamp = stamp;
  auto in = shm.subscribe<Sized<kBytes>>("/sized");
  auto out = shm.advertise<Sized<kBytes>>("/sized", options);
  CHECK(stride_in(shm.path()) == stride);
  for (std::uint64_t n = 0; n < 3 * kDepth; ++n) {
    auto message = out.loan();
    message->fill(n);
    CHECK(out.push(std::move(message)) == Status::Ok);
    if (n % 2 == 0) {
      // try_borrow() finds no new ring while the warden is in the registry for the last one.
      const auto seen = in.borrow(10s);
      CHECK((seen && seen->is(n)));
      CHECK(seen.envelope().pushed.has_value() == stamp);
    } else {
      const auto seen = in.try_pull();
      CHECK((seen && seen->is(n)));
      CHECK(in.envelope().sequence == n);
      CHECK(in.envelope().pushed.has_value() == stamp);
    }
  }
  CHECK(in.missed_total() == 0);
}

TEST_CASE_FIXTURE(BothEngines, "plain messages of up to 240 bytes travel in their slots") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    for (const Policy policy : {Policy::Overwrite, Policy::Block, Policy::Refuse}) {
      for (const bool stamp : {false, true}) {
        carries<1>(shm, engine, policy, stamp, 64);
        carries<40>(shm, engine, policy, stamp, 64);
        carries<41>(shm, engine, policy, stamp, stamp ? 128 : 64);
        carries<48>(shm, engine, policy, stamp, stamp ? 128 : 64);
        carries<49>(shm, engine, policy, stamp, 128);
        carries<112>(shm, engine, policy, stamp, stamp ? 256 : 128);
        carries<113>(shm, engine, policy, stamp, 256);
        carries<232>(shm, engine, policy, stamp, 256);
        carries<240>(shm, engine, policy, stamp, stamp ? 0 : 256);
        carries<241>(shm, engine, policy, stamp, 0);
      }
    }
  });
}

TEST_CASE_FIXTURE(BothEngines, "LOT_FAST_LANE comes before PusherOptions::fast_lane") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    const auto is_fast = [&](bool asked) {
      auto how = pushing(engine);
      how.fast_lane = asked;
      const auto out = shm.advertise<Ball>("/ball", how);
      return stride_in(shm.path()) != 0;
    };
    CHECK(is_fast(true));
    CHECK(!is_fast(false));
    {
      const Variable on("LOT_FAST_LANE", "1");
      CHECK(is_fast(false));
    }
    {
      const Variable off("LOT_FAST_LANE", "0");
      CHECK(!is_fast(true));
    }
    const Variable bad("LOT_FAST_LANE", "yes");
    CHECK_THROWS_WITH_AS((void)shm.advertise<Ball>("/ball"), doctest::Contains("LOT_FAST_LANE=yes"),
                         lot::Error);
  });
}

TEST_CASE_FIXTURE(BothEngines, "what is overwritten in its slot is counted, the rest is there") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = shm.subscribe<Ball>("/ball");
    auto out = shm.advertise<Ball>("/ball", pushing(engine));
    std::uint64_t next = 0;
    for (const std::uint64_t burst : {1U, kDepth, kDepth + 1, 3 * kDepth + 1, 40 * kDepth}) {
      for (std::uint64_t n = 0; n < burst; ++n) CHECK(push(out, next++) == Status::Ok);
      const std::uint64_t there = std::min<std::uint64_t>(burst, kDepth);
      CHECK(in.size() == there);
      for (std::uint64_t n = 0; n < there; ++n) {
        const auto ball = in.try_borrow();
        REQUIRE(ball);
        CHECK(is(*ball, next - there + n));
        CHECK(ball.missed() == (n == 0 ? burst - there : 0));
      }
      CHECK(!in.try_borrow());
    }
    // A late reader gets at most what the queue has.
    for (const std::uint64_t history : {0U, 1U, kDepth, 100U}) {
      auto late = shm.subscribe<Ball>("/ball", with_history(history));
      CHECK(late.size() == std::min<std::uint64_t>(history, kDepth));
      if (history != 0) {
        const auto ball = late.try_pull();
        REQUIRE(ball);
        CHECK(is(*ball, next - std::min<std::uint64_t>(history, kDepth)));
      }
    }
  });
}

TEST_CASE_FIXTURE(BothEngines, "a publisher with a history takes back what was read in the slots") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto how = pushing(engine);
    how.history = 1;
    auto in = shm.subscribe<Ball>("/ball");
    auto out = shm.advertise<Ball>("/ball", how);
    for (std::uint64_t n = 0; n < kDepth; ++n) {
      CHECK(push(out, n) == Status::Ok);
      CHECK(in.try_borrow());
    }
    (void)out.loan();  // takes back
    auto late = shm.subscribe<Ball>("/ball", with_history(kDepth));
    const auto ball = late.try_pull();
    REQUIRE(ball);
    CHECK(is(*ball, kDepth - 1));
    CHECK(!late.try_pull());
  });
}

TEST_CASE_FIXTURE(BothEngines, "a lossless publisher waits for the slowest, not for an observer") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = shm.subscribe<Ball>("/ball");
    lot::PullerOptions looks_on;
    looks_on.observer = true;
    auto observer = shm.subscribe<Ball>("/ball", looks_on);
    auto out = shm.advertise<Ball>("/ball", pushing(engine, Policy::Refuse));
    CHECK(!observer.try_borrow());  // it has found the queue
    std::uint64_t next = 0;
    for (; next < kDepth; ++next) CHECK(push(out, next) == Status::Ok);
    CHECK(push(out, next) == Status::Full);
    for (std::uint64_t n = 0; n < 2 * kDepth; ++n) {
      const auto ball = in.try_pull();
      REQUIRE(ball);
      CHECK(is(*ball, n));
      CHECK(push(out, next++) == Status::Ok);
    }
    const auto seen = observer.try_borrow();
    REQUIRE(seen);
    CHECK(is(*seen, next - kDepth));
    CHECK(seen.missed() == next - kDepth);
    CHECK(in.missed_total() == 0);
  });
}

TEST_CASE_FIXTURE(BothEngines, "a message is whole while its publisher overwrites the slots") {
  constexpr std::uint64_t kMessages = 30'000;
  with_each_engine([&](QueueEngine engine) {
    for (const std::uint32_t depth : {1U, 3U}) {
      CAPTURE(depth);
      lot::ShmEngine shm(options);
      using Message = Sized<240>;
      auto borrows = shm.subscribe<Message>("/fast");
      auto keeps = shm.subscribe<Message>("/fast");
      std::atomic<bool> done{false};
      std::thread publisher([&] {
        lot::ShmEngine other(options);
        auto out = other.advertise<Message>("/fast", pushing(engine, Policy::Overwrite, depth));
        for (std::uint64_t n = 0; n < kMessages; ++n) {
          auto message = out.loan();
          message->fill(n);
          (void)out.push(std::move(message));
        }
        (void)eventually([&] { return done.load(); });
      });
      std::uint64_t torn = 0;
      std::uint64_t got[2] = {0, 0};
      const auto is_whole = [&](const Message& m) {
        torn += std::count(m.bytes.begin(), m.bytes.end(), m.bytes[0]) != 240;
      };
      while (got[0] + borrows.missed_total() < kMessages ||
             got[1] + keeps.missed_total() < kMessages) {
        if (const auto seen = borrows.try_borrow()) {
          ++got[0];
          is_whole(*seen);
        }
        if (const auto seen = keeps.try_pull()) {
          ++got[1];
          is_whole(*seen);
        }
      }
      done = true;
      publisher.join();
      CHECK(torn == 0);
      CHECK(got[0] + borrows.missed_total() == kMessages);
      CHECK(got[1] + keeps.missed_total() == kMessages);
    }
  });
}

TEST_CASE_FIXTURE(BothEngines, "what is kept of a slot is the keeper's own message") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = shm.subscribe<Ball>("/ball");
    auto out = shm.advertise<Ball>("/ball", pushing(engine));
    CHECK(push(out, 1) == Status::Ok);
    lot::ShmSharedPtr<const Ball> first;
    lot::ShmSharedPtr<const Ball> second;
    {
      const auto borrow = in.try_borrow();
      REQUIRE(borrow);
      first = borrow.keep();
      second = borrow.keep();
    }
    for (std::uint64_t n = 2; n < 10 * kDepth; ++n) CHECK(push(out, n) == Status::Ok);
    CHECK(is(*first, 1));
    CHECK(is(*second, 1));
    CHECK(first.get() != second.get());
    CHECK(first.use_count() == 1);
    const lot::ShmWeakPtr<const Ball> weak = first;
    CHECK(!weak.expired());
    first.reset();
    CHECK(weak.expired());
    // It goes on to another topic, and into another message.
    auto again = shm.subscribe<Ball>("/again");
    auto on = shm.advertise<Ball>("/again", pushing(engine));
    CHECK(on.push(second) == Status::Ok);
    const auto seen = again.try_pull();
    REQUIRE(seen);
    CHECK(is(*seen, 1));
    auto refers_in = shm.subscribe<Refers>("/refers");
    auto refers_out = shm.advertise<Refers>("/refers", pushing(engine));
    auto refers = refers_out.loan();
    refers->ball = second;
    second.reset();
    CHECK(refers_out.push(std::move(refers)) == Status::Ok);
    const auto whole = refers_in.try_pull();
    REQUIRE(whole);
    CHECK(is(*whole->ball, 1));
  });
}

TEST_CASE_FIXTURE(BothEngines, "what is kept of a slot stays if another engine publishes it") {
  with_each_engine([&](QueueEngine engine) {
    // By another name of the directory: a participant of its own, as each copy of the library is.
    lot::EngineOptions elsewhere = options;
    elsewhere.directory += "/.";
    lot::ShmEngine one(options);
    lot::ShmEngine other(elsewhere);
    auto keeps = other.subscribe<Ball>("/ball");
    auto out = one.advertise<Ball>("/ball", pushing(engine));
    lot::PusherOptions by_pointer = pushing(engine);
    by_pointer.fast_lane = false;
    auto on = one.advertise<Ball>("/on", by_pointer);
    auto reads = one.subscribe<Ball>("/on");
    const auto keep = [&](std::uint64_t number) {
      CHECK(push(out, number) == Status::Ok);
      auto kept = keeps.pull(10s);
      REQUIRE(kept);
      CHECK(is(*kept, number));
      return kept;
    };
    auto kept = keep(1);
    CHECK(on.push(kept) == Status::Ok);
    kept.reset();
    const auto read = reads.pull(10s);
    REQUIRE(read);
    CHECK(push(on, 2) == Status::Ok);
    for (std::uint64_t n = 3; n < 10 * kDepth; ++n) (void)keep(n);
    CHECK(is(*read, 1));
  });
}

TEST_CASE_FIXTURE(BothEngines, "what was kept of slots and let go does not count as held") {
  lot::EngineOptions few = options;
  few.blocks = 64;  // a subscription may hold a quarter
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(few);
    auto in = shm.subscribe<Ball>("/ball");
    auto out = shm.advertise<Ball>("/ball", pushing(engine));
    std::array<lot::ShmSharedPtr<const Ball>, 3> kept;
    std::array<lot::ShmWeakPtr<const Ball>, 3> weak;
    for (std::uint64_t n = 0; n < 2000; ++n) {
      CHECK(push(out, n) == Status::Ok);
      auto ball = in.try_pull();
      REQUIRE(ball);
      const std::size_t at = n * n % kept.size();  // some live longer than others
      kept[at] = std::move(ball);
      CHECK(is(*kept[at], n));
      CHECK(in.envelope().sequence == n);
      if (n % 4 != 0) continue;
      const auto before = std::exchange(weak[at], kept[at]);
      CHECK(before.expired());
      CHECK(is(*weak[at].lock(), n));
    }
    CHECK(in.missed_total() == 0);
  });
}

TEST_CASE_FIXTURE(BothEngines, "a pull needs a block for what it finds in a slot, a borrow none") {
  lot::EngineOptions few = options;
  few.blocks = 3;
  for (const QueueEngine engine : kEngines) {
    CAPTURE(static_cast<int>(engine));
    lot::ShmEngine shm(few);
    auto in = shm.subscribe<Ball>("/ball");
    auto out = shm.advertise<Ball>("/ball", pushing(engine));
    std::vector<lot::ShmSharedPtr<const Ball>> kept;
    for (std::uint64_t n = 0; n < 10; ++n) {
      CHECK(push(out, n) == Status::Ok);
      if (auto ball = in.try_pull()) {
        CHECK(is(*ball, n));
        kept.push_back(std::move(ball));
        continue;
      }
      CHECK(in.status() == Status::HoldsTooMuch);
      const auto borrow = in.try_borrow();
      REQUIRE(borrow);
      CHECK(is(*borrow, n));
      CHECK(error_of([&] { (void)borrow.keep(); }).first == EDQUOT);
    }
    CHECK(!kept.empty());
    CHECK(kept.size() <= 3);
  }
}

TEST_CASE_FIXTURE(BothEngines, "where all blocks are in use a pop says so, and the item stays") {
  lot::EngineOptions few = options;
  few.blocks = 64;
  for (const QueueEngine engine : kEngines) {
    CAPTURE(static_cast<int>(engine));
    lot::ShmEngine shm(few);
    auto values = shm.queue<Ball>("/values", queueing(engine, false));
    auto items = shm.queue<lot::ShmUniquePtr<Ball>>("/items", queueing(engine, false));
    auto in = shm.subscribe<Ball>("/ball");
    auto out = shm.advertise<Ball>("/ball", pushing(engine));
    CHECK(values.put({1, ~std::uint64_t{1}}) == Status::Ok);
    CHECK(items.put(items.make(Ball{2, ~std::uint64_t{2}})) == Status::Ok);
    CHECK(push(out, 3) == Status::Ok);
    auto greedy = shm.advertise<Ball>("/greedy", pushing(engine));
    std::vector<lot::ShmUniquePtr<Ball>> loans;
    while (auto loan = greedy.try_loan()) loans.push_back(std::move(loan));
    const auto says = doctest::Contains("EngineOptions::blocks");
    CHECK_THROWS_WITH_AS((void)values.try_pop(), says, lot::OutOfMemory);
    CHECK_THROWS_WITH_AS((void)items.wait_and_pop_for(10ms), says, lot::OutOfMemory);
    CHECK(!in.try_pull());
    CHECK(in.status() == Status::HoldsTooMuch);
    {
      const auto borrow = in.try_borrow();
      REQUIRE(borrow);
      CHECK(is(*borrow, 3));
      CHECK_THROWS_WITH_AS((void)borrow.keep(), says, lot::OutOfMemory);
    }
    loans.clear();
    const auto value = values.try_pop();
    CHECK((value && is(*value, 1)));
    const auto item = items.try_pop();
    CHECK((item && is(**item, 2)));
  }
}

TEST_CASE_FIXTURE(BothEngines, "each item in a slot is for one that pops, and its own") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto queue = shm.queue<lot::ShmUniquePtr<Ball>>("/items", queueing(engine, false));
    constexpr std::uint64_t kItems = 2'000;
    std::vector<std::uint64_t> got[2];
    std::thread poppers[2];
    for (unsigned i : {0U, 1U}) {
      poppers[i] = std::thread([&, i] {
        lot::ShmEngine own(options);
        auto mine = own.queue<lot::ShmUniquePtr<Ball>>("/items", queueing(engine, false));
        for (;;) {
          auto item = mine.wait_and_pop();
          if (item->number == kItems) return;
          must(is(*item, item->number), "a whole item");
          item->again = 0;  // it is this thread's alone
          got[i].push_back(item->number);
        }
      });
    }
    for (std::uint64_t n = 0; n < kItems; ++n) {
      auto item = queue.make();
      *item = {n, ~n};
      CHECK(queue.put_for(std::move(item), 20s) == Status::Ok);
    }
    for (int i = 0; i < 2; ++i) {
      auto end = queue.make();
      *end = {kItems, ~kItems};
      CHECK(queue.put_for(std::move(end), 20s) == Status::Ok);
    }
    for (std::thread& popper : poppers) popper.join();
    std::set<std::uint64_t> all(got[0].begin(), got[0].end());
    all.insert(got[1].begin(), got[1].end());
    CHECK(all.size() == kItems);
    CHECK(got[0].size() + got[1].size() == kItems);
    for (const auto& some : got) CHECK(std::is_sorted(some.begin(), some.end()));
  });
}

TEST_CASE_FIXTURE(BothEngines, "a handle that lags counts each item that waits in the slots") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto overwriting = queueing(engine, false);
    overwriting.policy = Policy::Overwrite;
    auto out = shm.queue<Ball>("/items", overwriting);
    auto in = shm.queue<Ball>("/items", overwriting);
    for (std::uint64_t n = 0; n < 5 * kDepth; ++n) {
      CHECK(out.put(Ball{n, ~n}) == Status::Ok);
      if (n == 0) CHECK(in.try_pop().has_value());  // from then on it lags
      CHECK(in.size() == std::min<std::uint64_t>(n, kDepth));
    }
    for (std::uint64_t n = kDepth; n > 0; --n) {
      CHECK(in.size() == n);
      const auto item = in.try_pop();
      CHECK((item && is(*item, 5 * kDepth - n)));
    }
    CHECK(in.is_empty());
  });
}

TEST_CASE_FIXTURE(BothEngines, "what was taken out of a slot can be put and pushed again") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto items = shm.queue<lot::ShmUniquePtr<Ball>>("/items", queueing(engine, false));
    auto others = shm.queue<lot::ShmUniquePtr<Ball>>("/others", queueing(engine, false));
    auto in = shm.subscribe<Ball>("/balls");
    auto out = shm.advertise<Ball>("/balls", pushing(engine));
    auto item = items.make();
    *item = {3, ~std::uint64_t{3}};
    CHECK(items.put(std::move(item)) == Status::Ok);
    auto popped = items.try_pop();
    REQUIRE(popped.has_value());
    CHECK(others.put(std::move(*popped)) == Status::Ok);
    popped = others.try_pop();
    REQUIRE(popped.has_value());
    const lot::ShmSharedPtr<const Ball> shared(std::move(*popped));
    CHECK(out.push(shared) == Status::Ok);
    const auto seen = in.try_pull();
    CHECK((seen && is(*seen, 3)));
  });
}

TEST_CASE_FIXTURE(BothEngines, "a task in a slot comes back when its worker is killed") {
  with_each_engine([&](QueueEngine engine) {
    const Steps taken;
    Child worker([&] {
      lot::ShmEngine shm(options);
      auto queue = shm.queue<lot::ShmUniquePtr<Ball>>("/tasks", queueing(engine, true));
      const auto task = queue.wait_and_take();
      must(task && is(*task, 7), "a whole task");
      taken.tell();
      pause();
    });
    lot::ShmEngine shm(options);
    auto queue = shm.queue<lot::ShmUniquePtr<Ball>>("/tasks", queueing(engine, true));
    auto item = queue.make();
    *item = {7, ~std::uint64_t{7}};
    CHECK(queue.put_for(std::move(item), 10s) == Status::Ok);
    CHECK(taken.next() == '.');
    worker.kill9();
    auto task = queue.wait_and_take();
    REQUIRE(task);
    CHECK(is(*task, 7));
    CHECK(task.deliveries() == 2);
    task.finish();
    CHECK(queue.size() == 0);
  });
}

TEST_CASE_FIXTURE(BothEngines, "what a killed publisher had sent is read from its slots") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    lot::PullerOptions parks;
    parks.wait = Wait::Park;
    auto in = shm.subscribe<Ball>("/ball", parks);
    const Steps sent;
    const Steps read;
    Child publisher([&] {
      lot::ShmEngine other(options);
      auto out = other.advertise<Ball>("/ball", pushing(engine));
      must(push(out, 0) == Status::Ok, "pushed");
      must(read.next() == '.', "the reader has read");
      for (std::uint64_t n = 1; n <= kDepth; ++n) must(push(out, n) == Status::Ok, "pushed");
      sent.tell();
      pause();
    });
    const auto first = in.pull(20s);  // it sleeps until then
    REQUIRE(first);
    CHECK(is(*first, 0));
    read.tell();
    CHECK(sent.next() == '.');
    publisher.kill9();
    for (std::uint64_t n = 1; n <= kDepth; ++n) {
      const auto ball = in.borrow(20s);
      REQUIRE(ball);
      CHECK(is(*ball, n));
    }
    CHECK(!in.borrow(20s));
    CHECK(in.status() == Status::PublisherGone);
  });
}

TEST_CASE_FIXTURE(BothEngines, "a wait set and a descriptor tell of messages in slots") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = shm.subscribe<Ball>("/ball");
    auto out = shm.advertise<Ball>("/ball", pushing(engine));
    pollfd readable{in.fd(), POLLIN, 0};
    CHECK(!in.try_borrow());
    CHECK(push(out, 1) == Status::Ok);
    CHECK(poll(&readable, 1, 20'000) == 1);
    CHECK(in.try_borrow());
    std::uint64_t seen = 0;
    lot::WaitSet set;
    set.add(in, [&] {
      const auto ball = in.try_pull();
      if (ball) seen = ball->number;
    });
    std::thread publisher([&] { (void)push(out, 2); });
    while (seen == 0) set.run_once(20s);
    publisher.join();
    CHECK(seen == 2);
  });
}

TEST_CASE_FIXTURE(BothEngines, "a program without the type reads messages in slots") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto out = shm.advertise<Ball>("/ball", pushing(engine));
    auto any = shm.subscribe_any("/ball");
    CHECK(push(out, 5) == Status::Ok);
    {
      const auto borrow = any.try_borrow();
      REQUIRE(borrow);
      CHECK(borrow.root()["number"].as<std::uint64_t>() == 5);
      CHECK(borrow.keep().root()["again"].as<std::uint64_t>() == ~std::uint64_t{5});
    }
    CHECK(push(out, 6) == Status::Ok);
    const lot::AnyMessage kept = any.try_pull();
    REQUIRE(kept);
    CHECK(kept.root()["number"].as<std::uint64_t>() == 6);
    const auto ball = kept.as<Ball>();
    REQUIRE(ball);
    CHECK(is(*ball, 6));
    auto on = shm.advertise_any("/again", any.type());
    auto again = shm.subscribe<Ball>("/again");
    CHECK(on.push(kept) == Status::Ok);
    const auto seen = again.try_pull();
    REQUIRE(seen);
    CHECK(is(*seen, 6));
  });
}

TEST_CASE_FIXTURE(BothEngines, "a slot that no publisher can have written is an error") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = shm.subscribe<Ball>("/ball");
    auto out = shm.advertise<Ball>("/ball", pushing(engine));
    lot::segment::Segment s(shm.path());
    const auto ring = s.ring(0);
    CHECK(push(out, 0) == Status::Ok);
    auto* const words = &ring.slots[0];
    words[1].store(lot::ring::sequence(words[0].load()) + 1);  // of another slot
    CHECK(error_of([&] { (void)in.try_borrow(); }).first == EBADMSG);
    CHECK(push(out, 1) == Status::Ok);
    const auto next = in.try_borrow();  // behind the damaged one, which counts as missed
    REQUIRE(next);
    CHECK(is(*next, 1));
    CHECK(next.missed() == 1);
  });
  const QueueEngine engine = QueueEngine::Ring;
  lot::ShmEngine shm(options);
  {
    // Where items are taken, `begin` says nothing.
    auto queue = shm.queue<lot::ShmUniquePtr<Ball>>("/items", queueing(engine, false));
    auto item = queue.make();
    *item = {3, ~std::uint64_t{3}};
    CHECK(queue.put_for(std::move(item), 10s) == Status::Ok);
    lot::segment::Segment(shm.path()).ring(0).slots.begin(0, lot::ring::kSequenceMask / 2);
    CHECK(is(**queue.wait_and_pop_for(10s), 3));
  }
  auto out = shm.advertise<Ball>("/ball", pushing(engine));
  lot::segment::Segment s(shm.path());
  // A queue that redelivers has no slot more than claims.
  const auto taken = s.channels()[0].taken;
  s.channels()[0].taken = lot::segment::kFinished;
  CHECK(s.ring(0).depth == 0);
  s.channels()[0].taken = taken;
  for (const unsigned stride : {8U, 32U, 65U, 512U}) {
    s.channels()[0].stride = static_cast<std::uint16_t>(stride);
    CHECK(error_of([&] { (void)shm.subscribe<Ball>("/ball"); }).first == EBADMSG);
  }
  s.channels()[0].stride = 64;
  CHECK_NOTHROW((void)shm.subscribe<Ball>("/ball"));
}

TEST_CASE_FIXTURE(BothEngines, "a subscription gives the block back that it had at hand") {
  lot::EngineOptions few = options;
  few.blocks = 8;
  for (const QueueEngine engine : kEngines) {
    CAPTURE(static_cast<int>(engine));
    lot::ShmEngine shm(few);
    auto out = shm.advertise<Ball>("/ball", pushing(engine));
    const lot::segment::Segment view(shm.path());
    for (unsigned round = 0; round < 3 * few.blocks; ++round) {
      auto in = shm.subscribe<Ball>("/ball");
      REQUIRE(push(out, round) == Status::Ok);
      const auto ring = view.ring(0);
      for (std::uint32_t i = 0; i < ring.places(); ++i) {
        auto* const words = &ring.slots[i];
        words[1].store(lot::ring::sequence(words[0].load()) + 1);  // of another slot
      }
      CHECK(error_of([&] { (void)in.try_pull(); }).first == EBADMSG);
    }
    auto other = shm.advertise<Ball>("/other", pushing(engine));
    CHECK(other.try_loan());
  }
}

}  // namespace
