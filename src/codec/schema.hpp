// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "lot/description.hpp"

namespace lot::codec {

/// The ROS 2 type whose bytes encode() makes (docs/codec.md).
struct Schema {
  std::string name;  ///< "robot/msg/Frame"
  /// The fields as in a .msg file, and behind lines of `=` those of each other type in it: what a
  /// file of type MCAP calls ros2msg.
  std::string msg;
  std::string idl;  ///< the same as one file of OMG IDL; each type stands before it is used
};

/// The schema of a type. REQUIRES: Program has compiled the description. Throws std::bad_alloc.
Schema schema_of(const Description& description);

}  // namespace lot::codec
