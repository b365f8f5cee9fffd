// SPDX-License-Identifier: Apache-2.0
#include "lot_ros/immediate_queue.hpp"

#include <algorithm>
#include <mutex>

#include <ros/callback_queue.h>
#include <ros/init.h>

namespace lot::ros {

ImmediateQueue& ImmediateQueue::the() {
  static auto* const queue = new ImmediateQueue;  // roscpp's threads may outlive static objects
  return *queue;
}

void ImmediateQueue::addCallback(const ::ros::CallbackInterfacePtr& callback, std::uint64_t owner) {
  ::ros::getGlobalCallbackQueue()->addCallback(callback, owner);
}

void ImmediateQueue::removeByID(std::uint64_t owner) {
  ::ros::getGlobalCallbackQueue()->removeByID(owner);
  std::unique_lock lock(mutex_);
  done_.wait(lock, [&] {
    return std::none_of(at_work_.begin(), at_work_.end(), [&](const Work& work) {
      return work.first == owner && work.second != std::this_thread::get_id();
    });
  });
}

void ImmediateQueue::call(const ::ros::CallbackInterfacePtr& callback, std::uint64_t owner) {
  if (::ros::isShuttingDown()) return;  // as roscpp's own queue does
  const Work work{owner, std::this_thread::get_id()};
  {
    const std::lock_guard guard(mutex_);
    at_work_.push_back(work);
  }
  const struct Done {
    ImmediateQueue& queue;
    const Work& work;
    ~Done() {
      const std::lock_guard guard(queue.mutex_);
      queue.at_work_.erase(std::find(queue.at_work_.begin(), queue.at_work_.end(), work));
      queue.done_.notify_all();
    }
  } done{*this, work};
  callback->call();
}

::ros::CallbackQueueInterface* immediate_queue() { return &ImmediateQueue::the(); }

}  // namespace lot::ros
