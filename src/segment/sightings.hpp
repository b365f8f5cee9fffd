// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "lot/detail/changed_by.hpp"

namespace lot::segment {

/// One message that a participant has been seen to hold. Only its warden writes it: it empties the
/// name first and stores the new name last. A process that reads the name, the time and the name
/// again (acquire) knows whether they belong together.
class Sighting {
 public:
  detail::ChangedBy<std::atomic<std::uint64_t>, Sighting>
      what;  ///< {block + 1 : 32 | generation : 32}, 0: none
  detail::ChangedBy<std::atomic<std::uint64_t>, Sighting>
      since_ns;  ///< steady clock, when it was first seen

  void set(std::uint64_t name, std::uint64_t since) noexcept {
    // Relaxed, both: the warden alone writes; the release of the time carries the 0.
    if (what.load(std::memory_order_relaxed) == name) return;
    what.store(0, std::memory_order_relaxed);  // as above
    // Edge "sighting": a reader that sees the time sees the old name gone.
    since_ns.store(since, std::memory_order_release);
    what.store(name, std::memory_order_release);  // edge "sighting": carries the time
  }
  /// Relaxed: a name that goes carries nothing.
  void clear() noexcept { what.store(0, std::memory_order_relaxed); }
};

/// Since when a participant holds its oldest messages. For people only, nothing depends on it
/// (docs/tool.md). The next participant with the same index overwrites what a dead one has left.
struct alignas(64) Sightings {
  static constexpr std::uint32_t kMost = 15;
  /// Steady clock, when the warden last looked; 0: not yet.
  detail::ChangedBy<std::atomic<std::uint64_t>, Sightings> looked_ns;
  std::uint64_t reserved;
  Sighting seen[kMost];

  /// The table is that of a look at `now`. Release: a reader that sees this time sees the table of
  /// this look or a later one.
  void note_look(std::uint64_t now) noexcept { looked_ns.store(now, std::memory_order_release); }
  /// Clears what a former participant has left. Relaxed: the state of the new one, which is stored
  /// later with release, carries it.
  void clear() noexcept {
    for (Sighting& place : seen) place.clear();
    looked_ns.store(0, std::memory_order_relaxed);  // as above
  }
};
static_assert(sizeof(Sightings) == 256);

}  // namespace lot::segment
