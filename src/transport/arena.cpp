// SPDX-License-Identifier: Apache-2.0
#include "lot/detail/arena.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <mutex>

#include "lot/error.hpp"

#include "transport/fill.hpp"
#include "transport/participant.hpp"
#include "transport/pieces.hpp"

namespace lot::detail {
namespace {

using segment::kGranule;
using transport::fit;
using transport::granules_in;

constexpr std::uint32_t kNoRun = segment::Granules<HardwareAtomics>::kNone;
/// From so many extents on large pieces share, in extents as large as all before them.
constexpr unsigned kManyExtents = 8;

std::uint64_t bytes_of(const Arena::Extent& extent) { return kGranule * extent.granules; }

/// The publisher will need another one like this: what it has now, and the newest extent.
void expect_another(transport::Participant& p, const Arena& arena, unsigned newest) noexcept {
  p.ahead().expect(p.holder().pool_of(arena.block), transport::Pieces::of(arena, newest));
}

[[noreturn, gnu::cold]] void refuse_to_grow(const Arena& arena) {
  transport::Participant* const p = transport::Participant::at(&arena);
  throw Error(EPERM, p != nullptr ? p->segment().path() : "message",
              "a message that was published can not grow or change any more",
              "build it wholly before push(), or copy it into a new loan()");
}

[[noreturn, gnu::cold]] void out_of_memory(transport::Participant& p, const Arena& arena,
                                           std::size_t bytes, int error) {
  const std::uint32_t asker = p.holder().pool_of(arena.block).index();
  throw OutOfMemory(
      (error == EDQUOT ? transport::describe_limit(p, bytes, arena.block)
                       : transport::describe_shortage(p, {asker, granules_in(bytes), error}, bytes))
          .c_str());
}

}  // namespace

Arena*& arena_being_built() noexcept {
  static thread_local Arena* arena = nullptr;
  return arena;
}

void* Arena::grow(std::size_t bytes, std::size_t align) {
  if (frozen == kPublished) refuse_to_grow(*this);
  own_spare();
  const std::uint64_t granules = fit(bytes);
  // First what is most likely: a large piece, as the last message here had one.
  for (unsigned i = 0; i < extents; ++i) {
    if (extent[i].granules == granules && extent[i].living == 0 && extent[i].kind == 0) {
      extent[i].living = 1;
      return base() + data + std::uint64_t{extent[i].granule} * kGranule;
    }
  }
  // Empty pieces, too, begin in an extent.
  return find_extent(
      std::max<std::size_t>(bytes, 1), align,
      static_cast<std::uint32_t>(std::clamp(granules, std::uint64_t{1}, std::uint64_t{kNoRun})));
}

void* Arena::find_extent(std::size_t bytes, std::size_t align, std::uint32_t granules) {
  const bool is_in_reserve = current != 0 && extent[current - 1].is_reserved();
  const bool alone = bytes >= kLargePiece && extents < kManyExtents;
  if (!alone || is_in_reserve) {
    if (void* const piece = place_in_current(bytes, align); piece != nullptr) return piece;
  }
  const unsigned idle = idle_extent(granules, !alone);
  if (idle != extents && extent[idle].granules >= granules && extent[idle].kind != 0) {
    return begin_in(idle, bytes);
  }
  transport::Participant* const p = transport::Participant::at(this);
  // The memory would be at home here, and the message there.
  if (p == nullptr || !p->holder().is_home(block)) {
    if (idle != extents && extent[idle].granules >= granules_in(bytes)) {
      return begin_in(idle, bytes);
    }
    if (void* const piece = place_in_current(bytes, align); piece != nullptr) return piece;
    throw OutOfMemory(
        "lot: a message that another process has made can not grow: copy it, or let its maker "
        "reserve() what it will need");
  }
  if (idle != extents) {
    resize(*p, idle, granules);
    if (extent[idle].granules >= granules_in(bytes)) return begin_in(idle, bytes);
    // It is too small, and the piece will need another one.
    if (!extent[idle].is_reserved()) drop(*p, idle);
  }
  if (!alone && grow_current(*p, bytes, align)) return place_in_current(bytes, align);
  return begin_in(claim(*p, bytes, granules, alone), bytes);
}

/// Null: it does not fit.
void* Arena::place_in_current(std::size_t bytes, std::size_t align) noexcept {
  const std::uint64_t begin = (cursor + (align - 1)) & ~std::uint64_t{align - 1};
  if (current == 0 || begin >= limit || bytes > limit - begin) return nullptr;
  cursor = begin + bytes;
  count(current - 1U);
  return base() + begin;
}

/// A new extent. For what is more than the piece needs, no message of another topic goes.
unsigned Arena::claim(transport::Participant& p, std::size_t bytes, std::uint32_t granules,
                      bool alone) {
  // The last message here had no small pieces: this one is of another kind, and may have no large
  // ones.
  if (!alone && current == 0) drop_idle(p);
  if (extents >= kMaxExtents) drop_idle(p);
  if (extents >= kMaxExtents) out_of_memory(p, *this, bytes, 0);
  if (!alone) trim_current();
  const std::uint64_t doubled =
      alone ? granules : std::max<std::uint64_t>(granules, granules_shared());
  auto claimed = static_cast<std::uint32_t>(std::min<std::uint64_t>(doubled, kNoRun));
  const bool waits = p.holder().cell(block).type != nullptr;  // try_loan() does not
  std::uint32_t run = p.try_claim_run(claimed, block + 1);
  if (run == kNoRun) {
    drop_idle(p);
    claimed = granules;
    run = p.claim_run(claimed, block + 1);
  }
  if (run == kNoRun) {  // what has gone meanwhile may be enough, the more so for a little less
    claimed = static_cast<std::uint32_t>(granules_in(bytes));
    run = waits ? p.await_run(claimed, block + 1) : p.claim_run(claimed, block + 1);
  }
  if (run == kNoRun && !waits) throw OutOfMemory("lot: no memory");  // its text is dropped
  if (run == kNoRun) out_of_memory(p, *this, bytes, errno);
  extent[extents] = {run, claimed, 0, alone ? std::uint16_t{0} : kShared};
  const unsigned newest = extents++;
  if (alone) expect_another(p, *this, newest);
  return newest;
}

/// An extent in which nothing lives begins with a piece of that size. It begins at a page, which
/// suits every alignment that a message may have. What reserve() made serves pieces of every size,
/// side by side.
void* Arena::begin_in(unsigned index, std::size_t bytes) {
  Extent& chosen = extent[index];
  const std::uint64_t begin = data + std::uint64_t{chosen.granule} * kGranule;
  if (chosen.kind != 0) {
    chosen.kind |= kShared;
    trim_current();
    current = static_cast<std::uint8_t>(index + 1);
    cursor = begin + bytes;
    limit = begin + bytes_of(chosen);
  }
  count(index);
  return base() + begin;
}

/// Of the extents of a kind in which nothing lives, those that are reserved among them, the
/// smallest one that has so many granules; where none has, the largest. `extents`: there is none.
unsigned Arena::idle_extent(std::uint32_t granules, bool shared) const noexcept {
  unsigned best = extents;
  for (unsigned i = 0; i < extents; ++i) {
    if (extent[i].living != 0 || current == i + 1) continue;
    if (!extent[i].is_reserved() && extent[i].is_shared() != shared) continue;
    if (best == extents) {
      best = i;
      continue;
    }
    const std::uint32_t has = extent[i].granules;
    const std::uint32_t best_has = extent[best].granules;
    const bool fits = has >= granules;
    if (fits != (best_has >= granules) ? fits : fits ? has < best_has : has > best_has) best = i;
  }
  return best;
}

/// What small pieces share; where the next large one will share as well, all.
std::uint64_t Arena::granules_shared() const noexcept {
  std::uint64_t sum = 0;
  for (unsigned i = 0; i < extents; ++i) {
    if (extent[i].is_shared() || extents >= kManyExtents) sum += extent[i].granules;
  }
  return sum;
}

/// Makes an idle extent as large as a piece needs: gives back what is too much, and takes the
/// granules behind it if they are free. What reserve() made is not made smaller.
///
/// Crash: killed anywhere in it, the granules carry this block's tag or none.
void Arena::resize(transport::Participant& p, unsigned index, std::uint32_t granules) noexcept {
  Extent& e = extent[index];
  if (e.granules < granules) {
    const std::uint32_t end = e.granule + e.granules;
    if (p.extend_run(end, granules - e.granules, block + 1)) e.granules = granules;
  } else if (!e.is_reserved()) {
    shorten(p, index, granules);
  }
}

void Arena::shorten(transport::Participant& p, unsigned index, std::uint32_t granules) noexcept {
  Extent& e = extent[index];
  const std::uint32_t more = e.granules - granules;
  if (more == 0) return;
  e.granules = granules;
  p.holder().pool_of(block).release_run(e.granule + granules, more);
}

/// Doubles the extent that the small pieces are in, where the granules behind it are free.
bool Arena::grow_current(transport::Participant& p, std::size_t bytes, std::size_t align) {
  if (current == 0) return false;
  Extent& e = extent[current - 1];
  const std::uint64_t begin = (cursor + (align - 1)) & ~std::uint64_t{align - 1};
  const std::uint64_t least = granules_in(begin + bytes - limit);
  const std::uint32_t end = e.granule + e.granules;
  for (const std::uint64_t more : {std::max<std::uint64_t>(least, e.granules), least}) {
    if (more < kNoRun && p.extend_run(end, static_cast<std::uint32_t>(more), block + 1)) {
      e.granules += static_cast<std::uint32_t>(more);
      limit += more * kGranule;
      return true;
    }
  }
  return false;
}

/// A thread that takes the spare extents has the lock, from its last look at the flag until it is
/// done. It is a thread of the home.
void Arena::await_taker() noexcept {
  transport::Participant* const p = transport::Participant::at(this);
  if (p == nullptr || !p->holder().is_home(block)) return;
  const std::lock_guard guard(p->holder().pool_of(block).lock());
  wanted.store(0, std::memory_order_relaxed);
}

void Arena::trim_whole() noexcept {
  own_spare();
  trim_current();
  for (unsigned i = extents; i-- > 0;) {
    if (extent[i].living != 0 || current == i + 1 || extent[i].granules <= kSmallRun ||
        extent[i].is_reserved()) {
      continue;
    }
    transport::Participant* const p = transport::Participant::at(this);
    if (p == nullptr || !p->holder().is_home(block)) return;
    drop(*p, i);
  }
}

/// Gives the end of the current extent back that nothing has been in, above 64 KiB and 1/16 of the
/// rest.
void Arena::trim_current() noexcept {
  if (current == 0 || extent[current - 1].is_reserved()) return;
  const Extent& e = extent[current - 1];
  const std::uint64_t begin = data + std::uint64_t{e.granule} * kGranule;
  const std::uint64_t used = std::max<std::uint64_t>(fit(cursor - begin + 1), kSmallRun);
  if (e.granules <= used) return;
  transport::Participant* const p = transport::Participant::at(this);
  if (p == nullptr || !p->holder().is_home(block)) return;
  shorten(*p, current - 1U, static_cast<std::uint32_t>(used));
  limit = begin + bytes_of(e);
}

/// Gives extents back in which nothing lives, but for those that reserve() made.
void Arena::drop_idle(transport::Participant& p) noexcept {
  for (unsigned i = extents; i-- > 0;) {
    if (extent[i].living == 0 && current != i + 1 && !extent[i].is_reserved()) drop(p, i);
  }
}

/// Gives an extent back that is not the current one.
void Arena::drop(transport::Participant& p, unsigned index) noexcept {
  const Extent gone = extent[index];
  extent[index] = extent[--extents];
  if (current == extents + 1) current = static_cast<std::uint8_t>(index + 1);
  p.holder().pool_of(block).release_run(gone.granule, gone.granules);
}

void Arena::change_hands() noexcept {
  // Relaxed: the holds of who writes it carry it.
  std::atomic_ref(changed_hands).store(kTaken, std::memory_order_relaxed);
}

void Arena::show() noexcept {
  // Relaxed: publishing carries it. Only the process that has taken the message comes here with
  // kTaken, and no reader takes the message from a queue any more.
  std::atomic_ref flag(changed_hands);
  if (flag.load(std::memory_order_relaxed) == kTaken) {
    flag.store(kShown, std::memory_order_relaxed);
  }
}

// Relaxed: publishing carries it to other processes. Another thread of this one that changes the
// message must be synchronised with the push, as with any change; another one that publishes it
// stores the same.
void Arena::freeze() noexcept {
  std::atomic_ref(frozen).store(kPublished, std::memory_order_relaxed);
  std::atomic_ref(cursor).store(limit, std::memory_order_relaxed);
}

bool Arena::freeze_first() noexcept {
  std::atomic_ref flag(frozen);
  if (flag.load(std::memory_order_relaxed) != 0 ||
      flag.exchange(kPublished, std::memory_order_relaxed) != 0) {
    return false;
  }
  freeze();
  return true;
}

bool Arena::was_handed_over() const noexcept {
  // Relaxed: as in change_hands().
  return !is_frozen() && std::atomic_ref(const_cast<std::uint8_t&>(changed_hands))
                                 .load(std::memory_order_relaxed) == kTaken;
}

bool Arena::is_frozen() const noexcept {
  return std::atomic_ref(const_cast<std::uint8_t&>(frozen)).load(std::memory_order_relaxed) != 0;
}

void Arena::deallocate(void* piece, std::size_t bytes) noexcept {
  if (is_frozen()) return;
  const std::uint64_t at = static_cast<std::uint64_t>(static_cast<unsigned char*>(piece) - base());
  const bool newest = at + bytes == cursor;
  const unsigned used = is_spare() ? 0 : extents;  // no piece is in a spare one
  for (unsigned i = 0; i < used; ++i) {
    Extent& e = extent[i];
    const std::uint64_t begin = data + std::uint64_t{e.granule} * kGranule;
    if (at < begin || at >= begin + bytes_of(e)) continue;
    if (e.living != 0 && e.living != 0xffff) --e.living;
    if (current == i + 1) {
      if (e.living == 0) {
        cursor = begin;
      } else if (newest) {
        cursor = at;
      }
    } else if (e.living == 0 && e.kind == 0) {
      // A vector that grows has left it, and will need more the next time.
      transport::Participant* const p = transport::Participant::at(this);
      if (p != nullptr && p->holder().is_home(block)) {
        drop(*p, i);
        expect_another(*p, *this, kMaxExtents);
      }
    }
    return;  // A2
  }
  if (newest && current == 0 && at < limit && limit - at <= segment::kSmallBytes)
    cursor = at;  // A2
}

}  // namespace lot::detail
