// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "lot/any_type.hpp"

/// The common messages of ROS 2 that have the same fields from Humble to Jazzy: std_msgs,
/// builtin_interfaces, geometry_msgs, sensor_msgs, nav_msgs and tf2_msgs.
namespace lot::gateway {

/// Whether that is the name in DDS of one of them: "geometry_msgs::msg::dds_::Twist_". Throws
/// std::bad_alloc.
bool is_ros_type(const std::string& dds_type);
/// What it is in LOT: the type that a program has with
/// `namespace geometry_msgs { struct Twist { Vector3 linear, angular; }; }`. None: it is none of
/// them. Throws std::bad_alloc.
AnyType type_of_ros(const std::string& dds_type);
/// Whether a message with that name in DDS and that `.msg` has the bytes and, but for capitals, the
/// names of fields of the common message that is called so. True: it has, or it is none of them.
/// Throws std::bad_alloc.
bool is_as_in_ros(const std::string& dds_type, const std::string& msg);

}  // namespace lot::gateway
