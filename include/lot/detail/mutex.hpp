// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>

#ifdef LOT_CHECK_LOCKS
#include <cstdio>
#include <cstdlib>
#endif

/// The private locks of the library, and the order in which a thread may take them
/// (docs/private-locks.md). The locks that lie in shared memory are another matter (docs/locks.md).
namespace lot::detail {

/// A lock's place in the order, outermost first. A thread that waits for a lock holds only locks of
/// lower ranks. A try is free: it waits for nothing. docs/private-locks.md has the same list.
enum class Rank : unsigned char {
  // lot::ros
  Camera,
  Opening,
  Session,
  Advertising,
  End,
  Outlet,
  Inlet,
  Taken,
  Ring,
  News,
  Made,
  Known,
  Idle,
  PeerNews,
  Loop,
  Intake,
  Immediate,
  // the gateway
  Gateway,
  // the library
  Recording,
  Signals,
  Listener,
  Queue,
  Joining,
  Leave,
  Departures,
  Topics,
  Reap,
  Settle,
  Keeper,
  Pools,
  Eviction,
  Ahead,
  Pool,
  Process,
  Notifier,
  Doubts,
};

// Code that is compiled with the check shares no function with code that is compiled without it.
#ifdef LOT_CHECK_LOCKS
#define LOT_LOCKS checked_locks
#else
#define LOT_LOCKS plain_locks
#endif
inline namespace LOT_LOCKS {

#ifdef LOT_CHECK_LOCKS
constexpr const char* name_of(Rank rank) noexcept {
  constexpr const char* kNames[] = {
      "Camera",     "Opening",  "Session",  "Advertising", "End",       "Outlet",
      "Inlet",      "Taken",    "Ring",     "News",        "Made",      "Known",
      "Idle",       "PeerNews", "Loop",     "Intake",      "Immediate", "Gateway",
      "Recording",  "Signals",  "Listener", "Queue",       "Joining",   "Leave",
      "Departures", "Topics",   "Reap",     "Settle",      "Keeper",    "Pools",
      "Eviction",   "Ahead",    "Pool",     "Process",     "Notifier",  "Doubts"};
  static_assert(sizeof(kNames) / sizeof(kNames[0]) == static_cast<unsigned>(Rank::Doubts) + 1);
  return kNames[static_cast<unsigned>(rank)];
}

/// The ranks that the calling thread holds.
///
/// Threads: each has its own.
class HeldLocks {
 public:
  static HeldLocks& mine() noexcept {
    static thread_local HeldLocks held;
    return held;
  }
  /// Ends the process if the thread may not wait for a lock of this rank now.
  void require(Rank rank) const noexcept {
    for (unsigned i = 0; i < count_; ++i) {
      if (ranks_[i] >= rank) fail("waits for", rank, ranks_[i]);
    }
  }
  void add(Rank rank) noexcept {
    if (count_ == kMost) fail("holds too many locks, and takes", rank, ranks_[0]);
    ranks_[count_++] = rank;
  }
  void remove(Rank rank) noexcept {
    unsigned i = count_;
    while (i != 0 && ranks_[i - 1] != rank) --i;
    if (i == 0) fail("unlocks, and does not hold,", rank, rank);
    ranks_[i - 1] = ranks_[--count_];
  }

 private:
  [[noreturn]] static void fail(const char* does, Rank rank, Rank held) noexcept {
    std::fprintf(stderr,
                 "lot: a thread that holds the lock %s %s the lock %s: see docs/private-locks.md\n",
                 name_of(held), does, name_of(rank));
    std::abort();
  }

  static constexpr unsigned kMost = 16;
  Rank ranks_[kMost]{};
  unsigned count_ = 0;
};

inline void before_lock(Rank rank) noexcept { HeldLocks::mine().require(rank); }
inline void after_lock(Rank rank) noexcept { HeldLocks::mine().add(rank); }
inline void before_unlock(Rank rank) noexcept { HeldLocks::mine().remove(rank); }
#else
constexpr void before_lock(Rank) noexcept {}
constexpr void after_lock(Rank) noexcept {}
constexpr void before_unlock(Rank) noexcept {}
#endif

/// A std::mutex with a place in the order. Code that is compiled with LOT_CHECK_LOCKS (the presets
/// asan, asan_ros and tsan) ends the process, and says both names, when a thread waits for a lock
/// that it may not wait for.
///
/// Threads: as std::mutex.
/// Memory:  private to a process. Without the check it is a std::mutex.
class Mutex {
 public:
#ifdef LOT_CHECK_LOCKS
  explicit constexpr Mutex(Rank rank) noexcept : rank_(rank) {}
#else
  explicit constexpr Mutex(Rank) noexcept {}
#endif
  Mutex(const Mutex&) = delete;
  Mutex& operator=(const Mutex&) = delete;

  void lock() {
    before_lock(rank());
    mutex_.lock();
    after_lock(rank());
  }
  bool try_lock() {
    const bool is_ours = mutex_.try_lock();
    if (is_ours) after_lock(rank());
    return is_ours;
  }
  void unlock() {
    before_unlock(rank());
    mutex_.unlock();
  }

 private:
  friend class Condition;

  std::mutex mutex_;
#ifdef LOT_CHECK_LOCKS
  constexpr Rank rank() const noexcept { return rank_; }
  const Rank rank_;
#else
  static constexpr Rank rank() noexcept { return {}; }
#endif
};

/// A std::condition_variable for a Mutex.
///
/// Threads: as std::condition_variable.
class Condition {
 public:
  void notify_one() noexcept { condition_.notify_one(); }
  void notify_all() noexcept { condition_.notify_all(); }

  template <class Predicate>
  void wait(std::unique_lock<Mutex>& lock, Predicate is_true) {
    while (!is_true()) {
      Waiting waiting(*lock.mutex());
      condition_.wait(waiting.lock);
    }
  }
  template <class Predicate>
  bool wait_for(std::unique_lock<Mutex>& lock, std::chrono::steady_clock::duration time,
                Predicate is_true) {
    const auto until = std::chrono::steady_clock::now() + time;
    while (!is_true()) {
      Waiting waiting(*lock.mutex());
      if (condition_.wait_until(waiting.lock, until) == std::cv_status::timeout) break;
    }
    return is_true();
  }

 private:
  /// While a thread waits, it holds the Mutex for std alone.
  struct Waiting {
    explicit Waiting(Mutex& of) : mutex(of), lock(of.mutex_, std::adopt_lock) {
      before_unlock(mutex.rank());
      before_lock(mutex.rank());
    }
    Waiting(const Waiting&) = delete;
    Waiting& operator=(const Waiting&) = delete;
    ~Waiting() {
      (void)lock.release();
      after_lock(mutex.rank());
    }
    Mutex& mutex;
    std::unique_lock<std::mutex> lock;
  };

  std::condition_variable condition_;
};

#ifndef LOT_CHECK_LOCKS
static_assert(sizeof(Mutex) == sizeof(std::mutex) &&
              sizeof(Condition) == sizeof(std::condition_variable));
#endif

}  // namespace LOT_LOCKS
}  // namespace lot::detail
