// SPDX-License-Identifier: Apache-2.0
#include "description/compose.hpp"

#include <algorithm>
#include <vector>

#include "description/wire.hpp"

namespace lot::description {
namespace {

/// Copies types with what they are made of; each one once, also where it lies within itself.
class Copy {
 public:
  explicit Copy(const Description& from) : from_(from), places_(from.types.size(), kNot) {}

  std::uint32_t add(std::uint32_t place) {
    if (places_[place] != kNot) return places_[place];
    const auto here = static_cast<std::uint32_t>(to_.types.size());
    places_[place] = here;
    to_.types.emplace_back();
    Description::Type type = from_.types[place];
    if (type.element != Description::kNone) type.element = add(type.element);
    for (Description::Field& field : type.fields) field.type = add(field.type);
    to_.types[here] = std::move(type);
    return here;
  }
  Description take() && { return std::move(to_); }

 private:
  static constexpr std::uint32_t kNot = Description::kNone;

  const Description& from_;
  Description to_;
  std::vector<std::uint32_t> places_;
};

}  // namespace

Description part(const Description& all, std::uint32_t place) {
  Copy copy(all);
  copy.add(place);
  return std::move(copy).take();
}

std::uint64_t natural_alignment(const Description& all, std::uint32_t place) noexcept {
  constexpr std::uint64_t kPointer = 8;
  constexpr std::uint64_t kMost = 16;  // of a number
  const Description::Type& type = all.types[place];
  switch (type.kind) {
    case Kind::String:
    case Kind::Vector:
    case Kind::Reference:
      return kPointer;
    case Kind::Array:
      return natural_alignment(all, type.element);
    case Kind::Struct: {
      std::uint64_t most = 1;
      for (const Description::Field& field : type.fields) {
        most = std::max(most, natural_alignment(all, field.type));
      }
      return most;
    }
    default:
      return std::min(std::max<std::uint64_t>(type.size & (~type.size + 1), 1), kMost);
  }
}

std::uint32_t Composer::add(const Description& all, std::uint32_t place) {
  // A type is known by the bytes of its description, from itself down.
  const auto [known, is_new] =
      places_.emplace(encode(part(all, place)), static_cast<std::uint32_t>(result_.types.size()));
  if (!is_new) return known->second;
  const std::uint32_t here = known->second;
  result_.types.emplace_back();
  Description::Type type = all.types[place];
  if (type.element != Description::kNone) type.element = add(all, type.element);
  for (Description::Field& field : type.fields) field.type = add(all, field.type);
  result_.types[here] = std::move(type);
  return here;
}

}  // namespace lot::description
