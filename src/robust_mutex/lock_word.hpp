// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

/// The word of a lock between processes, and each step that changes it. The caller sleeps, and asks
/// whether a holder lives (robust_mutex.hpp). docs/locks.md has the reasons.
///
/// 0: free. Else {a process sleeps : 1 | incarnation : 22 | participant + 1 : 9}: the last two are
/// the name of the lock's holder. No two processes get the same name while it may stand in a lock.
/// So a word that has not changed means that the same process still has the lock.
///
/// Crash: a holder that is killed leaves its name. Others take the lock over from it.
///
/// Edges
///   L1  unlock: name -> 0 (release) -> try_lock: 0 -> name (acquire)
///       carries: what the lock guards.
///   L2  a holder's death, or the next owner of its index -> the caller's question before take_over
///       carries: the same. The kernel says that the holder is dead after it has ended it. A
///       process that has taken the holder's seat has acquired that, and has released it again.
///   L3  a name is put into the word (release) -> seen(), announce() (acquire)
///       carries: the incarnation of the name's index. By it others know whether the name belongs
///       to the living process of that index.
namespace lot::lock {

inline constexpr std::uint32_t kSleepers = std::uint32_t{1} << 31;
inline constexpr std::uint32_t kParticipantBits = 9;
inline constexpr std::uint32_t kParticipants = (std::uint32_t{1} << kParticipantBits) - 1;
inline constexpr std::uint32_t kIncarnations = std::uint32_t{1} << (31 - kParticipantBits);

/// REQUIRES: participant < kParticipants.
constexpr std::uint32_t make_name(std::uint32_t participant, std::uint32_t incarnation) {
  return (incarnation % kIncarnations) << kParticipantBits | (participant + 1);
}
constexpr std::uint32_t name(std::uint32_t word) { return word & ~kSleepers; }
/// The participant of a name. Not below kParticipants for a name that no process has (a damaged
/// word).
constexpr std::uint32_t participant(std::uint32_t name) { return (name & kParticipants) - 1; }
constexpr std::uint32_t incarnation(std::uint32_t name) { return name >> kParticipantBits; }

template <class P>
class LockWord {
 public:
  using Word = typename P::template Atomic<std::uint32_t>;

  explicit LockWord(Word& word) noexcept : word_(word) {}

  /// Takes the lock if it is free. `has_slept`: the caller has slept for the lock, and may have got
  /// the only wake. It sets the mark, since others may still sleep.
  bool try_lock(std::uint32_t name, bool has_slept) {
    std::uint32_t free = 0;
    return word_.compare_exchange_strong(free, has_slept ? name | kSleepers : name,
                                         std::memory_order_acq_rel,  // L1, L3
                                         std::memory_order_relaxed);
  }

  /// Says that the caller is about to sleep. Returns the value to sleep on, or 0 when the lock is
  /// free.
  std::uint32_t announce() {
    std::uint32_t seen = word_.load(std::memory_order_acquire);  // L3
    while (seen != 0 && (seen & kSleepers) == 0) {
      if (word_.compare_exchange_strong(seen, seen | kSleepers, std::memory_order_relaxed,
                                        std::memory_order_acquire)) {  // L3
        seen |= kSleepers;
      }
    }
    return seen;
  }

  std::uint32_t seen() const { return word_.load(std::memory_order_acquire); }  // L3

  /// Takes the lock over from the dead holder that `seen` names. False: another process was
  /// quicker. The mark stays, since no process has woken those that sleep. REQUIRES: that holder is
  /// dead.
  bool take_over(std::uint32_t seen, std::uint32_t name) {
    return word_.compare_exchange_strong(seen, name | kSleepers,
                                         std::memory_order_release,  // L3; L2 is before
                                         std::memory_order_relaxed);
  }

  /// Sets the lock free. True when a process may sleep: the caller wakes one. It is never a plain
  /// store: if another process has damaged the word, a third one may have taken the lock since.
  [[nodiscard]] bool unlock(std::uint32_t name) {
    std::uint32_t seen = name;
    if (word_.compare_exchange_strong(seen, 0, std::memory_order_release,  // L1
                                      std::memory_order_relaxed)) {
      return false;
    }
    return seen == (name | kSleepers) &&
           word_.compare_exchange_strong(seen, 0, std::memory_order_release,  // L1
                                         std::memory_order_relaxed);
  }

 private:
  Word& word_;
};

}  // namespace lot::lock
