// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "lot/ros/immediate_queue.hpp"

namespace lot::ros {

/// What immediate_queue() is. What roscpp adds it may add under its own locks: that goes elsewhere.
///
/// Threads: all members may be called at once.
class ImmediateQueue final : public ::ros::CallbackQueueInterface {
 public:
  static ImmediateQueue& the();

  void addCallback(const ::ros::CallbackInterfacePtr& callback, std::uint64_t owner) override;
  /// Nothing of that owner is at work any more when this returns, but in this thread.
  void removeByID(std::uint64_t owner) override;

  /// Calls it. REQUIRES: no lock is held.
  void call(const ::ros::CallbackInterfacePtr& callback, std::uint64_t owner);

 private:
  using Work = std::pair<std::uint64_t, std::thread::id>;

  std::mutex mutex_;
  std::condition_variable done_;
  std::vector<Work> at_work_;
};

}  // namespace lot::ros
