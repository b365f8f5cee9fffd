// SPDX-License-Identifier: Apache-2.0
#include "lot/mutable_value.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>

#include "description/builder.hpp"
#include "description/ratio.hpp"
#include "description/reader.hpp"
#include "description/text.hpp"

namespace lot {
namespace {

using Access = detail::ValueAccess;

[[noreturn]] void does_not_fit(const Value& value, const detail::Number& number) {
  Access::refuse(
      value, ERANGE,
      description::number_text(number) + " does not fit a " + value.type_name() +
          (Access::bits(value) == 0 ? "" : " of " + std::to_string(Access::bits(value)) + " bits"));
}

template <class T>
void store(const Value& value, const detail::Number& number) {
  T result{};
  if (!number.to(result)) does_not_fit(value, number);
  std::memcpy(const_cast<unsigned char*>(Access::address(value)), &result, sizeof result);
}

void store_real(const Value& value, const detail::Number& number, std::uint64_t size) {
  if (size == sizeof(float)) return store<float>(value, number);
  if (size == sizeof(double)) return store<double>(value, number);
  if (size == sizeof(long double)) return store<long double>(value, number);
  Access::refuse(value, EINVAL, "a float of " + std::to_string(size) + " bytes is not written");
}

void store_whole(const Value& value, const detail::Number& number, std::uint64_t size,
                 bool is_signed) {
  switch (size) {
    case 1:
      return is_signed ? store<std::int8_t>(value, number) : store<std::uint8_t>(value, number);
    case 2:
      return is_signed ? store<std::int16_t>(value, number) : store<std::uint16_t>(value, number);
    case 4:
      return is_signed ? store<std::int32_t>(value, number) : store<std::uint32_t>(value, number);
    case 8:
      return is_signed ? store<std::int64_t>(value, number) : store<std::uint64_t>(value, number);
    default:
      Access::refuse(value, EINVAL,
                     "an integer of " + std::to_string(size) + " bytes is not written");
  }
}

void store_bits(const Value& value, const detail::Number& number, bool is_signed) {
  const std::uint32_t bits = Access::bits(value);
  std::uint64_t whole = 0;
  std::int64_t as_signed = 0;
  if (is_signed) {
    const std::int64_t most = static_cast<std::int64_t>((std::uint64_t{1} << (bits - 1)) - 1);
    if (!number.to(as_signed) || as_signed > most || as_signed < -most - 1) {
      does_not_fit(value, number);
    }
    whole = static_cast<std::uint64_t>(as_signed);
  } else if (!number.to(whole) || (bits < 64 && (whole >> bits) != 0)) {
    does_not_fit(value, number);
  }
  auto* const at = const_cast<unsigned char*>(Access::address(value));
  for (std::uint32_t i = 0; i < bits; ++i) {
    const std::uint32_t bit = Access::bit(value) + i;
    const auto mask = static_cast<unsigned char>(1U << (bit % 8));
    const bool is_set = ((whole >> i) & 1) != 0;
    at[bit / 8] = static_cast<unsigned char>(is_set ? at[bit / 8] | mask : at[bit / 8] & ~mask);
  }
}

/// Looks at the bools among elements of a type that has nothing but scalars, arrays and structs.
class Bools {
 public:
  Bools(const Value& value, std::uint32_t place, std::uint64_t bytes)
      : value_(value), place_(place), left_(kEach * bytes + kEach) {}

  /// Whether each is false or true.
  bool are_good(const std::byte* element) { return are_good(place_, element); }

 private:
  /// A description says at most so often of a byte what it is, unless it is forged.
  static constexpr std::uint64_t kEach = 64;

  bool are_good(std::uint32_t place, const std::byte* bytes) {
    if (left_-- == 0) Access::damaged(value_, "its description has fields that share bytes");
    const Description::Type& type = Access::type_at(value_, place);
    if (type.kind == Kind::Bool) return std::to_integer<unsigned>(*bytes) <= 1;
    if (type.kind == Kind::Array) {
      const std::uint64_t size = Access::type_at(value_, type.element).size;
      for (std::uint64_t i = 0; i < type.count; ++i) {
        if (!are_good(type.element, bytes + i * size)) return false;
      }
    }
    if (type.kind != Kind::Struct) return true;
    return std::all_of(type.fields.begin(), type.fields.end(), [&](const auto& field) {
      return field.bits != 0 || are_good(field.type, bytes + field.offset);
    });
  }

