// SPDX-License-Identifier: Apache-2.0

// Where a message's pieces lie is known to its home alone; a process that has taken the message
// checks what the arena says.

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <functional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/both_engines.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/seed.hpp"
#include "transport/participant.hpp"
#include "transport/pieces.hpp"

namespace {

using namespace lot::testing;
using lot::Status;
using lot::detail::Arena;
using lot::transport::Participant;

[[maybe_unused]] const std::string& prefix_taken = prefix();

struct Parts {
  lot::ShmVector<std::uint8_t> large;
  lot::ShmVector<std::uint8_t> more;
  lot::ShmVector<lot::ShmString> words;
};
using Items = lot::ShmQueue<lot::ShmUniquePtr<Parts>>;

std::uint32_t block_of(Participant& p, const void* message) {
  lot::segment::Segment& s = p.segment();
  for (std::uint32_t b = 0; b < s.capacity().blocks; ++b) {
    if (s.message_at(b, lot::detail::message_type<Parts>()) == message && p.holder().is_home(b)) {
      return b;
    }
  }
  return s.capacity().blocks;
}

/// The bytes of an arena, but for the flag that ends building.
class Noise {
 public:
  explicit Noise(std::mt19937& random) : random_(random) {}

  void hit(Arena& arena) {
    const std::uint8_t frozen = arena.frozen;
    auto* const bytes = reinterpret_cast<unsigned char*>(&arena);
    for (unsigned n = 1 + random_() % 8; n != 0; --n) {
      const std::size_t at = random_() % (sizeof(Arena) / 4) * 4;
      const std::uint32_t word = random_() % 2 == 0 ? static_cast<std::uint32_t>(random_())
                                                    : static_cast<std::uint32_t>(random_() % 64);
      std::memcpy(bytes + at, &word, sizeof(word));
    }
    arena.frozen = frozen;
    arena.references = 0;  // it is no message that refers to others
  }

 private:
  std::mt19937& random_;
};

bool is_all(const lot::ShmVector<std::uint8_t>& bytes, std::uint8_t value) {
  return std::all_of(bytes.begin(), bytes.end(), [&](std::uint8_t b) { return b == value; });
}

void add_words(Parts& parts, std::size_t count, char letter) {
  for (std::size_t n = 0; n < count; ++n) parts.words.emplace_back(std::size_t{40}, letter);
}
bool has_words(const Parts& parts, std::size_t from, std::size_t count, char letter) {
  if (parts.words.size() < from + count) return false;
  return std::all_of(parts.words.begin() + static_cast<std::ptrdiff_t>(from),
                     parts.words.begin() + static_cast<std::ptrdiff_t>(from + count),
                     [&](const lot::ShmString& word) {
                       return word.size() == 40 && word.find_first_not_of(letter) == word.npos;
                     });
}

TEST_SUITE_BEGIN("transport");

TEST_CASE("what another process writes into an arena moves no piece of a message that is built") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(64 << 20));
  lot::segment::Segment view(engine.path());
  auto pusher = engine.advertise<Parts>("/parts");
  const std::uint32_t before = view.granules().used();
  std::mt19937 random(seed());
  Noise noise(random);
  for (unsigned round = 0; round < 300; ++round) {
    CAPTURE(round);
    auto beside = pusher.loan();
    beside->more.resize(1 + random() % 200'000);
    std::fill(beside->more.begin(), beside->more.end(), std::uint8_t{7});
    auto message = pusher.loan();
    Participant& p = *Participant::at(message.get());
    const std::uint32_t block = block_of(p, message.get());
    REQUIRE(block < view.capacity().blocks);
    Arena& arena = p.segment().arena(block);
    message->large.resize(1 + random() % 300'000);
    std::fill(message->large.begin(), message->large.end(), std::uint8_t{1});
    noise.hit(arena);
    add_words(*message, random() % 200, 'a');
    const std::size_t words = message->words.size();
    noise.hit(arena);
    message->more.resize(1 + random() % 100'000);
    std::fill(message->more.begin(), message->more.end(), std::uint8_t{2});
    noise.hit(arena);
    add_words(*message, random() % 50, 'b');
    noise.hit(arena);
    message->more.resize(message->more.size() / 2);
    message->more.shrink_to_fit();
    REQUIRE(is_all(message->large, 1));
    REQUIRE(is_all(message->more, 2));
    REQUIRE(is_all(beside->more, 7));
    REQUIRE(has_words(*message, 0, words, 'a'));
    REQUIRE(has_words(*message, words, message->words.size() - words, 'b'));
  }
  { const auto gone = std::move(pusher); }
  CHECK(eventually([&] { return view.granules().used() <= before; }));
}

TEST_CASE("a message that grows after it became shared has told so, also when it is referred to") {
  struct Referring {
    lot::ShmRef<const Parts> parts;
  };
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(64 << 20));
  auto pusher = engine.advertise<Parts>("/parts");
  auto referring = engine.advertise<Referring>("/referring");
  lot::ShmSharedPtr<Parts> shared = pusher.loan();
  Participant& p = *Participant::at(shared.get());
  const Arena& arena = p.segment().arena(block_of(p, shared.get()));
  const auto granules = [&] {
    return lot::segment::granules_of(arena, p.segment().granules().count());
  };
  CHECK(granules() == 0);
  shared->large.resize(8 << 20);
  CHECK(granules() >= 2048);
  shared->large.clear();
  shared->large.shrink_to_fit();
  CHECK(granules() < 2048);
  shared->large.resize(16 << 20);
  auto message = referring.loan();
  message->parts = shared;
  must_go(referring.push(std::move(message)));
  CHECK_THROWS_WITH_AS(shared->more.resize(100'000), doctest::Contains("published"), lot::Error);
  CHECK(granules() >= 4096);
}

TEST_CASE("a plain message has no memory of the larger one that was in its block before") {
  struct Plain {
    std::uint64_t number;
  };
  lot::ShmEngine engine(fresh(64 << 20));
  lot::segment::Segment view(engine.path());
  {
    auto large = engine.make<Parts>();
    large->large.resize(8 << 20);
  }
  const auto plain = engine.make<Plain>();
  CHECK(plain);
  CHECK(view.granules().used() == 0);
}

TEST_CASE("reserve() of any number of bytes that is too large throws OutOfMemory") {
  lot::ShmEngine engine(fresh(64 << 20));
  auto pusher = engine.advertise<Parts>("/parts");
  for (const std::size_t less : {std::size_t{0}, std::size_t{1}, std::size_t{4095},
                                 std::size_t{4096}, std::size_t{1} << 62}) {
    CAPTURE(less);
    CHECK_THROWS_AS(pusher.reserve(1, ~std::size_t{0} - less), lot::OutOfMemory);
  }
}

TEST_CASE("a child of fork() builds none of its parent's messages") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(64 << 20));
  auto pusher = engine.advertise<Parts>("/parts");
  auto message = pusher.loan();
  message->more.resize(100);
  Child child([&] {
    try {
      message->words.emplace_back(std::size_t{100}, 'x');
    } catch (const lot::Error& e) {
      must(e.error_number() == ECHILD && std::strstr(e.what(), "fork") != nullptr, e.what());
      return;
    }
    must(false, "it is refused");
  });
  CHECK(child.wait() == 0);
  message->more.resize(200);
  CHECK(message->words.empty());
}

TEST_CASE("a child of fork() may share its parent's message, which goes on at home") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(64 << 20));
  auto pusher = engine.advertise<Parts>("/parts");
  auto puller = engine.subscribe<Parts>("/parts");
  auto message = pusher.loan();
  message->more.resize(100);
  Child child([&] {
    const lot::ShmSharedPtr<Parts> shared(std::move(message));
    must(shared->more.size() == 100, "it is there");
  });
  CHECK(child.wait() == 0);
  message->more.resize(200);
  must_go(pusher.push(std::move(message)));
  const auto seen = puller.try_pull();
  REQUIRE(seen);
  CHECK(seen->more.size() == 200);
}

