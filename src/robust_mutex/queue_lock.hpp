// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <new>
#include <string>

#include "robust_mutex/robust_condition.hpp"
#include "robust_mutex/robust_mutex.hpp"

/// The queue's other engine, as most queues are built: every step under one lock, and a condition
/// to sleep on. It is kept to compare with.
///
/// The words are the ring's and so are the steps (lockfree_ring/ring.hpp): the lock only lets one
/// in at a time. So each step leaves words that are true by themselves wherever its owner is
/// killed, and the reaper, which takes no lock, repairs both engines alike. One thing is left to
/// the next owner: nobody may have been told of the last change. It wakes all.
///
/// Also if two got in at once (a process has damaged the word) no message would be lost: each step
/// is made for that.
namespace lot::mutex_engine {

using Word = std::atomic<std::uint32_t>;

/// What a queue of this engine has besides the ring's words.
struct alignas(64) Lock {
  Word held;     ///< lock_word.hpp
  Word arrived;  ///< the condition on which readers sleep, instead of on slots
};

/// One process's handle of a queue's lock. The ring has none: then it does nothing.
///
/// Threads: as a mutex.
/// Crash:   the next owner wakes all.
class QueueLock {
 public:
  QueueLock() noexcept = default;
  /// `space` is the word on which the queue's sender sleeps, `path` what errors name.
  QueueLock(Lock& lock, Word& space, LockOwner& owner, const std::string& path) noexcept
      : lock_(&lock), space_(&space), owner_(&owner), path_(&path) {}

  /// Throws lot::Error when a stopped process keeps the lock.
  void lock() const {
    if (lock_ != nullptr && !take()) refuse();
  }
  /// The same where nothing may be thrown: false when a stopped process keeps it. The step is done
  /// all the same then, since its words are true by themselves.
  bool lock_if_possible() const noexcept { return lock_ == nullptr || take(); }
  void unlock() const noexcept {
    if (lock_ != nullptr) RobustMutex(lock_->held, *owner_).unlock();
  }

 private:
  bool take() const noexcept;
  [[noreturn]] void refuse() const;

  Lock* lock_ = nullptr;
  Word* space_ = nullptr;
  LockOwner* owner_ = nullptr;
  const std::string* path_ = nullptr;
};

/// Alone with a queue of the mutex engine, while this lives.
class Alone {
 public:
  explicit Alone(const QueueLock& lock) : lock_(lock) { lock_.lock(); }
  Alone(const QueueLock& lock, std::nothrow_t) noexcept
      : lock_(lock), held_(lock.lock_if_possible()) {}
  ~Alone() {
    if (held_) lock_.unlock();
  }
  Alone(const Alone&) = delete;
  Alone& operator=(const Alone&) = delete;

  void lock() {
    lock_.lock();
    held_ = true;
  }
  void unlock() noexcept {
    lock_.unlock();
    held_ = false;
  }

 private:
  const QueueLock& lock_;
  bool held_ = true;
};

}  // namespace lot::mutex_engine
