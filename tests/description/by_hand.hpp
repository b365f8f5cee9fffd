// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "lot/description.hpp"

/// Descriptions that a test writes down, also such as no compiler makes.
namespace by_hand {

using lot::Description;
using lot::Kind;
using Type = Description::Type;
using Field = Description::Field;

inline constexpr std::uint32_t kNone = Description::kNone;

inline Type type(Kind kind, std::uint64_t size, const std::string& name = "",
                 std::uint32_t element = kNone, std::uint64_t count = 0) {
  Type t;
  t.kind = kind;
  t.size = size;
  t.name = name;
  t.element = element;
  t.count = count;
  return t;
}
inline Type duration(std::uint64_t size, std::uint32_t element, std::int64_t numerator,
                     std::int64_t denominator) {
  Type t = type(Kind::Duration, size, "", element);
  t.numerator = numerator;
  t.denominator = denominator;
  return t;
}
inline Field field(const std::string& name, std::uint32_t of, std::uint64_t offset,
                   std::uint32_t bits = 0, std::uint32_t bit = 0) {
  Field f;
  f.name = name;
  f.type = of;
  f.offset = offset;
  f.bits = static_cast<decltype(f.bits)>(bits);
  f.bit = static_cast<decltype(f.bit)>(bit);
  return f;
}
inline Type structure(const std::string& name, std::uint64_t size, std::vector<Field> fields) {
  Type t = type(Kind::Struct, size, name);
  t.fields = std::move(fields);
  return t;
}

}  // namespace by_hand
