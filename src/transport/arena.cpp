// SPDX-License-Identifier: Apache-2.0
#include "lot/detail/arena.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <exception>
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
/// From this many extents on, large pieces share extents, each as large as all before it together.
constexpr unsigned kManyExtents = 8;

/// Copies an extent. Each word is read once.
Arena::Extent copy_of(const Arena::Extent& e) noexcept {
  return {read_once(e.granule), read_once(e.granules), read_once(e.living), read_once(e.kind)};
}

std::uint64_t bytes_of(const Arena::Extent& extent) { return kGranule * extent.granules; }

/// The pool that the build's message belongs to. REQUIRES: its home is in this process.
transport::Pool& pool_of(transport::Participant& p, const Build& build) noexcept {
  return p.holder().pool_of(p.segment().block_of(*build.arena));
}
std::uint32_t tag_of(transport::Participant& p, const Build& build) noexcept {
  return p.segment().block_of(*build.arena) + 1;
}

/// Tells Ahead that the publisher will need another message like this one, with what it has now and
/// its newest extent.
void expect_another(transport::Participant& p, const Build& build, unsigned newest) noexcept {
  p.ahead().expect(pool_of(p, build), transport::Pieces::of(build, newest));
}

[[noreturn, gnu::cold, gnu::noinline]] void refuse_to_grow(const Arena& arena) {
  transport::Participant* const p = transport::Participant::at(&arena);
  throw Error(EPERM, p != nullptr ? p->segment().path() : "message",
              "a message that was published can not grow or change any more",
              "build it wholly before push(), or copy it into a new loan()");
}

[[noreturn, gnu::cold, gnu::noinline]] void refuse_place(const Arena& arena) {
  transport::Participant* const p = transport::Participant::at(&arena);
  if (p == nullptr && Mapping::of(&arena) != nullptr) {
    throw Error(ECHILD, "message",
                "the objects of its segment are inert: they were inherited through fork(), or this "
                "process was taken for dead",
                "build messages with a lot::ShmEngine that this process has made since");
  }
  if (p == nullptr) {
    throw Error(EINVAL, "message", "it lies in no segment that this copy of the library has joined",
                "let the copy that made the message build it");
  }
  throw Error(EBADMSG, p->segment().path(), "the memory of a message is damaged",
              "somebody has written into the segment who should not");
}

[[noreturn, gnu::cold]] void out_of_memory(transport::Participant& p, const Build& build,
                                           std::size_t bytes, int error) {
  const std::uint32_t asker = pool_of(p, build).index();
  throw OutOfMemory(
      (error == EDQUOT
           ? transport::describe_limit(p.holder(), bytes, p.segment().block_of(*build.arena))
           : transport::describe_shortage(p.memory(), {asker, granules_in(bytes), error}, bytes))
          .c_str());
}

}  // namespace

Arena*& arena_being_built() noexcept {
  static thread_local Arena* arena = nullptr;
  return arena;
}

void* allocate_elsewhere(Arena& arena, std::size_t bytes, std::size_t align) {
  if (Build::of(arena) == nullptr) refuse_place(arena);
  if (arena.frozen == Arena::kPublished) refuse_to_grow(arena);
  Build taken;
  taken.take(arena);
  void* const piece = taken.grow(bytes, align);
  taken.tell();
  return piece;
}

void Arena::deallocate(void* piece, std::size_t bytes) noexcept {
  if (is_frozen()) return;
  Build* const build = Build::of(*this);
  if (build == nullptr) return;
  if (build->arena == this) {
    if (!build->is_told) poison(piece, bytes);
    build->give_back(piece, bytes);
    return;
  }
  try {
    Build taken;
    taken.take(*this);
    taken.give_back(piece, bytes);
    taken.tell();
  } catch (const std::exception&) {  // it is damaged: its memory goes with the message
  }
}

std::uint64_t Build::begin_of(const Extent& e) const noexcept {
  return mapping->in_granules(kGranule * e.granule);
}

/// This process's participant, if the message has its home there. Null for a copy.
transport::Participant* Build::home() const noexcept {
  if (Build::of(*arena) != this) return nullptr;
  transport::Participant* const p = transport::Participant::at(arena);
  if (p == nullptr) return nullptr;
  const std::uint32_t block = p->segment().block_of(*arena);
  return block < p->blocks() && p->holder().is_home(block) ? p : nullptr;
}

void Build::open(Arena& its, const Mapping& here) noexcept {
  arena = &its;
  mapping = &here;
  extents = 0;
  // Relaxed, both: no other thread knows the build yet.
  spare.store(kBuilders, std::memory_order_relaxed);
  wanted.store(0, std::memory_order_relaxed);  // as above
}

