// SPDX-License-Identifier: Apache-2.0
#include "transport/biased_lock.hpp"

#include "transport/process_barrier.hpp"

namespace lot::transport {

BiasedLock::BiasedLock() noexcept {
  if (!ProcessBarrier::is_there()) {
    // Relaxed, both: no other thread knows the lock yet.
    owner_.store(kNobody, std::memory_order_relaxed);
    shared_.store(true, std::memory_order_relaxed);  // as above
  }
}

void BiasedLock::lock_shared() noexcept {
  const std::uint32_t thread = detail::ThisThread::id();
  detail::Patience patience;
  std::uint32_t inside = 0;
  while (!taken_.compare_exchange_weak(inside, thread, std::memory_order_acquire,
                                       std::memory_order_relaxed)) {  // P2
    while (inside != 0) {
      patience.wait(inside);
      inside = taken_.load(std::memory_order_relaxed);  // relaxed: the compare-and-swap acquires
    }
  }
  // Relaxed, here and below: owner_ and shared_ change only with taken_ (P2).
  const std::uintptr_t owner = owner_.load(std::memory_order_relaxed);
  if (owner == kUnowned) {
    owner_.store(self(), std::memory_order_relaxed);  // as above
  } else if (owner != self()) {
    if (!shared_.load(std::memory_order_relaxed)) revoke(patience);  // as above
    alone_ = 0;
  } else if (++alone_ == kReturn) {
    shared_.store(false, std::memory_order_relaxed);  // relaxed: carried with taken_ (P2)
  }
}

void BiasedLock::revoke(detail::Patience& patience) noexcept {
  shared_.store(true, std::memory_order_seq_cst);  // P1
  ProcessBarrier::pass();
  while (busy_.load(std::memory_order_acquire)) patience.wait(0);  // P1, P2
}

}  // namespace lot::transport
