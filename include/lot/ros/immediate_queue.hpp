// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <ros/callback_queue_interface.h>

namespace lot::ros {

/// For the lowest latency: LOT's thread calls the callbacks of LOT's subscribers itself, as soon as
/// it has read the message. Where a callback queue is between them it wakes another thread for
/// that, which costs as much again as the message's whole way.
///
///     nh.setCallbackQueue(lot::ros::immediate_queue());
///     auto sub = nh.subscribe<Image>("/camera/image", 10, &callback);
///     ros::spin();                     // for all others' callbacks
///
/// Shape:   the process's one; it lives for ever.
/// Threads: these callbacks come one after the other, on LOT's thread, which brings all messages of
///          the process: what takes long holds up the other topics. All else that has this queue
///          (timers, services, ordinary subscribers) goes to ros::getGlobalCallbackQueue(). Signals
///          are blocked there. Elsewhere the end of a subscriber waits for its own callback while
///          that is at work, as with any queue; the end of a publisher waits at most 0.1 s for
///          subscribers that have just come.
/// Errors:  what a callback throws is logged, and goes no further.
/// In a callback: publish, advertise, subscribe and shut down at will.
::ros::CallbackQueueInterface* immediate_queue();

}  // namespace lot::ros
