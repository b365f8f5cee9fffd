// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace lot::detail {

/// The calling thread, as others of its process name it while they wait for it.
class ThisThread {
 public:
  /// The kernel's id, asked for once. (A child of fork() asks again. One of raw clone() does not,
  /// and says its parent's: the id is only a hint.)
  static std::uint32_t id() noexcept {
    const std::uint32_t known = id_;
    return known != 0 ? known : ask();
  }

  /// Behind a section for which others may have waited: gives a priority back that was lent to us.
  /// REQUIRES: the section has named us by id().
  static void passed() noexcept {
    // Only the compiler is kept from looking too early. A waiter on this core interrupts us between
    // two instructions, so that it has come before our look or sees that the section is over. One
    // on another core can be missed for an instant: it sleeps until its time is over.
    std::atomic_signal_fence(std::memory_order_seq_cst);
    if (loans_[id_ % kLoans].load(std::memory_order_relaxed) != 0) give_back();
  }

 private:
  friend class Patience;
  using Loan = std::atomic<std::uint32_t>;
  static constexpr std::size_t kLoans = 256;

  static std::uint32_t ask() noexcept;
  static void give_back() noexcept;
  static void forget() noexcept;
  static Loan& loan_to(std::uint32_t thread) noexcept { return loans_[thread % kLoans]; }

  static inline thread_local std::uint32_t id_ = 0;
  /// PI futexes: the thread with so many in hand, as far as others wait for it; 0: no thread.
  /// Written by waiters, by that thread, and by the kernel.
  static inline Loan loans_[kLoans]{};
};

/// How a thread waits for another thread of its process that is within a few instructions.
///
/// It spins and yields for some ten microseconds. Then the other thread is not running: the waiter
/// lends it its priority and sleeps until that thread has passed. So a real-time waiter leaves its
/// core, and no thread of a priority in between keeps the other one from going on.
///
/// The loan is a PI futex that the waiter locks in the name of the other thread. It then sleeps on
/// it; the kernel raises the owner, which unlocks it in ThisThread::passed(). All that costs the
/// other thread one look. Where there is no such loan (Linux before 5.14, a sandbox, the futex is
/// another thread's by chance) the waiter sleeps 50 us at a time.
///
///     patience.wait(thread);  // the caller looks again each time
///
/// Threads: one object a waiter.
/// Memory:  private to the process.
/// Source:  futex(2), FUTEX_LOCK_PI2.
class Patience {
 public:
  Patience() noexcept = default;
  ~Patience() {
    if (named_ != 0) withdraw();
  }
  Patience(const Patience&) = delete;
  Patience& operator=(const Patience&) = delete;

  /// `thread`: the one that is waited for, or 0 when that is not known. A wrong one does no harm.
  void wait(std::uint32_t thread) noexcept;

 private:
  void withdraw() noexcept;

  unsigned looks_ = 0;
  std::uint32_t named_ = 0;  ///< whose loan bears its name, since before our last look
};

}  // namespace lot::detail
