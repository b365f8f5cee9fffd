// SPDX-License-Identifier: Apache-2.0
#pragma once

/// LOT in ROS 1: what a node writes. See lot::ros::NodeHandle.
#include "lot/ros/immediate_queue.hpp"
#include "lot/ros/message.hpp"
#include "lot/ros/node_handle.hpp"
#include "lot/ros/publisher.hpp"
#include "lot/ros/relay.hpp"
#include "lot/ros/standard.hpp"
#include "lot/ros/subscriber.hpp"
