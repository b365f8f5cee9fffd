// SPDX-License-Identifier: Apache-2.0

// What one reader keeps, and one publisher takes, is bounded: no other one notices.

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdint>
#include <poll.h>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr std::size_t kFrame = 1 << 20;
constexpr std::size_t kSegment = 64 << 20;

struct Frame {
  std::uint64_t number = 0;
  lot::ShmVector<unsigned char> data;
};
struct Note {
  std::uint64_t number = 0;
};
using Kept = std::vector<lot::ShmSharedPtr<const Frame>>;

bool says(const std::string& text, const std::string& what) {
  return text.find(what) != std::string::npos;
}

void push(lot::ShmPusher<Frame>& pusher, std::uint64_t number, std::size_t bytes = kFrame) {
  auto frame = pusher.loan();
  frame->number = number;
  frame->data.resize(bytes);
  frame->data.front() = frame->data.back() = static_cast<unsigned char>(number);
  must(pusher.push(std::move(frame)) == lot::Status::Ok, "pushed");
}

lot::PullerOptions quota(std::uint64_t bytes) {
  lot::PullerOptions options;
  options.max_held_bytes = bytes;
  return options;
}

/// Pulls and keeps until the subscription may not, or there is nothing more.
lot::Status hoard(lot::ShmPuller<Frame>& puller, Kept& kept) {
  while (auto frame = puller.try_pull()) kept.push_back(std::move(frame));
  return puller.status();
}

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("at max_held_bytes pull says HoldsTooMuch, and goes on when the reader lets some go") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  auto pusher = engine.advertise<Frame>("/frames");
  auto keeper = engine.subscribe<Frame>("/frames", quota(4 * kFrame));
  auto other = engine.subscribe<Frame>("/frames");
  Kept kept;
  for (std::uint64_t n = 0; n < 10; ++n) {
    push(pusher, n);
    REQUIRE(other.try_pull()->number == n);
  }
  CHECK(hoard(keeper, kept) == lot::Status::HoldsTooMuch);
  CHECK(kept.size() == 4);
  CHECK(to_string(keeper.status()) == std::string("holds too much"));
  CHECK(keeper.pull(1ms) == nullptr);
  CHECK(keeper.status() == lot::Status::HoldsTooMuch);
  CHECK(keeper.missed_total() == 0);  // they wait

  // A look in place keeps nothing.
  {
    const auto look = keeper.try_borrow();
    REQUIRE(look);
    CHECK(look->number == 4);
    try {
      (void)look.keep();
      FAIL("kept");
    } catch (const lot::Error& e) {
      const std::string text = e.what();
      CAPTURE(text);
      CHECK(e.error_number() == EDQUOT);
      CHECK(says(text, "/frames"));
      CHECK(says(text, "4 MiB in 4 messages"));
      CHECK(says(text, "max_held_bytes"));
      CHECK_FALSE(says(text, "all subscriptions"));
    }
  }
  kept.erase(kept.begin());
  REQUIRE(keeper.try_pull()->number == 5);
  kept.clear();
  CHECK(hoard(keeper, kept) == lot::Status::Empty);
  CHECK(kept.size() == 4);
  CHECK(kept.back()->number == 9);
  // What comes in the meantime is overwritten, and counts.
  for (std::uint64_t n = 10; n < 200; ++n) push(pusher, n);
  kept.clear();
  const auto next = keeper.try_pull();
  REQUIRE(next);
  CHECK(next->number == 10 + keeper.missed());
  CHECK(keeper.missed() > 100);
}

TEST_CASE("a message that was let go on another thread makes room for a pull that waits") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  auto pusher = engine.advertise<Frame>("/frames");
  auto keeper = engine.subscribe<Frame>("/frames", quota(2 * kFrame));
  Kept kept;
  for (std::uint64_t n = 0; n < 5; ++n) push(pusher, n);
  REQUIRE(hoard(keeper, kept) == lot::Status::HoldsTooMuch);
  std::thread other([&] { kept.clear(); });
  lot::ShmSharedPtr<const Frame> frame;
  while (!frame) frame = keeper.pull(10s);
  other.join();
  CHECK(frame->number == 2);
  // It does not wait for ever for what does not come.
  kept.push_back(frame);
  kept.push_back(keeper.try_pull());
  CHECK(keeper.pull() == nullptr);
  CHECK(keeper.status() == lot::Status::HoldsTooMuch);
}

