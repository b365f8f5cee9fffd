// SPDX-License-Identifier: Apache-2.0

// Whose messages go: an Eviction over a segment alone, with publishers that the tests play.

#include "transport/eviction.hpp"

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/control.hpp"

#include "support/local_segment.hpp"

namespace {

using lot::testing::LocalSegment;
using lot::transport::Eviction;
using lot::transport::Evictor;
using lot::transport::Request;
using lot::transport::Shortage;
using What = Eviction::Step::What;

constexpr std::uint32_t kSelf = 1;
constexpr std::uint32_t kBlocks = 64;
constexpr std::uint64_t kGranule = lot::segment::kGranule;
constexpr std::uint32_t kNobody = ~std::uint32_t{0};

/// A publisher that gives what the test says, and notes what it was asked.
struct Publisher final : Evictor {
  Publisher(std::uint32_t its_pool, Stock its_stock) : index(its_pool), has(its_stock) {}

  std::uint32_t pool() const noexcept override { return index; }
  bool settle() noexcept override {
    ++settled;
    return had_free;
  }
  std::size_t look(std::span<std::uint32_t> foreign) noexcept override {
    foreign[0] = 100 + index;
    return 1;
  }
  Stock stock(Shortage shortage) noexcept override {
    last = shortage;
    return has;
  }
  void mark(bool own, std::uint64_t keep, bool unread,
            std::vector<bool>& blocks) noexcept override {
    marked = {own, keep, unread};
    for (const std::uint32_t b : marks) blocks[b] = true;
  }
  bool give_up() noexcept override {
    ++gave_up;
    return gives;
  }
  bool give_up_to_other(Shortage shortage, std::uint64_t keep) noexcept override {
    ++asked;
    asked_for = {shortage, keep};
    if (refuses) has.held -= lost;
    return !refuses;
  }
  std::chrono::nanoseconds patience() const noexcept override { return waits; }

