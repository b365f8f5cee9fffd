// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "lot/detail/wait.hpp"

namespace lot::detail {

/// A word of this process that says "stop", and that waiting threads sleep on beside the words
/// which they wait for.
///
/// Edges
///   W1  word = 1 (exchange, release) in set() -> load in is_set(), exchange in take() (acquire)
///       carries: what the thread or the signal handler that called set() wrote before.
///
/// Threads: all at once; set() also in a signal handler.
/// Crash:   private memory: it goes with the process.
class StopWord {
 public:
  bool is_set() const noexcept { return word_.load(std::memory_order_acquire) != 0; }  // W1
  /// Sets it, and wakes all threads that sleep on it. False: it was set. Does only what a signal
  /// handler may do, and leaves errno alone.
  bool set() noexcept;
  /// Clears it. True once for one set(), or for several that came together.
  bool take() noexcept {
    // Relaxed: the exchange acquires.
    return word_.load(std::memory_order_relaxed) != 0 &&
           word_.exchange(0, std::memory_order_acquire) != 0;  // W1
  }
  /// What to sleep on until it is set.
  FutexWait wait() const noexcept { return {&word_, 0}; }

 private:
  /// Futex: 1 = stop. An exchange and not a store sets it: it also carries what an earlier set() of
  /// another thread has released.
  std::atomic<std::uint32_t> word_{0};
};

/// Of a wait: null, nothing stops it.
inline bool is_set(const StopWord* stop) noexcept { return stop != nullptr && stop->is_set(); }

}  // namespace lot::detail
