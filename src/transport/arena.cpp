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

/// A copy, each word of which is read once.
Arena::Extent copy_of(const Arena::Extent& e) noexcept {
  return {read_once(e.granule), read_once(e.granules), read_once(e.living), read_once(e.kind)};
}

std::uint64_t begin_of(const Mapping& mapping, const Arena::Extent& extent) {
  return mapping.in_granules(kGranule * read_once(extent.granule));
}
std::uint64_t bytes_of(const Arena::Extent& extent) {
  return kGranule * read_once(extent.granules);
}

/// The pool whose message an arena has. REQUIRES: its home is here.
transport::Pool& pool_of(transport::Participant& p, const Arena& arena) noexcept {
  return p.holder().pool_of(p.segment().block_of(arena));
}
std::uint32_t tag_of(transport::Participant& p, const Arena& arena) noexcept {
  return p.segment().block_of(arena) + 1;
}

/// The process's participant, if the arena's message has its home there; else null.
transport::Participant* home_of(const Arena& arena) noexcept {
  transport::Participant* const p = transport::Participant::at(&arena);
  if (p == nullptr) return nullptr;
  const std::uint32_t block = p->segment().block_of(arena);
  return block < p->blocks() && p->holder().is_home(block) ? p : nullptr;
}

/// The publisher will need another one like this: what it has now, and the newest extent.
void expect_another(transport::Participant& p, const Arena& arena, unsigned newest) noexcept {
  p.ahead().expect(pool_of(p, arena), transport::Pieces::of(arena, newest));
}

[[noreturn, gnu::cold, gnu::noinline]] void refuse_to_grow(const Arena& arena) {
  transport::Participant* const p = transport::Participant::at(&arena);
  throw Error(EPERM, p != nullptr ? p->segment().path() : "message",
              "a message that was published can not grow or change any more",
              "build it wholly before push(), or copy it into a new loan()");
}

[[noreturn, gnu::cold]] void out_of_memory(transport::Participant& p, const Arena& arena,
                                           std::size_t bytes, int error) {
  const std::uint32_t asker = pool_of(p, arena).index();
  throw OutOfMemory(
      (error == EDQUOT ? transport::describe_limit(p, bytes, p.segment().block_of(arena))
                       : transport::describe_shortage(p, {asker, granules_in(bytes), error}, bytes))
          .c_str());
}

}  // namespace

Arena*& arena_being_built() noexcept {
  static thread_local Arena* arena = nullptr;
  return arena;
}

void Arena::refuse_place() const {
  transport::Participant* const p = transport::Participant::at(this);
  if (p == nullptr) {
    throw Error(EINVAL, "message", "it lies in no segment that this copy of the library has joined",
                "let the copy that made the message build it");
  }
  throw Error(EBADMSG, p->segment().path(), "the memory of a message is damaged",
              "somebody has written into the segment who should not");
}

void* Arena::grow(std::size_t bytes, std::size_t align) {
  if (frozen == kPublished) refuse_to_grow(*this);
  own_spare();
  const std::uint64_t granules = fit(bytes);
  // First what is most likely: a large piece, as the last message here had one.
  for (unsigned i = 0, n = count(); i < n; ++i) {
    if (extent[i].granules == granules && extent[i].living == 0 && extent[i].kind == 0) {
      const Mapping& here = mapping();
      void* const piece = at(here, begin_of(here, extent[i]), bytes);
      extent[i].living = 1;
      return piece;
    }
  }
  // Empty pieces, too, begin in an extent.
  return find_extent(
      std::max<std::size_t>(bytes, 1), align,
      static_cast<std::uint32_t>(std::clamp(granules, std::uint64_t{1}, std::uint64_t{kNoRun})));
}

void* Arena::find_extent(std::size_t bytes, std::size_t align, std::uint32_t granules) {
  const unsigned now = current_index();
  const bool is_in_reserve = now != kNone && extent[now].is_reserved();
  const bool alone = bytes >= kLargePiece && count() < kManyExtents;
  if (!alone || is_in_reserve) {
    if (void* const piece = place_in_current(bytes, align); piece != nullptr) return piece;
  }
  const unsigned idle = idle_extent(granules, !alone);
  if (idle != kNone && extent[idle].granules >= granules && extent[idle].kind != 0) {
    return begin_in(idle, bytes);
  }
  transport::Participant* const p = home_of(*this);
  // The memory would be at home here, and the message there.
  if (p == nullptr) {
    if (idle != kNone && extent[idle].granules >= granules_in(bytes)) {
      return begin_in(idle, bytes);
    }
    if (void* const piece = place_in_current(bytes, align); piece != nullptr) return piece;
    throw OutOfMemory(
        "lot: a message that another process has made can not grow: copy it, or let its maker "
        "reserve() what it will need");
  }
  if (idle != kNone) {
    resize(*p, idle, granules);
    if (extent[idle].granules >= granules_in(bytes)) return begin_in(idle, bytes);
    // It is too small, and the piece will need another one.
    if (!extent[idle].is_reserved()) drop(*p, idle);
  }
  if (!alone && grow_current(*p, bytes, align)) {
    void* const piece = place_in_current(bytes, align);
    if (piece == nullptr) refuse_place();
    return piece;
  }
  return begin_in(claim(*p, bytes, granules, alone), bytes);
}

