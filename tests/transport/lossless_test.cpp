// SPDX-License-Identifier: Apache-2.0

// Publishers that lose nothing, where their depth does not fit into the segment: what all readers
// have read goes back when memory is short, and nothing else.

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <deque>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/in_blocks.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;

constexpr std::size_t kMiB = std::size_t{1} << 20;
/// 64 frames, the default depth, do not fit: as 16 MiB in 1 GiB.
constexpr std::size_t kSegment = 64 * kMiB;
constexpr std::uint64_t kFrames = 300;

struct Frame {
  std::uint64_t number = 0;
  lot::ShmVector<unsigned char> data;
};
struct Note {
  std::uint64_t number = 0;
};

unsigned char mark(std::uint64_t number) { return static_cast<unsigned char>(number * 37 + 11); }

void push(lot::ShmPusher<Frame>& pusher, std::uint64_t number, std::size_t bytes = kMiB) {
  auto frame = pusher.loan();
  frame->number = number;
  frame->data.resize(bytes);
  frame->data.front() = frame->data.back() = mark(number);
  must(pusher.push(std::move(frame)) == Status::Ok, "pushed");
}

bool is_whole(const Frame& frame, std::uint64_t number) {
  return frame.number == number && frame.data.size() >= 1 && frame.data.front() == mark(number) &&
         frame.data.back() == mark(number);
}

lot::PullerOptions past(std::uint64_t history) {
  lot::PullerOptions options;
  options.history = history;
  options.max_held_bytes = lot::PullerOptions::kNoQuota;
  return options;
}

/// Reads `count` frames from the first one on, as long as it takes. REQUIRES: nothing was missed.
void read_all(lot::ShmPuller<Frame>& reader, std::uint64_t count) {
  for (std::uint64_t n = 0; n < count; ++n) {
    const auto frame = reader.pull(20s);
    must(frame != nullptr, "a frame");
    must(is_whole(*frame, n), "the next frame, whole");
  }
  must(reader.missed_total() == 0, "nothing was missed");
}

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("frames that do not fit at default depth all arrive, under Policy::Block and Refuse") {
  for (const Policy policy : {Policy::Block, Policy::Refuse}) {
    CAPTURE((policy == Policy::Block));
    const Watchdog watchdog(60);
    lot::ShmEngine engine(fresh(kSegment));
    auto pusher = engine.advertise<Frame>("/camera", {policy});
    auto reader = engine.subscribe<Frame>("/camera");
    std::uint64_t next = 0;
    for (std::uint64_t n = 0; n < kFrames; ++n) {
      REQUIRE_NOTHROW(push(pusher, n));
      // It falls behind, and catches up.
      const std::uint64_t lag = n + 1 == kFrames ? 0 : n / 50 % 2 == 0 ? 1 : 20;
      while (n + 1 - next > lag) {
        const auto frame = reader.try_pull();
        REQUIRE(frame);
        REQUIRE(is_whole(*frame, next++));
      }
    }
    CHECK(next == kFrames);
    CHECK(reader.missed_total() == 0);
  }
}

TEST_CASE("such frames all reach readers in other processes, of which one keeps some frames") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  Steps ready, go, end;
  Child quick([&] {
    lot::ShmEngine engine(options);
    auto reader = engine.subscribe<Frame>("/camera");
    ready.tell();
    read_all(reader, kFrames);
    end.tell();
  });
  Child keeper([&] {
    lot::ShmEngine engine(options);
    auto reader = engine.subscribe<Frame>("/camera", past(0));
    ready.tell();
    std::deque<lot::ShmSharedPtr<const Frame>> kept;
    for (std::uint64_t n = 0; n < kFrames; ++n) {
      kept.push_back(reader.pull(20s));
      must(kept.back() != nullptr, "a frame");
      if (kept.size() == 10) {
        must(is_whole(*kept.front(), n - 9), "whole, however late");
        kept.pop_front();
      }
    }
    must(reader.missed_total() == 0, "nothing was missed");
    end.tell();
  });
  REQUIRE(ready.next() == '.');
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/camera", {Policy::Block, 32, 20s});
    for (std::uint64_t n = 0; n < kFrames; ++n) REQUIRE_NOTHROW(push(pusher, n));
    for (int n = 0; n < 2; ++n) CHECK(end.next() == '.');
  }
  CHECK(quick.wait() == 0);
  CHECK(keeper.wait() == 0);
}

