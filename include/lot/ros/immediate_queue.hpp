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
///          (timers, services, ordinary subscribers) goes to ros::getGlobalCallbackQueue().
///          Signals are blocked there. Who ends a topic's last subscriber, elsewhere, waits for the
///          callback that is at work: hold no lock meanwhile that a callback takes.
/// Errors:  what a callback throws is logged, and goes no further.
/// In a callback: publish, advertise, subscribe and shut down at will; but subscribe throws
/// lot::Error (EDEADLK) just while the topic's last subscriber is being shut down elsewhere.
::ros::CallbackQueueInterface* immediate_queue();

}  // namespace lot::ros
