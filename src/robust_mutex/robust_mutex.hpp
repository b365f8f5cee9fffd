// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <string>

#include "lot/detail/atomics.hpp"

#include "robust_mutex/lock_word.hpp"

namespace lot {

/// The participant under whose name a process takes locks. It also says whether another holder
/// lives.
class LockOwner {
 public:
  /// lock::make_name() of the process. 0: the process is no participant, has no lock, and gets
  /// none.
  virtual std::uint32_t name() const noexcept = 0;
  /// True when the process of that name is dead. Never true for a living one. For a dead one it may
  /// take a while to become true.
  virtual bool is_gone(std::uint32_t name) noexcept = 0;
  /// A stopped process, described for people: which one it is, and what to do about it. `process`
  /// is empty when it is not stopped, or when it cannot be seen from here. May take milliseconds.
  struct Stopped {
    std::string process, advice;
  };
  virtual Stopped stopped(std::uint32_t /*name*/) const { return {}; }
  /// After each such time a process that waits asks whether the one that it waits for is stopped.
  static constexpr std::chrono::milliseconds kStoppedPatience{800};

  /// Throws lot::Error (ESTALE), naming `path`, when the process is no participant any more.
  void require_place(const std::string& path) const;

 protected:
  ~LockOwner() = default;
};

/// A lock between processes that survives the death of its holder: one word of 32 bits in shared
/// memory (lock_word.hpp).
///
/// When the holder dies, the next process to lock takes the lock over, and the outcome tells it so.
/// What the lock guards must then be repaired. Or, as everywhere in LOT, each word of it is correct
/// by itself, so that there is nothing to repair.
///
/// A waiter sleeps on the word. A waiter that was woken may be killed before it gets the lock. So
/// all waiters look by themselves as well, first after 2 ms, then ever more seldom. Only then do
/// they ask whether the holder lives, so contention costs no system call.
///
/// Threads: the threads of one process exclude each other. A thread that ends while it has the lock
///          does not count as a death: the others wait until their time has passed.
/// Crash:   a holder that is killed leaves Outcome::OwnerDied to the next one.
/// Source:  futex(2).
class RobustMutex {
 public:
  using Word = std::atomic<std::uint32_t>;
  enum class Outcome { Locked, OwnerDied, Busy };

  RobustMutex(Word& word, LockOwner& owner) noexcept : word_(word), owner_(owner) {}

  /// Locks. Waits until `timeout` has passed (steady clock), and then returns Busy.
  Outcome lock_for(std::chrono::nanoseconds timeout) noexcept;
  /// Locks if the lock is free or its holder is dead.
  Outcome try_lock() noexcept;
  void unlock() noexcept;
  /// The name of the process that has the lock; 0: none.
  std::uint32_t holder() const noexcept;

 private:
  Outcome wait_for(std::chrono::nanoseconds timeout, std::uint32_t name) noexcept;
  bool take_over(std::uint32_t seen, std::uint32_t name) noexcept;

  Word& word_;
  LockOwner& owner_;
};

}  // namespace lot
