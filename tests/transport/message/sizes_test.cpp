// SPDX-License-Identifier: Apache-2.0

// A message takes the memory that it needs, and little more, however it was built and whatever was
// in its block before. LOT_LOANS says how many loans the last case makes (tests/CMakeLists.txt).

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <random>
#include <sys/wait.h>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/sanitizers.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr std::uint64_t kMiB = 1 << 20;
constexpr std::uint64_t kLoans = LOT_LOANS;

struct Frame {
  lot::ShmVector<std::uint8_t> data;
  lot::ShmVector<std::uint8_t> more;
  lot::ShmVector<lot::ShmString> words;
};

struct Refusing {
  explicit Refusing(bool throws) {
    if (throws) throw 5;
  }
  std::uint8_t bytes[100'000];
};

struct Pieces {
  lot::ShmVector<lot::ShmVector<std::uint8_t>> pieces;
};

struct Segment {
  explicit Segment(std::uint64_t bytes) : engine(fresh(bytes)), view(engine.path()) {}

  /// Bytes of messages and rings. A unit that is on its way back to the file system has the tag of
  /// a block without a topic meanwhile, and is no message's.
  std::uint64_t used() {
    std::uint64_t granules = 0;
    for (std::uint32_t i = 0; i < view.granules().count(); ++i) {
      const std::uint32_t tag = view.granules().tag(i);
      const bool is_ring = (tag & lot::segment::kRingTag) != 0;
      granules += tag != 0 && (is_ring || view.arena(tag - 1).topic != 0);
    }
    return granules * lot::segment::kGranule;
  }
  std::uint64_t size() { return view.granules().count() * lot::segment::kGranule; }

  lot::ShmEngine engine;
  lot::segment::Segment view;
};

/// What a message of so many bytes may take.
std::uint64_t most(std::uint64_t bytes) { return bytes + std::max(bytes / 16, 64 * 1024 / 16UL); }

/// Adds frames of this size until there is no room for another.
void take_all(lot::ShmPusher<Frame>& pusher, std::size_t bytes,
              std::vector<lot::ShmUniquePtr<Frame>>& frames) {
  try {
    for (;;) {
      auto frame = pusher.loan();
      frame->data.resize(bytes);
      frames.push_back(std::move(frame));
    }
  } catch (const lot::OutOfMemory&) {
  }
}

/// How many frames of this size fit now, beside those that are kept.
std::size_t fitting(lot::ShmEngine& engine, std::size_t bytes) {
  auto pusher = engine.advertise<Frame>("/fitting");
  std::vector<lot::ShmUniquePtr<Frame>> frames;
  take_all(pusher, bytes, frames);
  return frames.size();
}

}  // namespace

template <>
struct lot::is_trusted_message<Refusing> : std::true_type {};

TEST_SUITE_BEGIN("message");

TEST_CASE("above 64 KiB a message takes at most 1/16 more than it is") {
  Segment segment(256 * kMiB);
  std::mt19937_64 random(seed());
  std::vector<std::uint64_t> sizes;
  for (unsigned bits = 16; bits <= 26; ++bits) {
    for (const int difference : {-4097, -4096, -1, 0, 1, 4095, 4096, 4097}) {
      sizes.push_back((std::uint64_t{1} << bits) + static_cast<std::uint64_t>(difference + 8192));
    }
  }
  for (int n = 0; n < 200; ++n) {
    sizes.push_back(static_cast<std::uint64_t>(
        std::exp2(std::uniform_real_distribution<double>(16.1, 26)(random))));
  }
  SUBCASE("each in a block of its own") {
    for (const std::uint64_t size : sizes) {
      CAPTURE(size);
      auto pusher = segment.engine.advertise<Frame>("/size");
      const std::uint64_t before = segment.used();
      auto frame = pusher.loan();
      frame->data.resize(size);
      REQUIRE(segment.used() - before <= most(size));
    }
  }
  SUBCASE("in the block of another size") {
    std::shuffle(sizes.begin(), sizes.end(), random);
    auto pusher = segment.engine.advertise<Frame>("/size");
    const std::uint64_t before = segment.used();
    for (const std::uint64_t size : sizes) {
      CAPTURE(size);
      auto frame = pusher.loan();
      frame->data.resize(size);
      REQUIRE(segment.used() - before <= most(size));
    }
  }
  SUBCASE("a small one after a large one") {
    auto pusher = segment.engine.advertise<Frame>("/size");
    const std::uint64_t before = segment.used();
    pusher.loan()->data.resize(60 * kMiB);
    auto frame = pusher.loan();
    frame->data.resize(1000);
    CHECK(segment.used() - before <= 64 * 1024);
    frame->more.resize(30 * kMiB);
    CHECK(segment.used() - before <= most(30 * kMiB) + 64 * 1024);
    frame->more.clear();
    frame->more.shrink_to_fit();
    CHECK(segment.used() - before <= 64 * 1024);
  }
  SUBCASE("two pieces") {
    auto pusher = segment.engine.advertise<Frame>("/size");
    const std::uint64_t before = segment.used();
    for (std::size_t n = 0; n + 1 < sizes.size(); ++n) {
      CAPTURE(sizes[n]);
      CAPTURE(sizes[n + 1]);
      auto frame = pusher.loan();
      frame->data.resize(sizes[n]);
      frame->more.resize(sizes[n + 1]);
      const lot::ShmSharedPtr<Frame> complete = std::move(frame);
      REQUIRE(segment.used() - before <= most(sizes[n]) + most(sizes[n + 1]));
    }
  }
}

