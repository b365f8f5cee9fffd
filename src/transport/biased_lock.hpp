// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "lot/detail/mutex.hpp"
#include "lot/detail/patience.hpp"

namespace lot::transport {

/// A lock between the threads of one process, for sections that never block. As long as only one
/// thread uses it, it costs no locked operation.
///
/// The first thread that takes the lock becomes its owner, and says by a plain store that it is
/// inside. A second thread revokes that bias: it raises shared_, makes every core that runs the
/// process pass a barrier (membarrier), and waits until the owner is out. From then on all threads
/// take an ordinary spin lock. When the owner has taken it kReturn times and no other thread has,
/// the owner gets the bias back.
///
/// A thread that waits lends its priority to the thread that is inside (detail::Patience). So a
/// real-time thread waits for the section and not for the scheduler. Only while a thread revokes
/// the bias, it sleeps 50 us at a time instead.
///
/// Edges
///   P1  busy_ = true, then shared_ load, by the owner
///       <-> shared_ = true, membarrier, then busy_ load, by the revoker:
///       one of the two sees the other. The owner's half is ordered for the compiler only. The
///       membarrier is the processor's half of both.
///   P2  busy_ = false / taken_ = 0 (release) -> busy_ load / taken_ compare-and-swap (acquire)
///       carries: what the lock guards.
///
/// Threads: all members may be called at once.
/// Memory:  private to the process, so that nothing of it can be left by a crash.
/// Source:  biased locking as in Java's monitors; the barrier is ProcessBarrier.
class BiasedLock {
 public:
  BiasedLock() noexcept;

  void lock() noexcept {
    detail::before_lock(detail::Rank::Pool);
    take();
    detail::after_lock(detail::Rank::Pool);
  }

  void unlock() noexcept {
    detail::before_unlock(detail::Rank::Pool);
    if (biased_) [[likely]] {
      biased_ = false;
      busy_.store(false, std::memory_order_release);  // P2
    } else {
      taken_.store(0, std::memory_order_release);  // P2
      detail::ThisThread::passed();
    }
  }

  /// How often the owner takes the lock alone before it gets the bias back. A barrier costs some
  /// microseconds, at most once in so many sections.
  static constexpr std::uint32_t kReturn = 1000;
  /// True if the owner needs no locked operation. It may change at any time. Relaxed: a hint.
  bool is_biased() const noexcept { return !shared_.load(std::memory_order_relaxed); }

 private:
  void take() noexcept {
    // Relaxed: only this thread itself can have stored its own number here.
    if (owner_.load(std::memory_order_relaxed) == self()) [[likely]] {
      busy_.store(true, std::memory_order_relaxed);               // P1
      std::atomic_signal_fence(std::memory_order_seq_cst);        // P1, for the compiler
      if (!shared_.load(std::memory_order_relaxed)) [[likely]] {  // P1
        biased_ = true;
        return;
      }
      busy_.store(false, std::memory_order_release);  // P2
    }
    lock_shared();
  }

  static constexpr std::uintptr_t kUnowned = 0;
  static constexpr std::uintptr_t kNobody = 1;

  /// A number that tells this thread from all other living threads.
  static std::uintptr_t self() noexcept {
    static thread_local char here;
    return reinterpret_cast<std::uintptr_t>(&here);
  }
  void lock_shared() noexcept;
  void revoke(detail::Patience& patience) noexcept;

  /// never changes once set: only the owner writes busy_
  std::atomic<std::uintptr_t> owner_{kUnowned};
  std::atomic<bool> busy_{false};  ///< the owner is inside, without taken_
  /// the bias was revoked; a thread writes it while it has taken_
  std::atomic<bool> shared_{false};
  std::atomic<std::uint32_t> taken_{0};  ///< the thread that is inside, for waiters; 0: none
  bool biased_ = false;  ///< the thread inside came in by the bias; guarded by the lock itself
  /// the owner's entries since another thread's; guarded by the lock itself
  std::uint32_t alone_ = 0;
};

}  // namespace lot::transport
