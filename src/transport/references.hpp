// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "lot/detail/arena.hpp"

#include "segment/segment.hpp"

namespace lot::transport {

/// Calls f(entry) for each entry of the list of what the message in block b refers to, the free
/// ones too, until f returns false. Bounds are checked, since the list may be damaged.
///
/// The home writes the list. A reaper reads it under the dead home's byte lock, or after
/// the message's death. A process that is short of memory, and `lot who`, take what they see for
/// hints.
template <class F>
void each_entry(const segment::Segment& segment, std::uint32_t b, F&& f) {
  using detail::ReferenceList;
  std::uint64_t at = detail::read_once(segment.arena(b).references);
  // A message has one entry for each block, and no new list while an entry is free.
  const std::uint32_t most = segment.capacity().blocks / ReferenceList::kEntries + 1;
  for (std::uint32_t n = 0; n < most && at != 0; ++n) {
    if (at % alignof(ReferenceList) != 0 || !segment.holds(b, at, sizeof(ReferenceList))) return;
    auto* list = reinterpret_cast<ReferenceList*>(segment.base() + at);
    for (ReferenceList::Entry& entry : list->entry) {
      if (!f(entry)) return;
    }
    at = detail::read_once(list->next);
  }
}

/// Calls f(block) for each block that the message in b refers to.
template <class F>
void each_reference(const segment::Segment& segment, std::uint32_t b, F&& f) {
  each_entry(segment, b, [&](detail::ReferenceList::Entry& entry) {
    // Read once: a write that comes meanwhile cannot get past the check.
    const std::uint32_t target = detail::read_once(entry.block);
    if (target < segment.capacity().blocks) f(target);
    return true;
  });
}

}  // namespace lot::transport