TEST_CASE("a published message has given back what its growing vectors have left") {
  Segment segment(256 * kMiB);
  auto pusher = segment.engine.advertise<Frame>("/grown", {lot::Policy::Overwrite, 2, {}});
  const std::uint64_t before = segment.used();
  for (int round = 0; round < 3; ++round) {
    CAPTURE(round);
    auto frame = pusher.loan();
    for (int n = 0; n < 3'000'000; ++n) frame->data.push_back(static_cast<std::uint8_t>(n));
    const std::uint64_t capacity = frame->data.capacity();
    CHECK(segment.used() - before <= most(capacity) + 64 * 1024);
    CHECK(frame->data[2'999'999] == static_cast<std::uint8_t>(2'999'999));
  }
  SUBCASE("pushed by the only pointer") {
    auto frame = pusher.loan();
    for (int n = 0; n < 20000; ++n) frame->words.emplace_back(std::size_t{100}, 'x');
    std::uint64_t bytes = frame->words.capacity() * sizeof(lot::ShmString);
    for (const auto& word : frame->words) bytes += word.capacity() + 1;
    auto puller = segment.engine.subscribe<Frame>("/grown");
    must_go(pusher.push(std::move(frame)));
    const auto kept = puller.pull(10s);
    REQUIRE(kept);
    { const auto gone = std::move(pusher); }  // and with it what it makes ahead of the next loan
    CHECK(eventually(
        [&] { return segment.used() - before <= most(bytes) + bytes / 16 + 128 * 1024; }));
    CHECK(kept->words.size() == 20000);
  }
  SUBCASE("made a shared one, and then a little larger") {
    lot::ShmUniquePtr<Frame> own = pusher.loan();
    for (int n = 0; n < 20000; ++n) own->words.emplace_back(std::size_t{100}, 'x');
    std::uint64_t bytes = own->words.capacity() * sizeof(lot::ShmString);
    for (const auto& word : own->words) bytes += word.capacity() + 1;
    lot::ShmSharedPtr<Frame> shared = std::move(own);
    CHECK(segment.used() - before <= most(bytes) + bytes / 16 + 128 * 1024);
    shared->data.resize(100);
    shared->words.back() = "another word, which is too long for a short string";
    CHECK(shared->words.front().size() == 100);
    must_go(pusher.push(shared));
  }
}

TEST_CASE("a message may have many large pieces") {
  Segment segment(512 * kMiB);
  auto maker = segment.engine.advertise<Pieces>("/pieces");
  for (const std::uint64_t size : {70 * 1024UL, 300 * 1024UL, kMiB, 12 * kMiB}) {
    CAPTURE(size);
    const std::uint64_t before = segment.used();
    auto message = maker.loan();
    message->pieces.resize(30);
    for (auto& piece : message->pieces) {
      piece.resize(size);
      std::fill(piece.begin(), piece.end(),
                static_cast<std::uint8_t>(&piece - &message->pieces[0]));
    }
    for (const auto& piece : message->pieces) {
      REQUIRE(piece.back() == static_cast<std::uint8_t>(&piece - &message->pieces[0]));
      REQUIRE(std::count(piece.begin(), piece.end(), piece.back()) ==
              static_cast<std::ptrdiff_t>(size));
    }
    const lot::ShmSharedPtr<Pieces> complete = std::move(message);
    CHECK(segment.used() - before <= most(30 * size) + 8 * most(size) - 8 * size + kMiB);
  }
}

