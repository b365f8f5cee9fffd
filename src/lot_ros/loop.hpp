// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "lot/wait_set.hpp"

namespace lot::ros {

/// LOT's thread of a process: rings are read, messages are delivered and links are looked after
/// there. What roscpp's threads reach of LOT has this, and may outlive the session.
///
/// What is LOT's thread's (rings, links, arrivals()) one thread has at a time: that one, except in
/// what it does afterwards, where callbacks of the application are; or one that is in call().
///
/// Threads: all members may be called at once, but arrivals().
class Loop {
 public:
  explicit Loop(Wait wait);
  Loop(const Loop&) = delete;
  Loop& operator=(const Loop&) = delete;

  using Clock = std::chrono::steady_clock;

  /// Calls it on LOT's thread, soon or then; never, when that ends first.
  void soon(std::function<void()> work) { at(Clock::time_point(), std::move(work)); }
  void at(Clock::time_point time, std::function<void()> work);
  /// Calls it here, while this thread has what is LOT's thread's: at once if it has that already.
  /// Waits for no callback of the application.
  void call(const std::function<void()>& work);

  /// Calls it on LOT's thread when that has done what it does now, so that it finds nothing half
  /// done, and keeps nobody waiting.
  void afterwards(std::function<void()> work);

  /// What LOT's thread waits for besides. REQUIRES: this thread has what is LOT's thread's.
  WaitSet& arrivals() noexcept { return arrivals_; }

  /// What LOT's thread does.
  void run();
  /// It ends soon. False when LOT's thread is long about that, in a callback of the application's,
  /// or is this thread.
  bool end() noexcept;
  /// Counts the turns of LOT's thread: each does what is due, reads rings, and then does what was
  /// to be done afterwards. REQUIRES: this is that thread.
  std::uint64_t turn() const noexcept { return turn_; }
  /// True on LOT's thread.
  bool is_here() const noexcept { return thread_.load() == std::this_thread::get_id(); }
  /// True where this thread has what is LOT's thread's.
  bool has_turn() const noexcept { return owner_.load() == std::this_thread::get_id(); }
  /// True in a forked child, which has no such thread: nothing is done there any more.
  bool is_inherited() const noexcept;

 private:
  class Turn;
  void guarded(const std::function<void()>& work);
  bool do_what_is_due();

  const int process_;
  std::mutex mutex_;
  std::multimap<Clock::time_point, std::function<void()>> work_;  ///< by when it is to be done
  bool ended_ = false;                                            ///< nobody does any work any more
  bool ends_ = false;
  std::atomic<std::thread::id> thread_{};
  std::atomic<std::thread::id> owner_{};  ///< who has what is LOT's thread's; changes under mutex_
  unsigned callers_ = 0;                  ///< that wait in call()
  std::condition_variable changed_;       ///< one of these, or ended_
  WaitSet arrivals_;
  std::vector<std::function<void()>> afterwards_;  ///< LOT's thread's own
  std::uint64_t turn_ = 0;
};

}  // namespace lot::ros
