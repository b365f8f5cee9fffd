// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>

#include "lot/fuzz.hpp"

#include "support/processes.hpp"
#include "transport/participant.hpp"

namespace lot::fuzz {

/// Aborts when something is still held in the participant's segment, though nobody has a handle or
/// a pointer any more. (A warden may be at it: so it is looked at again for a while.)
template <class Participants>
void require_nothing_left(const Participants& participants) {
  std::string left;
  const bool clean = testing::eventually([&] {
    for (transport::Participant* p : participants) p->trim();
    for (transport::Participant* p : participants) p->collect();
    const testing::Audit audit((*participants.begin())->segment());
    left = audit.text();
    return audit.nothing();
  });
  if (!clean) std::fprintf(stderr, "%s\n", left.c_str());
  require(clean, "nothing is left behind");
}

}  // namespace lot::fuzz
