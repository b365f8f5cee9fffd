// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <sys/types.h>
#include <vector>

#include "board.hpp"

namespace lot::chaos {

/// Tells a machine that stands still from nodes that do: one process on each processor does nothing
/// but say that it was given the processor. A virtual machine may withhold one for a minute.
class Canary {
 public:
  explicit Canary(Board& board);
  ~Canary();
  Canary(const Canary&) = delete;
  Canary& operator=(const Canary&) = delete;

  /// True when some processor has not been given to anybody who asked for a while; the board says
  /// so to the nodes as well.
  bool machine_stalls();

 private:
  Board& board_;
  std::vector<pid_t> canaries_;
};

/// True when the machine has stalled a moment ago: who then gave up waiting is not to blame.
bool has_stalled(const Board& board);

}  // namespace lot::chaos
