// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <chrono>
#include <cstdint>

#include "board.hpp"
#include "settings.hpp"

namespace lot::chaos {

inline double seconds(std::chrono::steady_clock::duration d) {
  return std::chrono::duration<double>(d).count();
}

/// What a run has done, and the table of it.
struct Tally {
  /// Where the killed were.
  struct Kills {
    std::uint32_t first_moments = 0;
    std::uint32_t later = 0;
    std::uint32_t stopped = 0;
  };

  std::chrono::steady_clock::time_point begun = std::chrono::steady_clock::now();
  std::uint32_t kills = 0;
  std::array<Kills, kDoingNames.size()> kills_while{};
  std::uint32_t lives = 0;
  std::uint32_t left = 0;
  std::uint32_t no_room = 0;
  std::uint32_t gave_up = 0;  ///< while the machine stood still
  std::uint32_t killed_over_a_take = 0;
  std::uint32_t gone_with_takers = 0;  ///< items that these had in hand
  std::uint32_t epochs = 0;
  std::uint32_t audits = 0;
  std::chrono::steady_clock::duration stood_still{};

  /// Its last line is the summary.
  void print(const Board& board, const Settings& settings) const;
};

}  // namespace lot::chaos