TEST_CASE("two lossless publishers and one with Policy::Overwrite share a segment") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  lot::ShmEngine engine(options);
  Steps ready, end;
  auto first = engine.subscribe<Frame>("/first");
  auto second = engine.subscribe<Frame>("/second");
  const auto publisher = [&](const char* topic, Policy policy) {
    return [&options, &ready, &end, topic, policy] {
      lot::ShmEngine mine(options);
      auto pusher = mine.advertise<Frame>(topic, {policy, 64, 20s});
      ready.tell();
      for (std::uint64_t n = 0; n < kFrames; ++n) {
        // Under Refuse it says at once that the others' readers have yet to read.
        const auto loaned = [&]() -> lot::ShmUniquePtr<Frame> {
          auto frame = pusher.loan();
          frame->number = n;
          frame->data.resize(kMiB);
          frame->data.front() = frame->data.back() = mark(n);
          return frame;
        };
        lot::ShmUniquePtr<Frame> frame;
        while (!frame) {
          try {
            frame = loaned();
          } catch (const lot::OutOfMemory&) {
            if (policy == Policy::Block) throw;
            std::this_thread::sleep_for(1ms);
          }
        }
        while (pusher.push(std::move(frame)) != Status::Ok) std::this_thread::sleep_for(1ms);
        if (n % 4 == 0) std::this_thread::sleep_for(1ms);
      }
      ready.tell();
      end.next(60s);
    };
  };
  Child block(publisher("/first", Policy::Block));
  Child refuse(publisher("/second", Policy::Refuse));
  Child overwrite([&] {
    lot::ShmEngine mine(options);
    auto pusher = mine.advertise<Frame>("/camera");
    ready.tell();
    std::uint64_t n = 0;
    for (; n < kFrames; ++n) push(pusher, n);
    ready.tell();
    while (end.next(1ms) == 0) push(pusher, n++);
  });
  std::thread a([&] { read_all(first, kFrames); });
  std::thread b([&] { read_all(second, kFrames); });
  a.join();
  b.join();
  for (int n = 0; n < 6; ++n) CHECK(ready.next() == '.');
  // All has been read: of some 54 frames each has a third. 60 % of that at least, and it stays so.
  CHECK(eventually([&] { return engine.subscribe<Frame>("/camera", past(64)).size() >= 11; }));
  for (const char* topic : {"/first", "/second"}) {
    CHECK(engine.subscribe<Frame>(topic, past(64)).size() >= 2);
  }
  for (int n = 0; n < 3; ++n) end.tell();
  CHECK(block.wait() == 0);
  CHECK(refuse.wait() == 0);
  CHECK(overwrite.wait() == 0);
}

TEST_CASE("what was read of a lossless publisher goes to another topic, but for the newest") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  lot::ShmEngine engine(options);
  auto reader = engine.subscribe<Frame>("/lossless");
  Steps ready, end;
  const auto lossless = [&options, &ready, &end] {
    lot::ShmEngine mine(options);
    auto pusher = mine.advertise<Frame>("/lossless", {Policy::Block, 64, 20s});
    for (std::uint64_t n = 0; n < 40; ++n) push(pusher, n);
    ready.tell();
    end.next(60s);
  };
  Child other(lossless);
  REQUIRE(ready.next() == '.');
  for (std::uint64_t n = 0; n < 30; ++n) {
    const auto frame = reader.try_pull();
    REQUIRE(frame);
    CHECK(is_whole(*frame, n));
  }
  auto camera = engine.advertise<Frame>("/camera");
  SUBCASE("as far as the shares are equal") {
    for (std::uint64_t n = 0; n < 60; ++n) push(camera, n);
    const auto has = engine.subscribe<Frame>("/camera", past(64)).size();
    CHECK(has >= 24);
    CHECK(has <= 33);
  }
  SUBCASE("what its reader has yet to read stays, whatever is loaned") {
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    CHECK_THROWS_AS(
        for (;;) {
          loans.push_back(camera.loan());
          loans.back()->data.resize(kMiB);
        },
        lot::OutOfMemory);
  }
  for (std::uint64_t n = 30; n < 40; ++n) {
    const auto frame = reader.try_pull();
    REQUIRE(frame);
    CHECK(is_whole(*frame, n));
  }
  CHECK(reader.missed_total() == 0);
  SUBCASE("and of what was read the newest two stay") {
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    CHECK_THROWS_AS(
        for (;;) {
          loans.push_back(camera.loan());
          loans.back()->data.resize(kMiB);
        },
        lot::OutOfMemory);
    auto late = engine.subscribe<Frame>("/lossless", past(64));
    CHECK(late.size() == 2);
    for (std::uint64_t n = 38; n < 40; ++n) {
      const auto frame = late.try_pull();
      REQUIRE(frame);
      CHECK(is_whole(*frame, n));
    }
    CHECK(late.missed_total() == 0);
  }
  end.tell();
  CHECK(other.wait() == 0);
}

