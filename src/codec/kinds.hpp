// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "lot/description.hpp"

/// What the types of a description are to ROS 2 (docs/codec.md).
namespace lot::codec {

/// The number that a value lies as: an enum, a duration and a time point are one. Null: it is no
/// number, or its description contradicts itself.
inline const Description::Type* number_of(const Description& all, const Description::Type& type) {
  const Description::Type* found = &type;
  constexpr int kMostLevels = 3;  // a time point, its duration, the duration's number
  for (int level = 0; level < kMostLevels; ++level) {
    const Kind kind = found->kind;
    if (kind != Kind::Enum && kind != Kind::Duration && kind != Kind::TimePoint) break;
    if (found->element >= all.types.size()) return nullptr;
    found = &all.types[found->element];
    if (found->size != type.size) return nullptr;
  }
  const bool is_number = found->kind == Kind::Bool || found->kind == Kind::Char ||
                         found->kind == Kind::Int || found->kind == Kind::UInt ||
                         found->kind == Kind::Float;
  return is_number ? found : nullptr;
}

/// `time` or `duration` of ROS 1: a struct with that name, of two words.
inline bool is_ros_time(const Description& all, const Description::Type& type) {
  if (type.kind != Kind::Struct || (type.name != "time" && type.name != "duration")) return false;
  const auto is = [&](const Description::Field& field, const char* name) {
    if (field.name != name || field.bits != 0 || field.type >= all.types.size()) return false;
    const Description::Type& its = all.types[field.type];
    return (its.kind == Kind::UInt || its.kind == Kind::Int) && its.size == 4;
  };
  return type.fields.size() == 2 && is(type.fields[0], "sec") && is(type.fields[1], "nsec");
}

/// std_msgs/Header of ROS 1, whose first field ROS 2 does not have.
inline bool is_ros_header(const Description& all, const Description::Type& type) {
  return type.kind == Kind::Struct && type.name == "std_msgs/Header" && type.fields.size() == 3 &&
         type.fields[0].name == "seq" && type.fields[0].bits == 0 &&
         type.fields[0].type < all.types.size() &&
         all.types[type.fields[0].type].kind == Kind::UInt;
}

}  // namespace lot::codec
