// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "lot/any_type.hpp"

namespace lot::segment {
class Segment;
}

/// What the writer of a gateway says of itself in its user data: `key=value;` as ROS 2's own
/// writers do. Any program may say anything there.
namespace lot::gateway {

struct Peer {
  std::string segment;  ///< where its messages come from: place_of()
  AnyType type;         ///< what they are in LOT; none: it is not known, or could not be said
  /// The gateway's Ledger, which counts the samples of all of its writers of a topic. 0: it has
  /// none.
  std::uint64_t ledger = 0;
  std::uint64_t written = 0;  ///< samples that its earlier writers of the topic had written
};

/// Tells apart the segments of all machines. Throws lot::Error (a system call failed),
/// std::bad_alloc.
std::string place_of(const segment::Segment& segment);

/// Throws std::bad_alloc.
std::string user_data_of(const Peer& peer);
/// None: the writer is no gateway's. Throws lot::Error (EBADMSG) for a type that can be none,
/// std::bad_alloc.
std::optional<Peer> peer_of(std::string_view user_data);

}  // namespace lot::gateway