TEST_CASE("memory from reserve() serves pieces of any size") {
  Segment segment(64 * kMiB);
  auto pusher = segment.engine.advertise<Frame>("/reserved");
  pusher.reserve(1, 4 * kMiB);
  auto other = segment.engine.advertise<Frame>("/other");
  std::vector<lot::ShmUniquePtr<Frame>> all;  // there is nothing beside it
  for (const std::size_t size : {kMiB, kMiB / 16, 4096UL, 300UL}) take_all(other, size, all);
  for (int round = 0; round < 3; ++round) {
    CAPTURE(round);
    auto frame = pusher.loan();
    frame->words.resize(100);
    for (auto& word : frame->words) word.assign(1000, 'x');
    CHECK_NOTHROW(frame->data.resize(3 * kMiB));
    CHECK_NOTHROW(frame->more.resize(kMiB / 2));
    CHECK_THROWS_AS(frame->more.resize(2 * kMiB), lot::OutOfMemory);
    frame.reset();
    frame = pusher.loan();
    CHECK_NOTHROW(frame->data.resize(4 * kMiB));
    frame.reset();
    frame = pusher.loan();
    for (int n = 0; n < 30000; ++n) frame->data.push_back('x');
  }
}

TEST_CASE("two messages that grow by turns find room as one alone does") {
  Segment segment(256 * kMiB);
  auto pusher = segment.engine.advertise<Frame>("/turns");
  auto a = pusher.loan();
  auto b = pusher.loan();
  for (int n = 0; n < 150000; ++n) {
    a->words.emplace_back(std::size_t{100}, 'a');
    b->words.emplace_back(std::size_t{100}, 'b');
  }
  CHECK(a->words.back() == lot::ShmString(100, 'a'));
  CHECK(b->words.front() == lot::ShmString(100, 'b'));
}

TEST_CASE("small pieces behind a large one take nothing from other topics") {
  Segment segment(64 * kMiB);
  auto other = segment.engine.advertise<Frame>("/other");
  for (int n = 0; n < 16; ++n) {
    auto frame = other.loan();
    frame->data.resize(kMiB);
    must_go(other.push(std::move(frame)));
  }
  auto pusher = segment.engine.advertise<Frame>("/size");
  const std::uint64_t before = segment.used();
  auto frame = pusher.loan();
  frame->data.resize(30 * kMiB);
  frame->words.resize(20);
  for (auto& word : frame->words) word.assign(100, 'x');
  CHECK(segment.used() - before <= most(30 * kMiB) + 64 * 1024);
  lot::PullerOptions all;
  all.history = 64;
  auto reader = segment.engine.subscribe<Frame>("/other", all);
  std::size_t left = 0;
  while (reader.try_pull()) ++left;
  CHECK(left == 16);
}

TEST_CASE("a constructor that throws leaves nothing in its block") {
  Segment segment(64 * kMiB);
  auto pusher = segment.engine.advertise<Refusing>("/refusing");
  for (int n = 0; n < 100; ++n) CHECK_THROWS_AS((void)pusher.loan(true), int);
  CHECK(segment.used() < 10 * kMiB);
  CHECK_NOTHROW((void)pusher.loan(false));
}