TEST_CASE("the same message counts once, and what has died not at all") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  auto pusher = engine.advertise<Frame>("/map");
  auto keeper = engine.subscribe<Frame>("/map", quota(4 * kFrame));
  auto loan = pusher.loan();
  loan->data.resize(kFrame);
  const lot::ShmSharedPtr<Frame> map(std::move(loan));
  Kept kept;
  for (int n = 0; n < 300; ++n) {
    REQUIRE(pusher.push(map) == lot::Status::Ok);
    kept.push_back(keeper.try_pull());
    REQUIRE(kept.back());
  }
  kept.clear();
  for (std::uint64_t n = 0; n < 500; ++n) {
    push(pusher, n);
    REQUIRE(keeper.try_pull()->number == n);
  }
}

TEST_CASE("by default max_held_bytes is a quarter of the segment, in memory or in messages") {
  const Watchdog watchdog(60);
  auto options = fresh(kSegment);
  options.blocks = 400;
  lot::ShmEngine engine(options);
  auto frames = engine.advertise<Frame>("/frames");
  auto keeper = engine.subscribe<Frame>("/frames");
  Kept kept;
  for (std::uint64_t n = 0; n < 100 && keeper.status() != lot::Status::HoldsTooMuch; ++n) {
    push(frames, n);
    hoard(keeper, kept);
  }
  CHECK(kept.size() >= 13);
  CHECK(kept.size() <= 16);
  kept.clear();
  auto notes = engine.advertise<Note>("/notes");
  auto reader = engine.subscribe<Note>("/notes");
  std::vector<lot::ShmSharedPtr<const Note>> all;
  for (int n = 0; n < 400; ++n) {
    REQUIRE(notes.push(notes.loan()) == lot::Status::Ok);
    if (auto note = reader.try_pull()) all.push_back(std::move(note));
  }
  CHECK(reader.status() == lot::Status::HoldsTooMuch);
  CHECK(all.size() == 100);
  CHECK_THROWS_AS((void)reader.try_borrow().keep(), lot::Error);
  // One that needs it says so.
  auto whole = engine.subscribe<Note>("/notes", quota(lot::PullerOptions::kNoQuota));
  for (int n = 0; n < 200; ++n) {
    REQUIRE(notes.push(notes.loan()) == lot::Status::Ok);
    all.push_back(whole.try_pull());
    REQUIRE(all.back());
  }
}

TEST_CASE("a reader at its max_held_bytes holds up no other topic") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  Steps ready, end;
  Child hoarder([&] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Frame>("/a");
    ready.tell();
    Kept kept;
    while (end.next(1ms) == 0) hoard(puller, kept);
    must(puller.status() == lot::Status::HoldsTooMuch, "it is told");
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto a = engine.advertise<Frame>("/a");
    auto b = engine.advertise<Frame>("/b");
    auto small = engine.advertise<Note>("/c");
    auto other_a = engine.subscribe<Frame>("/a");
    auto other_b = engine.subscribe<Frame>("/b");
    auto other_c = engine.subscribe<Note>("/c");
    for (std::uint64_t n = 0; n < 510; ++n) {
      push(a, n);
      push(b, n);
      REQUIRE(small.push(small.loan()) == lot::Status::Ok);
      REQUIRE(other_a.try_pull()->number == n);
      REQUIRE(other_b.try_pull()->number == n);
      REQUIRE(other_c.try_pull());
    }
  }
  end.tell();
  CHECK(hoarder.wait() == 0);
}

