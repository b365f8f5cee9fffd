// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace lot::transport {

class Participant;

/// Why a segment has no room for so many bytes, for people: what would have fitted, who holds most,
/// and what helps. `error`: ENOSPC, when it was the file system that had none.
std::string describe_shortage(Participant& participant, std::size_t bytes, int error);
/// The same, for the queue of a new publisher on a topic.
std::string describe_ring_shortage(Participant& participant, std::uint32_t topic,
                                   std::uint32_t granules, int error);
/// The same, of a publisher that has all that PusherOptions::max_bytes gives it. `block`: of its
/// message.
std::string describe_limit(Participant& participant, std::size_t bytes, std::uint32_t block);

}  // namespace lot::transport