void Build::unpoison_whole() const noexcept {
  unpoison(at(mapping->small_of(arena)), segment::kSmallBytes);
  for (unsigned i = 0; i < extents; ++i) unpoison(at(begin_of(extent[i])), bytes_of(extent[i]));
}

void Build::tell() noexcept {
  if (!is_told) unpoison_all();
  is_told = true;
  Arena& said = *arena;
  write_once(said.extents, extents);
  write_once(said.current, current);
  write_once(said.cursor, cursor);
  for (unsigned i = 0; i < extents; ++i) {
    write_once(said.extent[i].granule, extent[i].granule);
    write_once(said.extent[i].granules, extent[i].granules);
    write_once(said.extent[i].living, extent[i].living);
    write_once(said.extent[i].kind, extent[i].kind);
  }
}

/// Takes over from an arena where the pieces are, in the extents that this build has. False: they
/// cannot be there.
bool Build::learn_pieces(const Arena& said) noexcept {
  const std::uint8_t now = read_once(said.current);
  const std::uint64_t at = read_once(said.cursor);
  std::uint64_t begin = mapping->small_of(arena);
  std::uint64_t end = begin + segment::kSmallBytes;
  if (now != 0) {
    if (now > extents) return false;
    begin = begin_of(extent[now - 1]);
    end = begin + bytes_of(extent[now - 1]);
  }
  if (at < begin || at > end) return false;
  for (unsigned i = 0; i < extents; ++i) {
    const Extent e = copy_of(said.extent[i]);
    extent[i].living = e.living;
    extent[i].kind |= e.kind & Arena::kShared;
  }
  current = now;
  cursor = at;
  limit = end;
  return true;
}

void Build::take(Arena& its) {
  transport::Participant* const p = transport::Participant::at(&its);
  const Mapping* const here = Mapping::of(&its);
  if (p == nullptr || here == nullptr) refuse_place(its);
  const segment::Segment& s = p->segment();
  const std::uint32_t block = s.block_of(its);
  if (block >= p->blocks() || &s.arena(block) != &its) refuse_place(its);
  open(its, *here);
  extents = static_cast<std::uint8_t>(its.count());
  for (unsigned i = 0; i < extents; ++i) {
    extent[i] = copy_of(its.extent[i]);
    if (!s.holds(block, begin_of(extent[i]), bytes_of(extent[i]))) refuse_place(its);
  }
  if (!learn_pieces(its)) refuse_place(its);
}

void Build::take_again() noexcept {
  if (read_once(arena->changed_hands) == 0) return;
  if (!learn_pieces(*arena)) limit = cursor;  // it is damaged: no small piece fits any more
}

void* Build::find_room(std::size_t bytes, std::size_t align) {
  own_spare();
  const std::uint64_t granules = fit(bytes);
  // First the most likely case: a large piece, as the last message here had one.
  for (unsigned i = 0; i < extents; ++i) {
    if (extent[i].granules == granules && extent[i].living == 0 && extent[i].kind == 0) {
      extent[i].living = 1;
      return at(begin_of(extent[i]));
    }
  }
  // Empty pieces, too, begin in an extent.
  return find_extent(
      std::max<std::size_t>(bytes, 1), align,
      static_cast<std::uint32_t>(std::clamp(granules, std::uint64_t{1}, std::uint64_t{kNoRun})));
}

void* Build::grow_told(std::size_t bytes, std::size_t align) {
  void* const piece = find_room(bytes, align);
  tell();
  return piece;
}

void* Build::find_extent(std::size_t bytes, std::size_t align, std::uint32_t granules) {
  const bool is_in_reserve = current != 0 && extent[current - 1U].is_reserved();
  const bool alone = bytes >= kLargePiece && extents < kManyExtents;
  if (!alone || is_in_reserve) {
    if (void* const piece = place_in_current(bytes, align); piece != nullptr) return piece;
  }
  const unsigned idle = idle_extent(granules, !alone);
  if (idle != kNone && extent[idle].granules >= granules && extent[idle].kind != 0) {
    return begin_in(idle, bytes);
  }
  transport::Participant* const p = home();
  if (p == nullptr && Build::of(*arena) == this) refuse_place(*arena);
  // A new extent would be at home in this process, and the message in another.
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
    // The extent is too small, and the piece will need another one.
    if (!extent[idle].is_reserved()) drop(*p, idle);
  }
  if (!alone && grow_current(*p, bytes, align)) {
    return place_in_current(bytes, align);
  }
  return begin_in(claim(*p, bytes, granules, alone), bytes);
}

/// Null: the piece does not fit.
void* Build::place_in_current(std::size_t bytes, std::size_t align) noexcept {
  const std::uint64_t begin = aligned_cursor(align);
  if (begin >= limit || bytes > limit - begin) return nullptr;
  cursor = begin + bytes;
  if (current != 0) note_piece(current - 1U);
  return at(begin);
}

