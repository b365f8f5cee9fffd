// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <vector>

#include "lot/ros/core.hpp"

namespace lot::ros {

/// A type of messages that a relay knows.
struct Relayed {
  const char* datatype;           ///< "my_msgs/Cloud"
  const detail::Kind& (*kind)();  ///< what LOT knows of it
};
/// The Relayed of a message that ROS has generated: `relayed<my_msgs::Cloud_>()`. Throws nothing.
template <template <class> class Generated>
[[nodiscard]] Relayed relayed() {
  return {::ros::message_traits::DataType<Generated<std::allocator<void>>>::value(),
          detail::kind_of<Message<Generated>>};
}

/// The program lot_relay, for types of your own:
///
///     #include <lot/ros/relay.hpp>
///     #include <my_msgs/Cloud.h>
///     int main(int argc, char** argv) {
///       return lot::ros::relay(argc, argv, {lot::ros::relayed<my_msgs::Cloud_>()});
///     }
///
/// A node `lot_relay IN OUT` that publishes on OUT what comes on IN: copied into shared memory once
/// where a plain node publishes it, not at all where a LOT node does. It waits for IN to have a
/// type. What latches on IN does so on OUT; of several publishers that latch, the last message.
/// `_queue_size:=N` (100): so many messages may wait; that many OUT keeps in shared memory, if
/// there is room.
///
/// Returns what main() does: 0 when it was asked to end (SIGINT, SIGTERM, rosnode kill), 1 for a
/// type that is not in `types`, and where ROS refuses a topic, 2 for a wrong command line.
///
/// Threads: one at a time, once in a process: it calls ros::init().
/// Errors:  what roscpp throws for a bad name; lot::Error and std::bad_alloc as Publisher.
/// Memory:  `queue_size` messages that wait, and as many in OUT's queue.
/// Crash:   as Publisher and Subscriber: publish the topic again by starting it again.
[[nodiscard]] int relay(int argc, char** argv, const std::vector<Relayed>& types);

}  // namespace lot::ros
