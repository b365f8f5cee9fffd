// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <new>
#include <string>

#include "robust_mutex/robust_condition.hpp"
#include "robust_mutex/robust_mutex.hpp"

/// The queue's other engine, built like most queues: every step is done under one lock, and waiters
/// sleep on a condition. It is kept as a comparison for the ring.
///
/// It has the ring's words and the ring's steps (lockfree_ring/ring.hpp). The lock only lets one
/// process in at a time. So wherever its owner is killed, each word is true by itself. The reaper
/// takes no lock, and repairs both engines alike. One thing is left to the lock's next owner: the
/// dead one may not have woken others for its last change. So the next owner wakes all.
///
/// Even if two processes got in at once (a third has damaged the word), no message would be lost:
/// each step of the ring allows for that.
namespace lot::mutex_engine {

using Word = std::atomic<std::uint32_t>;

/// What a queue of this engine has besides the ring's words.
struct alignas(64) Lock {
  Word held;     ///< lock_word.hpp
  Word arrived;  ///< the condition on which readers sleep, instead of on slots
};

/// One process's handle of a queue's lock. A queue of the ring engine has no lock: then the handle
/// does nothing.
///
/// Threads: as a mutex.
/// Crash:   the next owner of the lock wakes all.
class QueueLock {
 public:
  QueueLock() noexcept = default;
  /// `space` is the word on which the queue's sender sleeps. `path` is the path that errors name.
  QueueLock(Lock& lock, Word& space, LockOwner& owner, const std::string& path) noexcept
      : lock_(&lock), space_(&space), owner_(&owner), path_(&path) {}

  /// Throws lot::Error when a stopped process keeps the lock.
  void lock() const {
    if (lock_ != nullptr && !take()) refuse();
  }
  /// As lock(), for callers that must not throw: false when a stopped process keeps the lock. Then
  /// the caller does its step all the same, since each word is true by itself.
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

/// Holds the lock of a queue of the mutex engine while it lives.
class QueueGuard {
 public:
  explicit QueueGuard(const QueueLock& lock) : lock_(lock) { lock_.lock(); }
  QueueGuard(const QueueLock& lock, std::nothrow_t) noexcept
      : lock_(lock), held_(lock.lock_if_possible()) {}
  ~QueueGuard() {
    if (held_) lock_.unlock();
  }
  QueueGuard(const QueueGuard&) = delete;
  QueueGuard& operator=(const QueueGuard&) = delete;

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