TEST_CASE("memory from reserve() stays while messages need less, and grows no pile beside it") {
  Segment segment(64 * kMiB);
  auto pusher = segment.engine.advertise<Frame>("/reserved");
  const std::uint64_t before = segment.used();
  pusher.reserve(1, 4 * kMiB);
  const std::uint64_t reserved = segment.used() - before;
  CHECK(reserved >= 4 * kMiB);
  pusher.loan()->data.resize(100);
  pusher.loan()->data.resize(100'000);
  CHECK(segment.used() - before >= reserved);
  for (std::uint64_t size = 5; size < 20; ++size) {
    CAPTURE(size);
    auto frame = pusher.loan();
    frame->data.resize(size * kMiB);
    REQUIRE(segment.used() - before <= reserved + most(size * kMiB) + 64 * 1024);
  }
}

TEST_CASE("frames that are no power of two fill the segment") {
  Segment segment(64 * kMiB);
  CHECK(fitting(segment.engine, 17 * kMiB) == 3);
  CHECK(fitting(segment.engine, 40 * kMiB) == 1);
  CHECK(fitting(segment.engine, 9 * kMiB) == 5);
}

TEST_CASE("one message of 90 % of the segment fits when all others are gone") {
  Segment segment(128 * kMiB);
  std::mt19937_64 random(seed());
  auto pusher = segment.engine.advertise<Frame>("/any", {lot::Policy::Overwrite, 8, {}});
  for (int n = 0; n < 2000; ++n) {
    auto frame = pusher.loan();
    frame->data.resize(random() % (4 * kMiB));
    must_go(pusher.push(std::move(frame)));
  }
  CHECK(fitting(segment.engine, segment.size() / 10 * 9) == 0);
  { const auto gone = std::move(pusher); }
  CHECK(fitting(segment.engine, segment.size() / 10 * 9) == 1);
}

TEST_CASE("a few messages that are kept do not lie in the way of large ones") {
  Segment segment(1024 * kMiB);
  std::mt19937_64 random(seed());
  const std::size_t empty = fitting(segment.engine, 16 * kMiB);
  auto pusher = segment.engine.advertise<Frame>("/small");
  auto puller = segment.engine.subscribe<Frame>("/small");
  std::vector<lot::ShmSharedPtr<const Frame>> kept;
  std::uint64_t bytes = 0;
  for (int n = 0; n < 1200; ++n) {
    auto frame = pusher.loan();
    frame->data.resize(64 * 1024 + random() % (4 * kMiB - 128 * 1024));
    must_go(pusher.push(std::move(frame)));
    auto seen = puller.try_pull();
    REQUIRE(seen);
    if (n % 100 != 50) continue;
    bytes += seen->data.size();
    kept.push_back(std::move(seen));
  }
  const std::size_t now = fitting(segment.engine, 16 * kMiB);
  MESSAGE(kept.size() << " messages are kept, " << bytes / kMiB << " MiB: " << now << " of "
                      << empty << " frames of 16 MiB fit");
  CHECK(now * 4 >= empty * 3);
}

TEST_CASE("what a message that is being built has no need of serves other messages") {
  Segment segment(128 * kMiB);
  auto pusher = segment.engine.advertise<Frame>("/built");
  const auto make_warm = [&](std::size_t bytes) { pusher.loan()->data.resize(bytes); };
  SUBCASE("of its own publisher") {
    make_warm(100 * kMiB);
    auto small = pusher.loan();
    auto large = pusher.loan();
    CHECK_NOTHROW(large->data.resize(100 * kMiB));
    small->data.resize(kMiB);
    std::fill(small->data.begin(), small->data.end(), std::uint8_t{7});
    std::fill(large->data.begin(), large->data.end(), std::uint8_t{9});
    CHECK(std::count(small->data.begin(), small->data.end(), 7) == kMiB);
  }
  SUBCASE("of another one") {
    make_warm(100 * kMiB);
    auto small = pusher.loan();
    auto other = segment.engine.advertise<Frame>("/other");
    auto large = other.loan();
    CHECK_NOTHROW(large->data.resize(100 * kMiB));
    small->data.resize(kMiB);
  }
  SUBCASE("of another process") {
    make_warm(100 * kMiB);
    auto small = pusher.loan();
    Child child([&] {
      lot::EngineOptions same;
      same.segment = std::filesystem::path(segment.engine.path()).filename();
      lot::ShmEngine theirs(same);
      auto other = theirs.advertise<Frame>("/other");
      auto large = other.loan();
      large->data.resize(100 * kMiB);
      return 0;
    });
    CHECK(child.wait() == 0);
    small->data.resize(kMiB);
  }
  SUBCASE("of another process, which answers late") {
    Steps ready, end;
    Child child([&] {
      lot::EngineOptions same;
      same.segment = std::filesystem::path(segment.engine.path()).filename();
      lot::ShmEngine theirs(same);
      auto other = theirs.advertise<Frame>("/other");
      other.loan()->data.resize(100 * kMiB);
      const auto small = other.loan();
      ready.tell();
      end.next(60s);
    });
    REQUIRE(ready.next() == '.');
    child.send(SIGSTOP);
    int status = 0;
    REQUIRE(waitpid(child.pid(), &status, WUNTRACED) == child.pid());
    std::thread later([&] {
      std::this_thread::sleep_for(30ms);  // longer than the first look at the others
      child.send(SIGCONT);
    });
    auto large = pusher.loan();
    CHECK_NOTHROW(large->data.resize(100 * kMiB));
    later.join();
    end.tell();
    CHECK(child.wait() == 0);
  }
  SUBCASE("but for what reserve() made, and what it uses") {
    pusher.reserve(1, 60 * kMiB);
    auto reserved = pusher.loan();
    make_warm(30 * kMiB);
    auto used = pusher.loan();
    used->data.resize(30 * kMiB);
    auto large = pusher.loan();
    CHECK_THROWS_AS(large->data.resize(60 * kMiB), lot::OutOfMemory);
    CHECK_NOTHROW(reserved->data.resize(60 * kMiB));
  }
}

TEST_CASE("a thread that is short of memory takes nothing that a message uses") {
  const Watchdog watchdog(120);
  Segment segment(64 * kMiB);
  const std::uint64_t before = segment.used();
  std::atomic<bool> is_done{false};
  std::atomic<unsigned> spoiled{0};
  unsigned refused = 0;
  {
    auto pusher = segment.engine.advertise<Frame>("/built");
    auto greedy = segment.engine.advertise<Frame>("/greedy");
    auto kept = greedy.loan();  // beside it the asker never gets what it wants
    kept->data.resize(2 * kMiB);
    std::vector<std::thread> builders;
    for (unsigned t = 0; t < 2; ++t) {
      builders.emplace_back([&, t] {
        std::mt19937 random(seed() + t);
        for (unsigned n = 0; n < 600; ++n) {
          const auto value = static_cast<std::uint8_t>(2 * n + t);
          std::vector<lot::ShmUniquePtr<Frame>> frames;
          for (unsigned k = 0; k < 16; ++k) frames.push_back(pusher.loan());
          for (auto& frame : frames) {
            frame->data.resize(random() % 4 == 0 ? 100 : 70'000 + random() % 100'000);
            std::fill(frame->data.begin(), frame->data.end(), value);
          }
          for (const auto& frame : frames) {
            spoiled += std::count(frame->data.begin(), frame->data.end(), value) !=
                       static_cast<std::ptrdiff_t>(frame->data.size());
          }
        }
      });
    }
    std::thread asker([&] {
      while (!is_done) {
        auto frame = greedy.loan();
        CHECK_THROWS_AS(frame->data.resize(segment.size() - kMiB), lot::OutOfMemory);
        ++refused;
      }
    });
    for (auto& builder : builders) builder.join();
    is_done = true;
    asker.join();
  }
  CHECK(spoiled == 0);
  CHECK(refused >= 10);
  // Each run has gone back, once.
  CHECK(eventually([&] { return segment.used() == before; }));
}

// How well the segment is used does not depend on a sanitizer, and takes one most of a minute.
TEST_CASE("after many loans of any size most of the segment serves before one is refused" *
          doctest::skip(kIsSanitized)) {
  const Watchdog watchdog(300);
  // Rounds of messages that are being built may end early, at a fill that varies much: so the
  // median is that of many rounds.
  constexpr std::uint64_t kRounds = std::max<std::uint64_t>(11, kLoans / 30'000);
  constexpr std::uint64_t kLifetime = 80;  // of a message on average, in loans
  bool is_complete = false;
  SUBCASE("messages that are complete") { is_complete = true; }
  SUBCASE("messages that are being built") {}
  std::mt19937_64 random(seed());
  Segment segment(1024 * kMiB);
  auto maker = segment.engine.advertise<Frame>("/maker");
  // Of each round, at its first refusal. One that comes while messages come and go ends its round,
  // and another round goes on with the loans.
  std::vector<double> fills;
  std::uint64_t refused_early = 0;
  for (std::uint64_t loans = 0; loans < kLoans || fills.size() < kRounds;) {
    struct Message {
      std::uint64_t end;  ///< the loan that it lives until
      lot::ShmUniquePtr<Frame> built;
      lot::ShmSharedPtr<Frame> complete;
      const Frame& frame() const { return built ? *built : *complete; }
    };
    std::vector<Message> messages;
    for (std::uint64_t n = 0;; ++n) {
      const bool lasts = n >= kLoans / kRounds;  // then nothing goes any more
      if (!lasts) std::erase_if(messages, [n](const Message& m) { return m.end <= n; });
      const auto size = static_cast<std::size_t>(
          std::exp2(std::uniform_real_distribution<double>(0, 26)(random)));
      try {
        auto frame = maker.loan();
        frame->data.resize(size);
        messages.push_back({n + 1 + random() % (2 * kLifetime), {}, {}});
        if (is_complete) {
          messages.back().complete = std::move(frame);
        } else {
          messages.back().built = std::move(frame);
        }
      } catch (const lot::OutOfMemory&) {
        refused_early += !lasts;
        break;
      }
      ++loans;
    }
    std::uint64_t bytes = 0;
    for (const Message& m : messages) bytes += m.frame().data.size();
    fills.push_back(static_cast<double>(bytes) / static_cast<double>(segment.size()));
  }
  std::sort(fills.begin(), fills.end());
  const double median = fills[fills.size() / 2];
  MESSAGE("filled at the first refusal of " << fills.size() << " rounds: " << fills.front()
                                            << ", median " << median << "; " << refused_early
                                            << " while messages came and went");
  CHECK(median >= 0.75);
}

TEST_SUITE_END();
