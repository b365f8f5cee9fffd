// SPDX-License-Identifier: Apache-2.0
#include "transport/survey.hpp"

#include "lot/options.hpp"

#include "transport/references.hpp"

namespace lot::transport {

using Ownership = refcount::Ownership<segment::Atomics>;

namespace {

/// Not only the messages of this ring refer to it: how many do says nothing.
constexpr std::uint32_t kOthersRefer = ~std::uint32_t{0};

/// True if messages of the ring may go for another topic's need. False for the items of a queue
/// without loss: only their takers get them. False for what a publisher without loss has left: its
/// readers get that to the end.
bool may_lose(const segment::ChannelEntry& entry, ring::State state) {
  return detail::read_once(entry.policy) == static_cast<std::uint32_t>(Policy::Overwrite) ||
         (state == ring::State::Live && detail::read_once(entry.taken) == 0);
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
    if (ring::is_observer(position)) continue;
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
  all_referrers_.resize(segment_.capacity().blocks);
  referrers_.resize(segment_.capacity().blocks);
  follow_.reserve(segment_.capacity().blocks);
  publishers_.reserve(segment_.capacity().channels);
}

void Survey::look(std::uint32_t self, Shortage shortage) noexcept {
  shortage_ = shortage;
  self_ = self;
  some_refer_ = false;
  publishers_.clear();
  std::fill(granules_.begin(), granules_.end(), 0);
  std::fill(is_in_live_ring_.begin(), is_in_live_ring_.end(), false);
  std::fill(all_referrers_.begin(), all_referrers_.end(), 0);
  std::fill(referrers_.begin(), referrers_.end(), 0);
  for (std::uint32_t b = 0; b < granules_.size(); ++b) {
    // Relaxed: a hint.
    if (segment_.block(b).home.load(std::memory_order_relaxed) == refcount::kHomeFree) continue;
    each_reference(segment_, b, [this](std::uint32_t t) {
      ++all_referrers_[t];
      some_refer_ = true;
    });
  }
  const auto& tags = segment_.granules();
  for (std::uint32_t i = 0; i < tags.count(); ++i) {
    const std::uint32_t tag = tags.tag(i);
    if (tag != 0 && tag <= granules_.size()) ++granules_[tag - 1];
  }
  each_publisher(ring::State::Live, [this](std::uint32_t c, std::uint32_t) {
    const segment::Ring ring = segment_.ring(c);
    for (std::uint32_t i = 0; i < ring.depth; ++i) {
      // Relaxed: a hint.
      const ring::Word b = ring::block(ring.slots[i].load(std::memory_order_relaxed));
      if (b < granules_.size()) is_in_live_ring_[static_cast<std::size_t>(b)] = true;
    }
  });
  for (const ring::State state : {ring::State::Live, ring::State::Orphan}) {
    each_publisher(state, [&](std::uint32_t c, std::uint32_t owner) {
      if (owner != self && may_lose(segment_.channels()[c], state)) weigh(c, owner);
    });
  }
}

template <class F>
void Survey::each_publisher(ring::State state, F&& f) const noexcept {
  for (std::uint32_t c = 0; c < segment_.capacity().channels; ++c) {
    // Acquire: R7, R9.
    const ring::Word w = segment_.channels()[c].writer.load(std::memory_order_acquire);
    if (w == 0) break;  // channels are taken lowest first: those behind it never were
    const std::uint32_t owner = ring::writer_owner(w);
    // A damaged word may say anything.
    if (ring::writer_state(w) == state && owner < segment_.capacity().participants &&
        (state == ring::State::Orphan) == (owner == refcount::kOrphanage)) {
      f(c, owner);
    }
  }
}

void Survey::weigh(std::uint32_t channel, std::uint32_t owner) noexcept {
  Publisher p{owner, channel, 0, 0, 0, 0, 0};
  each_that_counts(channel, owner, [&](const Message& m) {
    if (p.held == 0 && m.weight != 0) {
      p.first = m.block;
      if (m.newer >= kNewest && m.was_read) p.oldest = m.weight;
    }
    p.held += m.weight;
    p.behind += m.behind;
    if (!m.was_read) p.unread += m.weight + m.behind;
    return true;
  });
  if (p.held != 0 || p.behind != 0) publishers_.push_back(p);
}

void Survey::mark_of(const Publisher& p, std::uint64_t keep, bool unread,
                     std::vector<bool>& blocks) noexcept {
  std::uint64_t held = p.held + p.behind;
  const bool has_gone = p.owner == refcount::kOrphanage;
  each_that_counts(p.channel, p.owner, [&](const Message& m) {
    const std::uint64_t weight = m.weight + m.behind;
    if (!has_gone) {
      if ((!m.was_read && !unread) || m.newer < kNewest || held < keep + weight) return false;
      held -= weight;
    }
    blocks[m.block] = true;
    for (const std::uint32_t t : follow_) blocks[t] = true;
    return true;
  });
}

/// A ring that is recycled meanwhile may say anything. The bounds in Segment::ring() and here make
/// that harmless.
template <class F>
void Survey::each_that_counts(std::uint32_t channel, std::uint32_t owner, F&& f) noexcept {
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
  const auto each_referred = [&](auto&& g) {
    if (!some_refer_) return;
    for (std::uint32_t i = 0; i < ring.depth; ++i) {
      const auto b = static_cast<std::uint32_t>(ring::block(word(i)));
      if (b < granules_.size()) each_reference(segment_, b, g);
    }
  };
  each_referred([this](std::uint32_t t) { ++referrers_[t]; });
  if (owner != refcount::kOrphanage) {  // of those all go
    each_referred([this](std::uint32_t t) {
      if (referrers_[t] < all_referrers_[t]) referrers_[t] = kOthersRefer;
    });
  }
  const bool loses = ring.guarded();
  const ring::Word place = loses ? 0 : slowest(ring, ring::next(ring::sequence(word(newest))));
  for (std::uint32_t n = 1; n <= ring.depth && left != 0; ++n) {
    const std::uint32_t i = newest + n;
    const ring::Word slot = word(i < ring.depth ? i : i - ring.depth);
    if (ring::block(slot) >= granules_.size()) continue;
    --left;
    const auto b = static_cast<std::uint32_t>(ring::block(slot));
    if (!dies(b, owner) || (owner == refcount::kOrphanage && ring.is_looked_at(b))) continue;
    Message m{b, weight_of(b), 0, left, loses || ring::distance(ring::sequence(slot), place) < 0};
    follow(m, owner);
    if ((m.weight != 0 || m.behind != 0) && !f(m)) break;
  }
  each_referred([this](std::uint32_t t) { referrers_[t] = 0; });
}

void Survey::follow(Message& message, std::uint32_t owner) noexcept {
  follow_.clear();
  if (!some_refer_) return;
  each_reference(segment_, message.block, [&](std::uint32_t t) {
    // Zero: the list has changed since they were counted.
    if (referrers_[t] == 0 || referrers_[t] == kOthersRefer) return;
    if (--referrers_[t] != 0) return;
    const Had by = had(t, owner);
    if (by == Had::ByOthers || follow_.size() == follow_.capacity()) return;
    (by == Had::ByOwner ? message.weight : message.behind) += weight_of(t);
    follow_.push_back(t);
  });
}

Survey::Had Survey::had(std::uint32_t target, std::uint32_t owner) const noexcept {
  segment::BlockWords& words = segment_.block(target);
  // Relaxed, here and below: hints (Survey).
  const std::uint32_t home = words.home.load(std::memory_order_relaxed);
  if (home == refcount::kHomeFree ||
      (home != refcount::kHomeOrphanage && segment::is_reserved(segment_.arena(target))) ||
      words.home_points.load(std::memory_order_relaxed) != 0) {  // a hint
    return Had::ByOthers;
  }
  if (Ownership::has_holder_besides(words, owner, home - 1)) return Had::ByOthers;
  if (is_in_live_ring_[target]) return home == self_ + 1 ? Had::BySelfToo : Had::ByOthers;
  const bool has_let_go =
      home == refcount::kHomeOrphanage || home == owner + 1 || Ownership::is_awaited(words);
  return has_let_go ? Had::ByOwner : Had::ByOthers;
}

bool Survey::dies(std::uint32_t b, std::uint32_t owner) const noexcept {
  segment::BlockWords& words = segment_.block(b);
  // Relaxed, here and below: hints (Survey).
  const std::uint32_t home = words.home.load(std::memory_order_relaxed);
  const bool has_gone = owner == refcount::kOrphanage;
  if (words.home_points.load(std::memory_order_relaxed) != 0) return false;  // a hint
  if (has_gone ? home == refcount::kHomeFree || is_in_live_ring_[b]
               : home != owner + 1 || segment::is_reserved(segment_.arena(b))) {
    return false;
  }
  return !Ownership::has_holder_besides(words, owner, home - 1);
}

}  // namespace lot::transport