TEST_CASE("all subscriptions together leave half of the segment to others") {
  const Watchdog watchdog(60);
  // Each may have a message more than the half: small ones beside the segment.
  constexpr std::size_t kLarge = 4 * kSegment;
  const auto options = fresh(kLarge);
  constexpr std::size_t kHoarders = 6;
  Steps ready, full, end;
  std::vector<Child> hoarders;
  for (std::size_t h = 0; h < kHoarders; ++h) {
    hoarders.emplace_back([&, h] {
      lot::ShmEngine engine(options);
      // Half of them ask for all there is.
      auto puller = engine.subscribe<Frame>("/" + std::to_string(h), quota(h % 2 * kLarge));
      ready.tell();
      Kept kept;
      while (hoard(puller, kept) != lot::Status::HoldsTooMuch) std::this_thread::sleep_for(1ms);
      full.tell();
      while (end.next(1ms) == 0) hoard(puller, kept);
    });
  }
  for (std::size_t h = 0; h < kHoarders; ++h) REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    std::vector<lot::ShmPusher<Frame>> pushers;
    for (std::size_t h = 0; h < kHoarders; ++h) {
      pushers.push_back(engine.advertise<Frame>("/" + std::to_string(h)));
    }
    std::atomic<bool> stop{false};
    std::thread camera([&] {
      for (std::uint64_t n = 0; !stop; ++n) {
        for (auto& pusher : pushers) push(pusher, n);
      }
    });
    for (std::size_t h = 0; h < kHoarders; ++h) CHECK(full.next() == '.');
    stop = true;
    camera.join();
    pushers.clear();
    // All that they do not keep can be loaned.
    auto pusher = engine.advertise<Frame>("/left");
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    try {
      for (;;) {
        auto loan = pusher.loan();
        loan->data.resize(kFrame);
        loans.push_back(std::move(loan));
      }
    } catch (const lot::OutOfMemory&) {
    }
    const std::size_t half =
        lot::segment::Segment(engine.path()).granules().count() * lot::segment::kGranule / 2;
    MESSAGE(loans.size() << " MiB are left of " << half / kFrame << " MiB, the half");
    CHECK(loans.size() * kFrame >= half - kHoarders * kFrame);
    loans.clear();
    // Those that come when the half is kept take little more, of messages of a 64th of the segment.
    constexpr std::size_t kLargeFrame = kLarge / 64;
    std::vector<lot::ShmPuller<Frame>> late;
    std::vector<Kept> theirs(8);
    for (std::size_t n = 0; n < theirs.size(); ++n) {
      late.push_back(engine.subscribe<Frame>("/left"));
    }
    for (std::uint64_t n = 0; n < 12; ++n) {
      push(pusher, n, kLargeFrame);
      for (std::size_t l = 0; l < late.size(); ++l) hoard(late[l], theirs[l]);
    }
    for (const Kept& kept : theirs) {
      CHECK(kept.size() >= 1);
      CHECK(kept.size() <= 3);
    }
    theirs.clear();
    late.clear();
    // And a subscription that comes last goes on all the same.
    auto puller = engine.subscribe<Frame>("/left");
    for (std::uint64_t n = 0; n < 100; ++n) {
      push(pusher, n, kLargeFrame);
      REQUIRE(puller.try_pull()->number == n);
    }
  }
  for (std::size_t h = 0; h < kHoarders; ++h) end.tell();
  for (auto& hoarder : hoarders) CHECK(hoarder.wait() == 0);
}

TEST_CASE("a WaitSet and a listener's on_error hear of HoldsTooMuch at times, and do not spin") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  auto pusher = engine.advertise<Frame>("/frames");
  auto keeper = engine.subscribe<Frame>("/frames", quota(2 * kFrame));
  Kept kept;
  for (std::uint64_t n = 0; n < 4; ++n) push(pusher, n);
  REQUIRE(hoard(keeper, kept) == lot::Status::HoldsTooMuch);
  lot::WaitSet set;
  int calls = 0;
  set.add(keeper, [&] {
    ++calls;
    if (hoard(keeper, kept) != lot::Status::HoldsTooMuch) calls = -1000;
  });
  const auto begin = std::chrono::steady_clock::now();
  while (calls < 2) set.run_once(1s);
  CHECK(std::chrono::steady_clock::now() - begin >= 900ms);
  // What it lets go it hears of.
  kept.clear();
  while (kept.empty()) set.run_once(1s);
  CHECK(kept.front()->number == 2);

  std::atomic<int> errors{0};
  lot::ThreadOptions thread;
  thread.on_error = [&](const lot::Error& e) { errors += e.error_number() == EDQUOT; };
  Kept heard;
  const auto listener = engine.listen<Frame>(
      "/frames", [&](const lot::ShmSharedPtr<const Frame>& frame) { heard.push_back(frame); },
      quota(kFrame), thread);
  push(pusher, 4);
  push(pusher, 5);
  CHECK(eventually([&] { return errors > 0; }));
}

