// SPDX-License-Identifier: Apache-2.0
#include "lot/detail/arena.hpp"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cerrno>

#include "lot/error.hpp"

#include "transport/fill.hpp"
#include "transport/participant.hpp"

namespace lot::detail {
namespace {

std::uint64_t bytes_of(const Arena::Extent& extent) { return segment::kGranule << extent.order; }

[[noreturn, gnu::cold]] void refuse_to_grow(const Arena& arena) {
  transport::Participant* const p = transport::Participant::at(&arena);
  throw Error(EPERM, p != nullptr ? p->segment().path() : "message",
              "a message that was published can not grow or change any more",
              "build it wholly before push(), or copy it into a new loan()");
}

[[noreturn, gnu::cold]] void out_of_memory(transport::Participant& p, std::size_t bytes,
                                           int error) {
  throw OutOfMemory(transport::describe_shortage(p, bytes, error).c_str());
}

}  // namespace

Arena*& arena_being_built() noexcept {
  static thread_local Arena* arena = nullptr;
  return arena;
}

void* Arena::grow(std::size_t bytes) {
  if (frozen == kPublished) refuse_to_grow(*this);
  bytes = std::max<std::size_t>(bytes, 1);  // empty pieces, too, begin in an extent
  // An extent begins at a page, which suits every alignment that a message may have.
  unsigned best = kMaxExtents;
  for (unsigned i = 0; i < extents; ++i) {
    if (extent[i].living == 0 && current != i + 1 && bytes_of(extent[i]) >= bytes &&
        (best == kMaxExtents || extent[i].order < extent[best].order)) {
      best = i;
    }
  }
  transport::Participant* p = nullptr;
  if (best == kMaxExtents) {
    p = transport::Participant::at(this);
    // The memory would be at home here, and the message there.
    if (p == nullptr || !p->holder().is_home(block)) {
      throw OutOfMemory(
          "lot: a message that another process has made can not grow: copy it, or let its maker "
          "reserve() what it will need");
    }
    if (extents == kMaxExtents) drop_idle(*p);
    if (extents == kMaxExtents) out_of_memory(*p, bytes, 0);
    // Each at least twice the one before: kMaxExtents suffice for any message.
    const std::uint64_t granules =
        (static_cast<std::uint64_t>(bytes) + segment::kGranule - 1) / segment::kGranule;
    const unsigned order =
        std::max(static_cast<unsigned>(std::bit_width(granules - 1)), unsigned{extents});
    unsigned claimed = order;
    std::uint32_t run = p->claim_run(order, block + 1);
    if (run == segment::Granules<HardwareAtomics>::kNone) {
      drop_idle(*p);
      claimed = static_cast<unsigned>(std::bit_width(granules - 1));
      run = p->claim_run(claimed, block + 1);
    }
    if (run == segment::Granules<HardwareAtomics>::kNone) out_of_memory(*p, bytes, errno);
    best = extents++;
    extent[best] = {run, static_cast<std::uint8_t>(claimed), 0};
  }
  Extent& chosen = extent[best];
  current = static_cast<std::uint8_t>(best + 1);
  const std::uint64_t begin = data + std::uint64_t{chosen.granule} * segment::kGranule;
  cursor = begin + bytes;
  limit = begin + bytes_of(chosen);
  count(best);
  return base() + begin;
}

/// Gives extents back in which nothing lives.
void Arena::drop_idle(transport::Participant& p) noexcept {
  std::uint8_t kept = 0;
  std::uint8_t now = 0;
  for (unsigned i = 0; i < extents; ++i) {
    if (extent[i].living == 0 && current != i + 1) {
      p.segment().granules().release(extent[i].granule, extent[i].order);
      continue;
    }
    extent[kept++] = extent[i];
    if (current == i + 1) now = kept;
  }
  extents = kept;
  current = now;
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
  for (unsigned i = 0; i < extents; ++i) {
    Extent& e = extent[i];
    const std::uint64_t begin = data + std::uint64_t{e.granule} * segment::kGranule;
    if (at < begin || at >= begin + bytes_of(e)) continue;
    if (e.living != 0 && e.living != 0xffff) --e.living;
    if (current != i + 1) return;  // A2
    if (e.living == 0) {
      cursor = begin;
    } else if (newest) {
      cursor = at;
    }
    return;
  }
  if (newest && current == 0 && at < limit && limit - at <= segment::kSmallBytes)
    cursor = at;  // A2
}

}  // namespace lot::detail
