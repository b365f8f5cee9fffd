// SPDX-License-Identifier: Apache-2.0
#include "transport/quota.hpp"

#include <algorithm>
#include <chrono>

#include "refcount/ownership.hpp"

namespace lot::transport {
namespace {

/// At least this many notes lie between two looks.
constexpr std::size_t kNotesAhead = 64;
/// All that is kept in the segment is weighed again when this subscription has taken one part in
/// kPartOfRest of what was left, or has taken more after kWeighedFor. So each of several that take
/// at once stays within what is left.
constexpr std::uint64_t kPartOfRest = 16;
constexpr std::chrono::milliseconds kWeighedFor{10};

/// The limit in granules. It stays below the half, so that a subscription that is alone leaves
/// others a part, too.
std::uint64_t limit_of(segment::Segment& segment, std::uint64_t bytes) {
  const std::uint64_t all = segment.granules().count();
  if (bytes == Quota::kNone) return Quota::kNone;
  const std::uint64_t granules = bytes == 0 ? all / 4 : bytes / segment::kGranule;
  return std::clamp(granules, std::uint64_t{1}, std::max<std::uint64_t>(all * 7 / 16, 1));
}

/// True if a subscription that holds `own` may take more. Each gets a part of what the others leave
/// of the half. The greater its limit, the greater its part. A subscription that is alone reaches
/// its limit.
bool is_within(std::uint64_t own, std::uint64_t limit, std::uint64_t all_kept, std::uint64_t half) {
  if (own >= limit || all_kept >= half) return false;
  return own * (half - limit) < limit * (half - all_kept);
}

/// What is kept in the whole segment: messages that processes got from others and have pointers to,
/// and messages that their own process has published and keeps.
struct Kept {
  std::uint64_t granules = 0;
  std::uint64_t blocks = 0;
};

bool is_kept(const segment::Segment& segment, std::uint32_t b) noexcept {
  const segment::BlockWords& words = segment.block(b);
  // Relaxed, here and below: see weigh_kept().
  const std::uint32_t home = words.home.load(std::memory_order_relaxed);
  if (home == refcount::kHomeFree) return false;
  if (words.home_points.load(std::memory_order_relaxed) != 0) return true;  // a hint
  for (std::uint32_t w = 0; w < segment::Atomics::kOwnWords; ++w) {
    std::uint64_t holders = words.own[w].load(std::memory_order_relaxed);  // a hint
    for (const std::uint32_t k : {refcount::kOrphanage, home - 1}) {
      holders = HardwareOwnership::holders(holders, w, k);
    }
    if (holders != 0) return true;
  }
  return false;
}

/// Relaxed, as in Survey: the next look sees what changes meanwhile.
Kept weigh_kept(segment::Segment& segment) noexcept {
  const std::uint32_t blocks = segment.capacity().blocks;
  Kept kept;
  for (std::uint32_t b = 0; b < blocks; ++b) kept.blocks += is_kept(segment, b);
  const auto& tags = segment.granules();
  std::uint32_t last = 0;
  bool counts = false;
  for (std::uint32_t i = 0; i < tags.count(); ++i) {
    const std::uint32_t tag = tags.tag(i);
    if (tag != last) {
      last = tag;
      counts = tag != 0 && tag <= blocks && is_kept(segment, tag - 1);
    }
    kept.granules += counts;
  }
  return kept;
}

}  // namespace

Quota::Quota(segment::Segment& segment, const Holder& holder, std::uint64_t limit)
    : segment_(segment),
      holder_(holder),
      limit_(limit_of(segment, limit)),
      limit_notes_(std::max<std::size_t>(segment.capacity().blocks / 4, 1)) {
  if (counts()) return;
  look_at_notes_ = ~std::size_t{0};
  look_at_granules_ = kNone;
}

std::uint32_t Quota::note(std::uint32_t block, std::uint64_t granules) noexcept {
  // Relaxed: the message is held, so its generation stays.
  const std::uint32_t generation =
      refcount::generation_of(segment_.block(block).life.load(std::memory_order_relaxed));
  granules_ += granules;
  // A reader that lets one message go before the next one comes has one note, and needs no look.
  if (!notes_.empty() && !has_pointers(notes_.back().block)) {
    granules_ -= notes_.back().granules;
    notes_.back() = {block, generation, granules};
  } else {
    notes_.push_back({block, generation, granules});  // allows_one_more() has made room
  }
  return generation;
}

bool Quota::look() {
  forget_what_went();
  // One message is always allowed: this subscription goes on even if others hold all that may be
  // held.
  is_full_ =
      !notes_.empty() && (granules_ >= limit_ || notes_.size() >= limit_notes_ || !leaves_enough());
  if (is_full_) {
    look_at_notes_ = 0;  // it looks each time from now on
    return false;
  }
  plan_next_look();
  return true;
}

/// Removes notes of messages that were let go. Each message counts once, however often it has come.
void Quota::forget_what_went() noexcept {
  std::erase_if(notes_, [this](const Note& note) { return !is_held(note); });
  const auto by_block = [](const Note& a, const Note& b) { return a.block < b.block; };
  const auto same_block = [](const Note& a, const Note& b) { return a.block == b.block; };
  std::sort(notes_.begin(), notes_.end(), by_block);
  notes_.erase(std::unique(notes_.begin(), notes_.end(), same_block), notes_.end());
  granules_ = 0;
  for (const Note& note : notes_) granules_ += note.granules;
}

bool Quota::is_held(const Note& note) const noexcept {
  const auto& life = segment_.block(note.block).life;
  return has_pointers(note.block) &&
         // Relaxed: a message that is held keeps its generation.
         refcount::generation_of(life.load(std::memory_order_relaxed)) == note.generation;
}

bool Quota::has_pointers(std::uint32_t block) const noexcept {
  // Relaxed: a hint, and what it misses the next look sees.
  const std::uint64_t word = holder_.control(block).hold.load(std::memory_order_relaxed);
  // While the word is busy a thread takes the first hold or lets go of the last: the next look will
  // see it.
  return (word & hold::kBusy) != 0 || hold::pointers(word) != 0;
}

bool Quota::leaves_enough() {
  const std::uint64_t half = segment_.granules().count() / 2;
  const std::uint64_t half_blocks = segment_.capacity().blocks / 2;
  const auto grown = [](std::uint64_t now, std::uint64_t then) {
    return now > then ? now - then : 0;
  };
  const auto part_of_rest = [&](std::uint64_t all, std::uint64_t kept) {
    return grown(all, kept) / kPartOfRest;
  };
  const auto now = futex::Clock::now();
  const bool is_young = now < weighed_.at + kWeighedFor;
  const std::uint64_t more = grown(granules_, weighed_.own_granules);
  const std::uint64_t more_notes = grown(notes_.size(), weighed_.own_notes);
  const bool is_new = is_shared_out_ ? is_young && notes_.size() >= weighed_.own_notes
                                     : weighed_.own_notes != 0 &&
                                           (is_young || (more == 0 && more_notes == 0)) &&
                                           more < part_of_rest(half, weighed_.granules) &&
                                           more_notes < part_of_rest(half_blocks, weighed_.blocks);
  if (!is_new) {
    const Kept kept = weigh_kept(segment_);
    weighed_ = {kept.granules, kept.blocks, granules_, notes_.size(), now};
  }
  is_shared_out_ = !is_within(granules_, limit_, weighed_.granules, half) ||
                   !is_within(notes_.size(), limit_notes_, weighed_.blocks, half_blocks);
  return !is_shared_out_;
}

/// Plans the next look, and makes room for the notes until then.
void Quota::plan_next_look() {
  const std::uint64_t half = segment_.granules().count() / 2;
  // Before it has weighed, it takes little: other subscriptions may have taken everything.
  const std::uint64_t left = weighed_.own_notes == 0 ? half / 2 : half;
  const std::uint64_t rest = left > weighed_.granules ? left - weighed_.granules : 0;
  const std::size_t notes =
      std::max(std::min(std::max(2 * notes_.size(), notes_.size() + kNotesAhead), limit_notes_),
               notes_.size() + 1);
  look_at_notes_ = 0;  // in case there is no memory for them
  notes_.reserve(notes);
  look_at_notes_ = notes;
  look_at_granules_ = std::min(limit_, granules_ + std::max<std::uint64_t>(rest / kPartOfRest, 1));
}

std::string Quota::describe() const {
  std::string text = "holds " + std::to_string(granules_ * segment::kGranule >> 20) + " MiB in " +
                     std::to_string(notes_.size()) + " messages, which is all that it may";
  if (is_shared_out_) text += " while all subscriptions together hold so much";
  return text;
}

}  // namespace lot::transport
