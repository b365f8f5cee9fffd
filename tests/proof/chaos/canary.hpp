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

  /// True when some processor has not been given for a while to a process that asked for it; the
  /// board says so to the nodes as well.
  bool machine_stalls();

 private:
  Board& board_;
  std::vector<pid_t> canaries_;
};

/// True when the machine has stalled a moment ago: a node that gave up waiting then is not to
/// blame.
bool has_stalled(const Board& board);

}  // namespace lot::chaos
