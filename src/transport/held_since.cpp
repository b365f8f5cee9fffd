// SPDX-License-Identifier: Apache-2.0
#include "transport/held_since.hpp"

#include <algorithm>
#include <array>
#include <new>
#include <utility>

#include "futex/futex.hpp"

namespace lot::transport {
namespace {

using segment::Sightings;

std::uint64_t now_ns() {
  return static_cast<std::uint64_t>(futex::Clock::now().time_since_epoch() /
                                    std::chrono::nanoseconds(1));
}

}  // namespace

void HeldSince::note() noexcept {
  const std::uint32_t self = holder_.own.self;
  const std::uint64_t now = now_ns();
  Held held;
  const auto add = [&](std::uint32_t b) {
    const std::uint64_t what =
        std::uint64_t{b + 1} << 32 |
        // Relaxed, here and below: what people see may be old.
        refcount::generation_of(world_.block(b).life.load(std::memory_order_relaxed));
    const auto before = held_since_.find(what);
    held.emplace(what, before != held_since_.end() ? before->second : now);
  };
  try {
    const std::uint32_t known = holder_.known.load(std::memory_order_relaxed);  // a hint
    for (std::uint32_t b = 0; b < known; ++b) {
      auto& words = world_.block(b);
      const std::uint64_t own =
          HardwareOwnership::word(words, self).load(std::memory_order_relaxed);  // a hint
      if ((own & HardwareOwnership::bit(self)) == 0) continue;
      const std::uint64_t v = holder_.control(b).hold.load(std::memory_order_relaxed);  // a hint
      // Relaxed: a hint. At home a lone pointer may be the pool's, on a block ready for a loan.
      const bool spare =
          (v & hold::kHome) != 0 && words.home_points.load(std::memory_order_relaxed) == 0;
      if (hold::pointers(v) != 0 && !spare) add(b);
    }
    const std::uint32_t used = world_.used_channels();
    for (std::uint32_t c = 0; c < used; ++c) {
      // Acquire: R7, R9.
      const auto state =
          ring::writer_state(world_.channel_writer(c).load(std::memory_order_acquire));
      if (state != ring::State::Live && state != ring::State::Orphan) continue;
      const segment::Ring r = world_.ring(c);
      for (std::uint32_t i = 0; i < r.readers; ++i) {
        // Both relaxed: a ring that is recycled meanwhile may say anything, which does no harm.
        if (r.who[i].load(std::memory_order_relaxed) != self + 1) continue;
        const ring::Word position = r.cells[i].position.load(std::memory_order_relaxed);
        if (position != ring::kIdle && ring::block(position) < world_.blocks()) {
          add(static_cast<std::uint32_t>(ring::block(position)));
        }
      }
    }
  } catch (const std::bad_alloc&) {
    return;  // the table stays as it was
  }
  show(held, now);
  held_since_ = std::move(held);
}

void HeldSince::show(const Held& held, std::uint64_t now) noexcept {
  // The oldest first, so that entries that stay mostly keep their places.
  std::array<std::pair<std::uint64_t, std::uint64_t>, Sightings::kMost> oldest{};
  const auto end = std::partial_sort_copy(
      held.begin(), held.end(), oldest.begin(), oldest.end(), [](const auto& a, const auto& b) {
        return a.second != b.second ? a.second < b.second : a.first < b.first;
      });
  Sightings& table = segment_.sightings()[holder_.own.self];
  for (auto place = oldest.begin(); place != end; ++place) {
    table.seen[place - oldest.begin()].set(place->first, place->second);
  }
  for (auto place = end; place != oldest.end(); ++place) {
    table.seen[place - oldest.begin()].clear();
  }
  table.note_look(now);
}

}  // namespace lot::transport
