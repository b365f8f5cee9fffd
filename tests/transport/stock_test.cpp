// SPDX-License-Identifier: Apache-2.0

// The pools of a process, over a segment alone: no participant, no warden, no other process.

#include "transport/stock.hpp"

#include <atomic>
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
    const std::uint32_t run = pool.try_claim_run(granules, b + 1);
    REQUIRE(run != Pool::kNoRun);
    lot::detail::Build& build = local.segment().build(b);
    build.extent[build.extents++] = {run, granules, 1, 0};
    return b;
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
