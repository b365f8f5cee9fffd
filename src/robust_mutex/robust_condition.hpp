// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "futex/futex.hpp"
#include "robust_mutex/robust_mutex.hpp"

namespace lot {

/// A condition variable beside a RobustMutex: waiters sleep on it until what the mutex guards has
/// changed.
///
/// It is one word in shared memory, {changes : 31 | a waiter sleeps : 1}. No word counts waiters: a
/// waiter that is killed leaves at most a mark, which costs one needless wake.
///
/// Every wake is for all waiters, in the end. A wake for one would be lost if that waiter is killed
/// before it gets the mutex.
///
///     A waiter that has the mutex and finds nothing to do:
///       seen = condition.announce(); unlock; sleep_until(seen, ...)
///     A thread that has the mutex and has changed something:
///       wake = condition.changed(); unlock; if (wake) wake_all()
///
/// Threads: announce() and changed() under the mutex; all others at any time.
/// Crash:   a thread that is killed between changed() and wake_all() leaves sleepers without a
///          mark. The reaper calls renew() and wakes unconditionally. So does the process that gets
///          the mutex with Outcome::OwnerDied.
/// Source:  futex(2).
///
/// Edges
///   Q1  renew() (release) -> announce() (acquire)
///       carries: what the caller of renew() stored before, without the mutex.
///   H1  see lockfree_ring/ear.hpp
template <class Word = std::atomic<std::uint32_t>>
class RobustCondition {
 public:
  explicit RobustCondition(Word& word) noexcept : word_(word) {}

  /// Says that the caller is about to sleep. Returns the value to sleep on.
  std::uint32_t announce() {
    bool stood = false;
    return announce(stood);
  }
  /// The same. `stood`: another waiter had said so before, on the same value.
  std::uint32_t announce(bool& stood) {
    const std::uint32_t seen = word_.fetch_or(kWaits, std::memory_order_seq_cst);  // Q1, H1
    stood = (seen & kWaits) != 0;
    return seen | kWaits;
  }

  /// Sleeps until something has changed since announce(). False when the deadline has passed. In
  /// both cases the caller locks and looks again.
  bool sleep_until(std::uint32_t seen, const futex::Deadline& deadline) const noexcept {
    return futex::wait(&word_, seen, deadline);
  }

  /// Says that something has changed. True when a waiter may sleep: the caller then sees to it that
  /// all wake.
  [[nodiscard]] bool changed() {
    // Both steps are relaxed: the mutex orders them.
    if ((word_.load(std::memory_order_relaxed) & kWaits) == 0) return false;
    word_.fetch_add(kWaits, std::memory_order_relaxed);  // takes the mark away, and is a change
    return true;
  }
  void wake_all() const noexcept { futex::wake_all(&word_); }

  /// Counts a change that the mutex does not guard, or one for which no process may have woken the
  /// waiters. The caller then wakes all, whatever the mark says. With the mutex or without it.
  void renew() {
    // Adds 2, so that the mark stays: only a caller with the mutex may take it away.
    word_.fetch_add(2 * kWaits, std::memory_order_seq_cst);  // Q1, H1
  }

 private:
  static constexpr std::uint32_t kWaits = 1;
  Word& word_;
};

}  // namespace lot