TEST_CASE("fd() is readable again once a reader at its max_held_bytes has let messages go") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  auto pusher = engine.advertise<Frame>("/frames");
  auto keeper = engine.subscribe<Frame>("/frames", quota(2 * kFrame));
  const int fd = keeper.fd();
  Kept kept;
  for (std::uint64_t n = 0; n < 4; ++n) push(pusher, n);
  REQUIRE(hoard(keeper, kept) == lot::Status::HoldsTooMuch);
  // It has told so once, and is not readable again before a second has passed.
  REQUIRE(hoard(keeper, kept) == lot::Status::HoldsTooMuch);
  kept.clear();  // no queue has news of this: the descriptor has to look by itself
  while (kept.empty()) {
    pollfd descriptor{fd, POLLIN, 0};
    REQUIRE(poll(&descriptor, 1, 20'000) == 1);
    hoard(keeper, kept);
  }
  CHECK(kept.front()->number == 2);
}

TEST_CASE("max_held_bytes of the whole segment, or more, still leaves others more than the half") {
  const Watchdog watchdog(60);
  for (const std::uint64_t asked : {std::uint64_t{kSegment}, std::uint64_t{1} << 50}) {
    lot::ShmEngine engine(fresh(kSegment));
    auto unread = engine.advertise<Frame>("/unread", {lot::Policy::Overwrite, 16, 1s});
    for (std::uint64_t n = 0; n < 16; ++n) push(unread, n);  // what no process keeps does not count
    auto pusher = engine.advertise<Frame>("/frames");
    auto keeper = engine.subscribe<Frame>("/frames", quota(asked));
    Kept kept;
    for (std::uint64_t n = 0; n < 50; ++n) {
      push(pusher, n);
      hoard(keeper, kept);
    }
    CHECK(keeper.status() == lot::Status::HoldsTooMuch);
    const std::size_t granules = lot::segment::Segment(engine.path()).granules().count();
    const std::size_t most = granules * lot::segment::kGranule / 16 * 7 / kFrame;
    CHECK(kept.size() >= most - 2);
    CHECK(kept.size() <= most + 1);
  }
}

TEST_CASE("all subscriptions together leave half of the messages to others, however small") {
  const Watchdog watchdog(60);
  auto options = fresh(kSegment);
  options.blocks = 2048;
  lot::ShmEngine engine(options);
  constexpr std::size_t kReaders = 4;
  std::vector<lot::ShmPusher<Note>> pushers;
  std::vector<lot::ShmPuller<Note>> readers;
  for (std::size_t r = 0; r < kReaders; ++r) {
    pushers.push_back(engine.advertise<Note>("/" + std::to_string(r), {lot::Policy::Overwrite, 2}));
    readers.push_back(engine.subscribe<Note>("/" + std::to_string(r)));
  }
  std::vector<lot::ShmSharedPtr<const Note>> kept;
  for (int n = 0; n < 600; ++n) {
    for (std::size_t r = 0; r < kReaders; ++r) {
      REQUIRE(pushers[r].push(pushers[r].loan()) == lot::Status::Ok);
      if (auto note = readers[r].try_pull()) kept.push_back(std::move(note));
    }
  }
  CHECK(kept.size() >= options.blocks / 4);  // each of them alone might keep that much
  CHECK(kept.size() <= options.blocks / 2 + kReaders);
  for (auto& reader : readers) {
    CHECK(reader.try_pull() == nullptr);
    CHECK(reader.status() == lot::Status::HoldsTooMuch);
  }
  try {
    (void)readers[0].try_borrow().keep();
    FAIL("kept");
  } catch (const lot::Error& e) {
    CHECK(says(e.what(), "while all subscriptions together hold so much"));
  }
}

TEST_CASE("what another subscription keeps leaves less to take, also the segment's first message") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  auto large = engine.advertise<Frame>("/large");
  auto reader = engine.subscribe<Frame>("/large");
  push(large, 0, 20 * kFrame);
  const auto first = reader.try_pull();
  REQUIRE(first);
  auto pusher = engine.advertise<Frame>("/frames");
  auto keeper = engine.subscribe<Frame>("/frames", quota(kSegment));
  Kept kept;
  for (std::uint64_t n = 0; n < 40; ++n) {
    push(pusher, n);
    hoard(keeper, kept);
  }
  CHECK(keeper.status() == lot::Status::HoldsTooMuch);
  CHECK(kept.size() >= 4);
  CHECK(kept.size() <= 14);  // it would be 27 if the large one did not count
}

