// SPDX-License-Identifier: Apache-2.0
#include "lot/value.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <vector>

#include "lot/error.hpp"

#include "description/containers.hpp"
#include "description/ratio.hpp"
#include "description/reader.hpp"
#include "description/text.hpp"

namespace lot {

namespace detail {

using description::BoostString;
using description::kNull;
using description::ReferenceWords;
using description::StdString;

std::string name_of_field(const Description::Type& type, std::uint64_t i) {
  const std::string& name = type.fields[i].name;
  return name.empty() ? "_" + std::to_string(i) : name;
}

namespace {

/// "a, b and 3 more"
std::string list_of_fields(const Description::Type& type) {
  constexpr std::size_t kMost = 12;
  std::string text;
  for (std::size_t i = 0; i < std::min(type.fields.size(), kMost); ++i) {
    text += (i == 0 ? "" : ", ") + name_of_field(type, i);
  }
  if (type.fields.size() > kMost) {
    text += " and " + std::to_string(type.fields.size() - kMost) + " more";
  }
  return text.empty() ? "no fields" : text;
}

}  // namespace

// ---- errors ----

void ValueAccess::damaged(const Value& v, const std::string& what) {
  refuse(v, EBADMSG, what, "end the process that writes into the segment where it should not");
}

void ValueAccess::refuse(const Value& v, int error, const std::string& what,
                         const std::string& advice) {
  std::string path = v.path();
  throw Error(error, path.empty() ? "message" : std::move(path), what, advice);
}

// ---- memory ----

bool ValueAccess::is_inside(const Value& v, const unsigned char* at, std::uint64_t bytes) noexcept {
  const auto first = reinterpret_cast<std::uintptr_t>(at);
  const auto begin = reinterpret_cast<std::uintptr_t>(v.range_.begin);
  const auto end = reinterpret_cast<std::uintptr_t>(v.range_.end);
  return first >= begin && first <= end && bytes <= end - first;
}

const ValueAccess::Type& ValueAccess::inside(const Value& v) {
  const Type& type = type_at(v, v.place_);
  if (!is_inside(v, v.at_, v.bits_ == 0 ? type.size : (v.bit_ + v.bits_ + 7) / 8)) {
    damaged(v, "it lies outside of the segment");
  }
  return type;
}

std::uint64_t ValueAccess::word(const Value& v, std::uint64_t offset) {
  if (reinterpret_cast<std::uintptr_t>(v.at_) % description::kWord != 0) {
    damaged(v, "it is not aligned");
  }
  return load<std::uint64_t>(v.at_ + offset);
}

const unsigned char* ValueAccess::follow(const Value& v, std::uint64_t offset) {
  const std::uint64_t distance = word(v, offset);
  if (distance == kNull) return nullptr;
  const auto* to = reinterpret_cast<const unsigned char*>(reinterpret_cast<std::uintptr_t>(v.at_) +
                                                          offset + distance);
  if (!is_inside(v, to, 0)) damaged(v, "it leads out of the segment");
  return to;
}

// ---- types ----

const ValueAccess::Type& ValueAccess::type_at(const Value& v, std::uint32_t place) {
  if (place >= v.all_->types.size()) damaged(v, "its description names a type that is not there");
  return v.all_->types[place];
}

const ValueAccess::Type& ValueAccess::scalar(const Value& v) {
  const Type* type = &inside(v);
  for (int levels = 0; levels < 3; ++levels) {
    if (type->kind != Kind::Enum && type->kind != Kind::Duration && type->kind != Kind::TimePoint) {
      break;
    }
    const Type& element = type_at(v, type->element);
    if (element.size != type->size) damaged(v, "its description is of another size");
    type = &element;
  }
  switch (type->kind) {
    case Kind::Bool:
    case Kind::Char:
    case Kind::Int:
    case Kind::UInt:
    case Kind::Float:
      return *type;
    default:
      refuse(v, EINVAL, "it is a " + v.type_name() + ", and no number");
  }
}

ValueAccess::Facts ValueAccess::facts(const Value& v, std::uint32_t place) {
  Facts facts;
  const Kind kind = type_at(v, place).kind;
  if (kind == Kind::Int || kind == Kind::UInt || kind == Kind::Float)
    return facts;  // no list of one
  std::vector<char> seen(v.all_->types.size(), 0);
  std::vector<std::uint32_t> open{place};
  while (!open.empty()) {
    const std::uint32_t next = open.back();
    open.pop_back();
    const Type& type = type_at(v, next);
    if (seen[next]++ != 0) continue;
    if (type.kind == Kind::String || type.kind == Kind::Vector || type.kind == Kind::Reference) {
      facts.is_plain = false;
    } else if (type.kind == Kind::Struct) {
      for (const Description::Field& field : type.fields) open.push_back(field.type);
    } else if (type.kind == Kind::Array) {
      open.push_back(type.element);
    } else if (type.kind == Kind::Opaque) {
      facts.is_opaque = true;
    } else {
      facts.has_bool = facts.has_bool || type.kind == Kind::Bool;
    }
  }
  return facts;
}

std::uint64_t ValueAccess::align(const Value& v, std::uint32_t place) {
  const Type* type = &type_at(v, place);
  for (std::size_t levels = 0; type->kind == Kind::Array; ++levels) {
    if (levels == Way::kMost) damaged(v, "its description has no end");
    type = &type_at(v, type->element);
  }
  return type->kind == Kind::Struct ? 1
                                    : std::max<std::uint64_t>(type->size & (~type->size + 1), 1);
}

std::string ValueAccess::name_of(const Description& all, std::uint32_t place, int levels) {
  if (place >= all.types.size() || levels == 0) return "?";
  const Type& type = all.types[place];
  const auto bits = [&] { return std::to_string(8 * type.size); };
  const auto element = [&] { return name_of(all, type.element, levels - 1); };
  switch (type.kind) {
    case Kind::Bool:
      return "bool";
    case Kind::Char:
      return "char";
    case Kind::Int:
      return "int" + bits();
    case Kind::UInt:
      return "uint" + bits();
    case Kind::Float:
      return type.size > 8 ? "long double" : "float" + bits();
    case Kind::Duration:
      return "duration";
    case Kind::TimePoint:
      return "time point of " + type.name;
    case Kind::Array:
      return element() + "[" + std::to_string(type.count) + "]";
    case Kind::String:
      return "string";
    case Kind::Vector:
      return "vector of " + element();
    case Kind::Reference:
      return "reference to " + element();
    case Kind::Opaque:
    case Kind::Enum:
    case Kind::Struct:
      break;
  }
  return type.name;
}

// ---- parts ----

Value ValueAccess::child(const Value& v, std::uint64_t step, const unsigned char* at,
                         std::uint32_t place) {
  if (v.way_.size() == Way::kMost) {
    refuse(v, ELOOP, "what it holds lies more than " + std::to_string(Way::kMost) + " levels deep");
  }
  Value result = v;
  result.way_.add(step);
  result.at_ = at;
  result.place_ = place;
  result.bit_ = 0;
  result.bits_ = 0;
  return result;
}

Value ValueAccess::field(const Value& v, const Type& type, std::uint64_t i) {
  const Description::Field& field = type.fields[i];
  const std::uint64_t bytes = field.bits == 0 ? type_at(v, field.type).size
                                              : (std::uint64_t{field.bit} + field.bits + 7) / 8;
  if (field.offset > type.size || bytes > type.size - field.offset || field.bits > 64 ||
      field.bit > 7) {
    damaged(v, "its description has a field outside of the struct");
  }
  Value result = child(v, i, v.at_ + field.offset, field.type);
  result.bit_ = field.bit;
  result.bits_ = field.bits;
  return result;
}

Value ValueAccess::item(const Value& v, const Items& items, std::uint64_t i) {
  if (i >= items.count) {
    refuse(
        v, EINVAL,
        "it has " + std::to_string(items.count) + " elements, and no [" + std::to_string(i) + "]");
  }
  return child(v, i, items.data + i * items.stride, items.type);
}

ValueAccess::Items ValueAccess::items(const Value& v) {
  const Type& type = inside(v);
  if (type.kind == Kind::Vector) return vector_items(v, type);
  if (type.kind != Kind::Array) {
    refuse(v, EINVAL, "it is a " + v.type_name() + ", and has no elements");
  }
  const std::uint64_t stride = type_at(v, type.element).size;
  if (stride == 0 || type.count > type.size / stride) {
    damaged(v, "its description has more elements than fit");
  }
  return {v.at_, type.count, stride, type.element};
}

ValueAccess::Items ValueAccess::vector_items(const Value& v, const Type& type) {
  const bool is_libcxx = description::is_libcxx(type.name);
  if (type.size != description::kVectorSize ||
      !(is_libcxx || description::is_libstdcxx(type.name))) {
    refuse(v, EINVAL, "it is a vector of another library: " + type.name);
  }
  const auto& words = is_libcxx ? description::kLibcxxVector : description::kStdVector;
  const Type& element = type_at(v, type.element);
  if (element.size == 0) damaged(v, "its description has elements without a size");
  const unsigned char* const begin = follow(v, words.begin);
  const unsigned char* const end = follow(v, words.end);
  if (begin == nullptr && end == nullptr) return {nullptr, 0, element.size, type.element};
  if (begin == nullptr || end < begin) damaged(v, "it ends before it begins");
  const auto bytes = static_cast<std::uint64_t>(end - begin);
  if (bytes % element.size != 0) damaged(v, "its last element is not whole");
  return {begin, bytes / element.size, element.size, type.element};
}

bool ValueAccess::leads_away(const Value& v) {
  std::uint32_t place = 0;
  for (std::size_t level = 0; level < v.way_.size(); ++level) {
    const Type& type = type_at(v, place);
    if (type.kind == Kind::Reference) return true;
    place = type.kind == Kind::Struct ? type.fields[v.way_[level]].type : type.element;
  }
  return false;
}

std::uint64_t ValueAccess::find(const Type& type, std::string_view name) {
  const auto& fields = type.fields;
  if (name.empty()) return fields.size();
  const auto found = std::find_if(fields.begin(), fields.end(),
                                  [&](const Description::Field& f) { return f.name == name; });
  if (found != fields.end()) return static_cast<std::uint64_t>(found - fields.begin());
  std::uint64_t i = 0;
  const char* const end = name.data() + name.size();
  const bool may_be = name.size() == 2 || (name.size() > 2 && name[1] != '0');  // no _01
  if (name[0] != '_' || !may_be) return fields.size();
  const auto [stop, error] = std::from_chars(name.data() + 1, end, i);
  return error == std::errc() && stop == end ? std::min<std::uint64_t>(i, fields.size())
                                             : fields.size();
}

namespace {

/// One step of a path. REQUIRES: `path` is not empty. Takes the step off it.
Value step(const Value& from, std::string_view& path, bool is_first) {
  const auto refuse = [&](const std::string& what) {
    ValueAccess::refuse(from, EINVAL, what + ", in the path at \"" + std::string(path) + "\"",
                        "a path looks like labels[2].name");
  };
  if (path.front() == '[') {
    const std::size_t end = path.find(']');
    std::uint64_t i = 0;
    const char* const digits = path.data() + 1;
    if (end == std::string_view::npos) refuse("a ] is missing");
    const auto [stop, error] = std::from_chars(digits, path.data() + end, i);
    if (error != std::errc() || stop != path.data() + end) refuse("there is no number in [ ]");
    path.remove_prefix(end + 1);
    return ValueAccess::item(from, ValueAccess::items(from), i);
  }
  if (!is_first) {
    if (path.front() != '.') refuse("a . or [ is missing");
    path.remove_prefix(1);
  }
  const std::string_view name = path.substr(0, path.find_first_of(".[]"));
  if (name.empty()) refuse("a name is missing");
  Value found = from[name];
  path.remove_prefix(name.size());
  return found;
}

/// A number of `bits` bits, the last of 9 bytes at most.
std::uint64_t load_bits(const unsigned char* at, std::uint32_t first, std::uint32_t count) {
  std::uint64_t result = 0;
  for (std::uint32_t done = 0; done < count;) {
    const std::uint32_t at_bit = first + done;
    const std::uint32_t in_byte = std::min(8 - at_bit % 8, count - done);
    const std::uint64_t part = ValueAccess::load<unsigned char>(at + at_bit / 8) >> (at_bit % 8);
    result |= (part & ((1U << in_byte) - 1)) << done;
    done += in_byte;
  }
  return result;
}

std::uint64_t load_whole(const unsigned char* at, std::uint64_t size) {
  switch (size) {
    case 1:
      return ValueAccess::load<std::uint8_t>(at);
    case 2:
      return ValueAccess::load<std::uint16_t>(at);
    case 4:
      return ValueAccess::load<std::uint32_t>(at);
    default:
      return ValueAccess::load<std::uint64_t>(at);
  }
}

/// IEEE 754's, and the machine's long double.
Number load_real(const Value& v, const unsigned char* at, std::uint64_t size) {
  if (size == sizeof(float)) return Number::of(ValueAccess::load<float>(at));
  if (size == sizeof(double)) return Number::of(ValueAccess::load<double>(at));
  if (size == sizeof(long double)) return Number::of(ValueAccess::load<long double>(at));
  ValueAccess::refuse(v, EINVAL, "a float of " + std::to_string(size) + " bytes is not read");
}

}  // namespace
}  // namespace detail

using Access = detail::ValueAccess;

// ---- what it is ----

const Description::Type& Value::type() const { return Access::type_at(*this, place_); }

std::string Value::type_name() const { return Access::name_of(*all_, place_, 8); }

std::string Value::path() const {
  std::string text;
  std::uint32_t place = 0;
  for (std::size_t level = 0; level < way_.size() && place < all_->types.size(); ++level) {
    const Description::Type& type = all_->types[place];
    if (type.kind == Kind::Struct) {
      text += (text.empty() ? "" : ".") + detail::name_of_field(type, way_[level]);
      place = type.fields[way_[level]].type;
      continue;
    }
    if (type.kind != Kind::Reference) text += "[" + std::to_string(way_[level]) + "]";
    place = type.element;
  }
  return text;
}

std::string Value::name() const {
  const std::string whole = path();
  const std::size_t last = whole.find_last_of(".[");
  return last == std::string::npos ? whole : whole.substr(whole[last] == '.' ? last + 1 : last);
}

// ---- its parts ----

std::size_t Value::size() const {
  const Description::Type& type = Access::inside(*this);
  switch (type.kind) {
    case Kind::Reference:
      return target().size();
    case Kind::Struct:
      return type.fields.size();
    case Kind::Array:
    case Kind::Vector:
      return Access::items(*this).count;
    case Kind::String:
      return text().size();
    case Kind::Opaque:
      return type.size;
    default:
      return 0;
  }
}

Value Value::operator[](std::size_t i) const {
  const Description::Type& type = Access::inside(*this);
  if (type.kind == Kind::Reference) return target()[i];
  if (type.kind != Kind::Struct) return Access::item(*this, Access::items(*this), i);
  if (i < type.fields.size()) return Access::field(*this, type, i);
  Access::refuse(*this, EINVAL,
                 "it has " + std::to_string(type.fields.size()) + " fields, and no field " +
                     std::to_string(i));
}

Value Value::operator[](std::string_view field) const {
  const Description::Type& type = Access::inside(*this);
  if (type.kind == Kind::Reference) return target()[field];
  if (type.kind != Kind::Struct) {
    Access::refuse(*this, EINVAL,
                   "it is a " + type_name() + ", and has no field \"" + std::string(field) + "\"");
  }
  const std::uint64_t i = Access::find(type, field);
  if (i < type.fields.size()) return Access::field(*this, type, i);
  Access::refuse(*this, EINVAL, "there is no field \"" + std::string(field) + "\"",
                 "there are " + detail::list_of_fields(type));
}

Value Value::at(std::string_view path) const {
  Value found = *this;
  for (bool is_first = true; !path.empty(); is_first = false) {
    found = detail::step(found.target(), path, is_first);
  }
  return found;
}

bool Value::has(std::string_view field) const {
  const Value here = target();
  const Description::Type& type = here.type();
  return type.kind == Kind::Struct && Access::find(type, field) < type.fields.size();
}

Value::Iterator Value::begin() const {
  const Value here = target();
  const Description::Type& type = Access::inside(here);
  Items items;
  if (type.kind == Kind::Struct) {
    items.count = type.fields.size();
  } else if (type.kind == Kind::Array || type.kind == Kind::Vector) {
    items = Access::items(here);
  }
  return {here, items};
}

Value Value::Iterator::operator*() const {
  const Description::Type& type = of_.type();
  if (type.kind != Kind::Struct) return Access::item(of_, items_, next_);
  if (next_ < type.fields.size()) return Access::field(of_, type, next_);
  Access::refuse(of_, EINVAL, "an iterator is behind its last field");
}

// ---- references ----

bool Value::is_null() const {
  const Description::Type& type = Access::inside(*this);
  return type.kind == Kind::Reference && type.size == detail::ReferenceWords::kSize &&
         Access::follow(*this, detail::ReferenceWords::kTarget) == nullptr;
}

Value Value::target() const {
  Value found = *this;
  while (true) {
    const Description::Type& type = Access::inside(found);
    if (type.kind != Kind::Reference) return found;
    if (type.size != detail::ReferenceWords::kSize) {
      Access::damaged(found, "its description is of another size");
    }
    const unsigned char* const to = Access::follow(found, detail::ReferenceWords::kTarget);
    if (to == nullptr) Access::refuse(found, EINVAL, "it refers to nothing");
    found = Access::child(found, 0, to, type.element);
  }
}

// ---- what it says ----

detail::Number Value::number() const {
  const Value here = target();
  const Description::Type& type = Access::scalar(here);
  if (type.kind == Kind::Float) return detail::load_real(here, here.at_, type.size);
  if (type.size != 1 && type.size != 2 && type.size != 4 && type.size != 8) {
    Access::refuse(here, EINVAL,
                   "an integer of " + std::to_string(type.size) + " bytes is not read");
  }
  detail::Number number;
  const std::uint32_t bits =
      here.bits_ == 0 ? 8 * static_cast<std::uint32_t>(type.size) : here.bits_;
  number.whole = here.bits_ == 0 ? detail::load_whole(here.at_, type.size)
                                 : detail::load_bits(here.at_, here.bit_, here.bits_);
  const bool is_signed =
      type.kind == Kind::Int || (type.kind == Kind::Char && std::is_signed_v<char>);
  if (is_signed && (number.whole >> (bits - 1)) != 0) {
    number.is_negative = true;
    if (bits < 64) number.whole |= ~std::uint64_t{0} << bits;
  }
  if (type.kind == Kind::Bool && number.whole > 1) {
    Access::refuse(here, EBADMSG, "a bool is " + std::to_string(number.whole),
                   "its publisher has not set it; or a process writes where it should not");
  }
  return number;
}

detail::Number Value::ticks(detail::Period wanted, bool rounded) const {
  const Value here = target();
  const Description::Type* type = &here.type();
  if (type->kind == Kind::TimePoint) type = &Access::type_at(here, type->element);
  if (type->kind != Kind::Duration) {
    Access::refuse(here, EINVAL, "it is a " + here.type_name() + ", and no duration");
  }
  const detail::Period has{type->numerator, type->denominator};
  if (has.numerator <= 0 || has.denominator <= 0) {
    Access::damaged(here, "its description has no period");
  }
  const detail::Number count = here.number();
  detail::Number result;
  if (!description::convert(count, has, wanted, rounded, result)) {
    Access::refuse(here, ERANGE,
                   "it is no whole number of the units that are asked for, or too many",
                   "ask for a duration of its own period, or of a floating-point number");
  }
  return result;
}

void Value::require_clock(const char* name) const {
  const Value here = target();
  const Description::Type& type = here.type();
  if (type.kind != Kind::TimePoint || type.name != name) {
    Access::refuse(here, EINVAL,
                   "it is a " + here.type_name() + ", and no time point of " + std::string(name));
  }
}

std::string_view Value::text() const {
  const Value here = target();
  const Description::Type& type = Access::inside(here);
  if (type.kind != Kind::String) {
    Access::refuse(here, EINVAL, "it is a " + here.type_name() + ", and no string");
  }
  const unsigned char* data = nullptr;
  std::uint64_t length = 0;
  if (description::is_libstdcxx(type.name) && type.size == detail::StdString::kSize) {
    data = Access::follow(here, detail::StdString::kData);
    length = Access::word(here, detail::StdString::kLength);
  } else if (description::is_libcxx(type.name) && type.size == detail::BoostString::kSize) {
    const std::uint64_t head = Access::word(here, detail::BoostString::kHead);
    const bool is_short = (head & 1) != 0;
    length = is_short ? (head & 0xff) >> 1 : head >> 1;
    if (is_short && length > detail::BoostString::kMostLocal) {
      Access::damaged(here, "a short string is too long");
    }
    data = is_short ? here.at_ + detail::BoostString::kLocal
                    : Access::follow(here, detail::BoostString::kData);
  } else {
    Access::refuse(here, EINVAL, "it is a string of another library: " + type.name);
  }
  if (data == nullptr || !Access::is_inside(here, data, length)) {
    Access::damaged(here, "its text does not lie in the segment");
  }
  return {reinterpret_cast<const char*>(data), length};
}

Bytes Value::bytes() const {
  const Value here = target();
  const Description::Type& type = Access::inside(here);
  if (type.kind == Kind::String) {
    const std::string_view text = here.text();
    return {reinterpret_cast<const std::byte*>(text.data()), text.size()};
  }
  const unsigned char* data = here.at_;
  std::uint64_t size = type.size;
  std::uint32_t place = here.place_;
  if (type.kind == Kind::Vector) {
    const Items items = Access::items(here);
    data = items.data;
    size = items.count * items.stride;
    place = items.type;
  }
  if (!Access::facts(here, place).is_plain || here.bits_ != 0) {
    Access::refuse(here, EINVAL, "a " + here.type_name() + " does not lie in one piece",
                   "look at its parts");
  }
  if (type.kind == Kind::Vector &&
      reinterpret_cast<std::uintptr_t>(data) % Access::align(here, place) != 0) {
    Access::damaged(here, "its elements are not aligned");
  }
  return {reinterpret_cast<const std::byte*>(data), size};
}

void Value::cannot_have(const detail::Number& number) const {
  Access::refuse(*this, ERANGE,
                 "it is " + description::number_text(number) +
                     ", which the type that is asked for cannot have");
}

}  // namespace lot