/// A queue's item, made by another process.
struct Made {
  explicit Made(std::size_t reserve = 0)
      : maker([this, reserve] {
          lot::ShmEngine theirs(options());
          auto pusher = theirs.advertise<Parts>("/parts");
          if (reserve != 0) pusher.reserve(1, reserve);
          auto out = theirs.queue<lot::ShmUniquePtr<Parts>>("out");
          auto back = theirs.queue<lot::ShmUniquePtr<Parts>>("back");
          auto item = pusher.loan();
          item->large.resize(100'000);
          std::fill(item->large.begin(), item->large.end(), std::uint8_t{1});
          add_words(*item, 20, 'a');
          must(out.put(std::move(item)) == Status::Ok, "put");
          if (reserve != 0) {
            auto again = back.wait_and_pop();
            must(has_words(*again, 0, 20, 'a') && has_words(*again, 20, 30, 'b'), "it came back");
            add_words(*again, 200, 'c');
            must(is_all(again->large, 1) && has_words(*again, 0, 20, 'a') &&
                     has_words(*again, 20, 30, 'b') && has_words(*again, 50, 200, 'c'),
                 "it grew at home");
          }
          steps.next();
        }) {}

  lot::EngineOptions options() const {
    lot::EngineOptions same;
    same.segment = std::filesystem::path(engine.path()).filename();
    return same;
  }

  lot::ShmEngine engine{fresh(64 << 20)};
  Steps steps;
  Child maker;
};

TEST_CASE("a message that comes home again grows behind what another process has added") {
  const Watchdog watchdog(60);
  Made made(1 << 20);
  Items out = made.engine.queue<lot::ShmUniquePtr<Parts>>("out");
  Items back = made.engine.queue<lot::ShmUniquePtr<Parts>>("back");
  auto item = out.wait_and_pop();
  add_words(*item, 30, 'b');
  CHECK(has_words(*item, 0, 20, 'a'));
  CHECK(has_words(*item, 20, 30, 'b'));
  CHECK(is_all(item->large, 1));
  CHECK(back.put(std::move(item)) == Status::Ok);
  made.steps.tell();
  CHECK(made.maker.wait() == 0);
}

TEST_CASE("what a message that was taken says about its memory is checked before it grows") {
  const Watchdog watchdog(60);
  Made made;
  Items out = made.engine.queue<lot::ShmUniquePtr<Parts>>("out");
  auto item = out.wait_and_pop();
  Participant& p = *Participant::at(item.get());
  lot::segment::Segment& s = p.segment();
  const auto block = static_cast<std::uint32_t>(
      (s.offset_of(item.get()) - s.offset_of(s.small(0))) / lot::segment::kSmallBytes);
  Arena& arena = s.arena(block);
  REQUIRE(arena.extents >= 2);
  REQUIRE(arena.current != 0);
  const auto is_refused = [&](const std::function<void()>& write) {
    unsigned char saved[sizeof(Arena)];
    std::memcpy(saved, &arena, sizeof(saved));
    write();
    std::string said;
    try {
      item->words.emplace_back(std::size_t{100}, 'x');
    } catch (const lot::Error& e) {
      said = e.what();
    }
    std::memcpy(static_cast<void*>(&arena), saved, sizeof(saved));
    return said.find("is damaged") != said.npos;
  };
  CHECK(is_refused([&] { arena.cursor = s.size() + 8; }));
  CHECK(is_refused([&] { arena.cursor = s.offset_of(s.small(block)); }));
  CHECK(is_refused([&] { arena.cursor = ~std::uint64_t{0} - 8; }));
  CHECK(is_refused([&] { arena.current = 0; }));
  CHECK(is_refused([&] { arena.current = 15; }));
  CHECK(is_refused([&] { arena.current = static_cast<std::uint8_t>(arena.current % 2 + 1); }));
  CHECK(is_refused([&] { arena.extent[0].granule = ~std::uint32_t{0}; }));
  CHECK(is_refused([&] { arena.extent[1].granule = s.granules().count() - 1; }));
  CHECK(is_refused([&] { arena.extent[0].granules = 0; }));
  CHECK(is_refused([&] { arena.extent[1].granules = ~std::uint32_t{0}; }));
  CHECK(is_refused([&] { arena.extents = 15; }));
  CHECK(has_words(*item, 0, 20, 'a'));
  CHECK(is_all(item->large, 1));
  made.steps.tell();
  CHECK(made.maker.wait() == 0);
}

TEST_CASE("the next message is expected to have what this one uses and its newest extent") {
  lot::detail::Build build;
  build.extents = 4;
  build.extent[0] = {0, 100, 1, 0};
  build.extent[1] = {100, 200, 0, 0};                 // nothing lives in it
  build.extent[2] = {300, 400, 1, Arena::kReserved};  // only reserve() makes such
  build.extent[3] = {700, 800, 0, 0};
  CHECK(lot::transport::Pieces::of(build, 3).granules() == 900);
  CHECK(lot::transport::Pieces::of(build, lot::detail::Build::kMaxExtents).granules() == 100);
}

TEST_CASE("a published message says that it has the memory that it has, and no more") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(64 << 20));
  auto pusher = engine.advertise<Parts>("/parts");
  for (const std::size_t count : {std::size_t{1'000}, std::size_t{5'000}, std::size_t{23'000}}) {
    CAPTURE(count);
    auto message = pusher.loan();
    add_words(*message, count, 'a');
    Participant& p = *Participant::at(message.get());
    const std::uint32_t block = block_of(p, message.get());
    must_go(pusher.push(std::move(message)));
    const auto& tags = p.segment().granules();
    std::uint32_t has = 0;
    for (std::uint32_t i = 0; i < tags.count(); ++i) has += tags.tag(i) == block + 1;
    CHECK(has != 0);
    CHECK(lot::segment::granules_of(p.segment().arena(block), tags.count()) == has);
  }
}

TEST_CASE("an extent with more pieces than can be counted is not begun anew while some live") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(64 << 20));
  auto pusher = engine.advertise<Parts>("/parts");
  pusher.reserve(1, 16 << 20);
  auto message = pusher.loan();
  constexpr std::size_t kPieces = 70'000;
  message->words.reserve(kPieces);
  add_words(*message, kPieces, 'a');
  message->words.resize(100);
  add_words(*message, 100, 'b');
  CHECK(has_words(*message, 0, 100, 'a'));
  CHECK(has_words(*message, 100, 100, 'b'));
}

TEST_CASE("a message that was taken has room for a piece where a larger one was") {
  const Watchdog watchdog(60);
  Made made;
  Items out = made.engine.queue<lot::ShmUniquePtr<Parts>>("out");
  auto item = out.wait_and_pop();
  item->large.clear();
  item->large.shrink_to_fit();
  item->more.resize(90'000);
  std::fill(item->more.begin(), item->more.end(), std::uint8_t{5});
  CHECK(is_all(item->more, 5));
  CHECK(has_words(*item, 0, 20, 'a'));
  made.steps.tell();
  CHECK(made.maker.wait() == 0);
}

}  // namespace