/// Claims a new extent. No message of another topic goes for the part that is more than the piece
/// needs.
unsigned Build::claim(transport::Participant& p, std::size_t bytes, std::uint32_t granules,
                      bool alone) {
  // The last message in this block had no small pieces. So this one is of another kind, and may
  // have no large ones.
  if (!alone && current == 0) drop_idle(p);
  if (extents == kMaxExtents) drop_idle(p);
  if (extents == kMaxExtents || granules_in(bytes) >= kNoRun) out_of_memory(p, *this, bytes, 0);
  if (!alone) trim_current();
  const std::uint64_t doubled =
      alone ? granules : std::max<std::uint64_t>(granules, granules_shared());
  auto claimed = static_cast<std::uint32_t>(std::min<std::uint64_t>(doubled, kNoRun));
  const std::uint32_t tag = tag_of(p, *this);
  // a loan that must not wait leaves `type` null
  const bool waits = p.holder().control(tag - 1).type != nullptr;
  std::uint32_t run = pool_of(p, *this).try_claim_run(claimed, tag);
  if (run == kNoRun) {
    drop_idle(p);
    claimed = granules;
    run = p.memory().claim_run(claimed, tag);
  }
  if (run == kNoRun) {  // what was freed meanwhile may be enough, the more so for a little less
    claimed = static_cast<std::uint32_t>(granules_in(bytes));
    run = waits ? p.memory().await_run(claimed, tag) : p.memory().claim_run(claimed, tag);
  }
  if (run == kNoRun && !waits) throw OutOfMemory("lot: no memory");  // the caller drops this text
  if (run == kNoRun) out_of_memory(p, *this, bytes, errno);
  const unsigned newest = extents++;
  extent[newest] = {run, claimed, 0, alone ? std::uint16_t{0} : Arena::kShared};
  if (alone) expect_another(p, *this, newest);
  return newest;
}

/// Begins an empty extent with a piece of that size. The extent begins at a page, which suits every
/// alignment that a message may have. An extent that reserve() made serves pieces of every size,
/// side by side.
void* Build::begin_in(unsigned index, std::size_t bytes) noexcept {
  Extent& chosen = extent[index];
  const std::uint64_t begin = begin_of(chosen);
  if (chosen.kind != 0) {
    chosen.kind |= Arena::kShared;
    trim_current();
    current = static_cast<std::uint8_t>(index + 1);
    cursor = begin + bytes;
    limit = begin + bytes_of(chosen);
  }
  note_piece(index);
  return at(begin);
}

