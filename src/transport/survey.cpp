// SPDX-License-Identifier: Apache-2.0
#include "transport/survey.hpp"

#include "lot/options.hpp"

namespace lot::transport {

using Ownership = refcount::Ownership<segment::Atomics>;

namespace {

/// True if messages of the ring may go for another topic's need. False for the items of a queue
/// without loss: only their takers get them. False for what a publisher without loss has left: its
/// readers get that to the end.
bool may_lose(const segment::ChannelEntry& entry, ring::State state) {
  return entry.policy == static_cast<std::uint32_t>(Policy::Overwrite) ||
         (state == ring::State::Live && entry.taken == 0);
}

/// The place of the slowest reader of a lossless ring. `head`: the ring's next message. A reader
/// that is joining may get any place.
ring::Word slowest(const segment::Ring& ring, ring::Word head) {
  ring::Word place = head;
  for (std::uint32_t c = 0; c < ring.readers; ++c) {
    // Relaxed: a hint.
    const ring::Word position = ring.cells[c].position.load(std::memory_order_relaxed);
    // Relaxed: a hint.
    if (position == ring::kIdle || ring.who[c].load(std::memory_order_relaxed) == 0) continue;
    const ring::Word its = ring::is_joining(position)
                               ? ring::advance(head, ring::kSequenceMask + 1 - ring.depth)
                               : ring::sequence(position);
    if (ring::distance(its, place) < 0) place = its;
  }
  return place;
}

}  // namespace

void Survey::prepare() {
  granules_.resize(segment_.capacity().blocks);
  is_in_live_ring_.resize(segment_.capacity().blocks);
  publishers_.reserve(segment_.capacity().channels);
}

void Survey::look(std::uint32_t self, Shortage shortage) noexcept {
  shortage_ = shortage;
  publishers_.clear();
  std::fill(granules_.begin(), granules_.end(), 0);
  std::fill(is_in_live_ring_.begin(), is_in_live_ring_.end(), false);
  const auto& tags = segment_.granules();
  for (std::uint32_t i = 0; i < tags.count(); ++i) {
    const std::uint32_t tag = tags.tag(i);
    if (tag != 0 && tag <= granules_.size()) ++granules_[tag - 1];
  }
  // The living publishers first, since what they still have does not die with an ended ring.
  for (const ring::State state : {ring::State::Live, ring::State::Orphan}) {
    for (std::uint32_t c = 0; c < segment_.capacity().channels; ++c) {
      // Acquire: R7, R9.
      const ring::Word w = segment_.channels()[c].writer.load(std::memory_order_acquire);
      if (w == 0) break;  // channels are taken lowest first: those behind it never were
      const std::uint32_t owner = ring::writer_owner(w);
      // A damaged word may say anything.
      if (ring::writer_state(w) != state || owner >= segment_.capacity().participants ||
          (state == ring::State::Orphan) != (owner == refcount::kOrphanage)) {
        continue;
      }
      if (state == ring::State::Live) {
        const segment::Ring ring = segment_.ring(c);
        for (std::uint32_t i = 0; i < ring.depth; ++i) {
          // Relaxed: a hint.
          const ring::Word b = ring::block(ring.slots[i].load(std::memory_order_relaxed));
          if (b < granules_.size()) is_in_live_ring_[static_cast<std::size_t>(b)] = true;
        }
      }
      if (owner == self || !may_lose(segment_.channels()[c], state)) continue;
      Publisher p{owner, c, 0, 0, 0, 0};
      each_that_counts(
          c, owner, [&](std::uint32_t b, std::uint64_t weight, std::uint32_t newer, bool was_read) {
            if (p.held == 0) {
              p.first = b;
              if (newer >= kNewest && was_read) p.oldest = weight;
            }
            p.held += weight;
            if (!was_read) p.unread += weight;
            return true;
          });
      if (p.held != 0) publishers_.push_back(p);
    }
  }
}

void Survey::mark_of(const Publisher& p, std::uint64_t keep, bool unread,
                     std::vector<bool>& blocks) const noexcept {
  std::uint64_t held = p.held;
  const bool has_gone = p.owner == refcount::kOrphanage;
  each_that_counts(p.channel, p.owner,
                   [&](std::uint32_t b, std::uint64_t weight, std::uint32_t newer, bool was_read) {
                     if (!has_gone) {
                       if ((!was_read && !unread) || newer < kNewest || held < keep + weight) {
                         return false;
                       }
                       held -= weight;
                     }
                     blocks[b] = true;
                     return true;
                   });
}

/// A ring that is recycled meanwhile may say anything. The bounds in Segment::ring() and here make
/// that harmless.
template <class F>
void Survey::each_that_counts(std::uint32_t channel, std::uint32_t owner, F&& f) const {
  const segment::Ring ring = segment_.ring(channel);
  // Relaxed: nothing that the slots lead to is read.
  const auto word = [&](std::uint32_t i) { return ring.slots[i].load(std::memory_order_relaxed); };
  std::uint32_t newest = 0;
  std::uint32_t left = 0;
  for (std::uint32_t i = 0; i < ring.depth; ++i) {
    left += ring::block(word(i)) < granules_.size();
    if (ring::distance(ring::sequence(word(i)), ring::sequence(word(newest))) > 0) newest = i;
  }
  if (left == 0) return;
  const bool loses = ring.guarded();
  const ring::Word place = loses ? 0 : slowest(ring, ring::next(ring::sequence(word(newest))));
  for (std::uint32_t n = 1; n <= ring.depth && left != 0; ++n) {
    const std::uint32_t i = newest + n;
    const ring::Word slot = word(i < ring.depth ? i : i - ring.depth);
    if (ring::block(slot) >= granules_.size()) continue;
    --left;
    const auto b = static_cast<std::uint32_t>(ring::block(slot));
    const std::uint64_t weight = weight_of(b, owner);
    if (weight == 0 || (owner == refcount::kOrphanage && ring.is_looked_at(b))) continue;
    if (!f(b, weight, left, loses || ring::distance(ring::sequence(slot), place) < 0)) return;
  }
}

std::uint64_t Survey::weight_of(std::uint32_t b, std::uint32_t owner) const noexcept {
  segment::BlockWords& words = segment_.block(b);
  // Relaxed, here and below: hints (Survey).
  const std::uint32_t home = words.home.load(std::memory_order_relaxed);
  const bool has_gone = owner == refcount::kOrphanage;
  if (words.home_points.load(std::memory_order_relaxed) != 0) return 0;  // a hint
  if (has_gone ? home == refcount::kHomeFree || is_in_live_ring_[b]
               : home != owner + 1 || segment::is_reserved(segment_.arena(b))) {
    return 0;
  }
  for (std::uint32_t w = 0; w < segment::Atomics::kOwnWords; ++w) {
    std::uint64_t holders = words.own[w].load(std::memory_order_relaxed);  // a hint
    for (const std::uint32_t k : {owner, home - 1}) holders = Ownership::holders(holders, w, k);
    if (holders != 0) return 0;
  }
  return shortage_ == Shortage::Blocks ? 1 : granules_[b];
}

}  // namespace lot::transport
