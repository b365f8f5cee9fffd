// SPDX-License-Identifier: Apache-2.0

// The other words that count: each is set close to its end before anybody uses it, and wraps while
// it is used.

#include "lockfree_ring/words.hpp"

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <list>
#include <optional>
#include <string>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "refcount/ownership.hpp"
#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "support/neighbour.hpp"
#include "support/raw.hpp"

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

[[maybe_unused]] const bool has_janitor = start_janitor();

constexpr std::uint32_t kEnd = ~std::uint32_t{0};

/// A segment that nobody uses yet, to set words in. It exists as long as this.
struct Fresh : Ground {
  explicit Fresh(std::uint32_t its_blocks = 16384, std::uint32_t its_channels = 2048) {
    blocks = its_blocks;
    channels = its_channels;
    {
      lot::EngineOptions kept = *this;
      kept.persist = true;
      const lot::ShmEngine maker(kept);
    }
    segment.emplace(file_of(*this));
    lot::test::raw(segment->directory().persists).store(0);  // the last one that leaves removes it
  }
  std::optional<lot::segment::Segment> segment;
};

void set_life(lot::segment::Segment& s, std::uint32_t version, std::uint32_t generation) {
  for (auto& block : s.blocks())
    lot::test::raw(block.life).store(std::uint64_t{version} << 32 | generation);
}
std::uint32_t version_of(const lot::segment::BlockWords& block) {
  return static_cast<std::uint32_t>(block.life.load() >> 32);
}
std::uint32_t generation_of(const lot::segment::BlockWords& block) {
  return lot::refcount::generation_of(block.life.load());
}

/// The only ring.
lot::segment::Ring ring_of(lot::segment::Segment& s) {
  for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
    if (lot::ring::writer_state(s.channels()[c].writer.load()) == lot::ring::State::Live) {
      return s.ring(c);
    }
  }
  return {};
}

}  // namespace

TEST_SUITE_BEGIN("words");

TEST_CASE("generations and versions of blocks wrap while messages cross and are kept") {
  const Watchdog watchdog(60);
  Fresh ground(8);
  set_life(*ground.segment, kEnd - 2, kEnd - 2);
  {
    lot::ShmEngine engine(ground);
    auto pusher = engine.advertise<Frame>("/t", {Policy::Block, 2, 30s});
    auto own = engine.subscribe<Frame>("/t", {Wait::Park, 0});
    Steps joined;
    Child reader([&] {
      lot::ShmEngine other(ground);
      auto puller = other.subscribe<Frame>("/t", {Wait::Park, 0});
      joined.tell();
      lot::ShmSharedPtr<const Frame> kept;
      lot::ShmWeakPtr<const Frame> weak;
      for (std::uint64_t n = 0; n < 200; ++n) {
        auto frame = puller.pull();
        must(frame->number == n && frame->data.size() == 300 && frame->data[299] == n, "a frame");
        const auto before = weak.lock();
        must(!before || before->number == n - 2, "a weak pointer to the one before");
        weak = kept;
        must(weak.lock() == kept, "a weak pointer to what is kept");
        kept = frame;
        must(kept->number == n, "kept");
      }
    });
    REQUIRE(joined.next() == '.');
    lot::ShmWeakPtr<const Frame> weak;
    for (std::uint64_t n = 0; n < 200; ++n) {
      auto frame = pusher.loan();
      frame->number = n;
      frame->data.assign(300, n);
      REQUIRE(pusher.push(std::move(frame)) == Status::Ok);
      const auto seen = own.pull(10s);
      REQUIRE(seen);
      CHECK(seen->number == n);
      const auto before = weak.lock();
      CHECK((!before || before->number == n - 1));
      weak = seen;
      CHECK(weak.lock() == seen);
    }
    CHECK(reader.wait() == 0);
  }
  const auto& blocks = ground.segment->blocks();
  CHECK(std::any_of(blocks.begin(), blocks.end(), [](auto& b) { return generation_of(b) < 1000; }));
  CHECK(std::any_of(blocks.begin(), blocks.end(), [](auto& b) { return version_of(b) < 1000; }));
  CHECK(Audit(*ground.segment).nothing());
  CHECK(files_of(ground) == 0);
}

