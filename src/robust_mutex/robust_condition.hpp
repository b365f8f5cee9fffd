// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "futex/futex.hpp"
#include "robust_mutex/robust_mutex.hpp"

namespace lot {

/// What those wait for whom a RobustMutex lets in: a change of what it guards.
///
/// One word in shared memory, {changes : 31 | somebody waits : 1}, and nothing that counts waiters:
/// a waiter that is killed leaves at most a mark, which costs one needless wake.
///
/// Every wake is for all. A wake for one is lost when that one is killed before it gets to the
/// lock.
///
///     waiter:   locked, nothing to do:  seen = condition.announce(); unlock; sleep_until(seen,
///     ...) changer:  locked, changed:        wake = condition.changed();  unlock; if (wake)
///     wake_all()
///
/// Threads: announce() and changed() under the mutex; all others at any time.
/// Crash:   killed between changed() and wake_all() it leaves sleepers without a mark. Whoever
///          repairs what the dead has left calls renew() and wakes unconditionally; so does who
///          gets the mutex with Outcome::OwnerDied.
/// Source:  futex(2).
///
/// Edges
///   C1  renew() (release) -> announce() (acquire)
///       carries: what the caller of renew() stored before, without the mutex.
template <class Word = std::atomic<std::uint32_t>>
class RobustCondition {
 public:
  explicit RobustCondition(Word& word) noexcept : word_(word) {}

  /// Says that the caller is about to sleep. Returns the value to sleep on.
  std::uint32_t announce() {
    return word_.fetch_or(kWaits, std::memory_order_acquire) | kWaits;  // C1
  }

  /// Sleeps until something has changed since announce(). False when the deadline has passed. The
  /// caller locks and looks again, in any case.
  bool sleep_until(std::uint32_t seen, const futex::Deadline& deadline) const noexcept {
    return futex::wait(&word_, seen, deadline);
  }

  /// Says that something has changed. True when somebody may sleep: the caller then wakes.
  [[nodiscard]] bool changed() {
    if ((word_.load(std::memory_order_relaxed) & kWaits) == 0) return false;
    word_.fetch_add(kWaits, std::memory_order_relaxed);  // takes the mark away, and is a change
    return true;
  }
  void wake_all() const noexcept { futex::wake_all(&word_); }

  /// A change that is no change of what the mutex guards, or of which nobody was told: the caller
  /// wakes everybody, whatever the mark says. With the mutex or without it.
  void renew() {
    // Takes no mark away, which needs the mutex: so by two.
    word_.fetch_add(2 * kWaits, std::memory_order_release);  // C1
  }

 private:
  static constexpr std::uint32_t kWaits = 1;
  Word& word_;
};

}  // namespace lot
