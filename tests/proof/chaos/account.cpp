// SPDX-License-Identifier: Apache-2.0
#include "account.hpp"

#include <algorithm>
#include <string>

namespace lot::chaos {

void Account::before_subscribe() {
  rings_.clear();
  early_.clear();
  least_credit_ = most_credit_ = 0;
  each_publisher([this](std::uint32_t i, const Incarnation& r) {
    const auto state = r.state.load(std::memory_order_acquire);
    early_.push_back(
        {i, r.done.load(std::memory_order_acquire), 0, state >= Incarnation::Live, false, 0});
  });
}

void Account::after_subscribe(std::uint64_t history) {
  began_ = life_.board.incarnations_begun.load();
  // Those that have begun meanwhile.
  const std::uint32_t newest = early_.empty() ? 0 : early_.front().incarnation;
  bool known = false;
  each_publisher([&](std::uint32_t i, const Incarnation&) {
    known |= i == newest;
    if (!known && i < began_) early_.push_back({i, 0, 0, false, false, 0});
  });
  for (Early& e : early_) {
    const Incarnation& r = record(e.incarnation);
    const std::uint64_t depth = r.depth - (blocking(e.incarnation) ? 1 : 0);
    const auto back = [&](std::uint64_t head) { return head - std::min({history, depth, head}); };
    e.joined = e.was_live && life_.lives(r);
    e.least = e.was_live ? back(e.least) : 0;
    e.most = r.begun.load(std::memory_order_acquire);
    // Where memory runs out a publisher may take the past back.
    if (life_.epoch.roomy || r.takes_back == 0) e.most = back(e.most);
  }
  std::partition(early_.begin(), early_.end(), [](const Early& e) { return e.joined; });
}

void Account::before_look() {
  for (Ring& ring : rings_) {
    const Incarnation& r = record(ring.incarnation);
    ring.over = rings_.size() > kMostRings && !life_.lives(r);
    ring.done = r.done.load(std::memory_order_acquire);
    if (life_.has(Plant::Ghost, 1)) ++ring.done;
  }
  for (Early& e : early_) {
    if (!e.joined) break;
    e.done = record(e.incarnation).done.load(std::memory_order_acquire);
  }
}

Account::Ring* Account::find(std::uint32_t incarnation) {
  // The newest are the busiest.
  const auto at = std::find_if(rings_.rbegin(), rings_.rend(), [incarnation](const Ring& r) {
    return r.incarnation == incarnation;
  });
  return at != rings_.rend() ? &*at : nullptr;
}

void Account::received(const Place& place, std::uint64_t missed) {
  const std::uint32_t i = place.incarnation;
  if (i == 0 || i >= life_.board.incarnations_begun.load()) {
    fail(Finding::Torn, "a message of nobody", i);
  }
  if (record(i).topic != topic_) fail(Finding::Torn, "a message of another topic", i);
  if (place.number >= record(i).begun.load(std::memory_order_acquire)) {
    fail(Finding::Torn, "number " + std::to_string(place.number) + " was never published", i);
  }
  std::int64_t least_gap = 0;
  std::int64_t most_gap = 0;
  if (Ring* ring = find(i)) {
    if (place.number < ring->next) {
      fail(Finding::Twice,
           "number " + std::to_string(place.number) + ", when " + std::to_string(ring->next) +
               " was next",
           i);
    }
    least_gap = most_gap = static_cast<std::int64_t>(place.number - ring->next);
    if (most_gap != 0 && blocking(i)) {
      fail(
          Finding::Lost,
          "under Block, from " + std::to_string(ring->next) + " to " + std::to_string(place.number),
          i);
    }
    ring->next = place.number + 1;
  } else {
    first_of(place, least_gap, most_gap);
    rings_.push_back({i, place.number + 1, 0, false});
  }
  const auto told = static_cast<std::int64_t>(missed);
  least_credit_ = std::max<std::int64_t>(least_credit_ + told - most_gap, 0);
  most_credit_ += told - least_gap;
  if (most_credit_ < 0) {
    fail(Finding::Lost,
         std::to_string(-most_credit_) + " before number " + std::to_string(place.number) +
             " were neither received nor told as missed (" + std::to_string(missed) + " were)",
         i);
  }
}

void Account::first_of(const Place& place, std::int64_t& least_gap, std::int64_t& most_gap) {
  const auto number = static_cast<std::int64_t>(place.number);
  const auto at = std::find_if(early_.begin(), early_.end(),
                               [&](const Early& e) { return e.incarnation == place.incarnation; });
  if (at == early_.end()) {  // it came later: read from the start, or told what that was
    least_gap = most_gap = number;
    return;
  }
  const Early early = *at;
  early_.erase(at);
  if (place.number < early.least) {
    fail(Finding::Twice,
         "number " + std::to_string(place.number) +
             " is older than the history that was asked for (" + std::to_string(early.least) + ")",
         place.incarnation);
  }
  if (early.was_live && blocking(place.incarnation)) {
    if (place.number > early.most) {
      fail(Finding::Lost,
           "under Block, all before " + std::to_string(place.number) + " and from " +
               std::to_string(early.most) + " at the latest",
           place.incarnation);
    }
    return;
  }
  most_gap = number - static_cast<std::int64_t>(early.least);
  least_gap = number - static_cast<std::int64_t>(std::min(early.most, place.number));
}

/// Every ring was read to where its gaps are known.
void Account::settle_credit() {
  if (!life_.epoch.roomy || credit_may_stay()) return;
  if (least_credit_ > 0) {
    fail(Finding::Lost, "told of " + std::to_string(least_credit_) + " more than were missed", 0);
  }
  most_credit_ = 0;
}

void Account::found_nothing() {
  for (const Ring& ring : rings_) {
    if (ring.done > ring.next && is_exact(ring.incarnation)) {
      fail(Finding::Lost,
           "a look found nothing, but from number " + std::to_string(ring.next) + " on up to " +
               std::to_string(ring.done) + " all was published before it",
           ring.incarnation);
    }
  }
  for (const Early& e : early_) {
    if (!e.joined) break;
    if (e.done > e.most && is_exact(e.incarnation)) {
      fail(Finding::Lost,
           "a look found nothing, but from number " + std::to_string(e.most) + " on up to " +
               std::to_string(e.done) + " all was published between subscribe() and it",
           e.incarnation);
    }
  }
  settle_credit();
  life_.count(Count::Closed);
  while (rings_.size() > kMostRings && rings_.front().over) rings_.erase(rings_.begin());
}

std::uint32_t Account::unheard() {
  std::uint32_t unheard = 0;
  each_publisher([&](std::uint32_t i, const Incarnation& r) {
    const bool silent = r.blocking != 0 && r.depth == 1;  // nothing is left for who joins late
    if (i >= began_ && life_.lives(r) && r.done.load() != 0 && is_exact(i) && !silent &&
        find(i) == nullptr) {
      unheard = i;
    }
  });
  return unheard;
}

void Account::fail(Finding finding, const std::string& what, std::uint32_t incarnation) {
  std::string text = std::string(kTopic[topic_].name) + ": " + what;
  if (incarnation != 0 && incarnation < kIncarnations) {
    const Incarnation& r = record(incarnation);
    text += "; publisher: incarnation " + std::to_string(incarnation) + " of " +
            std::to_string(began_) + ", chaos" + std::to_string(r.slot) + " life " +
            std::to_string(r.life) + (life_.lives(r) ? " (lives)" : " (ended)") + ", " +
            (r.blocking != 0 ? "Block" : "Overwrite") + " depth " + std::to_string(r.depth) +
            ", done " + std::to_string(r.done.load()) + ", begun " + std::to_string(r.begun.load());
  }
  life_.fail(finding, text);
}

}  // namespace lot::chaos
