// SPDX-License-Identifier: Apache-2.0
#include "tally.hpp"

#include <cstdio>

namespace lot::chaos {
void Tally::print(const Board& board, const Settings& settings) const {
  std::printf("\nkilled while         first 12 ms    later   of these, stopped\n");
  Kills all;
  for (std::size_t i = 0; i < kills_while.size(); ++i) {
    const Kills& k = kills_while[i];
    std::printf("  %-17s %12u %8u %10u\n", kDoingNames[i], k.first_moments, k.later, k.stopped);
    all.first_moments += k.first_moments;
    all.stopped += k.stopped;
  }
  std::printf("\n");
  for (std::size_t i = 0; i < kCountNames.size(); ++i) {
    std::printf("  %12llu  %s\n",
                static_cast<unsigned long long>(board.total(static_cast<Count>(i))),
                kCountNames[i]);
  }
  const double took = seconds(std::chrono::steady_clock::now() - begun);
  std::printf("  %12u  epochs, %u audits\n  %12u  lives, %u left cleanly, %u found no room\n",
              epochs, audits, lives, left, no_room);
  std::printf("  %12u  takers killed over a take, %u items gone with them\n", killed_over_a_take,
              gone_with_takers);
  if (stood_still.count() != 0) {
    std::printf(
        "  the machine stood still for %.0f s, which was not held against the nodes; %u gave up"
        " meanwhile\n",
        seconds(stood_still), gave_up);
  }
  std::printf(
      "\nsummary: %u kills (%u in the first 12 ms, %u while stopped) in %.0f s, %u processes,"
      " %llu messages read",
      kills, all.first_moments, all.stopped, took, settings.processes,
      static_cast<unsigned long long>(board.total(Count::Received)));
  for (std::size_t i = 0; i < kFindings; ++i) {
    std::printf(", %u %s", board.found[i].load(), kFindingNames[i]);
  }
  std::printf(", seed %llu\n", static_cast<unsigned long long>(settings.seed));
  std::fflush(stdout);
}

}  // namespace lot::chaos