TEST_CASE("a latched lossless message is there for late readers while others run out of memory") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  auto map = engine.advertise<Frame>("/map", {Policy::Block, 4, 20s});
  push(map, 7, 4 * kMiB);
  auto camera = engine.advertise<Frame>("/camera");
  auto stream = engine.advertise<Frame>("/stream", {Policy::Refuse});
  auto reader = engine.subscribe<Frame>("/stream");
  for (std::uint64_t n = 0; n < 2 * kFrames; ++n) {
    push(camera, n);
    push(stream, n);
    REQUIRE(reader.try_pull());
  }
  auto late = engine.subscribe<Frame>("/map", past(1));
  const auto got = late.try_pull();
  REQUIRE(got);
  CHECK(is_whole(*got, 7));
}

TEST_CASE("a reader that joins meanwhile gets as history the newest frames, without a gap") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  Steps ready;
  std::atomic<bool> over{false};
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Frame>("/camera", {Policy::Block, 64, 20s});
  auto reader = engine.subscribe<Frame>("/camera");
  std::atomic<std::uint64_t> joins{0};
  std::thread joiner([&] {
    lot::ShmEngine mine(options);
    for (std::uint64_t history = 1; !over; history = history % 70 + 1) {
      const bool all = history % 7 == 0;
      auto late = mine.subscribe<Frame>("/camera", past(all ? ~std::uint64_t{0} : history));
      std::uint64_t next = 0;
      for (int n = 0; n < 5; ++n) {
        const auto frame = late.pull(n == 0 ? 100ms : 1ms);
        if (!frame) break;
        must(n == 0 || frame->number == next, "no gap");
        must(is_whole(*frame, frame->number), "whole");
        if (n == 0) must(late.missed_total() == (all ? frame->number : 0), "what went before");
        next = frame->number + 1;
      }
      ++joins;
    }
  });
  for (std::uint64_t n = 0; n < 4 * kFrames || joins < 70; ++n) {
    push(pusher, n);
    const auto frame = reader.pull(20s);
    REQUIRE(frame);
    REQUIRE(is_whole(*frame, n));
  }
  over = true;
  joiner.join();
  CHECK(reader.missed_total() == 0);
}

TEST_CASE("a lossless publisher with max_bytes keeps to it and loses nothing") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  lot::PusherOptions limited{Policy::Refuse};
  limited.max_bytes = 8 * kMiB;
  auto pusher = engine.advertise<Frame>("/camera", limited);
  auto reader = engine.subscribe<Frame>("/camera");
  for (std::uint64_t n = 0; n < kFrames; ++n) {
    REQUIRE_NOTHROW(push(pusher, n));
    if (n < 4) continue;
    const auto frame = reader.try_pull();
    REQUIRE(frame);
    REQUIRE(is_whole(*frame, n - 4));
  }
  // Nothing goes in vain for what readers hold up.
  push(pusher, kFrames);
  push(pusher, kFrames + 1);
  push(pusher, kFrames + 2);
  auto frame = pusher.loan();
  CHECK_THROWS_AS(frame->data.resize(4 * kMiB), lot::OutOfMemory);
  CHECK(reader.size() == 7);
}

TEST_CASE("a loan waits for a slow reader as a push does, and for nothing else") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Frame>("/camera", {Policy::Block, 64, 20s});
  Steps ready, go;
  Child slow([&] {
    lot::ShmEngine mine(options);
    auto reader = mine.subscribe<Frame>("/camera");
    ready.tell();
    must(go.next() == '.', "memory is short");
    for (std::uint64_t n = 0; n < kFrames; ++n) {
      if (n < 100) std::this_thread::sleep_for(1ms);
      const auto frame = reader.pull(20s);
      must(frame && is_whole(*frame, n), "the next frame, whole");
    }
    must(reader.missed_total() == 0, "nothing was missed");
  });
  REQUIRE(ready.next() == '.');
  std::uint64_t n = 0;
  for (; n < 45; ++n) push(pusher, n);
  SUBCASE("where the message grows") {
    go.tell();
    for (; n < kFrames; ++n) REQUIRE_NOTHROW(push(pusher, n));
  }
  SUBCASE("where another publisher needs what it reads") {
    go.tell();
    auto other = engine.advertise<Frame>("/other", {Policy::Block, 64, 20s});
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    for (int i = 0; i < 40; ++i) {
      loans.push_back(other.loan());
      REQUIRE_NOTHROW(loans.back()->data.resize(kMiB));
    }
    loans.clear();
    for (; n < kFrames; ++n) REQUIRE_NOTHROW(push(pusher, n));
  }
  SUBCASE("a message that can never fit is refused at once") {
    const auto start = std::chrono::steady_clock::now();
    {
      auto frame = pusher.loan();
      CHECK_THROWS_AS(frame->data.resize(2 * kSegment), lot::OutOfMemory);
    }
    CHECK(std::chrono::steady_clock::now() - start < 20s);
    go.tell();
    for (; n < kFrames; ++n) REQUIRE_NOTHROW(push(pusher, n));
  }
  CHECK(slow.wait() == 0);
}

