// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "board.hpp"
#include "segment/segment.hpp"
#include "topics.hpp"

namespace lot::chaos {

/// What the living say that they have, at a checkpoint: no node publishes, all was read, and all
/// nodes have let go of what they had kept.
struct Living {
  std::uint32_t participants = 0;
  std::array<std::uint32_t, kTopics> pushers{};
  std::array<std::uint32_t, kTopics> pullers{};
  std::array<std::uint32_t, kTopics> observers{};
  std::array<std::uint32_t, kMostNodes> pushers_of{};  ///< each node
  std::array<std::uint32_t, kMostNodes> pullers_of{};  ///< each node, observers among them
};

/// What the segment holds that the living do not explain, or "":
///  - every index, ring, reader's cell, topic, home and ownership bit is a living participant's,
///    and there are as many of them as the living have;
///  - a topic that observers have and others, or observers only, is there once for each type, and
///    carries that whole type;
///  - a living one has no more blocks than its publishers can need, and than its readers can that
///    keep messages out of slots;
///  - what the orphanage keeps is a message that a living one still has in its ring, or that such
///    a message refers to;
///  - every granule belongs to a ring or a block that is in use.
std::string unexplained(segment::Segment& segment, const Living& living);

}  // namespace lot::chaos
