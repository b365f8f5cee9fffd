// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <string_view>

/// What topics and types are called in a DDS domain: as ROS 2 calls them.
namespace lot::gateway {

/// "rt/camera/front" for LOT's "/camera/front", and for "camera/front". None: ROS 2 allows no such
/// name. Throws std::bad_alloc.
std::optional<std::string> dds_topic_of(std::string_view topic);
/// "/camera/front" for "rt/camera/front". None: it is no topic of ROS 2. Throws std::bad_alloc.
std::optional<std::string> topic_of_dds(std::string_view dds_topic);
/// "robot::msg::dds_::Frame_" for the schema "robot/msg/Frame". Throws std::bad_alloc.
std::string dds_type_of(std::string_view schema);
/// Whether ROS 2 allows a node to be called so.
bool is_node_name(std::string_view name);

}  // namespace lot::gateway
