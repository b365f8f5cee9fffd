// SPDX-License-Identifier: Apache-2.0
#include "transport/lifetime.hpp"

namespace lot::transport {

/// Between enter() and exit() the owner neither leaves nor is destroyed. REQUIRES: the caller has a
/// pointer or a weak pointer of it.
void Lifetime::enter() noexcept {
  // seq_cst: life_ and left_ are looked at crosswise (see life_).
  life_.fetch_add(kReference | kInside, std::memory_order_seq_cst);
}

void Lifetime::exit() noexcept {
  // Relaxed: the compare-and-swap decides. seq_cst: see life_.
  std::uint64_t v = life_.load(std::memory_order_relaxed);
  while ((v & kClosing) == 0) {
    // seq_cst: see life_.
    if (life_.compare_exchange_weak(v, v - (kReference | kInside), std::memory_order_seq_cst,
                                    std::memory_order_relaxed)) {
      return;
    }
  }
  // All handles have gone. The last thread that comes out makes the owner leave, if no pointer
  // remains.
  life_.fetch_sub(kInside, std::memory_order_seq_cst);
  leave_if_unused();
  drop_reference();
}

void Lifetime::drop_reference() noexcept {
  // acq_rel, as in std::shared_ptr: the thread that deletes the owner sees what the others did.
  const std::uint64_t left = life_.fetch_sub(kReference, std::memory_order_acq_rel) - kReference;
  if ((left & kReferences) == 0) owner_.end();
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
    if (left_ || !unused()) return;
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