TEST_CASE("a loan that waits for a reader goes on when the reader is killed") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Frame>("/camera", {Policy::Block, 64, 60s});
  Steps ready;
  Child victim([&] {
    lot::ShmEngine mine(options);
    auto reader = mine.subscribe<Frame>("/camera");
    ready.tell();
    std::this_thread::sleep_for(60s);
  });
  REQUIRE(ready.next() == '.');
  std::uint64_t n = 0;
  for (; n < 45; ++n) push(pusher, n);
  std::thread killer([&] {
    std::this_thread::sleep_for(50ms);
    victim.kill9();
  });
  for (; n < kFrames; ++n) REQUIRE_NOTHROW(push(pusher, n));
  killer.join();
}

TEST_CASE("a loan waits no longer than block_for, and under Policy::Refuse not at all") {
  const Watchdog watchdog(60);
  struct Picture {
    std::uint64_t number;
    unsigned char pixels[kMiB];
  };
  for (const Policy policy : {Policy::Block, Policy::Refuse}) {
    lot::ShmEngine engine(fresh(kSegment));
    auto pusher = engine.advertise<Picture>("/camera", {policy, 64, 100ms});
    auto reader = engine.subscribe<Picture>("/camera");
    const auto fill = [&] {
      for (auto picture = pusher.try_loan(); picture; picture = pusher.try_loan()) {
        picture->number = 0;
        REQUIRE(pusher.push(std::move(picture)) == Status::Ok);
      }
    };
    fill();
    CHECK_FALSE(static_cast<bool>(pusher.try_loan()));
    const auto full = std::chrono::steady_clock::now();
    CHECK_THROWS_AS((void)pusher.loan(), lot::OutOfMemory);
    if (policy == Policy::Block) CHECK(std::chrono::steady_clock::now() - full >= 100ms);
    // What its reader reads meanwhile serves the loan.
    std::thread reads([&] {
      std::this_thread::sleep_for(10ms);
      while (reader.try_pull()) {
      }
    });
    if (policy == Policy::Block) CHECK(static_cast<bool>(pusher.loan()));
    reads.join();
    CHECK(static_cast<bool>(pusher.loan()));
    CHECK(reader.missed_total() == 0);
  }
}

TEST_CASE("a loan waits for blocks as for memory") {
  const Watchdog watchdog(60);
  auto options = fresh(kSegment);
  options.blocks = 32;
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Note>("/notes", in_blocks({Policy::Block, 31, 20s}));
  auto reader = engine.subscribe<Note>("/notes");
  for (std::uint64_t n = 0; n < 20; ++n) REQUIRE(pusher.push(pusher.loan(n)) == Status::Ok);
  std::vector<lot::ShmUniquePtr<Note>> loans;
  while (auto note = pusher.try_loan()) loans.push_back(std::move(note));
  std::thread reads([&] {
    std::this_thread::sleep_for(20ms);
    (void)reader.try_pull();  // makes room
  });
  CHECK(static_cast<bool>(pusher.loan()));
  reads.join();
  CHECK(reader.missed_total() == 0);
}

TEST_CASE("blocks that were read come back, too") {
  const Watchdog watchdog(60);
  auto options = fresh(kSegment);
  options.blocks = 64;
  lot::ShmEngine engine(options);
  auto one = engine.advertise<Note>("/one", in_blocks({Policy::Refuse, 63}));
  auto two = engine.advertise<Note>("/two", in_blocks({Policy::Block, 63}));
  auto of_one = engine.subscribe<Note>("/one");
  auto of_two = engine.subscribe<Note>("/two");
  for (std::uint64_t n = 0; n < 1000; ++n) {
    for (auto* pusher : {&one, &two}) {
      auto note = pusher->loan();
      note->number = n;
      REQUIRE(pusher->push(std::move(note)) == Status::Ok);
    }
    for (auto* reader : {&of_one, &of_two}) {
      const auto note = reader->try_pull();
      REQUIRE(note);
      CHECK(note->number == n);
    }
  }
}

TEST_SUITE_END();
