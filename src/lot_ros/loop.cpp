// SPDX-License-Identifier: Apache-2.0
#include "lot_ros/loop.hpp"

#include <algorithm>
#include <csignal>
#include <future>
#include <memory>
#include <pthread.h>
#include <unistd.h>

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

void Loop::run() {
  thread_ = std::this_thread::get_id();
  pthread_setname_np(pthread_self(), "lot-ros");
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);  // signals are the application's
  for (;;) {
    std::function<void()> work;
    auto most = std::chrono::duration_cast<Clock::duration>(kLookPeriod);
    {
      const std::lock_guard guard(mutex_);
      const auto first = work_.begin();
      const auto now = Clock::now();
      if (first != work_.end() && first->first <= now) {
        work = std::move(first->second);
        work_.erase(first);
      } else if (ends_) {
        ended_ = true;
        return;
      } else if (first != work_.end()) {
        most = std::min(most, first->first - now);
      }
    }
    try {
      if (work) {
        work();
        most = {};  // rings have their turn, however much there is to do
      }
      arrivals_.run_once(most);
    } catch (const std::exception& e) {
      ROS_ERROR("LOT: %s", e.what());
    } catch (const XmlRpc::XmlRpcException& e) {
      ROS_ERROR("LOT: %s", e.getMessage().c_str());
    }
  }
}

void Loop::end() noexcept {
  ends_ = true;
  arrivals_.stop();
}

}  // namespace lot::ros