  const Value& value_;
  std::uint32_t place_;
  std::uint64_t left_;
};

}  // namespace

void detail::ValueAccess::set_ticks(const MutableValue& to, const Number& count, Period period) {
  to.set_ticks(count, period);
}

const Value& MutableValue::own(const Value& value) const {
  if (Access::leads_away(value)) {
    Access::refuse(value, EINVAL, "it lies in another message, which a reference leads to",
                   "a reference cannot be set here, nor what it refers to");
  }
  return value;
}

void MutableValue::construct() const {
  description::Builder(Access::description(value_), memory_).construct(value_);
}

void MutableValue::set_number(const detail::Number& number) const {
  if (value_.kind() == Kind::Reference) Access::refuse(value_, EINVAL, "a reference cannot be set");
  const Description::Type& type = Access::scalar(value_);
  if (type.kind == Kind::Float) return store_real(value_, number, type.size);
  const bool is_signed =
      type.kind == Kind::Int || (type.kind == Kind::Char && std::is_signed_v<char>);
  if (type.kind == Kind::Bool && (number.is_real || number.is_negative || number.whole > 1)) {
    does_not_fit(value_, number);
  }
  if (Access::bits(value_) != 0) return store_bits(value_, number, is_signed);
  store_whole(value_, number, type.size, is_signed);
}

void MutableValue::set_ticks(const detail::Number& count, detail::Period period) const {
  const Description::Type* type = &Access::inside(value_);
  if (type->kind == Kind::TimePoint) type = &Access::type_at(value_, type->element);
  if (type->kind != Kind::Duration || type->numerator <= 0 || type->denominator <= 0) {
    Access::refuse(value_, EINVAL, "it is a " + value_.type_name() + ", and no duration");
  }
  const bool rounded = Access::scalar(value_).kind == Kind::Float;
  detail::Number ticks;
  if (!description::convert(count, period, {type->numerator, type->denominator}, rounded, ticks)) {
    Access::refuse(value_, ERANGE,
                   description::seconds_text(count, period) + " is no whole number of its units (" +
                       std::to_string(type->numerator) + "/" + std::to_string(type->denominator) +
                       " s), or too many");
  }
  set_number(ticks);
}

void MutableValue::set_text(std::string_view text) const {
  const Description::Type& type = Access::inside(value_);
  if (type.kind == Kind::String) {
    description::Builder(Access::description(value_), memory_).set_text(value_, text);
    return;
  }
  if (type.kind != Kind::Array || Access::type_at(value_, type.element).kind != Kind::Char) {
    Access::refuse(value_, EINVAL, "it is a " + value_.type_name() + ", and no string");
  }
  const auto items = Access::items(value_);
  if (text.size() > items.count) {
    Access::refuse(
        value_, ERANGE,
        std::to_string(text.size()) + " bytes of text do not fit a " + value_.type_name());
  }
  auto* const at = const_cast<unsigned char*>(items.data);
  if (!text.empty()) std::memmove(at, text.data(), text.size());
  std::memset(at + text.size(), 0, items.count - text.size());
}

void MutableValue::resize(std::size_t count) const {
  description::Builder(Access::description(value_), memory_).resize(value_, count, true);
}

void MutableValue::assign(Bytes bytes) const {
  const auto before = Access::items(value_);
  const Access::Facts facts = Access::facts(value_, before.type);
  if (!facts.is_plain || facts.is_opaque) {
    Access::refuse(value_, EINVAL,
                   "the elements of a " + value_.type_name() + " are not just bytes");
  }
  if (bytes.size() % before.stride != 0) {
    Access::refuse(value_, ERANGE,
                   std::to_string(bytes.size()) + " bytes are no whole number of its elements");
  }
  Bools bools(value_, before.type, bytes.size());
  for (std::size_t at = 0; facts.has_bool && at < bytes.size(); at += before.stride) {
    if (bools.are_good(bytes.data() + at)) continue;
    Access::refuse(value_, ERANGE,
                   "element " + std::to_string(at / before.stride) + " would have a bool in it " +
                       "that is neither 0 nor 1");
  }
  description::Builder(Access::description(value_), memory_)
      .resize(value_, bytes.size() / before.stride, false);
  if (bytes.size() == 0) return;
  std::memmove(const_cast<unsigned char*>(Access::items(value_).data), bytes.data(), bytes.size());
}

}  // namespace lot
