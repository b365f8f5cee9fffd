// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <optional>
#include <pthread.h>

#include "futex/futex.hpp"

namespace lot {

/// A lock between processes that survives the death of its holder.
///
/// It wraps a pthread mutex that lies in shared memory. When the holder dies, the next one to lock
/// gets the lock and is told so; what the lock guards must then be repaired, or, as everywhere in
/// LOT, be correct word by word, so that there is nothing to repair.
///
/// Only ever NORMAL + ROBUST + PROCESS_SHARED: recursive and error-checking kinds compare thread
/// ids, which collide between PID namespaces.
///
/// Who waits for it, or wakes a waiter, is not in the C library meanwhile. There the kernel counts
/// it among those who may have the lock: killed, it would set an owner free that has the same
/// thread id in another PID namespace (the first process of a container is always 1). The next
/// owner then puts the lock into its own list of robust locks, by pointers within the lock, and the
/// first one's list ends there: of the locks that it has had for longer nobody would learn that it
/// has died, and if it lives it unlinks the lock through pointers of the other process. So a waiter
/// sleeps by itself and tries when the lock looks free, and wakes are sent when it is unlocked.
/// What is left is a kill within the few instructions of a try or an unlock (or the C library's
/// wake, when somebody has begun to sleep within them), when one with the same thread id takes the
/// lock just then.
///
/// Threads: lock and unlock by the same thread.
/// Memory:  sizeof(pthread_mutex_t), address-free.
/// Crash:   a holder that is killed leaves Outcome::OwnerDied to the next one.
/// Source:  pthread_mutexattr_setrobust(3), Linux robust futexes.
class RobustMutex {
 public:
  enum class Outcome { Locked, OwnerDied, Busy };

  explicit RobustMutex(pthread_mutex_t& mutex) noexcept : mutex_(mutex) {}

  /// Makes the mutex in fresh memory; done once, before the segment can be found.
  static void construct(pthread_mutex_t& memory);

  /// Locks, however long that takes; never Busy, unless the memory is damaged.
  Outcome lock() noexcept;
  /// Locks, waiting until `timeout` has passed (steady clock): Busy then.
  Outcome lock_for(std::chrono::nanoseconds timeout) noexcept;
  Outcome try_lock() noexcept;
  /// True while a living thread holds it, as far as its word says: reads, and changes nothing.
  bool looks_held() const noexcept;
  /// What to sleep on until its holder dies or unlocks it, which wakes one of those who sleep (but
  /// not when it is killed while it unlocks). Nothing when nobody holds it.
  std::optional<detail::FutexWait> watch() noexcept;
  void unlock() noexcept;

 private:
  int attempt() noexcept;
  void mark() noexcept;
  void sleep_while_held(futex::Clock::time_point until) noexcept;
  Outcome outcome(int result) noexcept;
  pthread_mutex_t& mutex_;
};

}  // namespace lot
