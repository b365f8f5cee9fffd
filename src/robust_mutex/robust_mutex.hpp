// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <pthread.h>

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
  void unlock() noexcept;

 private:
  Outcome outcome(int result) noexcept;
  pthread_mutex_t& mutex_;
};

}  // namespace lot
