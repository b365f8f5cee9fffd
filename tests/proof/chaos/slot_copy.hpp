// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>

#include "message.hpp"

namespace lot::chaos {

/// A mistake that only messages in slots can have: the oldest message of a topic, copied out of its
/// slot, without a second look at `begin`. Halfway it pauses, so that a publisher can write over
/// the slot. Nothing where the topic has no message in a slot.
std::optional<Plain> copy_of_a_slot(const std::string& segment_path, const char* topic);

}  // namespace lot::chaos