/// Finds an empty extent of that kind; a reserved one suits every kind. It chooses the smallest one
/// that has so many granules, or the largest where none has.
unsigned Build::idle_extent(std::uint32_t granules, bool shared) const noexcept {
  unsigned best = kNone;
  for (unsigned i = 0; i < extents; ++i) {
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

/// The granules that small pieces share. All granules, where the next large piece will share as
/// well.
std::uint64_t Build::granules_shared() const noexcept {
  std::uint64_t sum = 0;
  for (unsigned i = 0; i < extents; ++i) {
    if (extent[i].is_shared() || extents >= kManyExtents) sum += extent[i].granules;
  }
  return sum;
}

/// Makes an idle extent as large as a piece needs. It gives back what is too much, or takes the
/// granules behind the extent if they are free. An extent that reserve() made does not shrink.
///
/// Crash: killed anywhere in it, the granules carry this block's tag or none.
void Build::resize(transport::Participant& p, unsigned index, std::uint32_t granules) noexcept {
  Extent& e = extent[index];
  if (e.granules < granules) {
    if (pool_of(p, *this).extend_run(e.granule + e.granules, granules - e.granules,
                                     tag_of(p, *this))) {
      e.granules = granules;
    }
  } else if (!e.is_reserved()) {
    shorten(p, index, granules);
  }
}

void Build::shorten(transport::Participant& p, unsigned index, std::uint32_t granules) noexcept {
  Extent& e = extent[index];
  if (e.granules <= granules) return;
  const std::uint32_t more = e.granules - granules;
  e.granules = granules;
  pool_of(p, *this).release_run(e.granule + granules, more);
}

/// Doubles the extent that the small pieces are in, where the granules behind it are free.
bool Build::grow_current(transport::Participant& p, std::size_t bytes, std::size_t align) noexcept {
  if (current == 0) return false;
  Extent& e = extent[current - 1U];
  // An alignment may lead behind the limit.
  const std::uint64_t needed = aligned_cursor(align) + bytes;
  const std::uint64_t least = granules_in(needed - limit);
  const std::uint32_t end = e.granule + e.granules;
  for (const std::uint64_t more : {std::max<std::uint64_t>(least, e.granules), least}) {
    if (more < kNoRun &&
        pool_of(p, *this).extend_run(end, static_cast<std::uint32_t>(more), tag_of(p, *this))) {
      e.granules += static_cast<std::uint32_t>(more);
      limit += more * kGranule;
      return true;
    }
  }
  return false;
}

/// Waits for a thread that takes the spare extents. It has the lock from its last look at the flag
/// until it is done. It is a thread of the home's process.
void Build::await_taker() noexcept {
  transport::Participant* const p = home();
  if (p == nullptr) return;
  const std::lock_guard guard(pool_of(*p, *this).lock());
  wanted.store(0, std::memory_order_relaxed);  // relaxed: the lock carries it (M1, P2)
}

void Build::trim_whole() noexcept {
  own_spare();
  trim_current();
  for (unsigned i = extents; i-- > 0;) {
    if (extent[i].living != 0 || current == i + 1 || extent[i].granules <= kSmallRun ||
        extent[i].is_reserved()) {
      continue;
    }
    transport::Participant* const p = home();
    if (p == nullptr) return;
    drop(*p, i);
  }
}

/// Gives back the end of the current extent that no piece has used, as far as it is more than 64
/// KiB and 1/16 of the rest.
void Build::trim_current() noexcept {
  if (current == 0) return;
  const Extent& e = extent[current - 1U];
  if (e.is_reserved()) return;
  const std::uint64_t begin = begin_of(e);
  const std::uint64_t used = std::max<std::uint64_t>(fit(cursor - begin + 1), kSmallRun);
  if (e.granules <= used) return;
  transport::Participant* const p = home();
  if (p == nullptr) return;
  shorten(*p, current - 1U, static_cast<std::uint32_t>(used));
  limit = begin + used * kGranule;
}

/// Gives back the empty extents, except for those that reserve() made.
void Build::drop_idle(transport::Participant& p) noexcept {
  for (unsigned i = extents; i-- > 0;) {
    if (extent[i].living == 0 && current != i + 1 && !extent[i].is_reserved()) drop(p, i);
  }
}

/// Gives back an extent that is not the current one.
void Build::drop(transport::Participant& p, unsigned index) noexcept {
  const Extent gone = extent[index];
  const unsigned last = --extents;
  extent[index] = extent[last];
  if (current == last + 1) current = static_cast<std::uint8_t>(index + 1);
  pool_of(p, *this).release_run(gone.granule, gone.granules);
}

void Build::give_back(const void* piece, std::size_t bytes) noexcept {
  const std::uint64_t at = mapping->offset_of(piece);
  const bool newest = at + bytes == cursor;
  const unsigned used = is_spare() ? 0 : extents;  // no piece is in a spare extent
  for (unsigned i = 0; i < used; ++i) {
    Extent& e = extent[i];
    const std::uint64_t begin = begin_of(e);
    if (at < begin || at >= begin + bytes_of(e)) continue;
    if (e.living != 0 && e.living != 0xffff) --e.living;
    if (current == i + 1) {
      if (e.living == 0) {
        cursor = begin;
      } else if (newest) {
        cursor = at;
      }
    } else if (e.living == 0 && e.kind == 0) {
      // A growing vector has left the extent, and the next message will need the larger one at
      // once.
      if (transport::Participant* const p = home(); p != nullptr) {
        drop(*p, i);
        if (is_told) tell();
        expect_another(*p, *this, kMaxExtents);
      }
    }
    return;  // A2
  }
  if (newest && current == 0 && at < limit && limit - at <= segment::kSmallBytes)
    cursor = at;  // A2
}

void Arena::change_hands() noexcept {
  // The holds of the process that writes it carry it.
  write_once<std::uint8_t>(changed_hands, kTaken);
}

void Arena::show() noexcept {
  // Publishing carries it. Only the process that has taken the message comes here with kTaken, and
  // from then on no reader takes the message from a queue.
  if (read_once(changed_hands) == kTaken) write_once<std::uint8_t>(changed_hands, kShown);
}

// Publishing carries it to other processes. Within this process, another thread that
// changes the message must be synchronised with the push, as with any change. Another thread that
// publishes it stores the same value.
void Arena::freeze() noexcept { write_once<std::uint8_t>(frozen, kPublished); }

bool Arena::freeze_first() noexcept {
  // Relaxed: as in freeze().
  return read_once(frozen) == 0 &&
         std::atomic_ref(frozen).exchange(kPublished, std::memory_order_relaxed) == 0;
}

bool Arena::was_handed_over() const noexcept {
  return !is_frozen() && read_once(changed_hands) == kTaken;
}

bool Arena::is_frozen() const noexcept { return read_once(frozen) != 0; }

}  // namespace lot::detail
