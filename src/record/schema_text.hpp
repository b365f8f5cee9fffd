// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include "lot/description.hpp"

namespace lot::record {

/// What a `.msg` text says.
struct SchemaType {
  Description description;  ///< of a message of LOT with these fields
  std::uint64_t align = 1;
  std::string fields;  ///< names and kinds of all fields, to any depth, without names of types
};

/// Reads a `.msg` of ROS 2: the fields, and behind lines of `=` those of the types in it. Constants
/// and defaults are left out. Throws lot::Error (EINVAL), with the line, for a text that is none,
/// for a type that is not in it, for one that lies within itself, and for `wstring`.
SchemaType read_schema(const std::string& name, const std::string& text);

}  // namespace lot::record
