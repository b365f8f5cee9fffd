// SPDX-License-Identifier: Apache-2.0
#include "lot_ros/loop.hpp"

#include <algorithm>
#include <csignal>
#include <future>
#include <memory>
#include <pthread.h>
#include <unistd.h>
#include <utility>

#include <ros/console.h>
#include <xmlrpcpp/XmlRpcException.h>

namespace lot::ros {
namespace {

using namespace std::chrono_literals;

constexpr auto kLookPeriod = 1s;

}  // namespace

Loop::Loop() noexcept : process_(getpid()) {}

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

void Loop::call(const std::function<void()>& work) {
  if (is_inherited()) return;
  if (is_here()) return work();
  const auto task = std::make_shared<std::packaged_task<void()>>(work);
  auto done = task->get_future();
  bool ended = false;
  {
    const std::lock_guard guard(mutex_);
    ended = ended_;
    if (!ended) work_.emplace(Clock::time_point(), [task] { (*task)(); });
  }
  if (ended) {
    (*task)();
  } else {
    arrivals_.stop();
  }
  done.get();
}

void Loop::afterwards(std::function<void()> work) {
  if (is_here()) {
    afterwards_.push_back(std::move(work));
  } else {
    soon(std::move(work));
  }
}

/// One's error does not keep the next one from its turn.
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
  thread_ = std::this_thread::get_id();
  pthread_setname_np(pthread_self(), "lot-ros");
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);  // signals are the application's
  while (!is_inherited()) {                   // a callback may have forked
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
        return;
      } else if (later != work_.end()) {
        most = std::min(most, later->first - now);
      }
    }
    for (const auto& work : due) guarded(work);
    guarded([&] { arrivals_.run_once(most); });
    while (!afterwards_.empty()) {
      for (const auto& each : std::exchange(afterwards_, {})) guarded(each);
    }
    ++turn_;
  }
}

void Loop::end() noexcept {
  ends_ = true;
  arrivals_.stop();
}

}  // namespace lot::ros
