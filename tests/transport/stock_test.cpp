// SPDX-License-Identifier: Apache-2.0

// The pools of a process, over a segment alone: no participant, no warden, no other process.

#include "transport/stock.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/control.hpp"

#include "support/local_segment.hpp"
#include "transport/ahead.hpp"
#include "transport/control_blocks.hpp"
#include "transport/held_since.hpp"
#include "transport/idle_look.hpp"
#include "transport/kept_list.hpp"
#include "transport/quota.hpp"
#include "transport/warden_thread.hpp"

namespace {

using lot::testing::LocalSegment;
using lot::transport::Pool;
using lot::transport::Stock;
namespace hold = lot::transport::hold;

constexpr std::uint32_t kSelf = 1;
constexpr std::uint32_t kBlocks = 64;

/// What a Stock needs.
struct Needs {
  Needs() {
    holder.segment = &local.segment();
    holder.own = lot::transport::HardwareOwnership(kSelf);
    holder.controls = controls.all();
    holder.make_tables(kBlocks);
  }

  /// A block of the pool, as a loan has it, with so much memory.
  std::uint32_t loan(Pool& pool, std::uint32_t granules) {
    const std::uint32_t b = pool.claim();
    REQUIRE(b != Pool::kNone);
    add_run(pool, b, granules);
    return b;
  }
  /// One more piece of memory for it.
  void add_run(Pool& pool, std::uint32_t b, std::uint32_t granules) {
    const std::uint32_t run = pool.try_claim_run(granules, b + 1);
    REQUIRE(run != Pool::kNoRun);
    lot::detail::Build& build = local.segment().build(b);
    build.extent[build.extents++] = {run, granules, 1, 0};
  }
  /// Closes the pool. Its ring has the only hold on a message.
  void close_with_message(Pool& pool) {
    const std::uint32_t b = loan(pool, 3);
    holder.acquire(b, hold::kRing);
    holder.release(b, hold::kPointer);
    stock.close(pool, {0, 1}, {b});
  }
  std::uint32_t free_granules() {
    const auto& tags = local.segment().granules();
    std::uint32_t free = 0;
    for (std::uint32_t i = 0; i < tags.count(); ++i) free += tags.tag(i) == 0;
    return free;
  }

