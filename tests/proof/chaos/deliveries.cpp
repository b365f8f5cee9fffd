// SPDX-License-Identifier: Apache-2.0
#include "deliveries.hpp"

#include <algorithm>
#include <string>

namespace lot::chaos {

void Deliveries::got(const Stamp& stamp, std::uint32_t deliveries) {
  check_origin(stamp);
  Item& task = item(stamp);
  const std::uint32_t before = task.taken_by.exchange(life_.mark());
  if (before == Item::kFinishing) fail(Finding::Twice, "delivered when it was finished", stamp);
  const std::uint32_t worker = before & ~Item::kFinishing;
  if (worker != 0 && life_.board.lives((worker & 0xff) - 1, worker >> 8)) {
    fail(Finding::Twice, "delivered while " + name_of(worker) + " works on it", stamp);
  }
  const std::uint32_t known = task.deliveries.exchange(static_cast<std::uint16_t>(deliveries));
  task.noted.fetch_add(1);
  if (deliveries <= known) {
    fail(Finding::Twice,
         "delivery " + std::to_string(deliveries) + ", after delivery " + std::to_string(known),
         stamp);
  }
  if (deliveries == 1) {
    got_first(stamp);
  } else {
    life_.count(Count::Redelivered);
  }
}

void Deliveries::got_first(const Stamp& stamp) {
  const auto at = std::find_if(rings_.begin(), rings_.end(),
                               [&](const Ring& r) { return r.incarnation == stamp.incarnation; });
  if (at == rings_.end()) {
    if (rings_.size() == kMostRings) rings_.erase(rings_.begin());
    rings_.push_back({stamp.incarnation, stamp.number + 1});
    return;
  }
  if (stamp.number < at->next) {
    fail(Finding::Twice, "new when " + std::to_string(at->next) + " was next", stamp);
  }
  at->next = stamp.number + 1;
}

void Deliveries::before_finish(const Stamp& stamp) {
  item(stamp).taken_by.store(Item::kFinishing | life_.mark());
}
void Deliveries::finished(const Stamp& stamp) { item(stamp).taken_by.store(Item::kFinishing); }
void Deliveries::before_give_back(const Stamp& stamp) { item(stamp).taken_by.store(0); }

}  // namespace lot::chaos
