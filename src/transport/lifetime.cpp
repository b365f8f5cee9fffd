// SPDX-License-Identifier: Apache-2.0
#include "transport/lifetime.hpp"

namespace lot::transport {

/// All handles have gone. The last thread that comes out makes the owner leave, if no pointer
/// remains.
void Lifetime::exit_when_closing() noexcept {
  life_.fetch_sub(kInside, std::memory_order_seq_cst);  // see life_
  leave_if_unused();
  drop_reference();
}

bool Lifetime::has_left() noexcept {
  if (!left_.load(std::memory_order_seq_cst)) return false;  // see life_
  const std::lock_guard guard(leave_mutex_);  // the thread that has set it may take it back
  // Relaxed: the mutex carries it.
  return left_.load(std::memory_order_relaxed);
}

void Lifetime::leave_if_unused() noexcept {
  const auto unused = [this] {
    // seq_cst: see life_.
    return (life_.load(std::memory_order_seq_cst) & kInsideMask) == 0 && !owner_.holds_pointers();
  };
  {
    const std::lock_guard guard(leave_mutex_);
    // Relaxed: the mutex carries it.
    if (left_.load(std::memory_order_relaxed) || !unused()) return;
    left_.store(true, std::memory_order_seq_cst);  // see life_
    if (!unused()) {  // a weak pointer was locked just now: its holder calls this again
      left_.store(false, std::memory_order_seq_cst);  // see life_
      return;
    }
  }
  owner_.leave();
  drop_reference();  // the reference that all handles share
}

}  // namespace lot::transport
