// SPDX-License-Identifier: Apache-2.0
#include "lot/any_type.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <limits>
#include <utility>

#include "lot/detail/message_type.hpp"
#include "lot/error.hpp"
#include "lot/message.hpp"

#include "description/compose.hpp"
#include "description/wire.hpp"
#include "registry/known_type.hpp"

namespace lot {
namespace {

using Type = Description::Type;

[[noreturn]] void refuse(const std::string& name, const std::string& what,
                         const std::string& advice = "correct the type") {
  throw Error(EINVAL, name.empty() ? "type" : name, what, advice);
}

/// The same of one that is given to make another.
void require(const AnyType& type, const std::string& whole) {
  if (!type) refuse(whole, "a part of it is no type", "make the part first");
}

const Type& root(const AnyType& type) { return type.description().root(); }

/// The name of a container of something, as that of a container of bytes: with the other element.
std::string name_of(std::string of_bytes, const std::string& element) {
  const std::string byte = TypeIdentity<std::uint8_t>::name();
  for (std::size_t at = 0; (at = of_bytes.find(byte, at)) != std::string::npos;) {
    const bool ends = at + byte.size() < of_bytes.size() && of_bytes[at + byte.size()] == '>';
    const std::string spelt = element + (ends && element.ends_with('>') ? " " : "");
    of_bytes.replace(at, byte.size(), spelt);
    at += spelt.size();
  }
  return of_bytes;
}

/// Whether a type has strings, vectors or references in its own bytes: which library's they are
/// counts at both ends of a topic then.
bool has_containers(const Description& all, std::uint32_t place) {
  const Type& type = all.types[place];
  switch (type.kind) {
    case Kind::String:
    case Kind::Vector:
    case Kind::Reference:
      return true;
    case Kind::Array:
      return has_containers(all, type.element);
    default:
      return std::any_of(type.fields.begin(), type.fields.end(),
                         [&](const auto& field) { return has_containers(all, field.type); });
  }
}

/// Checks it as a description of another process is checked.
AnyType made(std::string name, std::size_t alignment, Description description, std::uint64_t hash) {
  if (name.empty() || name.find('\0') != std::string::npos) {
    refuse(name, "a type has a name of one byte or more, without a zero");
  }
  if (!std::has_single_bit(alignment) || alignment > detail::kMaxAlignment) {
    refuse(name, "its alignment is " + std::to_string(alignment));
  }
  if (!description::decode(description::encode(description))) {
    refuse(name, "no type can be described so, or the description is too large",
           "have fewer and smaller parts (docs/layout.md)");
  }
  if (has_containers(description, 0)) hash ^= detail::kContainers;
  return AnyType(std::make_shared<const registry::KnownType>(std::move(name), alignment, hash,
                                                             std::move(description)));
}

/// A type that holds others of one type.
AnyType holder(std::string name, std::size_t alignment, const AnyType& element, Type type) {
  description::Composer composer;
  type.element = composer.add(element.description());
  return made(std::move(name), alignment, std::move(composer).take(std::move(type)), 0);
}

/// The same as a container of bytes is, but for the element.
template <class OfBytes>
AnyType container(const AnyType& element) {
  const AnyType bytes = AnyType::of<OfBytes>();
  require(element, bytes.name());
  return holder(name_of(bytes.name(), element.name()), bytes.alignment(), element, root(bytes));
}

}  // namespace

// ---- what it is ----

const std::string& AnyType::name() const noexcept { return type_->name(); }
const Description& AnyType::description() const { return type_->description(); }
std::size_t AnyType::size() const noexcept { return type_->type().size; }
std::size_t AnyType::alignment() const noexcept { return type_->type().align; }
bool AnyType::is_same(const AnyType& other) const {
  return type_ == other.type_ || (type_ != nullptr && other.type_ != nullptr &&
                                  detail::is_same(type_->type(), other.type_->type()));
}
std::string AnyType::encoded() const { return description::encode(description()); }

namespace {

AnyType part(const Description& all, std::uint32_t place) {
  Description description = description::part(all, place);
  const Type& type = description.root();
  const bool is_number = type.kind == Kind::Bool || type.kind == Kind::Char ||
                         type.kind == Kind::Int || type.kind == Kind::UInt ||
                         type.kind == Kind::Float;
  if (is_number) return AnyType::number(type.kind, type.size);
  const bool is_named =
      type.kind == Kind::Struct || type.kind == Kind::Enum || type.kind == Kind::Opaque;
  std::string name = is_named && !type.name.empty() ? type.name : "part of a message";
  const std::uint64_t alignment = description::natural_alignment(description, 0);
  return made(std::move(name), alignment, std::move(description), 0);
}

}  // namespace

AnyType AnyType::field(std::size_t i) const {
  const Description& all = description();
  if (i >= all.root().fields.size()) refuse(name(), "it has no field " + std::to_string(i));
  return part(all, all.root().fields[i].type);
}
AnyType AnyType::element() const {
  const Description& all = description();
  return all.root().element == Description::kNone ? AnyType() : part(all, all.root().element);
}

// ---- types that are made ----

AnyType AnyType::number(Kind kind, std::size_t size) {
  switch (kind) {
    case Kind::Bool:
      if (size == sizeof(bool)) return of<bool>();
      break;
    case Kind::Char:
      if (size == sizeof(char)) return of<char>();
      break;
    case Kind::Int:
      if (size == 1) return of<std::int8_t>();
      if (size == 2) return of<std::int16_t>();
      if (size == 4) return of<std::int32_t>();
      if (size == 8) return of<std::int64_t>();
      break;
    case Kind::UInt:
      if (size == 1) return of<std::uint8_t>();
      if (size == 2) return of<std::uint16_t>();
      if (size == 4) return of<std::uint32_t>();
      if (size == 8) return of<std::uint64_t>();
      break;
    case Kind::Float:
      if (size == sizeof(float)) return of<float>();
      if (size == sizeof(double)) return of<double>();
      if (size == sizeof(long double)) return of<long double>();
      break;
    default:
      refuse("type", "this kind is no number: " + std::to_string(static_cast<unsigned>(kind)));
  }
  refuse("type", "no number of this kind has " + std::to_string(size) + " bytes");
}

AnyType AnyType::string() { return of<ShmString>(); }

AnyType AnyType::vector(const AnyType& element) {
  return container<ShmVector<std::uint8_t>>(element);
}

AnyType AnyType::reference(const AnyType& target) {
  return container<ShmRef<std::uint8_t>>(target);
}

AnyType AnyType::array(const AnyType& element, std::size_t count) {
  require(element, "array");
  Type type;
  type.kind = Kind::Array;
  type.count = count;
  if (count == 0 || __builtin_mul_overflow(count, root(element).size, &type.size)) {
    refuse(element.name(), "an array cannot have " + std::to_string(count) + " elements");
  }
  const std::string& name = element.name();
  return holder("std::array<" + name + ", " + std::to_string(count) + "ul>", element.alignment(),
                element, std::move(type));
}

AnyType AnyType::enumeration(std::string name, const AnyType& number) {
  require(number, name);
  Type type;
  type.kind = Kind::Enum;
  type.size = number.size();
  type.name = name;
  return holder(std::move(name), number.alignment(), number, std::move(type));
}

AnyType AnyType::duration(const AnyType& number, std::int64_t numerator, std::int64_t denominator) {
  require(number, "duration");
  if (numerator <= 0 || denominator <= 0) {
    refuse("duration", "its unit is " + std::to_string(numerator) + "/" +
                           std::to_string(denominator) + " seconds");
  }
  Type type;
  type.kind = Kind::Duration;
  type.size = number.size();
  type.numerator = numerator;
  type.denominator = denominator;
  return holder("std::chrono::duration<" + number.name() + ", std::ratio<" +
                    std::to_string(numerator) + "l, " + std::to_string(denominator) + "l> >",
                number.alignment(), number, std::move(type));
}

AnyType AnyType::time_point(std::string clock, const AnyType& duration) {
  require(duration, "time point");
  Type type;
  type.kind = Kind::TimePoint;
  type.size = duration.size();
  type.name = clock;
  return holder("time point of " + std::move(clock) + ", " + duration.name(), duration.alignment(),
                duration, std::move(type));
}

AnyType AnyType::structure(std::string name, const std::vector<Field>& fields) {
  description::Composer composer;
  Type type;
  type.kind = Kind::Struct;
  type.name = name;
  std::uint64_t alignment = 1;
  std::uint64_t end = 0;
  for (const Field& field : fields) {
    require(field.type, name + "." + field.name);
    const std::uint64_t align = field.type.alignment();
    Description::Field& added = type.fields.emplace_back();
    added.name = field.name;
    added.type = composer.add(field.type.description());
    added.offset = (end + align - 1) / align * align;
    end = added.offset + field.type.size();
    alignment = std::max(alignment, align);
    // A sum of two such sizes does not wrap.
    if (end > std::numeric_limits<std::uint64_t>::max() / 4) refuse(name, "it is too large");
  }
  // An empty one has a byte, as in C++.
  type.size = std::max<std::uint64_t>((end + alignment - 1) / alignment * alignment, 1);
  return made(std::move(name), alignment, std::move(composer).take(std::move(type)), 0);
}

AnyType AnyType::opaque(std::string name, std::size_t size, std::size_t alignment) {
  if (alignment == 0 || size % alignment != 0) {
    refuse(name, "its size is no multiple of its alignment, " + std::to_string(alignment));
  }
  Type type;
  type.size = size;
  type.name = name;
  Description description;
  description.types.push_back(std::move(type));
  return made(std::move(name), alignment, std::move(description), 0);
}

AnyType AnyType::decoded(std::string name, std::size_t alignment, std::string_view bytes,
                         std::uint64_t hash) {
  auto description = description::decode(bytes);
  if (!description) refuse(name, "these bytes are no description");
  if (alignment != 0 && description->root().size % alignment != 0) {
    refuse(name, "its size is no multiple of its alignment, " + std::to_string(alignment));
  }
  return made(std::move(name), alignment, std::move(*description), hash);
}

}  // namespace lot
