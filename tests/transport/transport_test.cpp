// SPDX-License-Identifier: Apache-2.0

// Messages cross: every way to wait, to fill, to miss, to keep, to forward.

#include <algorithm>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/in_blocks.hpp"
#include "support/lock_owner.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;
using lot::Wait;

struct Number {
  std::uint64_t value;
};
struct Frame {
  std::uint64_t number;
  lot::ShmVector<std::uint64_t> data;
};
struct Big {
  std::uint64_t number;
  unsigned char bytes[100000];
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

template <class Pusher>
Status send(Pusher& pusher, std::uint64_t n) {
  return pusher.push(pusher.loan(n));
}
lot::ShmUniquePtr<Frame> frame_of(lot::ShmPusher<Frame>& pusher, std::uint64_t n,
                                  std::size_t size) {
  auto frame = pusher.loan();
  frame->number = n;
  frame->data.assign(size, n);
  return frame;
}
bool intact(const Frame& frame, std::size_t size) {
  return frame.data.size() == size && std::all_of(frame.data.begin(), frame.data.end(),
                                                  [&](auto v) { return v == frame.number; });
}

/// An engine on a segment of its own; afterwards no file may be left.
struct Place {
  explicit Place(std::uint64_t size = 64 << 20) : options(fresh(size)), engine(options) {}
  Place(const lot::EngineOptions& o) : options(o), engine(options) {}
  std::size_t granules() {
    lot::segment::Segment s(engine.path());
    return Audit(s).granules;
  }
  lot::EngineOptions options;
  lot::ShmEngine engine;
};

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("pull, try_pull, borrow and keep give the messages in order, and say why there is none") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  {
    lot::ShmEngine engine(options);
    CHECK(engine.path() == options.directory + "/" + options.segment);
    auto puller = engine.subscribe<Number>("/t");
    CHECK(puller.try_pull() == nullptr);
    CHECK(puller.status() == Status::PublisherGone);
    CHECK(puller.pull(1ms) == nullptr);
    CHECK(puller.status() == Status::PublisherGone);
    CHECK(puller.publishers() == 0);
    {
      auto pusher = engine.advertise<Number>("/t");
      CHECK(puller.publishers() == 1);
      CHECK(pusher.readers() == 1);
      CHECK(puller.try_pull() == nullptr);
      CHECK(puller.status() == Status::Empty);
      CHECK(!puller.try_borrow());
      CHECK(puller.status() == Status::Empty);
      for (std::uint64_t n = 0; n < 6; ++n) CHECK(send(pusher, n) == Status::Ok);
      CHECK(puller.try_pull()->value == 0);
      CHECK(puller.status() == Status::Ok);
      CHECK(puller.pull(1s)->value == 1);
      CHECK(puller.pull()->value == 2);
      CHECK(puller.pull_until(std::chrono::steady_clock::now() + 1s)->value == 3);
      lot::ShmSharedPtr<const Number> kept;
      {
        auto look = puller.borrow();
        REQUIRE(look);
        CHECK(look->value == 4);
        CHECK((*look).value == 4);
        CHECK(look.missed() == 0);
        CHECK_THROWS_AS((void)puller.try_pull(), lot::Error);  // one borrow at a time
        kept = look.keep();
        auto moved = std::move(look);
        CHECK(!look);  // NOLINT: moved-from is empty
        CHECK(look.keep() == nullptr);
        CHECK(moved->value == 4);
        moved.end();
        CHECK(!moved);
        moved.end();
      }
      CHECK(kept->value == 4);
      CHECK(puller.borrow_until(std::chrono::steady_clock::now() + 1s)->value == 5);
      CHECK(!puller.borrow(1ms));
      CHECK(puller.status() == Status::Timeout);
      CHECK(puller.missed_total() == 0);
      CHECK(send(pusher, 6) == Status::Ok);
    }  // the publisher goes; what it has sent is read
    CHECK(puller.pull(1s)->value == 6);
    CHECK(puller.try_pull() == nullptr);
    CHECK(puller.status() == Status::PublisherGone);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("missed() tells each reader exactly how many messages it has lost") {
  const Watchdog watchdog(60);
  std::mt19937_64 random(seed());
  for (const std::uint32_t depth : {1U, 2U, 3U, 7U, 64U}) {
    Place place;
    auto pusher = place.engine.advertise<Number>("/t", {Policy::Overwrite, depth, 1s});
    std::vector<lot::ShmPuller<Number>> pullers;
    for (int i = 0; i < 3; ++i) pullers.push_back(place.engine.subscribe<Number>("/t"));
    std::vector<std::uint64_t> next(3, 0), missed(3, 0);
    std::uint64_t sent = 0;
    for (int step = 0; step < 3000; ++step) {
      const auto i = static_cast<std::size_t>(random() % 6);
      if (i >= 3) {
        for (std::uint64_t n = random() % (depth + 2); n > 0; --n) send(pusher, sent++);
        continue;
      }
      const bool borrowing = random() % 2 == 0;
      auto look = borrowing ? pullers[i].try_borrow() : lot::ShmBorrow<Number>();
      auto kept = borrowing ? look.keep() : pullers[i].try_pull();
      if (!kept) {
        REQUIRE(next[i] == sent);
        continue;
      }
      missed[i] += pullers[i].missed();
      REQUIRE(kept->value == next[i] + pullers[i].missed());
      REQUIRE(sent - kept->value <= depth);
      next[i] = kept->value + 1;
    }
    for (std::size_t i = 0; i < 3; ++i) CHECK(pullers[i].missed_total() == missed[i]);
  }
}

TEST_CASE("a borrowed message stays as it is while its publisher laps the reader") {
  const Watchdog watchdog(60);
  Place place;
  auto pusher = place.engine.advertise<Frame>("/t", {Policy::Overwrite, 4, 1s});
  auto numbers = place.engine.advertise<Number>("/n", {Policy::Overwrite, 4, 1s});
  auto puller = place.engine.subscribe<Frame>("/t");
  auto number_puller = place.engine.subscribe<Number>("/n");
  must_go(pusher.push(frame_of(pusher, 7, 3000)));
  send(numbers, 7);
  auto look = puller.borrow(1s);
  auto number = number_puller.borrow(1s);
  for (std::uint64_t n = 100; n < 600; ++n) {
    must_go(pusher.push(frame_of(pusher, n, 3000)));
    send(numbers, n);
  }
  CHECK(look->number == 7);
  CHECK(intact(*look, 3000));
  CHECK(number->value == 7);
  look.end();
  number.end();
  look = puller.borrow(1s);
  CHECK(look->number == 596);
  CHECK(look.missed() == 496);
  number = number_puller.borrow(1s);
  CHECK(number->value == 596);
}

TEST_CASE("under Policy::Block nothing is lost; a full queue leaves the message with the caller") {
  const Watchdog watchdog(60);
  Place place;
  for (const std::uint32_t depth : {1U, 2U, 5U}) {
    auto pusher = place.engine.advertise<Number>("/t", {Policy::Block, depth, 5ms});
    auto puller = place.engine.subscribe<Number>("/t");
    for (std::uint64_t n = 0; n < depth; ++n) CHECK(send(pusher, n) == Status::Ok);
    auto message = pusher.loan(std::uint64_t{depth});
    CHECK(pusher.try_push(std::move(message)) == Status::Full);
    REQUIRE(message);
    CHECK(pusher.push(std::move(message)) == Status::Full);
    REQUIRE(message);
    const lot::ShmSharedPtr<Number> shared = std::move(message);
    CHECK(pusher.push(shared) == Status::Full);
    CHECK(shared->value == depth);
    CHECK(shared.use_count() == 1);
    {
      auto look = puller.borrow(1s);
      CHECK(pusher.push(shared, 1ms) == Status::Full);  // a borrowed message is not read yet
    }
    CHECK(pusher.push(shared) == Status::Ok);
    for (std::uint64_t n = 1; n <= depth; ++n) CHECK(puller.pull(1s)->value == n);
    CHECK(puller.missed_total() == 0);
  }
}

TEST_CASE("two processes hand 20000 messages over under Policy::Block, each way of waiting") {
  const Watchdog watchdog(100);
  for (const auto wait : {Wait::Park, Wait::Adaptive, Wait::Spin}) {
    const auto options = fresh();
    constexpr std::uint64_t kMessages = 20000;
    Steps ready;
    Child reader([&] {
      lot::ShmEngine engine(options);
      auto puller = engine.subscribe<Number>("/t", {wait, 0});
      ready.tell();
      for (std::uint64_t n = 0; n < kMessages; ++n) {
        if (n % 2 == 0) {
          auto look = puller.borrow(20s);
          must(bool(look) && look->value == n, "the next number, borrowed");
        } else {
          auto kept = puller.pull(20s);
          must(bool(kept) && kept->value == n, "the next number, kept");
        }
      }
      must(puller.missed_total() == 0, "none missed");
    });
    REQUIRE(ready.next() == '.');
    {
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Number>("/t", {Policy::Block, 8, 30s});
      REQUIRE(pusher.wait_for_readers(1, 20s));
      for (std::uint64_t n = 0; n < kMessages; ++n) REQUIRE(send(pusher, n) == Status::Ok);
      CHECK(reader.wait() == 0);
    }
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("one ShmPuller reads several publishers, which come and go in any order") {
  const Watchdog watchdog(60);
  std::mt19937_64 random(seed());
  Place place;
  auto puller = place.engine.subscribe<Number>("/t");
  struct Publisher {
    lot::ShmPusher<Number> pusher;
    std::uint64_t id;
    std::uint64_t sent = 0;
  };
  std::vector<std::unique_ptr<Publisher>> publishers(5);
  std::vector<std::uint64_t> next(4000, 0);  // by id
  std::uint64_t ids = 0;
  std::uint64_t all_sent = 0;
  std::uint64_t all_got = 0;
  for (int step = 0; step < 4000; ++step) {
    auto& p = publishers[random() % 5];
    const auto what = random() % 10;
    if (what == 0) {
      if (p) {
        p.reset();
      } else {
        p.reset(new Publisher{place.engine.advertise<Number>("/t", {Policy::Overwrite, 4, 1s}),
                              ids++, 0});
        REQUIRE(puller.publishers() > 0);  // it looks, and so it joins
      }
    } else if (what < 5) {
      if (p) {
        send(p->pusher, p->id * 1000000 + p->sent++);
        ++all_sent;
      }
    } else if (auto seen = puller.try_pull()) {
      ++all_got;
      auto& expected = next[seen->value / 1000000];
      REQUIRE(seen->value % 1000000 >= expected);
      expected = seen->value % 1000000 + 1;
    }
  }
  while (puller.try_pull()) ++all_got;
  CHECK(all_got + puller.missed_total() == all_sent);  // received, or counted as missed
}

TEST_CASE("publishers are counted also while another process has the registry") {
  const Watchdog watchdog(60);
  Place place;
  auto puller = place.engine.subscribe<Number>("/t");
  auto pusher = place.engine.advertise<Number>("/t");
  lot::segment::Segment segment(place.engine.path());
  Steps held;
  std::thread other([&] {
    RegistryLock registry(segment);
    if (registry.lock()) held.tell();
    std::this_thread::sleep_for(30ms);
    registry.unlock();
  });
  CHECK(held.next() != 0);
  CHECK(puller.publishers() == 1);
  other.join();
}

TEST_CASE("what a publisher sent after the subscription counts, even before the first look") {
  const Watchdog watchdog(60);
  Place place;
  auto puller = place.engine.subscribe<Number>("/t");
  auto pusher = place.engine.advertise<Number>("/t", {Policy::Overwrite, 4, 1s});
  for (std::uint64_t n = 0; n < 10; ++n) send(pusher, n);
  std::uint64_t got = 0;
  while (puller.try_pull()) ++got;
  CHECK(got >= 3);
  CHECK(got + puller.missed_total() == 10);
}

TEST_CASE("a lossless publisher waits for all earlier subscribers, also before their first look") {
  const Watchdog watchdog(60);
  Place place;
  for (const auto policy : {Policy::Block, Policy::Refuse}) {
    CAPTURE(static_cast<int>(policy));
    auto first = place.engine.subscribe<Number>("/t");
    auto second = place.engine.subscribe<Number>("/t");
    auto pusher = place.engine.advertise<Number>("/t", {policy, 4, 1ms});
    std::uint64_t n = 0;
    const auto fill = [&] {
      const std::uint64_t before = n;
      while (send(pusher, n) == Status::Ok) ++n;
      return n - before;
    };
    CHECK(fill() == 4);
    for (std::uint64_t i = 0; i < 4; ++i) CHECK(first.pull(10s)->value == i);
    CHECK(fill() == 0);  // the second one has not looked
    for (std::uint64_t i = 0; i < 4; ++i) CHECK(second.pull(10s)->value == i);
    CHECK(fill() == 4);
    CHECK(first.missed_total() + second.missed_total() == 0);
  }
  // Who dies before it has looked holds nobody up.
  Steps steps;
  Child dead([&] {
    lot::ShmEngine engine(place.options);
    auto puller = engine.subscribe<Number>("/u");
    steps.tell();
    pause();
  });
  REQUIRE(steps.next() != 0);
  auto pusher = place.engine.advertise<Number>("/u", {Policy::Block, 4, 20s});
  for (std::uint64_t n = 0; n < 4; ++n) CHECK(send(pusher, n) == Status::Ok);
  dead.kill9();
  CHECK(send(pusher, 4) == Status::Ok);
}

TEST_CASE("a lossless queue is not full because another process is at the registry") {
  const Watchdog watchdog(60);
  Place place;
  lot::segment::Segment segment(place.engine.path());
  auto puller = place.engine.subscribe<Number>("/t");
  auto block = place.engine.advertise<Number>("/t", {Policy::Block, 1, 1s});
  auto refuse = place.engine.advertise<Number>("/t", {Policy::Refuse, 1, 1s});
  RegistryLock registry(segment);
  REQUIRE(registry.lock());
  auto message = block.loan();
  const Status tried = block.try_push(std::move(message));
  const Status pushed = send(refuse, 0);
  const Status full = send(refuse, 1);  // one that is full says so
  registry.unlock();
  CHECK(tried == Status::Ok);
  CHECK(pushed == Status::Ok);
  CHECK(full == Status::Full);
}

TEST_CASE("a lossless publisher does not wait for an index that no process has") {
  const Watchdog watchdog(60);
  Place place;
  auto first = place.engine.advertise<Number>("/t", {Policy::Block, 4, 1ms});
  {
    lot::segment::Segment segment(place.engine.path());
    for (auto& topic : segment.topics()) {
      lot::test::raw(topic.pullers[0]).store(1);  // as a wild write would do
      lot::test::raw(topic.pullers[5]).store(3);
    }
  }
  auto second = place.engine.advertise<Number>("/t", {Policy::Block, 4, 1ms});
  for (std::uint64_t n = 0; n < 20; ++n) {
    CHECK(send(first, n) == Status::Ok);
    CHECK(send(second, n) == Status::Ok);
  }
}

TEST_CASE("a block that a damaged queue leads to is not given back under a pointer") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps done;
  Steps go;
  Child other([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Number>("/t", in_blocks());
    done.tell();
    must(go.next() != 0, "somebody reads");
    must(send(pusher, 7) == Status::Ok, "it is sent");
    done.tell();
    pause();
  });
  REQUIRE(done.next() != 0);
  {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Number>("/t");
    std::optional pusher(engine.advertise<Number>("/u"));
    pusher->loan(8u).reset();  // kept for the next loan
    go.tell();
    REQUIRE(done.next() != 0);
    lot::segment::Segment segment(engine.path());
    const std::uint32_t home = lot::transport::Participant::join(options)->index() + 1;
    std::uint32_t ours = 0;
    while (ours < segment.capacity().blocks && segment.block(ours).home.load() != home) ++ours;
    REQUIRE(ours < segment.capacity().blocks);
    for (std::uint32_t c = 0; c < segment.capacity().channels; ++c) {
      const auto ring = segment.ring(c);
      if (ring.depth == 0) continue;
      auto& slot = ring.slots[0];
      if (lot::ring::block(slot.load()) == lot::ring::kNoBlock) continue;
      slot.store(lot::ring::make(lot::ring::sequence(slot.load()), ours));
    }
    auto wrong = puller.pull(10s);
    REQUIRE(wrong);
    pusher.reset();
    CHECK(segment.block(ours).home.load() == home);
    other.kill9();
  }
  CHECK(eventually([&] { return files_of(options) == 0; }, 10s));
}

TEST_CASE("a publisher that cannot have all its subscribers as readers says so at once") {
  const Watchdog watchdog(60);
  auto options = fresh();
  options.readers = 1;
  lot::ShmEngine engine(options);
  auto first = std::make_unique<lot::ShmPuller<Number>>(engine.subscribe<Number>("/t"));
  auto second = engine.subscribe<Number>("/t");
  try {
    (void)engine.advertise<Number>("/t");  // it throws
    FAIL("two subscribers, and room for one");
  } catch (const lot::Error& e) {
    CHECK(e.error_number() == EUSERS);
    CHECK(std::string(e.what()).find("EngineOptions::readers") != std::string::npos);
  }
  first.reset();
  auto pusher = engine.advertise<Number>("/t");
  CHECK(send(pusher, 1) == Status::Ok);
  CHECK(second.pull(10s)->value == 1);
}

TEST_CASE("a late joiner gets the history it asks for") {
  const Watchdog watchdog(60);
  Place place;
  for (const auto policy : {Policy::Overwrite, Policy::Block}) {
    auto pusher = place.engine.advertise<Number>("/t", {policy, 8, 1s});
    for (std::uint64_t n = 0; n < 20; ++n) send(pusher, n);
    auto none = place.engine.subscribe<Number>("/t");
    auto latched = place.engine.subscribe<Number>("/t", {Wait::Adaptive, 1});
    auto five = place.engine.subscribe<Number>("/t", {Wait::Adaptive, 5});
    auto many = place.engine.subscribe<Number>("/t", {Wait::Adaptive, 1000});
    CHECK(none.try_pull() == nullptr);
    CHECK(latched.try_pull()->value == 19);
    CHECK(latched.try_pull() == nullptr);
    for (std::uint64_t n = 15; n < 20; ++n) CHECK(five.try_pull()->value == n);
    CHECK(five.try_pull() == nullptr);
    std::uint64_t n = policy == Policy::Block ? 13 : 12;  // a sender may be one ahead
    for (; n < 20; ++n) CHECK(many.try_pull()->value == n);
    CHECK(many.missed_total() == 0);
  }
}

TEST_CASE("several threads push on one ShmPusher and none of their messages is lost") {
  const Watchdog watchdog(60);
  Place place;
  auto pusher = place.engine.advertise<Number>("/t", {Policy::Block, 16, 30s});
  auto puller = place.engine.subscribe<Number>("/t");
  std::vector<std::thread> threads;
  for (std::uint64_t t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (std::uint64_t n = 0; n < 2000; ++n) send(pusher, t * 1000000 + n);
    });
  }
  std::vector<std::uint64_t> next(4, 0);
  bool in_order = true;
  for (int n = 0; n < 8000; ++n) {
    auto seen = puller.pull(20s);
    REQUIRE(seen);
    in_order &= seen->value % 1000000 == next[seen->value / 1000000]++;
  }
  for (auto& t : threads) t.join();
  CHECK(in_order);
}

TEST_CASE("a received message is forwarded on other topics without a copy") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps ready, sent;
  Child far([&] {
    lot::ShmEngine engine(options);
    auto in = engine.subscribe<Frame>("/in");
    auto out = engine.advertise<Frame>("/out");
    ready.tell();
    auto seen = in.pull(20s);
    must(bool(seen), "a message");
    must(out.push(seen) == Status::Ok, "forwarded");
    must(out.push(seen) == Status::Ok, "forwarded twice");
    seen.reset();
    must(sent.next() == '.', "the end");
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto back = engine.subscribe<Frame>("/out");
    auto pusher = engine.advertise<Frame>("/in", {Policy::Overwrite, 1, 1s});
    REQUIRE(pusher.wait_for_readers(1, 10s));
    auto frame = frame_of(pusher, 5, 5000);
    const Frame* address = frame.get();
    must_go(pusher.push(std::move(frame)));
    auto first = back.pull(20s);
    auto second = back.pull(20s);
    REQUIRE(first);
    REQUIRE(second);
    CHECK(first.get() == address);
    CHECK(second.get() == address);
    // Overwritten at its origin, it lives on.
    for (std::uint64_t n = 10; n < 100; ++n) must_go(pusher.push(frame_of(pusher, n, 5000)));
    CHECK(intact(*first, 5000));
    CHECK(first->number == 5);
    sent.tell();
    CHECK(far.wait() == 0);
    CHECK(intact(*second, 5000));
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a pusher that only forwards gives the messages up again, also when it goes") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps ready, step, done;
  Child far([&] {
    lot::ShmEngine engine(options);
    auto in = std::make_unique<lot::ShmPuller<Number>>(engine.subscribe<Number>("/in"));
    auto out = std::make_unique<lot::ShmPusher<Number>>(
        engine.advertise<Number>("/out", {Policy::Overwrite, 2, 1s}));
    ready.tell();
    for (int n = 0; n < 100; ++n) {
      auto seen = in->pull(20s);
      must(bool(seen), "a message");
      must_go(out->push(seen));
    }
    (void)out->loan();  // looks at the retired ones: 34 of them, none its own
    out.reset();
    in.reset();
    step.tell();
    done.next();
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    {
      auto pusher = engine.advertise<Number>("/in", {Policy::Block, 200, 1s});
      REQUIRE(pusher.wait_for_readers(1, 10s));
      for (std::uint64_t n = 0; n < 100; ++n) REQUIRE(send(pusher, n) == Status::Ok);
      REQUIRE(step.next() == '.');
    }
    lot::segment::Segment s(engine.path());
    CHECK(eventually([&] { return Audit(s).homes == 0; }, 6s));
    INFO(Audit(s).text());
    CHECK(Audit(s).own_bits == 0);
    done.tell();
    CHECK(far.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a pointer that outlives its publisher gives its memory back when it goes") {
  const Watchdog watchdog(60);
  Place place;
  lot::ShmSharedPtr<const Frame> kept;
  lot::ShmUniquePtr<Frame> loan;
  {
    auto pusher = place.engine.advertise<Frame>("/t");
    kept = frame_of(pusher, 7, 10000);
    REQUIRE(pusher.push(kept) == Status::Ok);
    loan = frame_of(pusher, 8, 10000);
  }
  lot::segment::Segment s(place.engine.path());
  REQUIRE(eventually([&] { return Audit(s).channels == 0; }));
  place.engine.make<Number>(std::uint64_t{9}).reset();  // all that can be settled is, by now
  CHECK(intact(*kept, 10000));
  CHECK(Audit(s).granules != 0);
  kept.reset();
  loan.reset();
  CHECK(Audit(s).granules == 0);
}

TEST_CASE("when memory runs out, the oldest messages give way and are counted by missed()") {
  const Watchdog watchdog(60);
  Place place(16 << 20);
  auto pusher = place.engine.advertise<Frame>("/t", {Policy::Overwrite, 64, 1s});
  lot::PullerOptions greedy;
  greedy.max_held_bytes = lot::PullerOptions::kNoQuota;
  auto puller = place.engine.subscribe<Frame>("/t", greedy);
  constexpr std::size_t kSize = (1 << 20) / 8;
  for (std::uint64_t n = 0; n < 100; ++n) must_go(pusher.push(frame_of(pusher, n, kSize)));
  std::uint64_t next = 0;
  while (auto look = puller.try_borrow()) {
    REQUIRE(look->number == next + look.missed());
    REQUIRE(intact(*look, kSize));
    next = look->number + 1;
  }
  CHECK(next == 100);
  CHECK(puller.missed_total() > 80);
  CHECK(puller.missed_total() < 100);
  // What is kept can not give way.
  std::vector<lot::ShmSharedPtr<const Frame>> kept;
  for (std::uint64_t n = 0;; ++n) {
    REQUIRE(n < 20);
    try {
      must_go(pusher.push(frame_of(pusher, n, kSize)));
    } catch (const lot::OutOfMemory& e) {
      CHECK(std::string(e.what()).find("LOT_SIZE") != std::string::npos);
      break;
    }
    kept.push_back(puller.pull(1s));
    REQUIRE(kept.back());
  }
  for (auto& k : kept) CHECK(intact(*k, kSize));
  kept.clear();
  for (std::uint64_t n = 0; n < 30; ++n) {
    must_go(pusher.push(frame_of(pusher, n, kSize)));
    CHECK(puller.pull(1s)->number == n);
  }
}

TEST_CASE("when blocks run out, loan throws OutOfMemory, try_loan is null, and freeing helps") {
  const Watchdog watchdog(60);
  auto options = fresh(32 << 20);
  options.blocks = 16;
  Place place(options);
  auto pusher = place.engine.advertise<Number>("/t", {Policy::Block, 4, 1s});
  std::vector<lot::ShmUniquePtr<Number>> loans;
  for (std::uint64_t n = 0; n < 16; ++n) loans.push_back(pusher.loan(n));
  CHECK(!pusher.try_loan());
  try {
    (void)pusher.loan();  // it throws
    FAIL("no exception");
  } catch (const lot::OutOfMemory& e) {
    CHECK(std::string(e.what()).find("EngineOptions::blocks") != std::string::npos);
  }
  auto other = place.engine.advertise<Number>("/u");
  loans.resize(8);
  for (int n = 0; n < 8; ++n) loans.push_back(other.loan());  // another pool gets them
  CHECK(!other.try_loan());
}

TEST_CASE("frames of 16 MiB cross between processes and their content is right") {
  const Watchdog watchdog(100);
  const auto options = fresh(256 << 20);
  Steps ready;
  constexpr std::size_t kSize = (16 << 20) / 8;
  Child reader([&] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Frame>("/t");
    ready.tell();
    for (std::uint64_t n = 0; n < 30; ++n) {
      auto seen = puller.pull(20s);
      must(bool(seen) && seen->number == n, "the next frame");
      must(intact(*seen, kSize), "its content");
    }
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/t", {Policy::Block, 4, 30s});
    REQUIRE(pusher.wait_for_readers(1, 20s));
    pusher.reserve(4, 16 << 20);
    for (std::uint64_t n = 0; n < 30; ++n) {
      REQUIRE(pusher.push(frame_of(pusher, n, kSize)) == Status::Ok);
    }
    CHECK(reader.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a plain message larger than a block's small payload is not zeroed and crosses") {
  const Watchdog watchdog(60);
  Place place;
  auto pusher = place.engine.advertise<Big>("/t", {Policy::Overwrite, 2, 1s});
  auto puller = place.engine.subscribe<Big>("/t");
  for (std::uint64_t n = 0; n < 50; ++n) {
    auto big = pusher.loan();
    big->number = n;
    std::memset(big->bytes, static_cast<int>(n), sizeof(big->bytes));
    must_go(pusher.push(std::move(big)));
    auto seen = puller.pull(1s);
    REQUIRE(seen);
    CHECK(seen->number == n);
    CHECK(seen->bytes[0] == n);
    CHECK(seen->bytes[99999] == n);
  }
  CHECK(place.granules() < 2000);
}

TEST_CASE("a message grows in many small steps") {
  const Watchdog watchdog(60);
  Place place;
  auto pusher = place.engine.advertise<Frame>("/t", {Policy::Overwrite, 2, 1s});
  auto puller = place.engine.subscribe<Frame>("/t");
  for (int round = 0; round < 20; ++round) {
    auto frame = pusher.loan();
    for (std::uint64_t i = 0; i < 200000; ++i) frame->data.push_back(i);
    must_go(pusher.push(std::move(frame)));
    auto seen = puller.pull(1s);
    REQUIRE(seen->data.size() == 200000);
    for (std::uint64_t i = 0; i < 200000; i += 997) REQUIRE(seen->data[i] == i);
  }
  CHECK(place.granules() < 8192);
}

TEST_CASE("big and small messages in any mixture do not fill the segment up") {
  const Watchdog watchdog(100);
  std::mt19937_64 random(seed());
  Place place(128 << 20);
  auto pusher = place.engine.advertise<Frame>("/t", {Policy::Overwrite, 4, 1s});
  auto puller = place.engine.subscribe<Frame>("/t");
  std::deque<std::pair<lot::ShmSharedPtr<const Frame>, std::size_t>> kept;
  std::size_t most = 0;
  for (std::uint64_t n = 0; n < 2000; ++n) {
    const std::size_t size = random() % 20 == 0 ? random() % 500000 : random() % 2000;
    auto frame = pusher.loan();
    frame->number = n;
    if (random() % 2 == 0) {
      for (std::size_t i = 0; i < size; ++i) frame->data.push_back(n);
    } else {
      frame->data.assign(size, n);
    }
    REQUIRE(pusher.push(std::move(frame)) == Status::Ok);
    auto seen = puller.pull(1s);
    REQUIRE(seen);
    REQUIRE(seen->number == n);
    if (random() % 4 == 0) kept.emplace_back(seen, size);
    if (kept.size() > 6) kept.pop_front();
    if (n % 100 == 0) {
      for (const auto& [k, k_size] : kept) REQUIRE(intact(*k, k_size));
      most = std::max(most, place.granules());
    }
  }
  MESSAGE("at most ", most / 256, " MiB of 128 were in use");
}

TEST_CASE("several ShmEngine of one process on one segment are one participant") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  {
    auto first = std::make_unique<lot::ShmEngine>(options);
    lot::ShmEngine second(options);
    lot::segment::Segment s(second.path());
    CHECK(Audit(s).participants == 1);
    auto pusher = first->advertise<Number>("/t");
    auto puller = second.subscribe<Number>("/t");
    first.reset();
    send(pusher, 3);
    CHECK(puller.pull(1s)->value == 3);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("pushing a message of another segment is an error that names both") {
  const Watchdog watchdog(60);
  Place here;
  Place there;
  auto pusher = here.engine.advertise<Number>("/t");
  const lot::ShmSharedPtr<Number> other = there.engine.make<Number>();
  try {
    must_go(pusher.push(other));
    FAIL("no exception");
  } catch (const lot::Error& e) {
    CHECK(std::string(e.what()).find(there.engine.path()) != std::string::npos);
    CHECK(std::string(e.what()).find(here.engine.path()) != std::string::npos);
  }
}

TEST_SUITE_END();
