// SPDX-License-Identifier: Apache-2.0

// The pools of a process, over a segment alone: no participant, no warden, no other process.

#include "transport/stock.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/control.hpp"

#include "support/local_segment.hpp"
#include "transport/ahead.hpp"
#include "transport/control_blocks.hpp"
#include "transport/idle_look.hpp"
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
  pool.keep_reserved(reserved);
  const lot::detail::MessageType large{1 << 20, 8, 0, "", nullptr, true, nullptr};
  for (const std::uint32_t b : {reserved, other}) {
    for (auto& extent : needs.local.segment().build(b).extent) extent.living = 0;
    needs.holder.control(b).type = &large;
    pool.give_back(b);
  }
  CHECK(needs.free_granules() == all - 5);  // both pieces of the one, nothing of the other
  CHECK(pool.granules() == 5);
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
