// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "lot/detail/mutex.hpp"
#include "lot/wait_set.hpp"

namespace lot::ros {

/// LOT's thread of a process: it reads rings, delivers messages and looks after links. roscpp's
/// threads reach this object through all that they have of LOT, so it may outlive the session.
///
/// One thread at a time has the *turn*: it alone may touch what belongs to LOT's thread (rings,
/// links, arrivals()). That is LOT's thread, except while it does what was left for afterwards,
/// which includes callbacks of the application; or it is a thread in call().
///
/// Threads: all members may be called at once, but arrivals().
class Loop {
 public:
  explicit Loop(Wait wait);
  Loop(const Loop&) = delete;
  Loop& operator=(const Loop&) = delete;

  using Clock = std::chrono::steady_clock;

  /// soon(), at(): has LOT's thread call `work`, soon or at that time. If LOT's thread ends first,
  /// it never calls it.
  void soon(std::function<void()> work) { at(Clock::time_point(), std::move(work)); }
  void at(Clock::time_point time, std::function<void()> work);
  /// Calls `work` on this thread, while this thread has the turn: at once if it has the turn
  /// already. Waits for no callback of the application.
  void call(const std::function<void()>& work);

  /// Has LOT's thread call `work` when it has done what it does now and has given the turn up. So
  /// `work` finds nothing half done, and no thread waits for it.
  void afterwards(std::function<void()> work);

  /// What else LOT's thread waits for. REQUIRES: this thread has the turn.
  WaitSet& arrivals() noexcept { return arrivals_; }

  /// What LOT's thread does.
  void run();
  /// Ends LOT's thread soon. False when that takes long, because LOT's thread is in a callback of
  /// the application's, or when this is LOT's thread.
  bool end() noexcept;
  /// Counts the rounds of LOT's thread. In each it does what is due and reads rings, and then does
  /// what was left for afterwards. REQUIRES: this is LOT's thread.
  std::uint64_t turn_number() const noexcept { return turn_; }
  /// True on LOT's thread.
  bool is_here() const noexcept {
    // Relaxed: only this thread itself can have stored its own id here.
    return thread_.load(std::memory_order_relaxed) == std::this_thread::get_id();
  }
  /// True when this thread has the turn.
  bool has_turn() const noexcept {
    // Relaxed: as in is_here().
    return owner_.load(std::memory_order_relaxed) == std::this_thread::get_id();
  }
  /// True in a forked child, which has no LOT's thread: nothing is done there any more.
  bool is_inherited() const noexcept;

 private:
  class Turn;
  void guarded(const std::function<void()>& work);
  bool do_what_is_due();

  const int process_;
  lot::detail::Mutex mutex_{lot::detail::Rank::Loop};
  std::multimap<Clock::time_point, std::function<void()>> work_;  ///< by when it is to be done
  bool ended_ = false;  ///< LOT's thread takes no work any more
  bool ends_ = false;
  std::atomic<std::thread::id> thread_{};
  std::atomic<std::thread::id> owner_{};  ///< the thread with the turn; changes under mutex_
  unsigned callers_ = 0;                  ///< threads that wait in call()
  lot::detail::Condition changed_;        ///< owner_, callers_ or ended_
  WaitSet arrivals_;
  std::vector<std::function<void()>> afterwards_;  ///< LOT's thread's own
  std::uint64_t turn_ = 0;
};

}  // namespace lot::ros
