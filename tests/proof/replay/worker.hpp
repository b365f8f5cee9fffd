// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace lot::replay {

/// What the conductor gives a worker on its command line.
struct Task {
  std::uint64_t seed;
  unsigned worker;      ///< its number, from 0
  unsigned life;        ///< how many workers of that number were killed before it
  unsigned operations;  ///< so many, then it waits for the others
  bool only_letters;    ///< it does nothing but push and pull letters
};

/// A worker's whole life: it publishes, reads, keeps and takes by the public interface, as `task`
/// says, and tells the conductor. Returns the exit status of the process.
int work(const Task& task);

}  // namespace lot::replay