TEST_CASE("a queue of shared items says that its reader holds too much") {
  const Watchdog watchdog(60);
  auto options = fresh(kSegment);
  options.blocks = 64;
  lot::ShmEngine engine(options);
  lot::QueueOptions shallow;
  shallow.depth = 8;
  auto queue = engine.queue<lot::ShmSharedPtr<const Note>>("notes", shallow);
  queue.listen();
  std::vector<lot::ShmSharedPtr<const Note>> kept;
  const auto put_and_pop = [&] {
    for (int n = 0; n < 64; ++n) {
      must_go(queue.put(lot::ShmSharedPtr<const Note>(queue.make())));
      kept.push_back(queue.wait_and_pop());
    }
  };
  try {
    put_and_pop();
    FAIL("kept all");
  } catch (const lot::Error& e) {
    const std::string text = e.what();
    CAPTURE(text);
    CHECK(e.error_number() == EDQUOT);
  }
  CHECK(kept.size() == 16);
  kept.clear();
  CHECK((*queue.try_pop()).get() != nullptr);
}

TEST_CASE("a publisher takes no more than max_bytes, and gives its own oldest up") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  lot::PusherOptions bounded;
  bounded.max_bytes = 8 * kFrame + (64 << 10);
  auto pusher = engine.advertise<Frame>("/frames", bounded);
  auto early = engine.subscribe<Frame>("/frames");
  for (std::uint64_t n = 0; n < 200; ++n) push(pusher, n, n % 2 == 0 ? kFrame : kFrame / 2);
  lot::PullerOptions all;
  all.history = 64;
  std::size_t bytes = 0;
  {
    auto late = engine.subscribe<Frame>("/frames", all);
    std::uint64_t last = 0;
    while (const auto frame = late.try_pull()) {
      bytes += frame->data.size();
      last = frame->number;
    }
    CHECK(last == 199);
  }
  CHECK(bytes <= bounded.max_bytes);
  CHECK(bytes >= 5 * kFrame);
  std::uint64_t seen = 0;
  while (early.try_pull()) ++seen;
  CHECK(early.missed_total() + seen == 200);

  // Others have the rest.
  auto other = engine.advertise<Frame>("/others");
  std::vector<lot::ShmUniquePtr<Frame>> loans;
  for (std::size_t n = 0; n < 48; ++n) {
    loans.push_back(other.loan());
    loans.back()->data.resize(kFrame);
  }
  // What can never be is refused, and takes nothing. The loan may: blocks are short by now.
  auto frame = pusher.loan();
  const std::uint64_t before = engine.subscribe<Frame>("/frames", all).size();
  CHECK(before >= 2);
  try {
    frame->data.resize(9 * kFrame);
    FAIL("it has grown");
  } catch (const lot::OutOfMemory& e) {
    const std::string text = e.what();
    CAPTURE(text);
    CHECK(says(text, "/frames"));
    CHECK(says(text, "max_bytes"));
  }
  CHECK(engine.subscribe<Frame>("/frames", all).size() == before);
}