/// Null: it does not fit.
void* Arena::place_in_current(std::size_t bytes, std::size_t align) {
  const unsigned now = current_index();
  const std::uint64_t begin = aligned_cursor(align);
  const std::uint64_t end = read_once(limit);
  if (now == kNone || begin >= end || bytes > end - begin) return nullptr;
  void* const piece = at(mapping(), begin, bytes);
  cursor = begin + bytes;
  note_piece(now);
  return piece;
}

/// A new extent. For what is more than the piece needs, no message of another topic goes.
unsigned Arena::claim(transport::Participant& p, std::size_t bytes, std::uint32_t granules,
                      bool alone) {
  // The last message here had no small pieces: this one is of another kind, and may have no large
  // ones.
  if (!alone && current_index() == kNone) drop_idle(p);
  if (count() == kMaxExtents) drop_idle(p);
  if (count() == kMaxExtents || granules_in(bytes) >= kNoRun) out_of_memory(p, *this, bytes, 0);
  if (!alone) trim_current();
  const std::uint64_t doubled =
      alone ? granules : std::max<std::uint64_t>(granules, granules_shared());
  auto claimed = static_cast<std::uint32_t>(std::min<std::uint64_t>(doubled, kNoRun));
  const std::uint32_t tag = tag_of(p, *this);
  const bool waits = p.holder().cell(tag - 1).type != nullptr;  // try_loan() does not
  std::uint32_t run = p.try_claim_run(claimed, tag);
  if (run == kNoRun) {
    drop_idle(p);
    claimed = granules;
    run = p.claim_run(claimed, tag);
  }
  if (run == kNoRun) {  // what has gone meanwhile may be enough, the more so for a little less
    claimed = static_cast<std::uint32_t>(granules_in(bytes));
    run = waits ? p.await_run(claimed, tag) : p.claim_run(claimed, tag);
  }
  if (run == kNoRun && !waits) throw OutOfMemory("lot: no memory");  // its text is dropped
  if (run == kNoRun) out_of_memory(p, *this, bytes, errno);
  const unsigned newest = std::min(count(), kMaxExtents - 1);
  extent[newest] = {run, claimed, 0, alone ? std::uint16_t{0} : kShared};
  extents = static_cast<std::uint8_t>(newest + 1);
  if (alone) expect_another(p, *this, newest);
  return newest;
}

/// An extent in which nothing lives begins with a piece of that size. It begins at a page, which
/// suits every alignment that a message may have. What reserve() made serves pieces of every size,
/// side by side.
void* Arena::begin_in(unsigned index, std::size_t bytes) {
  Extent& chosen = extent[index];
  const Mapping& here = mapping();
  const std::uint64_t begin = begin_of(here, chosen);
  void* const piece = at(here, begin, bytes);
  if (chosen.kind != 0) {
    chosen.kind |= kShared;
    trim_current();
    current = static_cast<std::uint8_t>(index + 1);
    cursor = begin + bytes;
    limit = begin + bytes_of(chosen);
  }
  note_piece(index);
  return piece;
}

