// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <unordered_map>

#include "segment/segment.hpp"
#include "transport/pool.hpp"
#include "transport/world.hpp"

namespace lot::transport {

/// Since when this process holds what it holds: a table for people (segment::Sightings). It is
/// written once a second, so it costs a loan, a pull and a release nothing.
///
/// Threads: one at a time, the warden.
/// Crash:   killed anywhere in note(), a place of the table is empty or true.
class HeldSince {
 public:
  HeldSince(segment::Segment& segment, World& world, const Holder& holder) noexcept
      : segment_(segment), world_(world), holder_(holder) {}

  void note() noexcept;

 private:
  /// By block and generation: since when, in ns.
  using Held = std::unordered_map<std::uint64_t, std::uint64_t>;
  void show(const Held& held, std::uint64_t now) noexcept;

  segment::Segment& segment_;
  World& world_;
  const Holder& holder_;
  Held held_since_;  ///< what the last look saw this process hold
};

}  // namespace lot::transport
