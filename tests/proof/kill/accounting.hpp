// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "segment/segment.hpp"

namespace lot::kill {

/// Everything that a segment's words say about participants who are not there, and memory whose
/// owner is not there: "" when each word is accounted for. `living` are the indexes in use.
std::string unaccounted(segment::Segment& segment, const std::vector<std::uint32_t>& living);

}  // namespace lot::kill
