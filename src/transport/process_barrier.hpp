// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace lot::transport {

/// A barrier that one thread makes all running threads of the process pass. It is the heavy half of
/// a pair whose light half lies on a path that must be fast, and orders for the compiler only.
///
/// Threads: all members may be called at once.
/// Start:   it is registered before main(), where that costs 2 us (process_barrier.cpp).
/// Source:  membarrier(2), MEMBARRIER_CMD_PRIVATE_EXPEDITED.
class ProcessBarrier {
 public:
  /// False: the kernel has no such barrier, or ThreadSanitizer runs, which does not know it. A
  /// forked child asks anew.
  static bool is_there() noexcept;
  /// Takes some microseconds. REQUIRES: is_there().
  static void pass() noexcept;
};

}  // namespace lot::transport
