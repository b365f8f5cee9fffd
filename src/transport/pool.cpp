// SPDX-License-Identifier: Apache-2.0
#include "transport/pool.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <utility>

#include "lot/detail/mapping.hpp"
#include "lot/error.hpp"

#include "futex/futex.hpp"
#include "transport/references.hpp"

namespace lot::transport {

using detail::Arena;
using detail::Build;
using detail::ControlBlock;

void Holder::acquire(std::uint32_t b, std::uint64_t amount) const noexcept {
  know(b);
  own.acquire(words(b), control(b).hold, amount);
}

void Holder::know(std::uint32_t b) const noexcept {
  // Relaxed: the number only grows, and what lies below it is looked at anew.
  std::uint32_t above = known.load(std::memory_order_relaxed);
  // Relaxed: see above.
  while (above <= b && !known.compare_exchange_weak(above, b + 1, std::memory_order_relaxed)) {
  }
}

bool Holder::claim(std::uint32_t b, std::uint64_t topic) noexcept {
  if (!own.claim(words(b), control(b).hold)) return false;
  control(b).type = nullptr;
  // Relaxed: no other thread knows the block yet; what publishes it carries the store.
  queued(b).store(0, std::memory_order_relaxed);
  Arena& arena = segment->arena(b);
  segment->open_build(b);
  detail::write_once(arena.references, std::uint64_t{0});
  arena.topic = topic;
  segment::set_reserved(arena, false);
  return true;
}

void Holder::release(std::uint32_t b, std::uint64_t amount) const noexcept {
  const Left left = own.release(words(b), control(b).hold, amount);
  if (left == Left::Home) pool_of(b).last_hold_gone(b);
  if (left == Left::Wanted) tell_home(b);
}

void Holder::ask(std::uint32_t k, std::uint32_t errand) const noexcept {
  auto& errands = segment->witnesses()[k].errands;
  if (errands.bring(errand)) futex::wake_all(errands.word());
}

void Holder::tell_home(std::uint32_t b) const noexcept {
  // Relaxed: a home that has changed meanwhile does not wait for this hold.
  const std::uint32_t home = words(b).home.load(std::memory_order_relaxed);
  if (home <= refcount::kHomeOrphanage || home - 1 >= segment->capacity().participants) return;
  ask(home - 1, segment::errand::kLook);
}

void Holder::release_references(std::uint32_t b) const noexcept {
  Arena& arena = segment->arena(b);
  if (arena.references == 0) return;
  // A message that comes home may let others come home while it is destroyed, and so on. Such a
  // chain may be longer than a stack is deep. So the outermost call destroys them, one after the
  // other.
  static thread_local HomeList* first = nullptr;
  const bool nested = first != nullptr && first->is_of(*this);
  HomeList mine(*this);
  HomeList& home = nested ? *first : mine;
  each_reference(*segment, b, [&](std::uint32_t target) {
    const Left left = own.release(words(target), control(target).hold, hold::kRing);
    if (left == Left::Home) home.push(target);
    if (left == Left::Wanted) tell_home(target);
  });
  detail::write_once(arena.references, std::uint64_t{0});
  if (nested) return;
  HomeList* const outer = std::exchange(first, &mine);
  while (!home.empty()) {
    const std::uint32_t target = home.pop();
    pool_of(target).last_hold_gone(target);
  }
  first = outer;
}

/// A weak pointer may have revived the message, and the last hold may have gone once more. Then
/// another thread has the block on its list. What this thread has read is handed to that thread
/// (acq_rel), which takes the block off its list before it looks.
void Holder::HomeList::push(std::uint32_t b) noexcept {
  auto& link = holder_.home_links[b];
  for (;;) {
    std::uint32_t none = 0;
    if (link.compare_exchange_strong(none, first_, std::memory_order_acq_rel,  // see above
                                     std::memory_order_relaxed)) {
      first_ = b + 2;
      return;
    }
    if (link.fetch_or(0, std::memory_order_acq_rel) != 0) return;  // see above
  }
}

std::uint32_t Holder::HomeList::pop() noexcept {
  const std::uint32_t b = first_ - 2;
  // acq_rel: acquires what a thread in push() has handed over.
  first_ = holder_.home_links[b].exchange(0, std::memory_order_acq_rel);
  return b;
}

bool Holder::may_grow(const ControlBlock& c) const noexcept {
  return is_home(c.block) || c.hub != control(c.block).hub ||
         segment->arena(c.block).was_handed_over();
}

void Holder::freeze_reachable(std::uint32_t b) const noexcept {
  // Each arena is frozen once, by one thread, which links it into its list of arenas to look at.
  const std::uint32_t end = segment->capacity().blocks;
  std::uint32_t first = end;
  // At most as many as there are blocks, even if the links are damaged.
  std::uint32_t left = end;
  for (std::uint32_t from = b; from < end && left != 0; --left) {
    each_reference(*segment, from, [&](std::uint32_t target) {
      const detail::MessageType* const type = control(target).type;
      if (type != nullptr && type->plain) return;  // it cannot grow
      if (!may_grow(control(target)) || !segment->arena(target).freeze_first()) return;
      segment->build(target).next_to_freeze = first;
      first = target;
    });
    from = first;
    if (first < end) first = segment->build(first).next_to_freeze;
  }
}

std::uint32_t Pool::try_reclaim() {
  while (!free_.empty()) {
    const std::uint32_t b = free_.front();
    free_.pop_front();
    if (reclaim(b, hold::kRing)) return b;
  }
  for (unsigned n = 0; n < 4 && !kept_.empty(); ++n) {
    const std::uint32_t b = kept_.front();
    if (reclaim(b, 0)) return b;
  }
  return kNone;
}

void Pool::prefetch(std::uint64_t b) const noexcept {
  if (b < holder_.segment->capacity().blocks) fetch(static_cast<std::uint32_t>(b));
}

void Pool::fetch(std::uint32_t b) const noexcept {
  constexpr std::uint64_t kLine = detail::HardwareAtomics::kLine;
  const unsigned char* const small = holder_.segment->small(b);
  detail::HardwareAtomics::prefetch_write(small);
  detail::HardwareAtomics::prefetch_write(&holder_.words(b));
  // The next message is most likely as long as the last one.
  const detail::MessageType* const type = holder_.control(b).type;
  if (type == nullptr || type->size <= kLine || !segment::is_small(*type)) return;
  for (std::uint64_t at = kLine; at < type->size; at += kLine) {
    detail::HardwareAtomics::prefetch_write(small + at);
  }
}

/// Makes the block exclusively this pool's again. On failure the block is the last of the kept
/// ones, unless this process still holds it: then the last hold that goes calls last_hold_gone().
/// On success the block is not among the kept ones. REQUIRES: the lock, and that the block is at
/// home in this pool.
bool Pool::reclaim(std::uint32_t b, std::uint64_t expected) noexcept {
  // The block is on the list before a holder can see kWanted. The holder asks the warden, perhaps
  // before this thread goes on, and the warden looks only at pools that have kept blocks.
  const bool ours = holder_.own.reclaim(holder_.words(b), holder_.control(b).hold, expected,
                                        [this, b] { return kept_.enter(b); });  // E1
  if (!ours) [[unlikely]] {
    keep(b);
    return false;
  }
  kept_.remove(b);
  // Relaxed: the block is exclusively this thread's.
  if (holder_.queued(b).load(std::memory_order_relaxed) != 0) forget_queue(b);
  return true;
}

/// What reclaim() does with a block that others still hold.
[[gnu::noinline]] void Pool::keep(std::uint32_t b) noexcept {
  // Relaxed: a hold that changes now calls last_hold_gone(), which waits for the lock.
  const std::uint64_t v = holder_.control(b).hold.load(std::memory_order_relaxed);
  if ((v & hold::kHome) != 0 && (v & hold::kHolds) == 0) {
    kept_.move_to_end(b);
  } else {
    kept_.remove(b);
  }
}

/// The message of a block was in a queue, and has died. Relaxed: the block is exclusively this
/// thread's.
[[gnu::noinline]] void Pool::forget_queue(std::uint32_t b) noexcept {
  const ControlBlock& c = holder_.control(b);
  holder_.queued(b).store(0, std::memory_order_relaxed);  // as above
  // A small plain message is laid out once for all. So what its taker has written there is cleared
  // here.
  if (c.type != nullptr && c.type->plain) {
    Arena& arena = holder_.segment->arena(b);
    arena.changed_hands = 0;
    arena.frozen = 0;
  }
}

std::uint32_t Pool::claim() {
  const std::uint32_t blocks = holder_.segment->capacity().blocks;
  // Relaxed: a hint where to begin. Holder::claim() decides (O3).
  std::uint32_t b = holder_.next_free.load(std::memory_order_relaxed);
  for (std::uint32_t n = 0; n < blocks; ++n, ++b) {
    if (b >= blocks) b = 0;
    if (!holder_.claim(b, topic_)) continue;
    holder_.next_free.store(b + 1, std::memory_order_relaxed);  // a hint
    holder_.know(b);
    // Relaxed: the release of a hold carries it (is_at_rest_here()).
    holder_.control(b).pool.store(index_, std::memory_order_relaxed);
    return b;
  }
  return kNone;
}

void* Pool::lay_out_anew(ControlBlock& c, const detail::MessageType& type, bool waits) {
  segment::Segment& s = *holder_.segment;
  const std::uint32_t b = c.block;
  const bool fits = segment::is_small(type);
  Arena& arena = s.arena(b);
  Build& build = s.build(b);
  if (c.type != nullptr) destroy_message(c);
  // Before the allocation: what was published in this block must not freeze the next message.
  arena.changed_hands = 0;
  arena.frozen = 0;
  build.begin(s.offset_of(s.small(b)));
  void* root = s.small(b);
  if (!type.plain && may_share_ && build.extents != 0) {
    build.spare.store(Build::kSpare, std::memory_order_release);  // M2
  }
  if (fits) {
    build.cursor += type.size;
  } else {
    c.type = waits ? &type : nullptr;  // Build::claim() reads it
    root = arena.allocate(type.size, type.align);
  }
  arena.root = build.root = s.offset_of(root);
  if (type.plain) {  // it does not grow: what a larger message had here, it will never need
    build.trim();
    build.tell();
  }
  c.type = &type;
  return root;
}

void Pool::give_back(ControlBlock& c) noexcept {
  if (!try_give_back(c)) release_block(c.block);
}

void Pool::last_hold_gone(std::uint32_t b) noexcept {
  {
    const std::lock_guard guard(lock_);
    if (!is_at_rest_here(b) || !reclaim(b, 0)) return;
  }
  give_back(b);
}

/// True if the block is at home in this pool and has no holds. False for a thread that comes late:
/// other threads took a hold and let it go meanwhile, and the message has died. The block may even
/// be in another pool now. Then nothing is left to do.
///
/// A block leaves this pool only with the lock (release_block). So a block that is seen here with
/// the lock, without holds, stays. Its pool is the one that is read: the acquire pairs with the
/// release of its last hold, which came after the pool was written.
bool Pool::is_at_rest_here(std::uint32_t b) const noexcept {
  const ControlBlock& c = holder_.control(b);
  const std::uint64_t v = c.hold.load(std::memory_order_acquire);  // O4
  return (v & hold::kHome) != 0 && (v & hold::kHolds) == 0 &&
         c.pool.load(std::memory_order_relaxed) == index_;  // O4 carries it
}

/// A block has left the ring, and no reader looks at it.
void Pool::let_go(std::uint32_t b) {
  ControlBlock& c = holder_.control(b);
  // Relaxed, both: the ring's hold keeps the block where it is.
  if ((c.hold.load(std::memory_order_relaxed) & hold::kHome) == 0 ||
      c.pool.load(std::memory_order_relaxed) != index_) [[unlikely]] {
    retire_foreign(b);
  } else if (!HardwareOwnership::drop_ring_hold_of_several(c.hold)) {
    free_.push_back(b);
  }
}

[[gnu::noinline]] void Pool::retire_foreign(std::uint32_t b) { foreign_.push_back(b); }

void Pool::poll_kept() {
  for (std::size_t n = kept_.size(); n > 0 && !kept_.empty(); --n) {
    const std::uint32_t b = kept_.front();
    if (reclaim(b, 0)) ready_.push_back(b);
  }
  poll_free();
}

void Pool::poll_free() {
  for (std::size_t n = free_.size(); n > 0; --n) {
    const std::uint32_t b = free_.front();
    free_.pop_front();
    if (reclaim(b, hold::kRing)) ready_.push_back(b);
  }
}

void Pool::settle() noexcept {
  for (std::size_t n = kept_.size(); n > 0; --n) {
    std::uint32_t b;
    {
      const std::lock_guard guard(lock_);
      if (kept_.empty()) return;
      b = kept_.front();
      if (!reclaim(b, 0)) continue;
    }
    give_back(b);
  }
}

void Pool::settle_free() noexcept {
  for (;;) {
    std::uint32_t b;
    {
      const std::lock_guard guard(lock_);
      if (free_.empty()) return;
      b = free_.front();
      free_.pop_front();
      if (!reclaim(b, hold::kRing)) continue;
    }
    give_back(b);
  }
}

void Pool::destroy_whole(ControlBlock& c) noexcept {
  const std::uint32_t b = c.block;
  const detail::MessageType* const type = std::exchange(c.type, nullptr);
  Arena& arena = holder_.segment->arena(b);
  Build& build = holder_.segment->build(b);
  build.own_spare();
  build.unpoison_all();
  if (type == nullptr) {  // nothing was built, or the constructor threw
    for (unsigned i = 0; i < build.extents; ++i) build.extent[i].living = 0;
    holder_.release_references(b);
    return;
  }
  if (type->plain) {
    recycle_extents(build);
    return;
  }
  arena.frozen = Arena::kDying;  // pieces that are destroyed now need not give back their memory
  if (type->destroy != nullptr && arena.changed_hands == 0) {
    type->destroy(holder_.segment->base() + build.root);
  }
  if (arena.references != 0) [[unlikely]]
    holder_.release_references(b);
  recycle_extents(build);
}

/// True if the block is at home in this pool and has spare extents. While the lock is held, a block
/// of this pool stays in it (is_at_rest_here()). The home is read after the flag, which was set
/// while the block was here.
bool Pool::has_spare_in(std::uint32_t b) const noexcept {
  return holder_.segment->build(b).is_spare() && holder_.is_home(b) &&
         holder_.control(b).pool.load(std::memory_order_relaxed) == index_;  // the lock carries it
}

bool Pool::want_spare(std::uint32_t b) noexcept {
  const std::lock_guard guard(lock_);
  if (!has_spare_in(b)) return false;
  holder_.segment->build(b).wanted.store(1, std::memory_order_relaxed);  // M1
  return true;
}

/// A builder that has seen that its spare extents are wanted has cleared the flag, or waits for the
/// lock.
///
/// Crash:   the runs carry the block's tag until they are free.
bool Pool::take_spare(std::uint32_t b) noexcept {
  Build& build = holder_.segment->build(b);
  std::array<Build::Extent, Build::kMaxExtents> taken;
  unsigned count = 0;
  {
    const std::lock_guard guard(lock_);
    if (!has_spare_in(b) || build.wanted.load(std::memory_order_relaxed) == 0) return false;  // M1
    std::uint8_t left = 0;
    for (unsigned i = 0; i < build.extents; ++i) {
      const Build::Extent& extent = build.extent[i];
      if (extent.granules > Build::kSmallRun && !extent.is_reserved()) {
        taken[count++] = extent;
      } else {
        build.extent[left++] = extent;
      }
    }
    build.extents = left;
    build.spare.store(Build::kBuilders, std::memory_order_release);  // M2
    build.wanted.store(0, std::memory_order_release);                // M1
  }
  for (unsigned i = 0; i < count; ++i) release_run(taken[i].granule, taken[i].granules);
  return count != 0;
}

/// Keeps the extents in which the message lived when it died, since the next message will want
/// them. Gives back what a growing vector has left behind.
void Pool::recycle_extents(Build& build) noexcept {
  std::uint8_t kept = 0;
  for (unsigned i = 0; i < build.extents; ++i) {
    const Build::Extent& extent = build.extent[i];
    if (extent.living == 0 && !extent.is_reserved()) [[unlikely]] {
      release_run(extent.granule, extent.granules);
      continue;
    }
    if (kept != i) build.extent[kept] = extent;
    build.extent[kept++].living = 0;
  }
  build.extents = kept;
}

void Pool::release_block(std::uint32_t b) noexcept {
  ControlBlock& c = holder_.control(b);
  // A damaged ring or reference can lead here, too. Relaxed: the caller alone has the block. The
  // list that it has taken it from carries the word, with the lock or by ahead_.
  if ((c.hold.load(std::memory_order_relaxed) & hold::kHolds) != hold::kPointer) {
    if (holder_.own.release(holder_.words(b), c.hold, hold::kPointer) == Left::Wanted) {
      holder_.tell_home(b);
    }
    return;
  }
  destroy_message(c);
  Build& build = holder_.segment->build(b);
  for (unsigned i = 0; i < build.extents; ++i) {
    release_run(build.extent[i].granule, build.extent[i].granules);
  }
  c.type = nullptr;
  const std::lock_guard guard(lock_);  // is_at_rest_here()
  holder_.give_back(b);
}

void Pool::count_out(std::uint64_t granules) noexcept {
  // A damaged counter may hold any number: the result is never below 0. Relaxed: it guards no data.
  std::uint64_t has = granules_.load(std::memory_order_relaxed);
  while (!granules_.compare_exchange_weak(has, has - std::min(has, granules),
                                          std::memory_order_relaxed)) {
  }
}

std::uint32_t Pool::try_claim_run(std::uint32_t granules, std::uint32_t tag) noexcept {
  if (!take(granules)) {
    errno = EDQUOT;
    return kNoRun;
  }
  const std::uint32_t run = holder_.segment->claim_run(granules, tag);
  if (run == kNoRun) count_out(granules);
  return run;
}

bool Pool::extend_run(std::uint32_t end, std::uint32_t granules, std::uint32_t tag) noexcept {
  if (!take(granules)) return false;
  const bool is_longer = holder_.segment->extend_run(end, granules, tag);
  if (!is_longer) count_out(granules);
  return is_longer;
}

void Pool::release_run(std::uint32_t first, std::uint32_t granules) noexcept {
  count_out(granules);
  // What a message gives back while it is built: another process may claim it at once.
  detail::unpoison(holder_.segment->base() + holder_.segment->granule_offset(first),
                   segment::kGranule * granules);
  holder_.segment->granules().release(first, granules);
}

void Pool::keep_reserved(std::uint32_t b) noexcept {
  Build& build = holder_.segment->build(b);
  build.own_spare();
  for (unsigned i = 0; i < build.extents; ++i) build.extent[i].kind |= Arena::kReserved;
  segment::set_reserved(holder_.segment->arena(b), true);
}

void Pool::grow(std::size_t room) {
  retired_.reserve(room);
  foreign_.reserve(room);
  room_ = room;
}

std::size_t Pool::take_foreign(std::span<std::uint32_t> into) noexcept {
  std::size_t n = 0;
  for (; n < into.size() && !foreign_.empty(); ++n) {
    into[n] = foreign_.back();
    foreign_.pop_back();
  }
  return n;
}

bool Pool::trim(bool with_reserved) noexcept {
  const bool any = trim_ahead();
  {
    const std::lock_guard guard(lock_);
    poll_kept();
  }
  return release_idle([&](std::uint32_t b) {
           return with_reserved || !segment::is_reserved(holder_.segment->arena(b));
         }) ||
         any;
}

bool Pool::drain() noexcept {
  trim(true);
  const std::lock_guard guard(lock_);
  return kept_.empty() && free_.empty() && retired_.empty() && ready_.empty();
}

}  // namespace lot::transport
