// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace lot::transport {

struct Holder;
class Memory;

/// A run of memory that could not be had.
struct Shortfall {
  std::uint32_t asker = 0;  ///< the index of the pool that wanted it
  std::uint64_t granules = 0;
  int error = 0;  ///< ENOSPC when the file system had no memory
};

/// Says, for people, why a segment has no room for so many bytes: what would have fitted, which
/// process holds most, and what helps.
std::string describe_shortage(Memory& memory, const Shortfall& shortfall, std::size_t bytes);
/// The same, for the queue of a new publisher on a topic.
std::string describe_ring_shortage(Memory& memory, const Shortfall& shortfall, std::uint32_t topic);
/// The same, where all blocks are in use.
std::string describe_block_shortage(Memory& memory);
/// Says why there is no room for a publisher that has all that PusherOptions::max_bytes gives it.
/// `block`: the block of its message.
std::string describe_limit(const Holder& holder, std::size_t bytes, std::uint32_t block);

}  // namespace lot::transport
