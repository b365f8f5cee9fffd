// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <utility>

#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <std_msgs/String.h>

#include "lot/ros.hpp"

namespace lot::ros::test {

using String = lot::ros::Message<std_msgs::String_>;

/// A topic of its own for each case.
inline std::string fresh_topic() {
  static int n = 0;
  return "/handles" + std::to_string(++n);
}

/// Spins until it holds. False: in vain for a minute.
inline bool comes(const std::function<bool()>& condition) {
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > until) return false;
    ::ros::getGlobalCallbackQueue()->callAvailable(::ros::WallDuration(0.01));
  }
  return true;
}

inline void say(const lot::ros::Publisher<String>& publisher, const char* text) {
  auto message = publisher.loan();
  message->data = text;
  publisher.publish(std::move(message));
}

}  // namespace lot::ros::test
