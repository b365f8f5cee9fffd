// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace lot::detail {

/// The calling thread, as other threads of its process name it while they wait for it.
class ThisThread {
 public:
  /// The kernel's id of the thread; the thread asks for it once. (A child of fork() asks again. A
  /// child of raw clone() does not, and returns its parent's id: the id is only a hint.)
  static std::uint32_t id() noexcept {
    const std::uint32_t known = id_;
    return known != 0 ? known : ask();
  }

  /// Ends a section for which other threads may have waited: gives back a priority that a waiter
  /// has lent to this thread. REQUIRES: the section has named this thread by id().
  static void passed() noexcept {
    // seq_cst, as a fence for the compiler alone: it keeps the look behind the end of the section.
    // A waiter on this core interrupts this thread between two instructions. So the waiter came
    // before our look, or it sees that the section is over. We can miss a waiter on another core
    // for an instant: it sleeps until its time is over. The load is relaxed: a loan carries no
    // data.
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
  /// PI futexes, by thread id modulo kLoans: the id of the thread that others wait for; 0: no
  /// thread. Waiters write them, and so do that thread and the kernel.
  static inline Loan loans_[kLoans]{};
};

/// How a thread waits for another thread of its process that needs only a few more instructions.
///
/// The waiter spins and yields for some ten microseconds. If the other thread has not passed by
/// then, it is not running: the waiter lends it its priority and sleeps until that thread has
/// passed. So a real-time waiter leaves its core, and no thread of a priority in between keeps the
/// other thread from going on.
///
/// The loan is a PI futex that the waiter locks in the name of the other thread. The waiter then
/// sleeps on it. The kernel raises the owner, and the owner unlocks the futex in
/// ThisThread::passed(). All that costs the other thread one look. Without such a loan the waiter
/// sleeps 50 us at a time. The loan is missing before Linux 5.14, in a sandbox, and when another
/// thread happens to use the same futex.
///
///     patience.wait(thread);  // the caller looks again each time
///
/// Threads: one object for each waiter.
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

  /// `thread`: the thread that the caller waits for, or 0 when the caller does not know it. A wrong
  /// id does no harm.
  void wait(std::uint32_t thread) noexcept;

 private:
  void withdraw() noexcept;

  unsigned looks_ = 0;
  std::uint32_t named_ = 0;  ///< the thread whose loan bears its name, since before our last look
};

}  // namespace lot::detail
