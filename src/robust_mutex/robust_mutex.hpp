// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <string>

#include "lot/detail/atomics.hpp"

#include "robust_mutex/lock_word.hpp"

namespace lot {

/// The process in whose name locks are taken: it says whether another holder lives.
class LockOwner {
 public:
  /// lock::make_name() of the process; 0: it is no participant, has no lock, and gets none.
  virtual std::uint32_t name() const noexcept = 0;
  /// True when the process of that name is dead. A living one never is; a dead one is, soon.
  virtual bool is_gone(std::uint32_t name) noexcept = 0;
  /// A process that is stopped, for people to read: which one it is, and what to do about it. The
  /// first is empty when it is not stopped, or not seen from here. May take milliseconds.
  struct Stopped {
    std::string process, advice;
  };
  virtual Stopped stopped(std::uint32_t /*name*/) const { return {}; }

 protected:
  ~LockOwner() = default;
};

/// A lock between processes that survives the death of its holder: one word of 32 bits in shared
/// memory (lock_word.hpp).
///
/// When the holder dies, the next one to lock takes the lock over and is told so; what the lock
/// guards must then be repaired, or, as everywhere in LOT, be correct word by word, so that there
/// is nothing to repair.
///
/// A waiter sleeps on the word. One that was woken may be killed before it gets to the lock: so all
/// look by themselves as well, first after 2 ms, then ever more seldom. Only after such a look do
/// they ask whether the holder lives, so contention costs no call.
///
/// Threads: of one process exclude each other. A thread that ends while it has the lock is no
///          death: the others wait until their time has passed.
/// Crash:   a holder that is killed leaves Outcome::OwnerDied to the next one.
/// Source:  futex(2).
class RobustMutex {
 public:
  using Word = std::atomic<std::uint32_t>;
  enum class Outcome { Locked, OwnerDied, Busy };

  RobustMutex(Word& word, LockOwner& owner) noexcept : word_(word), owner_(owner) {}

  /// Locks, waiting until `timeout` has passed (steady clock): Busy then.
  Outcome lock_for(std::chrono::nanoseconds timeout) noexcept;
  /// Locks if it is free or its holder is dead.
  Outcome try_lock() noexcept;
  void unlock() noexcept;
  /// The name of the process that has it; 0: none.
  std::uint32_t holder() const noexcept;

 private:
  Outcome wait_for(std::chrono::nanoseconds timeout, std::uint32_t name) noexcept;
  bool take_over(std::uint32_t seen, std::uint32_t name) noexcept;

  Word& word_;
  LockOwner& owner_;
};

}  // namespace lot
