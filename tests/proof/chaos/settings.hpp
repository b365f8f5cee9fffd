// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>

#include "lot/options.hpp"

#include "plant.hpp"

namespace lot::chaos {

/// What the command line says.
struct Settings {
  unsigned kills = 10000;
  unsigned processes = 46;
  unsigned checkpoint = 1000;  ///< kills from one calm to the next
  std::uint64_t seed = 0;
  std::chrono::seconds at_most{0};  ///< 0: as long as it takes
  std::chrono::seconds patience{30};
  Plant plant = Plant::None;
  bool namespaces = true;
  bool carry_on = false;     ///< after a finding
  std::string save_segment;  ///< where a copy of the segment goes when something is found
};

/// What the nodes of an epoch have in common.
struct Epoch {
  EngineOptions engine;
  bool rests = false;  ///< it has checkpoints with everybody alive
  bool roomy = true;   ///< memory never runs out: nothing is evicted, and missed counts are exact
};

/// The books of so many rings are kept: those of writers that are long gone are closed, the oldest
/// first.
inline constexpr std::size_t kMostRings = 128;

}  // namespace lot::chaos
