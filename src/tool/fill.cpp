// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <boost/archive/iterators/binary_from_base64.hpp>
#include <boost/archive/iterators/dataflow_exception.hpp>
#include <boost/archive/iterators/transform_width.hpp>

#include "lot/error.hpp"

#include "description/reader.hpp"
#include "tool/values.hpp"

namespace lot::tool {
namespace {

using Access = detail::ValueAccess;

/// What stands in the YAML, in words.
std::string words_for(const YAML::Node& node) {
  constexpr std::size_t kMost = 40;
  switch (node.Type()) {
    case YAML::NodeType::Map:
      return "a map";
    case YAML::NodeType::Sequence:
      return "a list";
    case YAML::NodeType::Scalar: {
      const std::string& text = node.Scalar();
      return "\"" + std::string(begin_of(text, kMost)) + (text.size() > kMost ? "..." : "") + "\"";
    }
    default:
      return "nothing";
  }
}

[[noreturn]] void refuse(const MutableValue& value, const YAML::Node& node,
                         const std::string& wanted) {
  Access::refuse(value, EINVAL,
                 "it is a " + value.value().type_name() + ", and the YAML has " + words_for(node),
                 wanted);
}

bool is_quoted(const YAML::Node& scalar) { return scalar.Tag() == "!"; }

/// A scalar without quotes.
std::string_view plain(const MutableValue& value, const YAML::Node& node,
                       const std::string& wanted) {
  if (!node.IsScalar() || is_quoted(node)) refuse(value, node, wanted);
  return node.Scalar();
}

/// A whole number, in decimal or, behind 0x, in hexadecimal. False: it is none, or has too many
/// digits.
bool parse(std::string_view text, detail::Number& number) {
  number.is_negative = !text.empty() && text.front() == '-';
  if (!text.empty() && (text.front() == '-' || text.front() == '+')) text.remove_prefix(1);
  const bool is_hex = text.substr(0, 2) == "0x";
  if (is_hex) text.remove_prefix(2);
  std::uint64_t size = 0;
  const char* const end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, size, is_hex ? 16 : 10);
  if (error != std::errc() || stop != end) return false;
  if (number.is_negative && size > (std::uint64_t{1} << 63)) return false;
  number.is_negative &= size != 0;
  number.whole = number.is_negative ? ~size + 1 : size;
  return true;
}

void set_whole(const MutableValue& value, const detail::Number& number) {
  if (number.is_negative) {
    value.set(static_cast<std::int64_t>(number.whole));
  } else {
    value.set(number.whole);
  }
}

void fill_whole(const MutableValue& value, const YAML::Node& node) {
  detail::Number number;
  if (!parse(plain(value, node, "write a whole number"), number)) {
    refuse(value, node, "write a whole number of at most 64 bits");
  }
  set_whole(value, number);
}

/// A text of digits as a number of type T, rounded once. False: it has another form.
template <class T>
bool set_real(const MutableValue& value, const std::string& text, T (*read)(const char*, char**)) {
  char* end = nullptr;
  const T number = read(text.c_str(), &end);
  if (*end != '\0') return false;
  if (std::isinf(number) && !text.ends_with("inf")) {
    Access::refuse(value, ERANGE, text + " does not fit a " + value.value().type_name());
  }
  value.set(number);
  return true;
}

void fill_real(const MutableValue& value, const YAML::Node& node) {
  std::string text(plain(value, node, "write a number"));
  const bool has_sign = !text.empty() && (text[0] == '-' || text[0] == '+');
  const std::string size = text.substr(has_sign ? 1 : 0);
  if (size == ".nan" || size == ".NaN") {
    text = "nan";
  } else if (size == ".inf" || size == ".Inf") {
    text = (text[0] == '-' ? "-" : "") + std::string("inf");
  } else if (size.empty() || size.find_first_not_of("0123456789.eE+-") != std::string::npos) {
    refuse(value, node, "write a number");
  }
  const std::uint64_t bytes = value.value().type().size;
  const bool is_number = bytes == sizeof(float)    ? set_real(value, text, &std::strtof)
                         : bytes == sizeof(double) ? set_real(value, text, &std::strtod)
                                                   : set_real(value, text, &std::strtold);
  if (!is_number) refuse(value, node, "write a number");
}

void fill_bool(const MutableValue& value, const YAML::Node& node) {
  const std::string_view text = plain(value, node, "write true or false");
  if (text != "true" && text != "false") refuse(value, node, "write true or false");
  value.set(text == "true");
}

/// In quotes it is a character. Without, a whole number is that of a byte, as a digit must be one
/// or the other; any other character is itself.
void fill_char(const MutableValue& value, const YAML::Node& node) {
  const std::string wanted = "write one character of ASCII, in quotes, or without them a number";
  if (!node.IsScalar()) refuse(value, node, wanted);
  const std::string& text = node.Scalar();
  detail::Number number;
  if (!is_quoted(node) && parse(text, number)) return set_whole(value, number);
  if (text.size() != 1) refuse(value, node, wanted);
  value.set(text.front());
}

/// "7 * 1/90000s", as times are told whose decimals have no end.
bool parse_ticks(const std::string& text, detail::Number& count, detail::Period& period) {
  const std::size_t times = text.find(" * ");
  const std::size_t slash = text.find('/');
  if (times == text.npos || slash == text.npos || slash < times || text.back() != 's') return false;
  const auto part = [&](std::size_t from, std::size_t to, std::int64_t& number) {
    const char* const end = text.data() + to;
    const auto [stop, error] = std::from_chars(text.data() + from, end, number);
    return error == std::errc() && stop == end && number > 0;
  };
  return parse(std::string_view(text).substr(0, times), count) &&
         part(times + 3, slash, period.numerator) &&
         part(slash + 1, text.size() - 1, period.denominator);
}

/// "-1.5s", "20ms".
void fill_time(const MutableValue& value, const YAML::Node& node) {
  struct Unit {
    const char* name;
    detail::Period period{};
  };
  constexpr Unit kUnits[] = {{"ns", {1, 1'000'000'000}}, {"us", {1, 1'000'000}}, {"ms", {1, 1000}},
                             {"min", {60, 1}},           {"h", {3600, 1}},       {"s", {1, 1}}};
  const std::string wanted =
      "write a time with a unit: 1.5s, 20ms; there are ns, us, ms, s, min, h";
  if (!node.IsScalar()) refuse(value, node, wanted);
  std::string text = node.Scalar();
  detail::Number count;
  detail::Period period;
  if (parse_ticks(text, count, period)) return Access::set_ticks(value, count, period);
  const bool is_real = Access::scalar(value.value()).kind == Kind::Float;
  std::size_t unit_at = text.find_first_not_of("+-0123456789.");
  if (is_real) {
    char* end = nullptr;
    count = detail::Number::of(std::strtold(text.c_str(), &end));
    unit_at = static_cast<std::size_t>(end - text.c_str());
    if (std::isinf(count.real) && text.find("inf") == text.npos) {
      Access::refuse(value, ERANGE, text + " does not fit a " + value.value().type_name());
    }
  }
  const std::string name = unit_at < text.size() ? text.substr(unit_at) : "";
  const auto* const unit = std::find_if(std::begin(kUnits), std::end(kUnits),
                                        [&](const Unit& u) { return name == u.name; });
  if (unit == std::end(kUnits) || unit_at == 0) refuse(value, node, wanted);
  period = unit->period;
  if (is_real) return Access::set_ticks(value, count, period);
  text.resize(unit_at);
  if (const std::size_t point = text.find('.'); point != std::string::npos) {
    text.erase(text.find_last_not_of('0') + 1);
    for (std::size_t digits = text.size() - 1 - point; digits != 0; --digits) {
      if (__builtin_mul_overflow(period.denominator, 10, &period.denominator)) {
        refuse(value, node, "write less digits behind the point");
      }
    }
    text.erase(point, 1);
  }
  if (!parse(text, count)) refuse(value, node, wanted);
  Access::set_ticks(value, count, period);
}

std::string decoded(const MutableValue& value, const YAML::Node& node) {
  using namespace boost::archive::iterators;
  using Bytes = transform_width<binary_from_base64<const char*>, 8, 6>;
  std::string text = node.Scalar();
  text.erase(std::remove_if(text.begin(), text.end(),
                            [](char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }),
             text.end());
  const std::size_t digits = text.find_last_not_of('=') + 1;  // 0: npos + 1
  const std::size_t padding = text.size() - digits;
  const std::string wanted = "write base64, with its padding: \"AQI=\"";
  if (text.size() % 4 != 0 || padding > 2 || text.find('=') < digits) refuse(value, node, wanted);
  std::fill(text.begin() + static_cast<std::ptrdiff_t>(digits), text.end(), 'A');  // zeros
  try {
    const char* const begin = text.data();
    std::string bytes(Bytes(begin), Bytes(begin + text.size()));
    bytes.resize(bytes.size() - padding);
    return bytes;
  } catch (const dataflow_exception&) {
    refuse(value, node, wanted);
  }
}

bool is_binary(const YAML::Node& node) {
  return node.IsScalar() && node.Tag() == "tag:yaml.org,2002:binary";
}

void fill_text(const MutableValue& value, const YAML::Node& node) {
  if (!node.IsScalar()) refuse(value, node, "write a text");
  value.set(is_binary(node) ? decoded(value, node) : node.Scalar());
}

void fill_elements(const MutableValue& value, const YAML::Node& node) {
  const Description::Type& type = value.value().type();
  const bool of_chars = Access::type_at(value, type.element).kind == Kind::Char;
  if (is_binary(node) || (of_chars && node.IsScalar())) {
    if (type.kind == Kind::Array && of_chars) return fill_text(value, node);
    const std::string bytes = is_binary(node) ? decoded(value, node) : node.Scalar();
    return value.assign({reinterpret_cast<const std::byte*>(bytes.data()), bytes.size()});
  }
  if (!node.IsSequence()) refuse(value, node, "write a list");
  if (type.kind == Kind::Array && node.size() != type.count) {
    refuse(value, node,
           "write a list of " + std::to_string(type.count) + ", not of " +
               std::to_string(node.size()));
  }
  value.resize(node.size());
  std::size_t i = 0;
  for (const YAML::Node& item : node) fill(value[i++], item);
}

void fill_fields(const MutableValue& value, const YAML::Node& node) {
  if (!node.IsMap()) refuse(value, node, "write a map of its fields");
  std::set<std::uint64_t> named;  // `_0` may be another word for it
  for (const auto& entry : node) {
    const YAML::Node& key = entry.first;
    if (!key.IsScalar()) refuse(value, key, "write a map of its fields");
    const MutableValue field = value[key.Scalar()];
    if (!named.insert(Access::find(value.value().type(), key.Scalar())).second) {
      Access::refuse(value, EINVAL, "the YAML names the field \"" + key.Scalar() + "\" twice");
    }
    fill(field, entry.second);
  }
}

}  // namespace

void fill(const MutableValue& value, const YAML::Node& node) {
  switch (value.value().kind()) {
    case Kind::Bool:
      return fill_bool(value, node);
    case Kind::Char:
      return fill_char(value, node);
    case Kind::Int:
    case Kind::UInt:
    case Kind::Enum:
      return fill_whole(value, node);
    case Kind::Float:
      return fill_real(value, node);
    case Kind::Duration:
    case Kind::TimePoint:
      return fill_time(value, node);
    case Kind::Array:
    case Kind::Vector:
      return fill_elements(value, node);
    case Kind::Struct:
      return fill_fields(value, node);
    case Kind::String:
      return fill_text(value, node);
    case Kind::Reference:
      if (node.IsNull() && value.value().is_null()) return;
      refuse(value, node, "a reference cannot be set: leave it out, or write null");
    case Kind::Opaque:
      refuse(value, node, "only its own programs can set it: leave it out");
  }
}

}  // namespace lot::tool
