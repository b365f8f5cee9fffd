// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>

#include "lot/fuzz.hpp"

#include "support/plant.hpp"
#include "support/processes.hpp"
#include "transport/participant.hpp"

namespace lot::fuzz {

/// Aborts when something is still held in the participant's segment, though nobody has a handle or
/// a pointer any more. (A warden may be at it: so it is looked at again for a while. A planted leak
/// need not be waited for as long.)
template <class Participants>
void require_nothing_left(const Participants& participants) {
  const auto patience = std::chrono::seconds(plant().empty() ? 30 : 1);
  std::string left;
  const auto nothing = [&] {
    for (transport::Participant* p : participants) p->stock().trim(transport::Stock::kNobody);
    for (transport::Participant* p : participants) p->reaper().collect();
    const testing::Audit audit((*participants.begin())->segment());
    left = audit.text();
    return audit.nothing();
  };
  const bool clean = testing::eventually(nothing, patience);
  if (!clean) std::fprintf(stderr, "%s\n", left.c_str());
  require(clean, "nothing is left behind");
}

}  // namespace lot::fuzz