/// Of the extents of a kind in which nothing lives, those that are reserved among them, the
/// smallest one that has so many granules; where none has, the largest.
unsigned Arena::idle_extent(std::uint32_t granules, bool shared) const noexcept {
  unsigned best = kNone;
  for (unsigned i = 0, n = count(); i < n; ++i) {
    if (extent[i].living != 0 || current == i + 1) continue;
    if (!extent[i].is_reserved() && extent[i].is_shared() != shared) continue;
    if (best == kNone) {
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
  const unsigned n = count();
  for (unsigned i = 0; i < n; ++i) {
    if (extent[i].is_shared() || n >= kManyExtents) sum += extent[i].granules;
  }
  return sum;
}

/// Makes an idle extent as large as a piece needs: gives back what is too much, and takes the
/// granules behind it if they are free. What reserve() made is not made smaller.
///
/// Crash: killed anywhere in it, the granules carry this block's tag or none.
void Arena::resize(transport::Participant& p, unsigned index, std::uint32_t granules) noexcept {
  const Extent e = copy_of(extent[index]);
  if (e.granules < granules) {
    const std::uint32_t end = e.granule + e.granules;
    if (p.extend_run(end, granules - e.granules, tag_of(p, *this))) {
      extent[index].granules = granules;
    }
  } else if (!e.is_reserved()) {
    shorten(p, index, granules);
  }
}

void Arena::shorten(transport::Participant& p, unsigned index, std::uint32_t granules) noexcept {
  const Extent e = copy_of(extent[index]);
  if (e.granules <= granules) return;
  extent[index].granules = granules;
  pool_of(p, *this).release_run(e.granule + granules, e.granules - granules);
}

/// Doubles the extent that the small pieces are in, where the granules behind it are free.
bool Arena::grow_current(transport::Participant& p, std::size_t bytes, std::size_t align) {
  const unsigned now = current_index();
  if (now == kNone) return false;
  const Extent e = copy_of(extent[now]);
  const std::uint64_t begin = aligned_cursor(align);
  const std::uint64_t end_of_it = read_once(limit);
  if (begin > end_of_it || bytes <= end_of_it - begin) return false;  // it is not where it can be
  const std::uint64_t least = granules_in(bytes - (end_of_it - begin));
  const std::uint32_t end = e.granule + e.granules;
  for (const std::uint64_t more : {std::max<std::uint64_t>(least, e.granules), least}) {
    if (more < kNoRun && p.extend_run(end, static_cast<std::uint32_t>(more), tag_of(p, *this))) {
      extent[now].granules = e.granules + static_cast<std::uint32_t>(more);
      limit = end_of_it + more * kGranule;
      return true;
    }
  }
  return false;
}

/// A thread that takes the spare extents has the lock, from its last look at the flag until it is
/// done. It is a thread of the home.
void Arena::await_taker() noexcept {
  transport::Participant* const p = home_of(*this);
  if (p == nullptr) return;
  const std::lock_guard guard(pool_of(*p, *this).lock());
  wanted.store(0, std::memory_order_relaxed);
}

void Arena::trim_whole() noexcept {
  own_spare();
  trim_current();
  for (unsigned i = count(); i-- > 0;) {
    if (extent[i].living != 0 || current == i + 1 || extent[i].granules <= kSmallRun ||
        extent[i].is_reserved()) {
      continue;
    }
    transport::Participant* const p = home_of(*this);
    if (p == nullptr) return;
    drop(*p, i);
  }
}

/// Gives the end of the current extent back that nothing has been in, above 64 KiB and 1/16 of the
/// rest.
void Arena::trim_current() noexcept {
  const unsigned now = current_index();
  if (now == kNone || extent[now].is_reserved()) return;
  const Mapping* const here = Mapping::of(this);
  if (here == nullptr) return;
  const Extent e = copy_of(extent[now]);
  const std::uint64_t begin = begin_of(*here, e);
  const std::uint64_t used = std::max<std::uint64_t>(fit(cursor - begin + 1), kSmallRun);
  if (e.granules <= used) return;
  transport::Participant* const p = home_of(*this);
  if (p == nullptr) return;
  shorten(*p, now, static_cast<std::uint32_t>(used));
  limit = begin + used * kGranule;
}

/// Gives extents back in which nothing lives, but for those that reserve() made.
void Arena::drop_idle(transport::Participant& p) noexcept {
  for (unsigned i = count(); i-- > 0;) {
    if (extent[i].living == 0 && current != i + 1 && !extent[i].is_reserved()) drop(p, i);
  }
}

/// Gives an extent back that is not the current one.
void Arena::drop(transport::Participant& p, unsigned index) noexcept {
  const Extent gone = copy_of(extent[index]);
  const unsigned last = std::max(count(), 1U) - 1;
  extent[index] = extent[last];
  extents = static_cast<std::uint8_t>(last);
  if (current == last + 1) current = static_cast<std::uint8_t>(index + 1);
  pool_of(p, *this).release_run(gone.granule, gone.granules);
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
  const Mapping* const here = Mapping::of(this);
  if (here == nullptr) return;
  const std::uint64_t at = here->offset_of(piece);
  const bool newest = at + bytes == cursor;
  const unsigned used = is_spare() ? 0 : count();  // no piece is in a spare one
  for (unsigned i = 0; i < used; ++i) {
    Extent& e = extent[i];
    const std::uint64_t begin = begin_of(*here, e);
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
      if (transport::Participant* const p = home_of(*this); p != nullptr) {
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
