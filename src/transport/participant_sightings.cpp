// SPDX-License-Identifier: Apache-2.0
/// Since when a participant holds what it holds: a table for people. The warden writes it once a
/// second, so it costs a loan, a pull and a release nothing.
#include <algorithm>
#include <array>
#include <new>

#include "transport/participant.hpp"

namespace lot::transport {
namespace {

using segment::Sighting;
using segment::Sightings;

std::uint64_t now_ns() {
  return static_cast<std::uint64_t>(futex::Clock::now().time_since_epoch() /
                                    std::chrono::nanoseconds(1));
}

void write(Sighting& place, std::uint64_t what, std::uint64_t since_ns) {
  // Relaxed, both: the warden alone writes; the release of the time carries the 0.
  if (place.what.load(std::memory_order_relaxed) == what) return;
  place.what.store(0, std::memory_order_relaxed);  // as above
  // Edge "sighting": a reader that sees the time sees the old name gone.
  place.since_ns.store(since_ns, std::memory_order_release);
  place.what.store(what, std::memory_order_release);  // edge "sighting": carries the time
}

}  // namespace

/// Clears what the former owner of this index has left, before this process is in the segment, so
/// that no reader of the table takes it for this process's.
void Participant::forget_sightings() noexcept {
  Sightings& table = segment_.sightings()[index()];
  // Relaxed: the state of the participant, stored later with release, carries them.
  for (Sighting& place : table.seen) place.what.store(0, std::memory_order_relaxed);
  table.looked_ns.store(0, std::memory_order_relaxed);  // as above
}

/// Crash:   killed anywhere in here, a place is empty or true.
void Participant::note_sightings() noexcept {
  const std::uint64_t now = now_ns();
  std::unordered_map<std::uint64_t, std::uint64_t> held;
  const auto add = [&](std::uint32_t b) {
    const std::uint64_t what =
        std::uint64_t{b + 1} << 32 |
        // Relaxed, here and below: what people see may be old.
        refcount::generation_of(block(b).life.load(std::memory_order_relaxed));
    const auto before = held_since_.find(what);
    held.emplace(what, before != held_since_.end() ? before->second : now);
  };
  try {
    const std::uint32_t known = holder_.known.load(std::memory_order_relaxed);  // a hint
    for (std::uint32_t b = 0; b < known; ++b) {
      auto& words = block(b);
      const std::uint64_t own =
          HardwareOwnership::word(words, index()).load(std::memory_order_relaxed);  // a hint
      if ((own & HardwareOwnership::bit(index())) == 0) continue;
      const std::uint64_t v = holder_.cell(b).hold.load(std::memory_order_relaxed);  // a hint
      // Relaxed: a hint. At home a lone pointer may be the pool's, on a block ready for a loan.
      const bool spare =
          (v & hold::kHome) != 0 && words.home_points.load(std::memory_order_relaxed) == 0;
      if (hold::pointers(v) != 0 && !spare) add(b);
    }
    const std::uint32_t used = used_channels();
    for (std::uint32_t c = 0; c < used; ++c) {
      // Acquire: R7, R9.
      const auto state = ring::writer_state(channel_writer(c).load(std::memory_order_acquire));
      if (state != ring::State::Live && state != ring::State::Orphan) continue;
      const segment::Ring r = ring(c);
      for (std::uint32_t i = 0; i < r.readers; ++i) {
        // Both relaxed: a ring that is recycled meanwhile may say anything, which does no harm.
        if (r.who[i].load(std::memory_order_relaxed) != index() + 1) continue;
        const ring::Word position = r.cells[i].position.load(std::memory_order_relaxed);
        if (position != ring::kIdle && ring::block(position) < blocks()) {
          add(static_cast<std::uint32_t>(ring::block(position)));
        }
      }
    }
  } catch (const std::bad_alloc&) {
    return;  // the table stays as it was
  }

  // The oldest first, so that entries that stay mostly keep their places.
  std::array<std::pair<std::uint64_t, std::uint64_t>, Sightings::kMost> oldest{};
  const auto end = std::partial_sort_copy(
      held.begin(), held.end(), oldest.begin(), oldest.end(), [](const auto& a, const auto& b) {
        return a.second != b.second ? a.second < b.second : a.first < b.first;
      });
  Sightings& table = segment_.sightings()[index()];
  for (auto place = oldest.begin(); place != end; ++place) {
    write(table.seen[place - oldest.begin()], place->first, place->second);
  }
  for (auto place = end; place != oldest.end(); ++place) {
    // Relaxed: a name that goes carries nothing.
    table.seen[place - oldest.begin()].what.store(0, std::memory_order_relaxed);
  }
  // Release: a reader that sees this time sees the table of this look or a later one.
  table.looked_ns.store(now, std::memory_order_release);
  held_since_ = std::move(held);
}

}  // namespace lot::transport
