// SPDX-License-Identifier: Apache-2.0
#include "transport/idle_look.hpp"

#include <algorithm>
#include <array>
#include <span>
#include <utility>

namespace lot::transport {

IdleLook::IdleLook(segment::Segment& segment, const Holder& holder, Stock& stock,
                   Eviction& eviction)
    : segment_(segment), holder_(holder), stock_(stock), eviction_(eviction) {
  const std::size_t blocks = segment.capacity().blocks;
  lives_.resize(blocks);
  was_held_.resize(blocks);
  idle_looks_.resize(blocks);
  const std::size_t pools = stock.most();
  prints_.resize(pools);
  new_prints_.resize(pools);
  to_settle_.resize(pools);
  to_trim_.resize(pools);
}

/// Looks at messages that other processes have kept and that have left the ring of an idle
/// publisher. Without a turn of its own, such a publisher does not see that they are free. A
/// publisher that had a turn since the last look has seen it. The warden leaves pools alone whose
/// messages no other process ever kept, and so the bias of their locks.
void IdleLook::look() noexcept {
  const std::size_t pools = stock_.size();
  look_at_blocks(pools);
  for (std::uint32_t i = 0; i < pools; ++i) {
    Pool& pool = stock_.pool(i);
    if (to_trim_[i] && pool.granules() != 0) {
      stock_.trim_old(i, [this](std::uint32_t b) { return idle_looks_[b] >= kOldLooks; });
    }
    const bool is_idle = std::exchange(prints_[i], new_prints_[i]) == new_prints_[i];
    if (!is_idle || !to_settle_[i] || !pool.may_wait()) continue;
    std::array<std::uint32_t, 16> foreign;
    for (std::size_t n = foreign.size(); n == foreign.size();) {
      n = eviction_.look(i, foreign);
      stock_.release(std::span(foreign).first(n));
    }
    stock_.settle_free(i);
  }
}

void IdleLook::look_at_blocks(std::size_t pools) noexcept {
  std::fill(to_settle_.begin(), to_settle_.end(), false);
  std::fill(new_prints_.begin(), new_prints_.end(), 0);
  std::fill(to_trim_.begin(), to_trim_.end(), false);
  // Relaxed, as `pool` and `hold` below: hints. The pool looks again under its lock.
  const std::uint32_t known = holder_.known.load(std::memory_order_relaxed);
  for (std::uint32_t b = 0; b < known; ++b) {
    if (idle_looks_[b] >= kOldLooks) idle_looks_[b] = 0;  // it was a loan: the count starts anew
    if (!holder_.is_home(b)) {
      idle_looks_[b] = 0;
      continue;
    }
    // Each hold of another participant bumps the version (I3). Relaxed: a hint. Where the last look
    // saw another message, the comparison reports a hold too many rather than one too few.
    const std::uint64_t life = segment_.block(b).life.load(std::memory_order_relaxed);
    const std::uint64_t before = std::exchange(lives_[b], life);
    const bool same = refcount::generation_of(life) == refcount::generation_of(before);
    was_held_[b] =
        life / refcount::kVersion != before / refcount::kVersion || (same && was_held_[b]);
    const std::uint32_t pool = holder_.control(b).pool.load(std::memory_order_relaxed);  // a hint
    const std::uint64_t v = holder_.control(b).hold.load(std::memory_order_relaxed);     // a hint
    // A loan that the application keeps looks the same, but its pool does not have it among its
    // ready blocks.
    const bool rests = life == before && (v & hold::kHolds) == hold::kPointer &&
                       segment_.block(b).home_points.load(std::memory_order_relaxed) == 0;
    // Locked memory stays, and so do the blocks that have it.
    if (!rests || segment_.is_locked() || segment::is_reserved(segment_.arena(b))) {
      idle_looks_[b] = 0;
    } else {
      ++idle_looks_[b];
    }
    if (pool >= pools) continue;
    if (idle_looks_[b] >= kOldLooks) to_trim_[pool] = true;
    constexpr std::uint64_t kSpread = 0x9e3779b97f4a7c15;
    new_prints_[pool] += ((v + refcount::generation_of(life)) * kSpread) ^ b * kSpread;
    if (was_held_[b] && hold::pointers(v) == 0) to_settle_[pool] = true;
  }
}

}  // namespace lot::transport
