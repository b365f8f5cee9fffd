// SPDX-License-Identifier: Apache-2.0
#include "lot_ros/loop.hpp"

#include <algorithm>
#include <pthread.h>
#include <unistd.h>
#include <utility>

#include <ros/console.h>
#include <xmlrpcpp/XmlRpcException.h>

namespace lot::ros {
namespace {

using namespace std::chrono_literals;

constexpr auto kLookPeriod = 1s;
/// So long end() waits for a callback that is at work: the callback may itself wait for what the
/// ending thread has.
constexpr auto kLastCallback = 100ms;

}  // namespace

Loop::Loop(Wait wait) : process_(getpid()), arrivals_(wait) {}

bool Loop::is_inherited() const noexcept { return getpid() != process_; }

void Loop::at(Clock::time_point time, std::function<void()> work) {
  if (is_inherited()) return;
  {
    const std::lock_guard guard(mutex_);
    if (ended_) return;
    work_.emplace(time, std::move(work));
  }
  if (!is_here()) arrivals_.stop();
}

/// While it lives, this thread has the turn.
class Loop::Turn {
 public:
  /// `is_caller`: a thread in call(), which may be LOT's thread in a callback.
  Turn(Loop& loop, bool is_caller) : loop_(loop) {
    std::unique_lock lock(loop.mutex_);
    // Relaxed, all of owner_ here: the mutex carries it.
    if (is_caller) {
      ++loop.callers_;
      // Relaxed: LOT's thread has named itself before it took the turn, with the mutex.
      const bool is_lots = loop.owner_.load(std::memory_order_relaxed) ==
                           loop.thread_.load(std::memory_order_relaxed);
      if (is_lots) loop.arrivals_.stop();  // it may be asleep
    }
    // LOT's thread lets callers go first: else it would take the next turn at once, again and
    // again.
    loop.changed_.wait(lock, [&] {
      // Relaxed: the mutex carries it.
      const bool is_free = loop.owner_.load(std::memory_order_relaxed) == std::thread::id();
      return is_free && (is_caller || loop.callers_ == 0);
    });
    if (is_caller) --loop.callers_;
    loop.owner_.store(std::this_thread::get_id(), std::memory_order_relaxed);  // as above
  }
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;
  ~Turn() {
    const std::lock_guard guard(loop_.mutex_);
    loop_.owner_.store(std::thread::id(), std::memory_order_relaxed);  // the mutex carries it
    loop_.changed_.notify_all();
  }

 private:
  Loop& loop_;
};

void Loop::call(const std::function<void()>& work) {
  if (is_inherited()) return;
  if (has_turn()) return work();
  const Turn turn(*this, true);
  work();
}

void Loop::afterwards(std::function<void()> work) {
  if (is_here()) {
    afterwards_.push_back(std::move(work));
  } else {
    soon([this, work = std::move(work)]() mutable { afterwards_.push_back(std::move(work)); });
  }
}

/// Calls `work` and logs what it throws, so that the next work is done all the same.
void Loop::guarded(const std::function<void()>& work) {
  try {
    work();
  } catch (const std::exception& e) {
    ROS_ERROR("LOT: %s", e.what());
  } catch (const XmlRpc::XmlRpcException& e) {
    ROS_ERROR("LOT: %s", e.getMessage().c_str());
  } catch (...) {  // the user's callbacks may throw anything
    ROS_ERROR("LOT: a callback has thrown something that is no std::exception");
  }
}

void Loop::run() {
  // Relaxed: other threads compare it with their own id, which it never is.
  thread_.store(std::this_thread::get_id(), std::memory_order_relaxed);
  pthread_setname_np(pthread_self(), "lot-ros");
  while (!is_inherited() && do_what_is_due()) {  // a callback may have forked
    while (!afterwards_.empty()) {
      for (const auto& each : std::exchange(afterwards_, {})) {
        if (!is_inherited()) guarded(each);
      }
    }
    ++turn_;
  }
}

/// Does the work that is due, then waits for arrivals until the next work is due. False: LOT's
/// thread ends.
bool Loop::do_what_is_due() {
  const Turn turn(*this, false);
  std::vector<std::function<void()>> due;
  auto most = std::chrono::duration_cast<Clock::duration>(kLookPeriod);
  {
    const std::lock_guard guard(mutex_);
    const auto now = Clock::now();
    const auto later = work_.upper_bound(now);
    for (auto work = work_.begin(); work != later; ++work) due.push_back(std::move(work->second));
    work_.erase(work_.begin(), later);
    if (!due.empty()) {
      most = {};
    } else if (ends_) {
      ended_ = true;
      return false;
    } else if (later != work_.end()) {
      most = std::min(most, later->first - now);
    }
  }
  for (const auto& work : due) guarded(work);
  // Where work was due, once more: at() has told of that work by stop(), and after a stop()
  // run_once() reads no ring.
  if (!due.empty()) guarded([&] { arrivals_.run_once(most); });
  guarded([&] { arrivals_.run_once(most); });
  return true;
}

bool Loop::end() noexcept {
  std::unique_lock lock(mutex_);
  ends_ = true;
  arrivals_.stop();
  return !is_here() && changed_.wait_for(lock, kLastCallback, [this] { return ended_; });
}

}  // namespace lot::ros
