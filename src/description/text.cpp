// SPDX-License-Identifier: Apache-2.0
#include "description/text.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <utility>

#include "lot/error.hpp"

#include "description/reader.hpp"

namespace lot {

namespace description {
namespace {

template <class T>
std::string_view shortest(T number, char (&room)[64]) {
  if (std::isnan(number)) return "nan";  // with no sign
  return {room,
          static_cast<std::size_t>(std::to_chars(room, room + sizeof room, number).ptr - room)};
}

std::string real_text(long double number, std::uint64_t size) {
  char text[64];
  if (size == sizeof(float)) return std::string(shortest(static_cast<float>(number), text));
  if (size == sizeof(double) || !std::isfinite(number)) {
    return std::string(shortest(static_cast<double>(number), text));
  }
  std::snprintf(text, sizeof text, "%.21Lg", number);
  return text;
}

std::string whole_text(const detail::Number& number) {
  return number.is_negative ? std::to_string(static_cast<std::int64_t>(number.whole))
                            : std::to_string(number.whole);
}

/// How many decimals a denominator needs; 19: too many. `power` is 10 to that number.
int decimals(std::uint64_t denominator, std::uint64_t& power) {
  int n = 0;
  for (power = 1; n < 19 && power % denominator != 0; ++n) power *= 10;
  return n;
}

/// The element of a time point.
const Description::Type& duration_of(const Value& value) {
  const Description::Type& type = value.type();
  return type.kind == Kind::TimePoint ? detail::ValueAccess::type_at(value, type.element) : type;
}

}  // namespace

std::string_view text_of_number(float number, char (&room)[64]) noexcept {
  return shortest(number, room);
}
std::string_view text_of_number(double number, char (&room)[64]) noexcept {
  return shortest(number, room);
}

std::string number_text(const Value& value) {
  const Value here = value.target();
  const detail::Number number = detail::ValueAccess::number(here);
  return number.is_real ? real_text(number.real, here.type().size) : whole_text(number);
}

std::string number_text(const detail::Number& number) {
  const bool is_double = number.is_real && static_cast<double>(number.real) == number.real;
  return number.is_real ? real_text(number.real, is_double ? sizeof(double) : sizeof(long double))
                        : whole_text(number);
}

std::string seconds_text(const Value& value) {
  const Value here = value.target();
  const Description::Type& type = duration_of(here);
  const detail::Number count = detail::ValueAccess::number(here);
  if (type.kind != Kind::Duration || type.numerator <= 0 || type.denominator <= 0) {
    detail::ValueAccess::damaged(here, "it has no period");
  }
  return seconds_text(count, {type.numerator, type.denominator});
}

std::string seconds_text(const detail::Number& count, detail::Period period) {
  if (count.is_real) {
    return real_text(count.real * static_cast<long double>(period.numerator) /
                         static_cast<long double>(period.denominator),
                     sizeof(double)) +
           "s";
  }
  const auto common = std::gcd(period.numerator, period.denominator);
  const auto above = static_cast<std::uint64_t>(period.numerator / common);
  const auto below = static_cast<std::uint64_t>(period.denominator / common);
  const std::uint64_t size = count.is_negative ? ~count.whole + 1 : count.whole;
  std::uint64_t parts = 0;
  std::uint64_t power = 1;
  const int digits = decimals(below, power);
  if (digits == 19 || __builtin_mul_overflow(size, above, &parts)) {
    return whole_text(count) + " * " + std::to_string(above) + "/" + std::to_string(below) + "s";
  }
  std::string text = (count.is_negative ? "-" : "") + std::to_string(parts / below);
  const std::uint64_t rest = parts % below * (power / below);
  if (rest != 0) {
    std::string after = std::to_string(rest);
    after.insert(0, static_cast<std::size_t>(digits) - after.size(), '0');
    text += "." + after.substr(0, after.find_last_not_of('0') + 1);
  }
  return text + "s";
}

std::string_view text_of_chars(const Value& value) {
  const lot::Bytes bytes = value.bytes();
  const std::string_view all(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  return all.substr(0, all.find('\0'));
}

bool is_utf8(std::string_view text) noexcept {
  for (std::size_t i = 0; i < text.size();) {
    const auto byte = [&](std::size_t at) -> unsigned {
      return at < text.size() ? static_cast<unsigned char>(text[at]) : 0;
    };
    const unsigned first = byte(i);
    const std::size_t length = first < 0x80   ? 1
                               : first < 0xc2 ? 0
                               : first < 0xe0 ? 2
                               : first < 0xf0 ? 3
                               : first < 0xf5 ? 4
                                              : 0;
    if (length == 0) return false;
    for (std::size_t n = 1; n < length; ++n) {
      if ((byte(i + n) & 0xc0) != 0x80) return false;
    }
    const unsigned second = byte(i + 1);
    if ((first == 0xe0 && second < 0xa0) || (first == 0xed && second >= 0xa0) ||
        (first == 0xf0 && second < 0x90) || (first == 0xf4 && second >= 0x90)) {
      return false;
    }
    i += length;
  }
  return true;
}

}  // namespace description

namespace {

/// Prints a value, and what lies in it.
class Printer {
 public:
  explicit Printer(const TextLimits& limits) : limits_(limits), left_(limits.values) {}