  LocalSegment local{{16 << 20, 3, kBlocks, 1, 4, 2}};
  lot::detail::Hub hub{};
  lot::transport::ControlBlocks controls{kBlocks, hub};
  lot::transport::Holder holder;
  lot::transport::WardenThread warden;
  lot::transport::Ahead ahead{local.segment(), warden};
  Stock stock{local.segment(), holder, ahead};
};

/// Another process of the segment.
struct Other {
  explicit Other(Needs& needs) : controls(kBlocks, needs.hub) {
    holder.segment = &needs.local.segment();
    holder.own = lot::transport::HardwareOwnership(kSelf + 1);
    holder.controls = controls.all();
    holder.make_tables(kBlocks);
  }
  lot::transport::ControlBlocks controls;
  lot::transport::Holder holder;
};

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("a Stock opens a pool again once its ring has closed, and another pool before") {
  Needs needs;
  Pool& first = needs.stock.open("/first");
  needs.close_with_message(first);
  CHECK(!needs.stock.drain([](const auto&) { return false; }));
  CHECK(&needs.stock.open("/second") != &first);
  CHECK(needs.stock.size() == 2);

  CHECK(needs.stock.drain([](const auto&) { return true; }));
  CHECK(&needs.stock.open("/third") == &first);
  CHECK(needs.stock.size() == 2);
}

TEST_CASE("a Stock gives up the holds of a ring when the ring is closed, and not before") {
  Needs needs;
  const std::uint32_t all = needs.free_granules();
  needs.close_with_message(needs.stock.open("/numbers"));
  CHECK(!needs.stock.drain([](const auto&) { return false; }));
  CHECK(!needs.stock.has_released());
  CHECK(needs.free_granules() == all - 3);

  CHECK(needs.stock.drain([](const auto&) { return true; }));
  CHECK(needs.stock.has_released());
  CHECK(needs.free_granules() == all);
}

TEST_CASE("a Stock trims idle memory for another process, and reserve()'s only for its own pool") {
  Needs needs;
  const std::uint32_t all = needs.free_granules();
  Pool& pool = needs.stock.open("/numbers");
  const std::uint32_t idle = needs.loan(pool, 2);
  const std::uint32_t reserved = needs.loan(pool, 4);
  pool.keep_reserved(reserved);
  CHECK(!needs.stock.trim(Stock::kNobody));  // both are loaned
  pool.give_back(idle);
  pool.give_back(reserved);

  CHECK(needs.stock.trim(Stock::kNobody));
  CHECK(needs.free_granules() == all - 4);
  CHECK(needs.stock.trim(pool.index()));
  CHECK(needs.free_granules() == all);
}

TEST_CASE("a pool keeps the memory that reserve() made though a message uses none of it") {
  Needs needs;
  const std::uint32_t all = needs.free_granules();
  Pool& pool = needs.stock.open("/numbers");
  const std::uint32_t reserved = needs.loan(pool, 3);
  needs.add_run(pool, reserved, 2);
  const std::uint32_t other = needs.loan(pool, 5);
  needs.add_run(pool, other, 7);
  needs.add_run(pool, other, 6);
  pool.keep_reserved(reserved);
  const lot::detail::MessageType large{1 << 20, 8, 0, "", nullptr, true, nullptr};
  for (const std::uint32_t b : {reserved, other}) {
    auto& extent = needs.local.segment().build(b).extent;
    extent[0].living = 0;
    if (b == reserved) extent[1].living = 0;
    needs.holder.control(b).type = &large;
    pool.give_back(b);
  }
  CHECK(needs.free_granules() == all - 5 - 7 - 6);  // of the other, what its message used
  CHECK(pool.granules() == 5 + 7 + 6);
  const lot::detail::Build& build = needs.local.segment().build(other);
  REQUIRE(build.extents == 2);
  CHECK(build.extent[0].granules == 7);
  CHECK(build.extent[1].granules == 6);
  CHECK(build.extent[0].living + build.extent[1].living == 0);
  CHECK(needs.local.segment().build(reserved).extents == 2);
}

TEST_CASE("a pool's count of its memory is never below nothing, and keeps what max_bytes allows") {
  Needs needs;
  Pool& pool = needs.stock.open("/numbers");
  pool.limit(4 * lot::segment::kGranule);
  CHECK(pool.may_take(4));
  CHECK(!pool.may_take(5));
  CHECK(pool.take(2));
  CHECK(!pool.take(2, 1));  // one more would not fit
  CHECK(pool.granules() == 2);
  CHECK(pool.take(1, 1));
  CHECK(pool.granules() == 3);
  CHECK(pool.try_claim_run(2, 1) == Pool::kNoRun);
  CHECK(errno == EDQUOT);
  CHECK(pool.granules() == 3);
  pool.count_out(2);
  CHECK(pool.granules() == 1);
  pool.count_out(2);
  CHECK(pool.granules() == 0);

  pool.limit(1);  // less than a granule is one
  CHECK(pool.limit() == 1);
  pool.limit(0);
  CHECK(pool.may_take(std::uint64_t{1} << 40));
}

TEST_CASE("a pool hands out the foreign blocks that left its ring, as many as there is room for") {
  Needs needs;
  Pool& pool = needs.stock.open("/numbers");
  Pool& theirs = needs.stock.open("/theirs");
  pool.make_room(5);
  std::vector<std::uint32_t> foreign;
  for (int n = 0; n < 5; ++n) {
    foreign.push_back(needs.loan(theirs, 1));
    needs.holder.acquire(foreign.back(), hold::kRing);
    pool.retire(foreign.back(), n % 2 == 0);
  }
  CHECK(pool.retired() == 3);  // a reader may still look at these
  CHECK(pool.has_foreign());
  const auto scan_but = [&](std::uint32_t seen) {
    pool.scan([seen](std::uint32_t b) { return b == seen; });
  };
  scan_but(foreign[2]);
  CHECK(pool.retired() == 1);
  scan_but(Pool::kNone);
  CHECK(pool.retired() == 0);

  std::vector<std::uint32_t> got;
  for (const std::size_t count : {3U, 2U, 0U}) {
    std::array<std::uint32_t, 3> some{};
    CHECK(pool.take_foreign(some) == count);
    got.insert(got.end(), some.begin(), some.begin() + static_cast<std::ptrdiff_t>(count));
  }
  CHECK(!pool.has_foreign());
  std::sort(got.begin(), got.end());
  CHECK(got == foreign);
  for (const std::uint32_t b : foreign) {
    needs.holder.release(b, hold::kRing);
    theirs.give_back(b);
  }
}

TEST_CASE("a closed pool is opened again when its last block has come home, wherever it was") {
  Needs needs;
  Other other(needs);
  const std::uint32_t all = needs.free_granules();
  Pool& pool = needs.stock.open("/numbers");
  const auto drains = [&] { return needs.stock.drain([](const auto&) { return true; }); };

  const std::uint32_t kept = needs.loan(pool, 1);
  other.holder.acquire(kept, hold::kPointer);
  needs.holder.release(kept, hold::kPointer);
  CHECK(pool.kept() == 1);
  std::uint32_t borrowed = 0;
  for (const bool is_borrowed : {false, true}) {
    borrowed = needs.loan(pool, 1);
    needs.holder.acquire(borrowed, hold::kRing);
    needs.holder.release(borrowed, hold::kPointer);
    pool.retire(borrowed, is_borrowed);
  }
  CHECK(pool.has_free());
  CHECK(pool.retired() == 1);
  needs.stock.close(pool, {0, 1}, {});

  CHECK(!drains());
  CHECK(!pool.has_free());
  CHECK(needs.free_granules() == all - 2);
  other.holder.release(kept, hold::kPointer);
  CHECK(!drains());
  CHECK(pool.kept() == 0);
  CHECK(needs.free_granules() == all - 1);
  pool.scan([](std::uint32_t) { return false; });
  CHECK(drains());
  CHECK(needs.free_granules() == all);
  CHECK(&needs.stock.open("/next") == &pool);
}

TEST_CASE("a KeptList gives its blocks in order, wherever one is taken off or moved to the end") {
  using lot::transport::KeptList;
  std::vector<KeptList::Link> links(8);
  KeptList list(links.data());
  KeptList other(links.data());
  const auto said = [](KeptList& of) {
    std::vector<std::uint32_t> blocks;
    while (!of.empty()) {
      blocks.push_back(of.front());
      of.remove(of.front());
    }
    CHECK(of.size() == 0);
    return blocks;
  };
  using Blocks = std::vector<std::uint32_t>;
  for (const std::uint32_t off : {0U, 3U, 5U, 7U}) {
    for (const std::uint32_t b : {0U, 7U, 3U, 5U}) CHECK(list.enter(b));
    CHECK(!list.enter(7));
    CHECK(list.size() == 4);
    for (const std::uint32_t b : {1U, 2U}) CHECK(other.enter(b));
    list.remove(off);
    list.remove(off);  // it is on no list
    CHECK(list.size() == 3);
    Blocks rest{0, 7, 3, 5};
    rest.erase(std::find(rest.begin(), rest.end(), off));
    CHECK(said(list) == rest);
    CHECK(said(other) == Blocks{1, 2});
  }
  for (const std::uint32_t last : {0U, 1U, 2U}) {
    for (const std::uint32_t b : {0U, 1U}) list.move_to_end(b);  // they come
    list.move_to_end(last);                                      // one more comes, or one moves
    CHECK(list.size() == (last == 2 ? 3 : 2));
    CHECK(said(list) == (last == 0 ? Blocks{1, 0} : last == 1 ? Blocks{0, 1} : Blocks{0, 1, 2}));
  }
}

TEST_CASE("a Quota counts what its subscription still holds, each message once") {
  using lot::transport::Quota;
  Needs needs;
  Pool& theirs = needs.stock.open("/numbers");
  const auto all = std::uint64_t{needs.free_granules()};
  Quota quota(needs.local.segment(), needs.holder, 40 * lot::segment::kGranule);
  Quota none(needs.local.segment(), needs.holder, Quota::kNone);
  CHECK(quota.counts());
  CHECK(!none.counts());
  CHECK(none.allows_one_more());
  REQUIRE(all > 400);

  std::vector<std::uint32_t> held;
  for (int n = 0; n < 4; ++n) {
    held.push_back(needs.loan(theirs, 10));
    CHECK(quota.allows_one_more());
    CHECK(!quota.is_full());
    quota.note(held.back(), 10);
  }
  CHECK(!quota.allows_one_more());
  CHECK(quota.is_full());
  CHECK(quota.describe() == "holds 0 MiB in 4 messages, which is all that it may");
  CHECK(!quota.allows_one_more());  // looks each time now

  theirs.release(held.back());
  CHECK(quota.allows_one_more());
  quota.note(held.front(), 10);  // once more: it counts once
  quota.note(held.front(), 10);
  CHECK(quota.allows_one_more());
  const std::uint32_t other = needs.loan(theirs, 10);
  quota.note(other, 10);
  CHECK(!quota.allows_one_more());
  for (const std::uint32_t b : {held[0], held[1], held[2], other}) theirs.release(b);
  CHECK(quota.allows_one_more());
  CHECK(!quota.is_full());
}

TEST_CASE("HeldSince tells since when the oldest messages are held, and forgets what was let go") {
  using lot::segment::Sightings;
  Needs needs;
  Other other(needs);
  lot::transport::HeldSince held(needs.local.segment(), needs.local.world(), needs.holder);
  const Sightings& table = needs.local.segment().sightings()[kSelf];
  const auto look = [&] {
    held.note();
    std::vector<std::pair<std::uint64_t, std::uint64_t>> seen;  // block, since when
    for (const auto& place : table.seen) {
      if (place.what.load() != 0)
        seen.emplace_back((place.what.load() >> 32) - 1, place.since_ns.load());
    }
    return seen;
  };
  CHECK(look().empty());
  const std::uint64_t first_look = table.looked_ns.load();
  CHECK(first_look != 0);
  CHECK(needs.stock.open("/numbers").claim() == 0);  // ready for a loan: nothing that it keeps

  for (std::uint32_t b = 1; b <= Sightings::kMost + 2; ++b) {
    REQUIRE(other.holder.claim(b, 0));
    needs.holder.acquire(b, hold::kPointer);
    look();
  }
  CHECK(table.looked_ns.load() > first_look);
  const auto before = look();
  REQUIRE(before.size() == Sightings::kMost);
  for (std::size_t n = 0; n < before.size(); ++n) {
    CHECK(before[n].first == n + 1);
    CHECK(before[n].second > (n == 0 ? first_look : before[n - 1].second));
  }
  needs.holder.release(1, hold::kPointer);
  auto after = look();
  REQUIRE(after.size() == Sightings::kMost);
  CHECK(std::equal(before.begin() + 1, before.end(), after.begin()));
  CHECK(after.back().first == Sightings::kMost + 1);
  for (std::uint32_t b = 2; b <= Sightings::kMost + 2; ++b) needs.holder.release(b, hold::kPointer);
  CHECK(look().empty());
}

TEST_CASE("a BlockQueue gives blocks out as they came, also where it is full and begins anew") {
  lot::transport::BlockQueue queue(3);
  std::uint32_t next = 0;
  std::uint32_t last = 0;
  for (const std::uint32_t more : {2U, 1U, 2U, 2U, 1U, 2U}) {
    for (std::uint32_t n = 0; n < more; ++n) queue.push_back(last++);
    while (queue.size() > 1) {
      CHECK(queue.front() == next++);
      queue.pop_front();
    }
  }
  CHECK(queue.front() == next++);
  queue.pop_front();
  CHECK(queue.empty());
  CHECK(next == last);
  for (std::uint32_t b = 0; b < 4; ++b) queue.push_back(b);  // one more than there are
  CHECK(queue.size() == 3);
  for (std::uint32_t b = 0; b < 3; ++b) {
    CHECK(queue.front() == b);
    queue.pop_front();
  }
}

TEST_CASE("a BlockStack gives the newest block first, and lets go of those that a thread names") {
  lot::transport::BlockStack stack(4);
  for (std::uint32_t b = 0; b < 5; ++b) stack.push_back(b);  // one more than there are
  CHECK(stack.back() == 3);
  stack.take_if([](std::uint32_t b) { return b == 0 || b == 2; });
  CHECK(stack.pop_back() == 3);
  CHECK(stack.pop_back() == 1);
  CHECK(stack.empty());
}

TEST_CASE("a Stock has pointers while a loan is out, and none when only its pools have blocks") {
  Needs needs;
  Pool& pool = needs.stock.open("/numbers");
  const std::uint32_t b = needs.loan(pool, 1);
  CHECK(needs.stock.holds_pointers());
  pool.give_back(b);  // ready for the next loan, with a pointer hold of the pool
  CHECK(!needs.stock.holds_pointers());
}

TEST_CASE("an IdleLook gives back what a loan's pool has not used for some looks, and no loan") {
  Needs needs;
  lot::transport::Eviction eviction(needs.holder, needs.local.segment());
  eviction.prepare(kBlocks, 4);
  lot::transport::IdleLook idle(needs.local.segment(), needs.holder, needs.stock, eviction);
  Pool& pool = needs.stock.open("/numbers");
  const std::uint32_t all = needs.free_granules();
  const std::uint32_t out = needs.loan(pool, 2);
  pool.give_back(needs.loan(pool, 5));

  for (unsigned n = 0; n < lot::transport::IdleLook::kOldLooks; ++n) {
    CHECK(needs.free_granules() == all - 7);
    idle.look();
  }
  idle.look();
  CHECK(needs.free_granules() == all - 2);
  pool.give_back(out);
}

TEST_CASE("a Quota does not look for what was let go while there is far to its limit") {
  using lot::transport::Quota;
  Needs needs;
  Pool& theirs = needs.stock.open("/numbers");
  Quota quota(needs.local.segment(), needs.holder, 40 * lot::segment::kGranule);
  std::vector<std::uint32_t> held;
  for (int n = 0; n < 3; ++n) {
    held.push_back(needs.loan(theirs, 1));
    CHECK(quota.allows_one_more());
    quota.note(held.back(), 1);
  }
  theirs.release(held.front());
  CHECK(quota.allows_one_more());
  CHECK(quota.describe() == "holds 0 MiB in 3 messages, which is all that it may");
}
