// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <thread>
#include <utility>
#include <vector>

#include "lot/detail/mutex.hpp"
#include "lot/ros/immediate_queue.hpp"

namespace lot::ros {

/// The queue that immediate_queue() returns. roscpp may add callbacks under its own locks: those go
/// to the global callback queue.
///
/// Threads: all members may be called at once.
class ImmediateQueue final : public ::ros::CallbackQueueInterface {
 public:
  static ImmediateQueue& the();

  void addCallback(const ::ros::CallbackInterfacePtr& callback, std::uint64_t owner) override;
  /// When it returns, no callback of that owner is at work any more, but one in this thread.
  void removeByID(std::uint64_t owner) override;

  /// Calls the callback. REQUIRES: this thread holds no lock.
  void call(const ::ros::CallbackInterfacePtr& callback, std::uint64_t owner);

 private:
  using Work = std::pair<std::uint64_t, std::thread::id>;

  lot::detail::Mutex mutex_{lot::detail::Rank::Immediate};
  lot::detail::Condition done_;
  std::vector<Work> at_work_;
};

}  // namespace lot::ros