TEST_CASE("a weak pointer from before the wrap of the generation has expired behind it") {
  const Watchdog watchdog(60);
  for (const std::uint32_t start : {kEnd - 3, kEnd - 8192 - 3}) {  // also where the tag wraps
    Fresh ground(4);
    set_life(*ground.segment, 0, start);
    {
      lot::ShmEngine engine(ground);
      std::list<lot::ShmWeakPtr<Number>> dead;
      for (std::uint64_t n = 0; n < 24; ++n) {
        const lot::ShmSharedPtr<Number> message = engine.make<Number>();
        message->value = n;
        for (const auto& weak : dead) {
          CHECK(weak.expired());
          CHECK(weak.lock() == nullptr);
        }
        dead.emplace_back(message);
        CHECK(!dead.back().expired());
        CHECK(dead.back().lock() == message);
      }
    }
    const auto& blocks = ground.segment->blocks();
    CHECK(std::any_of(blocks.begin(), blocks.end(), [&](auto& block) {
      return generation_of(block) != start && generation_of(block) - start < 30;
    }));
  }
}

TEST_CASE("a weak pointer does not take a message whose generation has the same tag for its own") {
  const Watchdog watchdog(60);
  constexpr std::uint32_t kTags = 1 << 13;
  Fresh ground(4);
  set_life(*ground.segment, 0, kEnd - kTags - 100);  // it wraps on the way
  lot::ShmEngine engine(ground);
  lot::ShmSharedPtr<Number> message = engine.make<Number>();
  const lot::ShmWeakPtr<Number> weak = message;
  const Number* address = message.get();
  const auto& blocks = ground.segment->blocks();
  const auto& block = *std::find_if(blocks.begin(), blocks.end(),
                                    [](auto& words) { return words.home.load() != 0; });
  const std::uint32_t first = generation_of(block);
  std::uint32_t same_tag = 0;
  for (std::uint32_t n = 1; n <= 3 * kTags; ++n) {
    message.reset();
    message = engine.make<Number>();
    REQUIRE(message.get() == address);
    REQUIRE(generation_of(block) == first + n);
    if (n % kTags > 1 && n % kTags < kTags - 1) continue;
    same_tag += lot::detail::hold::tag_of(generation_of(block)) == lot::detail::hold::tag_of(first);
    CHECK(weak.expired());
    CHECK(weak.lock() == nullptr);
    CHECK(message.use_count() == 1);
  }
  CHECK(same_tag == 3);
  CHECK(generation_of(block) < 3 * kTags);
}

TEST_CASE("the roster wraps: a sender learns of each joiner") {
  const Watchdog watchdog(60);
  Fresh ground;
  lot::ShmEngine engine(ground);
  auto pusher = engine.advertise<Number>("/t", {Policy::Block, 2, 0s});
  const auto ring = ring_of(*ground.segment);
  ring.roster->store(kEnd - 2);
  std::list<lot::ShmPuller<Number>> readers;
  for (std::uint64_t n = 0; n < 6; ++n) {
    CHECK(pusher.push(pusher.loan(n)) == Status::Ok);  // it has looked at the roster
    for (auto& reader : readers) CHECK(reader.try_pull()->value == n);
    readers.push_back(engine.subscribe<Number>("/t"));
    CHECK(ring.roster->load() == static_cast<std::uint32_t>(kEnd - 2 + n + 1));
    for (const auto expected : {Status::Ok, Status::Ok, Status::Full}) {
      CHECK(pusher.push(pusher.loan(n)) == expected);  // the joiner alone has not read
      for (auto& reader : readers) {
        if (&reader != &readers.back()) CHECK((expected == Status::Full || reader.try_pull()));
      }
    }
    for (int i = 0; i < 2; ++i) CHECK(readers.back().try_pull());
  }
  CHECK(ring.roster->load() < 10);
}

TEST_CASE("the roster wraps: a sender knows what each joiner borrows") {
  const Watchdog watchdog(60);
  Fresh ground(64);
  lot::ShmEngine engine(ground);
  auto pusher = engine.advertise<Number>("/t", {Policy::Overwrite, 2, 1s});
  const auto ring = ring_of(*ground.segment);
  ring.roster->store(kEnd - 2);
  std::list<lot::ShmPuller<Number>> readers;
  std::list<lot::ShmBorrow<Number>> borrows;
  for (std::uint64_t n = 0; n < 6; ++n) {
    readers.push_back(engine.subscribe<Number>("/t"));
    must_go(pusher.push(pusher.loan(n)));
    borrows.push_back(readers.back().borrow(10s));
    for (std::uint64_t more = 0; more < 300; ++more) must_go(pusher.push(pusher.loan(1000 + more)));
    std::uint64_t expected = 0;
    for (const auto& borrow : borrows) CHECK(borrow->value == expected++);
  }
  CHECK(ring.roster->load() < 10);
}

