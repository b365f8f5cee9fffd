// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "segment/segment.hpp"
#include "transport/eviction.hpp"
#include "transport/pool.hpp"
#include "transport/stock.hpp"

namespace lot::transport {

/// Sees which publishers of this process are idle, and does for them what they do in their turns:
/// it destroys messages that other processes have let go of, and gives old idle memory back.
///
/// Threads: one at a time, the warden.
/// Memory:  private to the process, made once.
class IdleLook {
 public:
  /// Idle memory of a publisher goes back to the segment after this many looks.
  static constexpr std::uint8_t kOldLooks = 5;

  IdleLook(segment::Segment& segment, const Holder& holder, Stock& stock, Eviction& eviction);

  /// One look. Looks are about a second apart.
  void look() noexcept;

 private:
  void look_at_blocks(std::size_t pools) noexcept;

  segment::Segment& segment_;
  const Holder& holder_;
  Stock& stock_;
  Eviction& eviction_;
  std::vector<std::uint64_t> lives_;  ///< [blocks] `life` when it last looked
  /// [blocks] other processes held this message, as far as can be seen.
  std::vector<bool> was_held_;
  std::vector<std::uint64_t> prints_;      ///< [pools] a hash over the blocks at its last look
  std::vector<std::uint64_t> new_prints_;  ///< [pools] while it looks
  std::vector<bool> to_settle_;            ///< [pools] while it looks
  std::vector<std::uint8_t> idle_looks_;   ///< [blocks] how many looks in a row found it unchanged
  std::vector<bool> to_trim_;              ///< [pools] while it looks
};

}  // namespace lot::transport
