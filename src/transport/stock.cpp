// SPDX-License-Identifier: Apache-2.0
#include "transport/stock.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <utility>

#include "lot/error.hpp"

#include "transport/process_barrier.hpp"

namespace lot::transport {

Stock::Stock(segment::Segment& segment, Holder& holder, Ahead& ahead)
    : segment_(segment), holder_(holder), ahead_(ahead) {
  pools_.reserve(segment.capacity().channels + 64);
  draining_.reserve(pools_.capacity());  // closing a publisher then needs no memory
  idle_.reserve(pools_.capacity());
  holder.pools = &pools_;
}

Pool& Stock::open(std::string_view topic) {
  const std::uint64_t key = topic.empty() ? 0 : segment::topic_key(topic);
  const std::lock_guard guard(pools_mutex_);
  if (!idle_.empty()) {
    Pool* pool = idle_.back();
    idle_.pop_back();
    pool->serve(key);
    return *pool;
  }
  if (pools_.size() == pools_.capacity()) {
    throw Error(ENOSPC, segment_.path(), "too many publishers in this process",
                "make the segment with a larger EngineOptions::channels");
  }
  pools_.push_back(std::make_unique<Pool>(holder_, static_cast<std::uint32_t>(pools_.size())));
  pools_.back()->serve(key);
  return *pools_.back();
}

void Stock::close(Pool& pool, const registry::ChannelName& ring,
                  std::vector<std::uint32_t> blocks) noexcept {
  pool.close();
  ahead_.forget(pool);
  const std::lock_guard guard(pools_mutex_);
  draining_.push_back({&pool, ring, std::move(blocks), false});
}

bool Stock::has_released() noexcept {
  const std::lock_guard guard(pools_mutex_);
  return std::all_of(draining_.begin(), draining_.end(),
                     [](const Draining& d) { return d.blocks.empty() && !d.releasing; });
}

bool Stock::is_releasing() noexcept {
  const std::lock_guard guard(pools_mutex_);
  return std::any_of(draining_.begin(), draining_.end(),
                     [](const Draining& d) { return d.releasing; });
}

void Stock::settle_kept() noexcept {
  const std::lock_guard guard(settle_mutex_);
  const std::size_t n = size();
  for (std::size_t i = 0; i < n; ++i) pools_[i]->settle();  // a pool is never destroyed or moved
}

void Stock::release(std::span<const std::uint32_t> blocks) noexcept {
  const std::lock_guard guard(settle_mutex_);
  for (const std::uint32_t b : blocks) holder_.release(b, hold::kRing);
}

void Stock::settle_free(std::size_t i) noexcept {
  const std::lock_guard guard(settle_mutex_);
  pools_[i]->settle_free();
}

/// A block that is ready for a loan carries a pointer hold of its pool, so the pools give such
/// blocks back first. With each block goes what its message referred to, which then may be ready
/// itself.
bool Stock::holds_pointers() noexcept {
  // Both locks: the warden has pointer holds for a moment while it settles or drains.
  const std::lock_guard settling(settle_mutex_);
  const std::lock_guard guard(pools_mutex_);
  while (trim_all()) {
  }
  for (std::uint32_t b = 0; b < segment_.capacity().blocks; ++b) {
    // seq_cst: see Lifetime.
    if (hold::pointers(holder_.controls[b].hold.load(std::memory_order_seq_cst)) != 0) return true;
  }
  return false;
}

std::size_t Stock::size() noexcept {
  const std::lock_guard guard(pools_mutex_);
  return pools_.size();
}

bool Stock::trim(std::uint32_t asker) noexcept {
  ahead_.leave_off();
  const std::lock_guard guard(pools_mutex_);
  bool any = false;
  for (std::uint32_t i = 0; i < pools_.size(); ++i) any |= pools_[i]->trim(i == asker);
  return take_spare([](std::uint32_t) { return true; }) || any;
}

void Stock::trim_spare_of(const Pool& pool) noexcept {
  const std::lock_guard guard(pools_mutex_);
  take_spare([&](std::uint32_t index) { return index == pool.index(); });
}

template <class May>
bool Stock::take_spare(May&& may) noexcept {
  bool any = false;
  std::array<std::uint32_t, 64> wanted;
  // Relaxed: a hint. A block that is held for the first time just now is no idle one.
  for (std::uint32_t b = holder_.known.load(std::memory_order_relaxed); b != 0;) {
    std::size_t n = 0;
    while (b != 0 && n < wanted.size()) {
      --b;
      // Relaxed: want_spare() looks again.
      if (!holder_.is_home(b) || !segment_.build(b).is_spare()) continue;
      Pool& pool = holder_.pool_of(b);
      if (may(pool.index()) && pool.want_spare(b)) wanted[n++] = b;
    }
    if (n != 0) ProcessBarrier::pass();  // M1
    for (std::size_t i = 0; i < n; ++i) any |= holder_.pool_of(wanted[i]).take_spare(wanted[i]);
  }
  return any;
}

bool Stock::trim_all() noexcept {
  bool any = false;
  for (auto& pool : pools_) any |= pool->trim(true);
  return any;
}

/// Claims a free block. For a moment its tag marks the granules of a unit that goes back to the
/// system. It is not the last free block: a publisher that finds none gives messages up.
std::optional<std::uint32_t> Stock::claim_spare_block() noexcept {
  bool is_last = true;
  for (std::uint32_t b = segment_.capacity().blocks; b-- != 0;) {
    // Relaxed: a hint. Holder::claim() decides (O3).
    if (segment_.block(b).home.load(std::memory_order_relaxed) != refcount::kHomeFree) continue;
    if (!std::exchange(is_last, false) && holder_.claim(b, 0)) return b;
  }
  return std::nullopt;
}

std::uint64_t Stock::give_back_unit(std::uint32_t unit, std::uint32_t looks) noexcept {
  // Under this lock holds_pointers() does not see the block. A thread that is short of memory waits
  // for this one unit (trim()).
  const std::lock_guard guard(pools_mutex_);
  const auto b = claim_spare_block();
  if (!b) return 0;
  const std::uint64_t bytes = segment_.give_back(unit, looks, *b + 1);
  holder_.give_back(*b);
  return bytes;
}

}  // namespace lot::transport
