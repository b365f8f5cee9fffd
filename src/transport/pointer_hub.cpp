// SPDX-License-Identifier: Apache-2.0
#include "transport/pointer_hub.hpp"

#include <bit>

namespace lot::transport {

PointerHub::PointerHub(Membership& membership, Lifetime& lifetime, Holder& holder) noexcept
    : membership_(membership),
      lifetime_(lifetime),
      holder_(holder),
      segment_(membership.segment()) {
  fill_pointers();
  fill_weak_pointers();
  fill_answers();
}

/// Fills in what pointers do.
void PointerHub::fill_pointers() noexcept {
  drop_last = [](detail::ControlBlock* c) noexcept {
    const PointerHub& p = of(c);
    if (p.membership_.is_inert()) return;
    if (HardwareOwnership::die_unseen(p.segment_.block(c->block), c->hold)) {
      p.give_back(*c);
      return;
    }
    p.lifetime_.enter();
    p.holder_.release(c->block, hold::kPointer);
    p.lifetime_.exit();
  };
  abandoned = [](detail::ControlBlock* c) noexcept {
    const PointerHub& p = of(c);
    if (p.membership_.is_inert()) return;
    if (!p.holder_.was_received(*c)) {
      p.give_back(*c);
      return;
    }
    p.lifetime_.enter();
    p.holder_.release(c->block, hold::kPointer);
    p.lifetime_.exit();
  };
  acquire = [](detail::ControlBlock* c) noexcept {
    of(c).holder_.acquire(c->block, hold::kPointer);
  };
  shared_from_unique = [](detail::ControlBlock* c) noexcept {
    const PointerHub& p = of(c);
    if (p.membership_.is_inert()) return;
    // Only one thread has the pointer.
    if (p.holder_.is_home(c->block)) p.holder_.complete(c->block);
    p.points(c);
  };
  points = [](detail::ControlBlock* c) noexcept {
    const PointerHub& p = of(c);
    HardwareOwnership::note_pointers(p.segment_.block(c->block), c->hold);
  };
}

/// Gives a block back that is exclusively the caller's: its message was never shared, or has died.
void PointerHub::give_back(detail::ControlBlock& control) const noexcept {
  Pool& pool = holder_.pool_of(control);
  if (pool.try_give_back(control)) return;
  lifetime_.enter();
  pool.give_back(control);
  lifetime_.exit();
}

/// Fills in what weak pointers do.
void PointerHub::fill_weak_pointers() noexcept {
  lock_weak = [](detail::ControlBlock* c, std::uint32_t expected) noexcept {
    const PointerHub& p = of(c);
    if (p.membership_.is_inert()) return false;
    p.lifetime_.enter();
    segment::BlockWords& words = p.segment_.block(c->block);
    const Left left =
        p.lifetime_.has_left() ? Left::Gone : p.holder_.own.acquire_weak(words, c->hold, expected);
    if (left == Left::Wanted) p.holder_.tell_home(c->block);
    p.lifetime_.exit();
    return left == Left::Held;
  };
  generation = [](const detail::ControlBlock* c) noexcept {
    // Relaxed: the caller has seen its message live. A later number says that it has died, and
    // nothing else: only who locks a weak pointer looks at the message.
    return refcount::generation_of(
        of(c).segment_.block(c->block).life.load(std::memory_order_relaxed));
  };
  expired = [](const detail::ControlBlock* c, std::uint32_t expected) noexcept {
    const PointerHub& p = of(c);
    return p.membership_.is_inert() || p.lifetime_.has_left() || p.generation(c) != expected;
  };
  weak_count = [](detail::ControlBlock* c, int change) noexcept {
    const PointerHub& p = of(c);
    if (change > 0) {
      HardwareOwnership::end_unseen(c->hold);
      p.lifetime_.add_reference();
    } else {
      p.lifetime_.drop_reference();
    }
  };
}

/// Fills in what pointers ask.
void PointerHub::fill_answers() noexcept {
  path = [](const detail::ControlBlock* c) noexcept { return of(c).segment_.path().c_str(); };
  instance = [](const detail::ControlBlock* c) noexcept {
    return of(c).segment_.header().identity.instance;
  };
  others = [](const detail::ControlBlock* c) noexcept {
    const PointerHub& p = of(c);
    segment::BlockWords& words = p.segment_.block(c->block);
    const std::uint32_t self = p.index();
    // Relaxed, as home_points below: a count is out of date at once in any case.
    const std::uint32_t home = words.home.load(std::memory_order_relaxed);
    std::size_t n = 0;
    for (std::uint32_t w = 0; w < segment::Atomics::kOwnWords; ++w) {
      std::uint64_t holders = words.own[w].load(std::memory_order_acquire);  // O1
      const auto without = [&](std::uint32_t k) {
        holders = HardwareOwnership::holders(holders, w, k);
      };
      without(refcount::kOrphanage);
      without(self);
      // Relaxed: see above.
      if (home > 1 && words.home_points.load(std::memory_order_relaxed) == 0) without(home - 1);
      n += static_cast<std::size_t>(std::popcount(holders));
    }
    return n;
  };
  alone = [](const detail::ControlBlock* c) noexcept {
    const PointerHub& p = of(c);
    return !p.membership_.is_inert() && p.is_alone(*c);
  };
  base = [](const detail::ControlBlock* c) noexcept -> const unsigned char* {
    return of(c).segment_.base();
  };
}

const PointerHub& PointerHub::of(const detail::ControlBlock* control) noexcept {
  return *static_cast<const PointerHub*>(control->hub);
}

/// True only if other threads and processes have done all their reads before: each hold that goes
/// is released, and acquired here.
bool PointerHub::is_alone(const detail::ControlBlock& control) const noexcept {
  // A ring's hold stands while the ring has the message, and until no hazard names it (I1).
  const std::uint64_t v = control.hold.load(std::memory_order_acquire);  // O4
  if ((v & hold::kHolds) != hold::kPointer) return false;
  const segment::BlockWords& words = segment_.block(control.block);
  const std::uint64_t life = words.life.load(std::memory_order_acquire);  // O2
  std::uint32_t maker = index();
  // The home's bit stands as long as the home has the memory, whether it looks at the message or
  // not. It does not count when this process took the message from a queue and has not published it
  // since.
  if ((v & hold::kHome) == 0 && segment_.arena(control.block).was_handed_over()) {
    // Relaxed: only the number counts. What the home has done is in its bit (O1).
    const std::uint32_t home = words.home.load(std::memory_order_relaxed);
    if (home > refcount::kHomeOrphanage) maker = home - 1;
  }
  for (std::uint32_t w = 0; w < segment::Atomics::kOwnWords; ++w) {
    std::uint64_t holders = words.own[w].load(std::memory_order_acquire);  // O1
    for (const std::uint32_t k : {index(), maker}) {
      holders = HardwareOwnership::holders(holders, w, k);
    }
    if (holders != 0) return false;
  }
  // A hold may have moved behind the search. Then it has bumped the version (I3). Relaxed: the load
  // of the bit that it has left behind carries the bump (O1).
  return words.life.load(std::memory_order_relaxed) == life;
}

bool PointerHub::same_segment(const detail::ControlBlock& control) const noexcept {
  return control.hub == this ||
         control.hub->instance(&control) == segment_.header().identity.instance;
}

}  // namespace lot::transport