TEST_CASE("messages that threads build at once stay within their publisher's max_bytes") {
  const Watchdog watchdog(60);
  constexpr unsigned kThreads = 4;
  lot::ShmEngine engine(fresh(kSegment));
  lot::PusherOptions bounded;
  bounded.max_bytes = 9 * kFrame;
  auto pusher = engine.advertise<Frame>("/frames", bounded);
  unsigned most = 0;
  unsigned refused = 0;
  for (unsigned round = 0; round < 20; ++round) {
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    for (unsigned n = 0; n < kThreads; ++n) loans.push_back(pusher.loan());
    std::atomic<unsigned> built{0};
    std::atomic<unsigned> waiting{kThreads};
    std::vector<std::thread> threads;
    for (auto& loan : loans) {
      threads.emplace_back([&] {
        waiting.fetch_sub(1);
        while (waiting.load() != 0) std::this_thread::yield();
        try {
          loan->data.resize(4 * kFrame);
          built.fetch_add(1);
        } catch (const lot::OutOfMemory&) {
        }
      });
    }
    for (auto& thread : threads) thread.join();
    most = std::max(most, built.load());
    refused += kThreads - built;
  }
  CHECK(most == 2);
  CHECK(refused >= 20 * (kThreads - 2));
}

TEST_CASE("what readers keep counts for max_bytes, and a lossless publisher loses nothing") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  lot::PusherOptions bounded;
  bounded.max_bytes = 4 * kFrame;
  {
    auto pusher = engine.advertise<Frame>("/kept", bounded);
    auto puller = engine.subscribe<Frame>("/kept", quota(lot::PullerOptions::kNoQuota));
    Kept kept;
    for (std::uint64_t n = 0; n < 4; ++n) {
      push(pusher, n);
      hoard(puller, kept);
    }
    CHECK_THROWS_AS(push(pusher, 4), lot::OutOfMemory);
    kept.pop_back();
    push(pusher, 5);
    CHECK(puller.try_pull()->number == 5);
  }
  bounded.policy = lot::Policy::Refuse;
  bounded.depth = 16;
  auto pusher = engine.advertise<Frame>("/lossless", bounded);
  auto puller = engine.subscribe<Frame>("/lossless");
  for (std::uint64_t n = 0; n < 4; ++n) push(pusher, n);
  CHECK_THROWS_AS(push(pusher, 4), lot::OutOfMemory);
  CHECK(puller.size() == 4);
}

TEST_CASE("messages that outlive their publisher change no other publisher's max_bytes") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  lot::PusherOptions bounded;
  bounded.max_bytes = 8 * kFrame;
  for (const bool dies_later : {false, true}) {
    CAPTURE(dies_later);
    lot::ShmUniquePtr<Frame> old;
    {
      auto first = engine.advertise<Frame>("/first", bounded);
      old = first.loan();
      old->data.resize(6 * kFrame);
    }
    if (!dies_later) old.reset();
    auto second = engine.advertise<Frame>("/second", bounded);
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    const auto fill = [&] {
      try {
        for (;;) {
          auto loan = second.loan();
          loan->data.resize(kFrame);
          loans.push_back(std::move(loan));
        }
      } catch (const lot::OutOfMemory&) {
      }
    };
    fill();
    CHECK(loans.size() <= 8);
    old.reset();
    fill();
    CHECK(loans.size() == 8);
  }
}

TEST_CASE("a subscription at max_held_bytes without a message is empty, and try_borrow() goes on") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  Kept kept;
  auto keeper = engine.subscribe<Frame>("/frames", quota(2 * kFrame));
  {
    auto pusher = engine.advertise<Frame>("/frames");
    for (std::uint64_t n = 0; n < 2; ++n) push(pusher, n);
    CHECK(hoard(keeper, kept) == lot::Status::Empty);
    REQUIRE(kept.size() == 2);
    CHECK(keeper.pull(1ms) == nullptr);
    CHECK(keeper.status() == lot::Status::Timeout);
    push(pusher, 2);
    CHECK(keeper.try_pull() == nullptr);
    CHECK(keeper.status() == lot::Status::HoldsTooMuch);
    const auto look = keeper.try_borrow();
    REQUIRE(look);
    CHECK(look->number == 2);
    CHECK_THROWS_AS((void)look.keep(), lot::Error);
    CHECK_THROWS_AS((void)keeper.try_pull(), lot::Error);  // a borrow has not ended
  }
  CHECK(keeper.try_pull() == nullptr);
  CHECK(keeper.status() == lot::Status::PublisherGone);
  // A refused keep() does not hold up a reader that only looks.
  auto pusher = engine.advertise<Frame>("/frames");
  lot::WaitSet set;
  std::uint64_t looks = 0;
  set.add(keeper, [&] {
    while (auto look = keeper.try_borrow()) {
      ++looks;
      CHECK_THROWS_AS((void)look.keep(), lot::Error);
    }
  });
  for (std::uint64_t n = 0; n < 20; ++n) {
    push(pusher, n);
    while (looks <= n) set.run_once(20s);
  }
  CHECK(keeper.missed_total() == 0);
}

