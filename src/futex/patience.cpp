// SPDX-License-Identifier: Apache-2.0
#include "lot/detail/patience.hpp"

#include <cerrno>
#include <csignal>
#include <ctime>
#include <linux/futex.h>
#include <pthread.h>
#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "lot/detail/atomics.hpp"

namespace lot::detail {
namespace {

constexpr unsigned kPauses = 100;
constexpr unsigned kYields = 16;
constexpr long kNap = 50'000;            ///< ns, without a loan
constexpr long kLoanPeriod = 1'000'000;  ///< ns; an owner that passes ends the loan at once

#ifndef FUTEX_LOCK_PI2
constexpr int kLockPi2 = 13;
#else
constexpr int kLockPi2 = FUTEX_LOCK_PI2;
#endif

// All orders in this file are relaxed. A loan only decides which thread runs and which sleeps. What
// the threads hand over is ordered by the word that they wait for.

/// Sleeps on a loan. Not by FUTEX_LOCK_PI: its deadline is on the wall clock, which may be set
/// back.
bool lock_pi(std::atomic<std::uint32_t>& loan) noexcept {
  timespec until{};
  clock_gettime(CLOCK_MONOTONIC, &until);
  until.tv_nsec += kLoanPeriod;
  if (until.tv_nsec >= 1'000'000'000) {
    until.tv_nsec -= 1'000'000'000;
    ++until.tv_sec;
  }
  return syscall(SYS_futex, &loan, kLockPi2 | FUTEX_PRIVATE_FLAG, 0, &until, nullptr, 0) == 0;
}

/// REQUIRES: the calling thread owns the futex, and `thread` is its id.
void unlock_pi(std::atomic<std::uint32_t>& loan, std::uint32_t thread) noexcept {
  // Relaxed: the loan tells nothing else.
  if (!loan.compare_exchange_strong(thread, 0, std::memory_order_relaxed,
                                    std::memory_order_relaxed)) {  // the kernel knows of waiters
    syscall(SYS_futex, &loan, FUTEX_UNLOCK_PI | FUTEX_PRIVATE_FLAG, 0, nullptr, nullptr, 0);
  }
}

/// Clears the loan of a thread that has ended.
///
/// The kernel marks a loan when a waiter sleeps on it, and leaves the mark when the waiter's time
/// is over. The owner takes the mark away when it passes. An owner that has ended never passes:
/// then its waiters clear the loan, and can lend to the next thread that has this place. (If a new
/// thread has the same id, its waiters sleep until their time is over.)
bool clear(std::atomic<std::uint32_t>& loan, std::uint32_t owner) noexcept {
  // Relaxed: the loan tells nothing else.
  return loan.compare_exchange_strong(owner, 0, std::memory_order_relaxed,
                                      std::memory_order_relaxed);
}

bool has_ended(std::uint32_t owner) noexcept {
  const auto thread = static_cast<pid_t>(owner & FUTEX_TID_MASK);
  return tgkill(getpid(), thread, 0) == -1 && errno == ESRCH;
}

void nap() noexcept {
  const timespec time{0, kNap};
  nanosleep(&time, nullptr);
}

}  // namespace

std::uint32_t ThisThread::ask() noexcept {
  static const int forgets = pthread_atfork(nullptr, nullptr, &forget);
  (void)forgets;
  return id_ = static_cast<std::uint32_t>(gettid());
}

void ThisThread::give_back() noexcept {
  Loan& loan = loan_to(id_);
  // Relaxed: the loan tells nothing else.
  if ((loan.load(std::memory_order_relaxed) & FUTEX_TID_MASK) == id_) unlock_pi(loan, id_);
}

/// Runs in the child of a fork().
void ThisThread::forget() noexcept {
  id_ = 0;
  // Relaxed: the child has one thread.
  for (Loan& loan : loans_) loan.store(0, std::memory_order_relaxed);
}

void Patience::wait(std::uint32_t thread) noexcept {
  if (looks_ < kPauses) {
    ++looks_;
    HardwareAtomics::pause();
    return;
  }
  if (looks_ < kPauses + kYields) {
    ++looks_;
    sched_yield();
    return;
  }
  if (thread == 0) return nap();
  auto& loan = ThisThread::loan_to(thread);
  std::uint32_t owner = loan.load(std::memory_order_relaxed);  // the loan tells nothing else
  if (named_ != thread || (owner & FUTEX_TID_MASK) != thread) {
    // First this puts the other thread's name into the loan, then the caller looks again. If the
    // other thread passes after that look, it finds its name.
    if (named_ != 0) withdraw();
    const bool is_others = owner != 0 && (owner & FUTEX_TID_MASK) != thread;
    if (is_others && has_ended(owner) && clear(loan, owner)) owner = 0;
    // Relaxed: the loan tells nothing else.
    if (owner == 0 && loan.compare_exchange_strong(owner, thread, std::memory_order_relaxed,
                                                   std::memory_order_relaxed)) {
      owner = thread;
    }
    if ((owner & FUTEX_TID_MASK) != thread) return nap();  // another thread shares this loan
    named_ = thread;
    return;
  }
  if (lock_pi(loan)) {
    named_ = 0;
    unlock_pi(loan, ThisThread::id());
  } else if (errno != ETIMEDOUT) {
    if (errno == ESRCH) {                            // the other thread has ended
      owner = loan.load(std::memory_order_relaxed);  // the loan tells nothing else
      if ((owner & FUTEX_TID_MASK) == thread) clear(loan, owner);
      named_ = 0;
    }
    nap();
  }
}

/// Takes the name out of the loan if no waiter sleeps on it: the named thread may never pass again.
void Patience::withdraw() noexcept {
  std::uint32_t owner = named_;
  // Relaxed: the loan tells nothing else.
  ThisThread::loan_to(named_).compare_exchange_strong(owner, 0, std::memory_order_relaxed,
                                                      std::memory_order_relaxed);
  named_ = 0;
}

}  // namespace lot::detail