  struct Marked {
    bool own;
    std::uint64_t keep;
    bool unread;
    bool operator==(const Marked&) const = default;
  };
  std::uint32_t index;
  Stock has;
  bool had_free = false;
  bool gives = true;
  bool refuses = false;
  std::uint64_t lost = 0;  ///< when it refuses, so much of its stock has gone
  std::vector<std::uint32_t> marks;
  std::chrono::nanoseconds waits{};
  int settled = 0;
  int gave_up = 0;
  int asked = 0;
  std::pair<Shortage, std::uint64_t> asked_for{};
  Marked marked{};
  Shortage last = Shortage::Memory;
};

Evictor::Stock stock(std::uint64_t held, std::uint64_t oldest, std::uint64_t unread = 0) {
  return {held, unread, oldest, 0, 0, oldest};
}

struct Room {
  Room() {
    holder.segment = &local.segment();
    holder.own = lot::transport::HardwareOwnership(kSelf);
    eviction.prepare(kBlocks, 8);
  }
  LocalSegment local{{16 << 20, 4, kBlocks, 2, 3, 3}};
  lot::transport::Holder holder;
  Eviction eviction{holder, local.segment()};
  Eviction::Givers nobody{};
};

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("an Eviction asks the publisher that a pool names, and no other one") {
  Room room;
  Eviction& eviction = room.eviction;
  Publisher first(3, {10, 4, 0, 2, 0, 0});
  Publisher second(5, {20, 1, 0, 7, 0, 0});
  second.waits = std::chrono::nanoseconds(9);
  second.gives = false;
  eviction.add(first);
  eviction.add(second);
  std::array<std::uint32_t, 2> foreign{};
  CHECK(eviction.look(5, foreign) == 1);
  CHECK(foreign[0] == 105);
  CHECK(eviction.look(3, foreign) == 1);
  CHECK(foreign[0] == 103);
  CHECK(eviction.look(4, foreign) == 0);
  CHECK(eviction.could_give(3, Shortage::Blocks) == 8);
  CHECK(first.last == Shortage::Blocks);
  CHECK(eviction.could_give(5, Shortage::Memory) == 26);
  CHECK(eviction.could_give(4, Shortage::Memory) == 0);
  CHECK(eviction.patience(3).count() == 0);
  CHECK(eviction.patience(5).count() == 9);
  CHECK(eviction.patience(4).count() == 0);
  CHECK(eviction.give_up(3));
  CHECK(!eviction.give_up(5));
  CHECK(!eviction.give_up(4));
  CHECK(first.gave_up == 1);
  CHECK(second.gave_up == 1);

  CHECK(!eviction.settle());
  first.had_free = true;
  CHECK(eviction.settle());
  CHECK(first.settled == 2);
  CHECK(second.settled == 2);  // though the first one had something

  CHECK(eviction.has_unread(Shortage::Memory));
  eviction.remove(first);
  CHECK(eviction.has_unread(Shortage::Blocks));
  CHECK(second.last == Shortage::Blocks);
  second.has.unread = 0;
  CHECK(!eviction.has_unread(Shortage::Blocks));
  CHECK(!eviction.give_up(3));
  CHECK(first.gave_up == 1);
}

TEST_CASE("the publisher that holds most gives, if it keeps as much as the asker will have") {
  struct Row {
    std::array<Evictor::Stock, 3> others;
    int giver;  ///< -1: none of them
  };
  // The asker has 10 and needs 5 more.
  const Row table[] = {
      {{stock(30, 5), stock(40, 5), stock(20, 5)}, 1},
      {{stock(40, 5), stock(40, 6), stock(40, 7)}, 0},
      {{stock(39, 5), stock(40, 0), stock(38, 5)}, 0},   // what frees nothing
      {{stock(39, 5), stock(40, 26), stock(38, 5)}, 0},  // it would keep 14
      {{stock(39, 5), stock(40, 25), stock(38, 5)}, 1},  // it keeps 15
      {{stock(19, 5), stock(19, 5), stock(20, 5)}, 2},
      {{stock(19, 5), stock(19, 5), stock(19, 5)}, -1},
      {{stock(0, 0), stock(0, 0), stock(0, 0)}, -1},
  };
  for (const Row& row : table) {
    for (const Shortage shortage : {Shortage::Memory, Shortage::Blocks}) {
      Room room;
      Publisher asker(7, stock(10, 10));
      std::vector<Publisher> others;
      for (std::uint32_t n = 0; n < 3; ++n) others.emplace_back(n, row.others[n]);
      room.eviction.add(others[0]);
      room.eviction.add(asker);
      room.eviction.add(others[1]);
      room.eviction.add(others[2]);
      const Eviction::Step step = room.eviction.evict(7, 5, shortage, room.nobody);
      CHECK(step.what == What::Given);
      for (int n = 0; n < 3; ++n) {
        const Publisher& other = others[static_cast<std::size_t>(n)];
        CHECK(other.asked == (n == row.giver));
        CHECK(other.gave_up == 0);
        if (n == row.giver) CHECK(other.asked_for == std::pair{shortage, std::uint64_t{15}});
      }
      CHECK(asker.asked == 0);
      CHECK(asker.gave_up == (row.giver < 0));
    }
  }
}

TEST_CASE("where a publisher refuses, another one is asked, and at last the asker gives its own") {
  Room room;
  Publisher asker(7, stock(10, 0));
  Publisher first(1, stock(50, 5));
  Publisher second(2, stock(40, 5));
  for (Publisher* p : {&asker, &first, &second}) room.eviction.add(*p);
  const auto evict = [&] {
    for (Publisher* p : {&asker, &first, &second}) p->asked = p->gave_up = 0;
    return room.eviction.evict(7, 5, Shortage::Memory, room.nobody).what;
  };
  first.refuses = true;
  first.lost = 20;
  CHECK(evict() == What::Given);
  CHECK(first.asked == 1);
  CHECK(second.asked == 1);
  CHECK(asker.gave_up == 0);

  first.has.held = 50;
  first.lost = 0;  // it refuses again and again
  CHECK(evict() == What::Given);
  CHECK(first.asked == 3);  // once for each publisher
  CHECK(second.asked == 0);
  CHECK(asker.gave_up == 1);

  asker.gives = false;
  CHECK(evict() == What::Nothing);
  CHECK(asker.gave_up == 1);
  asker.gives = true;
  asker.has.unread = 10;  // nothing of its own may go
  CHECK(evict() == What::Nothing);
  CHECK(asker.gave_up == 0);
  room.eviction.remove(asker);
  CHECK(evict() == What::Nothing);
  first.refuses = false;
  CHECK(evict() == What::Given);
  CHECK(first.asked_for == std::pair{Shortage::Memory, std::uint64_t{5}});  // nothing but the need
}

TEST_CASE("an Eviction gives another process what it asks for, and 64 messages at most at once") {
  struct Row {
    Shortage shortage;
    std::uint64_t held, oldest, keep, need;
    int times;
  };
  const std::uint64_t g = kGranule;
  const Row table[] = {
      {Shortage::Memory, 20 * g, 2 * g, 18, 4, 2}, {Shortage::Memory, 20 * g, 2 * g, 18, 5, 3},
      {Shortage::Memory, 20 * g, 2 * g, 19, 4, 0}, {Shortage::Memory, 20 * g, 2 * g, 18, 0, 0},
      {Shortage::Blocks, 20, 2, 18, 4, 2},         {Shortage::Blocks, 20, 2, 19, 4, 0},
      {Shortage::Blocks, 20, 2, 18, 5, 3},         {Shortage::Blocks, 200, 1, 18, 63, 63},
      {Shortage::Blocks, 200, 1, 18, 1000, 64},
  };
  for (const Row& row : table) {
    Room room;
    Publisher other(1, stock(row.held, row.oldest));
    room.eviction.add(other);
    // It gives less where the machine is busy for 20 ms, and never more.
    for (int tries = 0; tries < 100; ++tries) {
      other.asked = 0;
      CHECK(room.eviction.give({row.shortage, row.keep, row.need}) == (row.times != 0));
      REQUIRE(other.asked <= row.times);
      if (other.asked == row.times) break;
    }
    CHECK(other.asked == row.times);
    const std::uint64_t unit = row.shortage == Shortage::Memory ? g : 1;
    if (row.times != 0) CHECK(other.asked_for == std::pair{row.shortage, row.keep * unit});
    other.refuses = true;
    other.asked = 0;
    CHECK(!room.eviction.give({row.shortage, row.keep, row.need}));
    CHECK(other.asked == (row.times != 0));
  }
}

TEST_CASE("a run can be free where its granules are free or marked, one beside the other") {
  Room room;
  lot::segment::Segment& segment = room.local.segment();
  Publisher asker(7, {});
  Publisher other(1, {});
  room.eviction.add(other);
  room.eviction.add(asker);
  const auto& tags = segment.granules();
  // Each granule has the tag of the next block, so three blocks beside each other are a run of
  // three.
  for (std::uint32_t i = 0; i < tags.count(); ++i) {
    REQUIRE(segment.claim_run(1, i % kBlocks + 1) == i);
  }
  using Backing = Eviction::Backing;
  const auto longest = [&](Backing backing) {
    std::uint32_t run = 0;
    while (room.eviction.can_free_run(7, run + 1, room.nobody, backing)) ++run;
    return run;
  };
  for (const Backing backing : {Backing::Asked, Backing::All, Backing::None}) {
    asker.marks = other.marks = {};
    CHECK(longest(backing) == 0);
    other.marks = {4, 6};
    CHECK(longest(backing) == 1);
    asker.marks = {5};
    CHECK(longest(backing) == 3);
    asker.marks = {kBlocks - 1};
    other.marks = {0};
    CHECK(longest(backing) == 2);
  }
  for (const bool waits : {false, true}) {
    asker.waits = std::chrono::nanoseconds(waits ? 1 : 0);
    other.waits = std::chrono::nanoseconds(1);  // the asker's patience alone counts
    CHECK(!room.eviction.can_free_run(7, 3, room.nobody));
    CHECK(asker.marked == Publisher::Marked{true, 3 * kGranule, waits});
    CHECK(other.marked == Publisher::Marked{false, 3 * kGranule, waits});
  }
  CHECK(!room.eviction.can_free_run(kNobody, 3, room.nobody));
  CHECK(asker.marked == Publisher::Marked{false, 3 * kGranule, false});
}

TEST_CASE("a publisher of another process is asked if it holds more, and can keep as much") {
  Room room;
  lot::segment::Segment& segment = room.local.segment();
  lot::transport::World& world = room.local.world();
  constexpr std::uint32_t kOther = 2;
  constexpr lot::detail::MessageType kNumber{8, 8, 1, "number", nullptr, true, nullptr};
  world.participant_state(kOther).take();
  lot::registry::ChannelName name{};
  {
    const lot::registry::Registry::Lock lock(room.local.registry());
    const std::uint32_t topic = room.local.registry().enter("/numbers", kNumber, kOther);
    name = room.local.registry().open(topic, kOther, {4, 3}).value();
  }
  lot::ring::Writer<lot::segment::Atomics> writer(segment.ring(name.channel));
  for (std::uint32_t b = 0; b < 4; ++b) {  // each has three granules
    lot::transport::HardwareOwnership::Hold hold{};
    REQUIRE(lot::transport::HardwareOwnership(kOther).claim(world.block(b), hold));
    REQUIRE(segment.claim_run(3, b + 1) != kNobody);
    writer.publish(b);
  }
  Eviction::Givers givers{};
  const auto evict = [&](std::uint64_t need, Shortage shortage) {
    return room.eviction.evict(7, need, shortage, givers);
  };
  room.eviction.look_at_others(Shortage::Memory);
  CHECK(evict(kGranule, Shortage::Memory).what == What::Nothing);
  givers[kOther] = true;

  struct Row {
    std::uint64_t own, need;
    Shortage shortage;
    std::uint64_t keeps, needs;  ///< as it is asked; 0: it is not
  };
  const Row table[] = {
      {0, 9 * kGranule, Shortage::Memory, 9, 9},
      {0, 9 * kGranule + 1, Shortage::Memory, 0, 0},
      {0, 9, Shortage::Blocks, 0, 0},
      {0, 3, Shortage::Blocks, 3, 3},
      {1, 2, Shortage::Blocks, 3, 2},
      {1, 3, Shortage::Blocks, 0, 0},
      {0, 1, Shortage::Memory, 1, 1},
      {kGranule, kGranule + 1, Shortage::Memory, 3, 2},
      {2, 2 * kGranule - 1, Shortage::Memory, 3, 2},
  };
  for (const Row& row : table) {
    Publisher asker(7, stock(row.own, 0, row.own));
    room.eviction.add(asker);
    const Eviction::Step step = evict(row.need, row.shortage);
    room.eviction.remove(asker);
    REQUIRE(step.what == (row.keeps == 0 ? What::Nothing : What::Ask));
    if (row.keeps == 0) continue;
    CHECK(step.from == kOther);
    CHECK(step.block == 0);
    CHECK(step.request.shortage == row.shortage);
    CHECK(step.request.keep == row.keeps);
    CHECK(step.request.need == row.needs);
  }

  Publisher ours(1, stock(12 * kGranule - 1, 1));
  room.eviction.add(ours);
  CHECK(evict(kGranule, Shortage::Memory).what == What::Ask);
  ours.has.held = 12 * kGranule;
  CHECK(evict(kGranule, Shortage::Memory).what == What::Given);
  CHECK(ours.asked == 1);
  ours.has = stock(3, 1);
  CHECK(evict(1, Shortage::Blocks).what == What::Ask);
  ours.has = stock(4, 1);
  CHECK(evict(1, Shortage::Blocks).what == What::Given);
}

TEST_SUITE_END();