TEST_CASE("what reserve() made counts for max_bytes, and stays the publisher's own") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  lot::ShmEngine engine(options);
  lot::PusherOptions bounded;
  bounded.max_bytes = 8 * kFrame;
  auto pusher = engine.advertise<Frame>("/reserved", bounded);
  CHECK_THROWS_AS(pusher.reserve(9, kFrame), lot::OutOfMemory);
  pusher.reserve(7, kFrame);
  Steps full, end;
  Child greedy([&] {
    lot::ShmEngine mine(options);
    auto others = mine.advertise<Frame>("/greedy");
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    try {
      for (;;) {
        auto loan = others.loan();
        loan->data.resize(kFrame / 4);
        loans.push_back(std::move(loan));
      }
    } catch (const lot::OutOfMemory&) {
    }
    full.tell();
    end.next();
  });
  REQUIRE(full.next() == '.');
  std::vector<lot::ShmUniquePtr<Frame>> loans;
  for (std::size_t n = 0; n < 7; ++n) {
    loans.push_back(pusher.loan());
    loans.back()->data.resize(kFrame);
  }
  end.tell();
  CHECK(greedy.wait() == 0);
}

TEST_CASE("what reserve() made goes to no other process, neither idle nor in a ring") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  constexpr std::uint64_t kReserved = 6;
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Frame>("/reserved");
  pusher.reserve(kReserved, kFrame);
  auto plain = engine.advertise<Frame>("/plain");
  bool in_ring = false;
  SUBCASE("idle") {}
  SUBCASE("in its ring") { in_ring = true; }
  for (std::uint64_t n = 0; n < kReserved; ++n) {
    push(plain, n);
    if (in_ring) push(pusher, n);
  }
  Steps full, end;
  Child greedy([&] {
    lot::ShmEngine mine(options);
    auto others = mine.advertise<Frame>("/greedy");
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    for (const std::size_t bytes : {kFrame, kFrame / 4, kFrame / 16}) {
      try {
        for (;;) {
          auto loan = others.loan();
          loan->data.resize(bytes);
          loans.push_back(std::move(loan));
        }
      } catch (const lot::OutOfMemory&) {
      }
    }
    full.tell();
    end.next();
  });
  REQUIRE(full.next() == '.');
  lot::PullerOptions all;
  all.history = 64;
  // It has taken what it may of the one that has reserved nothing, down to the newest two.
  CHECK(engine.subscribe<Frame>("/plain", all).size() == 2);
  auto late = engine.subscribe<Frame>("/reserved", all);
  if (in_ring) {
    for (std::uint64_t n = 0; n < kReserved; ++n) {
      const auto frame = late.try_borrow();
      REQUIRE(frame);
      CHECK(frame->number == n);
      CHECK(frame->data.back() == n);
    }
  }
  CHECK(late.missed_total() == 0);
  // And the publisher has what it has reserved, for as many frames as before.
  for (std::uint64_t n = 0; n < kReserved; ++n) {
    REQUIRE_NOTHROW(push(pusher, kReserved + n));
  }
  CHECK(engine.subscribe<Frame>("/reserved", all).size() == kReserved);
  end.tell();
  CHECK(greedy.wait() == 0);
}

TEST_CASE("a message that is as large as max_held_bytes is the only one that may be kept") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(kSegment));
  auto pusher = engine.advertise<Frame>("/frames");
  auto keeper = engine.subscribe<Frame>("/frames", quota(kFrame));
  Kept kept;
  for (std::uint64_t n = 0; n < 3; ++n) push(pusher, n);
  CHECK(hoard(keeper, kept) == lot::Status::HoldsTooMuch);
  CHECK(kept.size() == 1);
}
