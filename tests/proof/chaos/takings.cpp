// SPDX-License-Identifier: Apache-2.0
#include "takings.hpp"

#include <algorithm>

namespace lot::chaos {

void Takings::before_listen() {
  rings_.clear();
  for (std::uint32_t i = life_.board.newest[topic_].load(); i != 0; i = record(i).before) {
    if (life_.lives(record(i))) rings_.push_back({i, 0, 0, false});
  }
}

void Takings::after_listen() {
  rings_.erase(
      std::remove_if(rings_.begin(), rings_.end(),
                     [this](const Ring& r) { return !life_.lives(record(r.incarnation)); }),
      rings_.end());
}

void Takings::before_look() {
  for (Ring& ring : rings_) {
    ring.over = rings_.size() > kMostRings && !life_.lives(record(ring.incarnation));
    ring.done = record(ring.incarnation).done.load(std::memory_order_acquire);
  }
}

void Takings::took(const Stamp& stamp) {
  const std::uint32_t i = stamp.incarnation;
  check_origin(stamp);
  mark(stamp);
  const auto at =
      std::find_if(rings_.begin(), rings_.end(), [i](const Ring& r) { return r.incarnation == i; });
  if (at == rings_.end()) {
    rings_.push_back({i, stamp.number + 1, 0, false});
    return;
  }
  if (stamp.number < at->next) {
    fail(Finding::Twice, "taken when " + std::to_string(at->next) + " was next", stamp);
  }
  at->next = stamp.number + 1;
}

void Takings::mark(const Stamp& stamp) {
  std::uint32_t before = 0;
  if (item(stamp).taken_by.compare_exchange_strong(before, life_.mark())) return;
  fail(Finding::Twice,
       before == Item::kWrittenOff ? "taken though it was gone with a killed taker"
                                   : "taken by " + name_of(before) + " before",
       stamp);
}

void Takings::found_nothing() {
  for (const Ring& ring : rings_) {
    auto& cleared = record(ring.incarnation).cleared;
    std::uint64_t seen = cleared.load();
    while (seen < ring.done && !cleared.compare_exchange_weak(seen, ring.done)) {
    }
  }
  life_.count(Count::Closed);
  while (rings_.size() > kMostRings && rings_.front().over) rings_.erase(rings_.begin());
}

}  // namespace lot::chaos