TEST_CASE("the word that a sender sleeps on wraps, by readers that read and that leave") {
  const Watchdog watchdog(60);
  for (const bool readers_leave : {false, true}) {
    CAPTURE(readers_leave);
    Fresh ground;
    lot::ShmEngine engine(ground);
    auto pusher = engine.advertise<Number>("/t", {Policy::Block, 1, 60s});
    const auto ring = ring_of(*ground.segment);
    ring.space->store(kEnd - 5);  // even: nobody sleeps
    const std::uint64_t count = 12;
    std::list<lot::ShmPuller<Number>> readers;
    for (std::uint64_t n = 0; n < (readers_leave ? count : 1); ++n) {
      readers.push_back(engine.subscribe<Number>("/t"));
    }
    std::atomic<pid_t> thread{0};
    std::atomic<std::uint64_t> pushed{0};
    std::thread sender([&] {
      thread = gettid();
      while (pushed <= count && pusher.push(pusher.loan(pushed.load())) == Status::Ok) ++pushed;
    });
    for (std::uint64_t n = 0; n < count; ++n) {
      CHECK(eventually([&] {
        return pushed == n + 1 && (ring.space->load() & 1) != 0 && asleep(getpid(), thread);
      }));
      if (readers_leave) {
        for (auto& reader : readers) {
          if (&reader != &readers.front()) CHECK(reader.pull(10s)->value == n);
        }
        readers.pop_front();  // the one that held it back
      } else {
        CHECK(readers.front().pull(10s)->value == n);
      }
    }
    sender.join();
    CHECK(pushed == count + 1);
    CHECK(ring.space->load() < 100000);
  }
}

TEST_CASE("the directory's version wraps: a reader that waits for publishers learns of each") {
  const Watchdog watchdog(60);
  Fresh ground;
  auto& version = lot::test::raw(ground.segment->directory().version);
  version.store(kEnd - 3);
  lot::ShmEngine engine(ground);
  std::atomic<pid_t> thread{0};
  std::atomic<std::uint64_t> next{0};
  std::thread reader([&] {
    auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
    thread = gettid();
    while (next < 10) {
      const auto seen = puller.pull();
      if (!seen && puller.status() == Status::PublisherGone) continue;
      if (!seen || seen->value != next) break;
      ++next;
    }
  });
  std::list<lot::ShmPusher<Number>> pushers;  // the reader sleeps on the version, then on rings
  for (std::uint64_t n = 0; n < 10; ++n) {
    CHECK(eventually([&] { return next == n && asleep(getpid(), thread); }));
    if (n >= 5) pushers.clear();  // and on the version again
    CHECK(eventually([&] { return next == n && asleep(getpid(), thread); }));
    pushers.push_back(engine.advertise<Number>("/t"));
    CHECK(pushers.back().wait_for_readers(1, 10s));
    must_go(pushers.back().push(pushers.back().loan(n)));
  }
  reader.join();
  CHECK(next == 10);
  CHECK(version.load() < 100);
}

TEST_CASE("the generation of a ring wraps: publishers that follow each other are told apart") {
  const Watchdog watchdog(60);
  for (const std::uint32_t before : {kEnd - 3, kEnd - 2}) {  // one up for each end of a ring, too
    CAPTURE(before);
    Fresh ground(16384, 1);  // one channel for all of them
    auto& writer = lot::test::raw(ground.segment->channels()[0].writer);
    writer.store(lot::ring::make_writer(before, lot::ring::State::Free, 0));
    {
      lot::ShmEngine engine(ground);
      auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
      for (std::uint32_t n = 0; n < 8; ++n) {
        std::optional<lot::ShmPusher<Number>> pusher;
        CHECK(eventually([&] {  // the ring before it is in use until it was collected
          try {
            pusher = engine.advertise<Number>("/t");
          } catch (const lot::Error&) {
            return false;
          }
          return true;
        }));
        REQUIRE(pusher);
        const auto word = writer.load();
        CHECK(lot::ring::writer_state(word) == lot::ring::State::Live);
        for (std::uint64_t i = 0; i < 2; ++i) must_go(pusher->push(pusher->loan(2 * n + i)));
        CHECK(puller.pull(10s)->value == 2 * n);
        pusher.reset();
        CHECK(puller.pull(10s)->value == 2 * n + 1);  // what it has left
        CHECK(puller.try_pull() == nullptr);
        CHECK(puller.status() == Status::PublisherGone);
      }
      CHECK(puller.missed_total() == 0);
    }
    CHECK(lot::ring::writer_generation(writer.load()) < 20);
  }
}

TEST_SUITE_END();