  void add(const Value& value) {
    if (left_ == 0) {
      text_ += "...";
      return;
    }
    --left_;
    try {
      add_checked(value);
    } catch (const Error& error) {
      text_ += error.error_number() == ELOOP ? "..." : "<damaged>";
    }
  }
  std::string take() && { return std::move(text_); }

 private:
  void add_checked(const Value& value) {
    switch (value.kind()) {
      case Kind::Bool:
        text_ += value.as<bool>() ? "true" : "false";
        break;
      case Kind::Char:
        add_char(value);
        break;
      case Kind::Int:
      case Kind::UInt:
      case Kind::Float:
      case Kind::Enum:
        text_ += description::number_text(value);
        break;
      case Kind::Duration:
      case Kind::TimePoint:
        text_ += description::seconds_text(value);
        break;
      case Kind::Array:
      case Kind::Vector:
        add_elements(value);
        break;
      case Kind::Struct:
        add_fields(value);
        break;
      case Kind::String:
        add_text(value.as<std::string_view>());
        break;
      case Kind::Reference:
        value.is_null() ? void(text_ += "null") : add(value.target());
        break;
      case Kind::Opaque:
        text_ += "<" + std::to_string(value.size()) + " bytes>";
        break;
    }
  }

  void add_char(const Value& value) {
    const char c = value.as<char>();
    if (c >= ' ' && c <= '~') {
      text_ += std::string("'") + c + "'";
    } else {
      text_ += description::number_text(value);
    }
  }

  void add_elements(const Value& value) {
    const Description::Type& type = value.type();
    const bool is_text = type.kind == Kind::Array &&
                         detail::ValueAccess::type_at(value, type.element).kind == Kind::Char;
    if (is_text) return add_text(description::text_of_chars(value));
    const std::size_t before = text_.size();
    text_ += '[';
    std::uint64_t n = 0;
    const std::uint64_t count = value.size();
    try {
      for (auto item = value.begin(); item != value.end() && n < limits_.elements; ++item, ++n) {
        text_ += n == 0 ? "" : ", ";
        add(*item);
      }
    } catch (...) {
      text_.resize(before);
      throw;
    }
    if (count > n) {
      text_ += (n == 0 ? "" : ", ") + std::string("... ") + std::to_string(count) + " in all";
    }
    text_ += ']';
  }

  void add_fields(const Value& value) {
    text_ += '{';
    bool is_first = true;
    const Description::Type& type = value.type();
    for (std::size_t i = 0; i < type.fields.size(); ++i) {
      text_ += (is_first ? "" : ", ") + detail::name_of_field(type, i) + ": ";
      is_first = false;
      add_field(value, i);
    }
    text_ += '}';
  }
  /// One that is damaged does not hide the others.
  void add_field(const Value& value, std::size_t i) {
    const std::size_t before = text_.size();
    try {
      add(value[i]);
    } catch (const Error& error) {
      text_.resize(before);
      text_ += error.error_number() == ELOOP ? "..." : "<damaged>";
    }
  }

  void add_text(std::string_view text) {
    text_ += '"';
    for (const char c : text.substr(0, limits_.characters)) {
      if (c == '"' || c == '\\') {
        text_ += {'\\', c};
      } else if (c >= ' ' && c <= '~') {
        text_ += c;
      } else {
        char escaped[8];
        std::snprintf(escaped, sizeof escaped, "\\x%02x", static_cast<unsigned char>(c));
        text_ += escaped;
      }
    }
    text_ += text.size() > limits_.characters ? "... " + std::to_string(text.size()) + " bytes\""
                                              : std::string("\"");
  }

  TextLimits limits_;
  std::uint64_t left_;
  std::string text_;
};

}  // namespace

std::string to_string(const Value& value, const TextLimits& limits) {
  Printer printer(limits);
  printer.add(value);
  return std::move(printer).take();
}

}  // namespace lot
