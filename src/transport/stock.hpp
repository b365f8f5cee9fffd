// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "lot/detail/mutex.hpp"

#include "registry/registry.hpp"
#include "segment/segment.hpp"
#include "transport/ahead.hpp"
#include "transport/pool.hpp"

namespace lot::transport {

/// The pools of this process: they open, close, drain, and give idle memory back.
///
/// Threads: all members may be called at once.
/// Crash:   pools are private to the process. Their blocks and runs carry its name.
class Stock {
 public:
  /// Pools of this Holder are this Stock's from now on.
  Stock(segment::Segment& segment, Holder& holder, Ahead& ahead);
  Stock(const Stock&) = delete;
  Stock& operator=(const Stock&) = delete;

  /// Opens a pool for a new publisher, or, without a topic, for an engine's own messages. The pool
  /// is used again after its publisher has gone and its last message has died. Throws lot::Error.
  Pool& open(std::string_view topic = {});
  /// The publisher of the pool has gone. Its ring holds `blocks`, or they were retired from it.
  /// Those holds go once the ring is closed.
  void close(Pool& pool, const registry::ChannelName& ring,
             std::vector<std::uint32_t> blocks) noexcept;
  /// Gives up the holds of rings for which is_closed(ring) is true. Closed pools whose messages
  /// have all died may be opened again. False when some are left.
  template <class Closed>
  bool drain(Closed&& is_closed) noexcept;
  /// True when no hold of a ring is left that a thread of this process has still to give up.
  bool has_released() noexcept;
  /// True while a thread gives up such holds.
  bool is_releasing() noexcept;

  /// How many pools there are. They stay where they are.
  std::size_t size() noexcept;
  /// How many there may be.
  std::size_t most() const noexcept { return pools_.capacity(); }
  /// REQUIRES: i < size().
  Pool& pool(std::size_t i) noexcept { return *pools_[i]; }

  // The following let messages die, one thread at a time.

  /// Destroys kept messages that no other process holds any more. It leaves pools without kept
  /// messages alone, and so the bias of their locks.
  void settle_kept() noexcept;
  /// Pool::trim_old() of that pool.
  template <class Old>
  void trim_old(std::size_t i, Old&& is_old) noexcept {
    const std::lock_guard guard(settle_mutex_);
    pools_[i]->trim_old(is_old);
  }
  /// Lets go of ring holds.
  void release(std::span<const std::uint32_t> blocks) noexcept;
  /// Pool::settle_free() of that pool.
  void settle_free(std::size_t i) noexcept;

  /// Gives idle memory of this process's pools back to the segment, for the need of the publisher
  /// with this pool, or of another process (kNobody). Other publishers keep what reserve() made.
  /// True when there was some.
  static constexpr std::uint32_t kNobody = ~std::uint32_t{0};
  bool trim(std::uint32_t asker) noexcept;
  /// Gives back the extents that messages under construction do not need yet, in one pool.
  void trim_spare_of(const Pool& pool) noexcept;
  /// Gives unused memory of the segment back to the system, unit by unit, until enough() is true. A
  /// unit goes if `looks` looks in a row have found it unused. Returns the bytes.
  template <class Enough>
  std::uint64_t give_back_to_system(std::uint32_t looks, Enough&& enough) noexcept {
    std::uint64_t bytes = 0;
    for (std::uint32_t unit = segment_.first_unit(); unit < segment_.units(); ++unit) {
      if (!segment_.is_unused(unit, looks)) continue;
      if (!segment_.can_give_back() || enough()) break;
      bytes += give_back_unit(unit, looks);
    }
    return bytes;
  }

  /// True when the process still has pointers to messages. Called only after all handles have gone.
  bool holds_pointers() noexcept;

 private:
  struct Draining {
    Pool* pool;
    registry::ChannelName ring;
    std::vector<std::uint32_t> blocks;
    bool releasing;  ///< a thread is giving up what the ring held: blocks may still come home
  };

  /// REQUIRES: pools_mutex_ is held. Destructors of messages run under it.
  bool trim_all() noexcept;
  /// Gives back such extents in the pools that may(index) names.
  ///
  /// REQUIRES: pools_mutex_, so that one thread at a time wants spare extents. What a thread takes
  /// was then wanted before its own barrier.
  template <class May>
  bool take_spare(May&& may) noexcept;
  std::optional<std::uint32_t> claim_spare_block() noexcept;
  std::uint64_t give_back_unit(std::uint32_t unit, std::uint32_t looks) noexcept;

  segment::Segment& segment_;
  Holder& holder_;
  Ahead& ahead_;
  /// Held while kept messages die, since their destructors are the application's code.
  detail::Mutex settle_mutex_{detail::Rank::Settle};
  detail::Mutex pools_mutex_{detail::Rank::Pools};
  std::vector<std::unique_ptr<Pool>> pools_;
  std::vector<Draining> draining_;
  std::vector<Pool*> idle_;
};

template <class Closed>
bool Stock::drain(Closed&& is_closed) noexcept {
  const auto is_due = [&](const Draining& d) {
    return !d.blocks.empty() && !d.releasing && is_closed(d.ring);
  };
  std::unique_lock lock(pools_mutex_);
  for (auto d = draining_.begin();
       (d = std::find_if(draining_.begin(), draining_.end(), is_due)) != draining_.end();) {
    const std::vector<std::uint32_t> blocks = std::exchange(d->blocks, {});
    const Pool* const pool = d->pool;
    d->releasing = true;
    lock.unlock();
    for (const std::uint32_t b : blocks) holder_.release(b, hold::kRing);
    lock.lock();
    const auto of_pool = [pool](const Draining& e) { return e.pool == pool; };
    std::find_if(draining_.begin(), draining_.end(), of_pool)->releasing = false;
  }
  for (std::size_t i = 0; i < draining_.size();) {
    const auto& d = draining_[i];
    if (d.blocks.empty() && !d.releasing && d.pool->drain()) {
      idle_.push_back(draining_[i].pool);
      draining_.erase(draining_.begin() + static_cast<std::ptrdiff_t>(i));
    } else {
      ++i;
    }
  }
  return draining_.empty();
}

}  // namespace lot::transport
