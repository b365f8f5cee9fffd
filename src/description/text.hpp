// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <charconv>
#include <string>
#include <string_view>
#include <type_traits>

#include "lot/value.hpp"

/// Texts of single values, as people and programs read them.
namespace lot::description {

/// A number of a type that the machine has: as number_text(). The text stands in `room`, or is that
/// of what is no number.
std::string_view text_of_number(float number, char (&room)[64]) noexcept;
std::string_view text_of_number(double number, char (&room)[64]) noexcept;
template <class T, class = std::enable_if_t<std::is_integral_v<T>>>
std::string_view text_of_number(T number, char (&room)[64]) noexcept {
  return {room,
          static_cast<std::size_t>(std::to_chars(room, room + sizeof room, number).ptr - room)};
}
/// A number, exactly: "-7", "0.1" (the shortest text that is this float or double), "nan", "inf",
/// "-inf". Throws as Value::as().
std::string number_text(const Value& value);
/// A duration, or a time point since its epoch, in seconds: "-1.000000005s"; "7 * 1/3s" where that
/// has no end in decimals. Throws as Value::as().
std::string seconds_text(const Value& value);
/// The same of a count of periods, which are above 0.
std::string seconds_text(const detail::Number& count, detail::Period period);
/// A number as it is, the shortest text that is this double, or this long double.
std::string number_text(const detail::Number& number);
/// The text of an array of char, up to its first zero.
std::string_view text_of_chars(const Value& value);
bool is_utf8(std::string_view text) noexcept;

}  // namespace lot::description
