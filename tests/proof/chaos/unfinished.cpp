// SPDX-License-Identifier: Apache-2.0
#include "unfinished.hpp"

#include <sys/stat.h>

namespace lot::chaos {

std::uint64_t segment_file(const std::string& path) {
  struct stat file {};
  return stat(path.c_str(), &file) == 0 ? file.st_ino : 0;
}

std::string unfinished(Board& board, const Hands& hands, const Living& living,
                       std::uint64_t segment) {
  for (std::uint32_t topic = kFirstTask; topic < kFirstShape; ++topic) {
    if (living.pullers[topic] == 0) continue;
    std::uint32_t unnoted = 0;
    for (std::uint32_t i = board.newest[topic].load(); i != 0; i = board.incarnations[i].before) {
      const Incarnation& r = board.incarnations[i];
      if (r.segment != segment) continue;
      const std::uint64_t done = r.done.load();
      for (std::uint64_t n = 0; n < r.begun.load(); ++n) {
        const Item& task = board.item(r, n);
        const std::uint32_t worker = task.taken_by.load();
        const std::uint32_t deliveries = task.deliveries.load();
        unnoted += deliveries - task.noted.load();
        if ((worker & Item::kFinishing) != 0 || (n >= done && deliveries == 0)) continue;
        return std::string(kTopic[topic].name) + ": nobody has finished task " + std::to_string(n) +
               " of incarnation " + std::to_string(i) + ", chaos" + std::to_string(r.slot) +
               " life " + std::to_string(r.life) + (board.lives(r) ? " (lives)" : " (ended)") +
               ", depth " + std::to_string(r.depth) + ", done " + std::to_string(done) +
               "; it was delivered " + std::to_string(deliveries) + " times";
      }
    }
    if (unnoted > hands.seen_in_segment(topic)) {
      return std::string(kTopic[topic].name) + ": " + std::to_string(unnoted) +
             " deliveries were not noted, but " + std::to_string(hands.seen_in_segment(topic)) +
             " workers were killed over a take";
    }
  }
  return "";
}

}  // namespace lot::chaos
