// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <vector>

#include "lot/detail/mutex.hpp"

#include "futex/futex.hpp"
#include "segment/segment.hpp"
#include "transport/eviction.hpp"
#include "transport/held_since.hpp"
#include "transport/idle_look.hpp"
#include "transport/membership.hpp"
#include "transport/pool.hpp"
#include "transport/reaper.hpp"
#include "transport/rings.hpp"
#include "transport/stock.hpp"
#include "transport/topics.hpp"
#include "transport/warden_thread.hpp"
#include "transport/world.hpp"

namespace lot::transport {

/// Watches over the other participants: it sleeps on their notices and reaps the dead. It answers
/// their errands, finishes what other threads have put off because a lock was taken for a moment,
/// and takes the process out of the segment at the end.
///
/// Threads: start() and stop() from one thread; the rest from any.
/// Crash:   the errands of a process that is killed stay undone until it is reaped.
class Warden {
 public:
  /// What it does its work with.
  struct Parts {
    Membership& membership;
    World& world;
    const Holder& holder;
    WardenThread& thread;
    Eviction& eviction;
    Stock& stock;
    Reaper& reaper;
    Rings& rings;
    Topics& topics;
    /// Held while the lock file is opened: a forked child must know all descriptors that it has to
    /// close.
    detail::Mutex& no_fork;
  };
  explicit Warden(const Parts& parts);
  Warden(const Warden&) = delete;
  Warden& operator=(const Warden&) = delete;

  /// Starts the thread. Throws lot::Error.
  void start();
  /// Leaves the segment, and returns when that is done.
  void stop() noexcept;
  /// A signal ends the process: the files are to go (Membership::settle_files()). Does not wait.
  void end_soon() noexcept;

 private:
  std::uint32_t index() const noexcept { return membership_.index(); }
  void run();
  void leave() noexcept;
  void stand_guard() noexcept;
  void settle_files() noexcept;
  void run_errands(std::uint32_t asked) noexcept;
  bool look_around() noexcept;
  bool watch_others() noexcept;
  void give_unused_back() noexcept;
  void wake() noexcept;

  Membership& membership_;
  liveness::LockFile& lock_file_;
  liveness::Presence& presence_;
  segment::Segment& segment_;
  World& world_;
  const Holder& holder_;
  WardenThread& thread_;
  Eviction& eviction_;
  Stock& stock_;
  Reaper& reaper_;
  Rings& rings_;
  Topics& topics_;
  detail::Mutex& no_fork_;

  std::atomic<bool> warden_stop_{false};
  // Both relaxed: errands (E1) carry them.
  std::atomic<bool> is_ending_{false};  ///< a signal ends the process: the files are to go
  // Only the thread uses these.
  IdleLook idle_look_;
  HeldSince held_since_;
  detail::FutexWaits watched_;       ///< what it sleeps on
  futex::Clock::time_point looked_;  ///< its last look for what no errand and no notice tells it
  bool orphans_ = true;              ///< the last search found orphans, or there was no search yet
  std::uint32_t adoptions_ = 0;      ///< Directory::adoptions before the last search
};

}  // namespace lot::transport
