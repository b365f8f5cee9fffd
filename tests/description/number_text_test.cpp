// SPDX-License-Identifier: Apache-2.0

// Numbers, times and texts of messages as text: each bound of each form.

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/value.hpp"

#include "description/text.hpp"

namespace {

using lot::Description;
using lot::Kind;
using lot::TextLimits;
using lot::Value;
using lot::description::is_utf8;
using lot::description::number_text;
using lot::description::seconds_text;
using lot::detail::Number;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

}  // namespace

TEST_SUITE_BEGIN("number_text");

TEST_CASE("a number's text is the shortest that is this number") {
  CHECK(number_text(Number::of(0)) == "0");
  CHECK(number_text(Number::of(-7)) == "-7");
  CHECK(number_text(Number::of(INT64_MIN)) == "-9223372036854775808");
  CHECK(number_text(Number::of(UINT64_MAX)) == "18446744073709551615");
  CHECK(number_text(Number::of(0.1)) == "0.1");
  CHECK(number_text(Number::of(0.1L)) == "0.100000000000000000001");
  CHECK(number_text(Number::of(1e300)) == "1e+300");
  CHECK(number_text(Number::of(kInfinity)) == "inf");
  CHECK(number_text(Number::of(-kInfinity)) == "-inf");
  CHECK(number_text(Number::of(std::nan(""))) == "nan");
  char room[64];
  using lot::description::text_of_number;
  CHECK(text_of_number(0.1F, room) == "0.1");
  CHECK(text_of_number(0.1, room) == "0.1");
  CHECK(text_of_number(static_cast<double>(0.1F), room) == "0.10000000149011612");
  CHECK(text_of_number(-std::numeric_limits<float>::infinity(), room) == "-inf");
  CHECK(text_of_number(std::numeric_limits<float>::infinity(), room) == "inf");
  CHECK(text_of_number(std::nanf(""), room) == "nan");
  CHECK(text_of_number(std::copysign(std::nan(""), -1), room) == "nan");
}

TEST_CASE("a duration's text is exact, in decimals where they end") {
  struct Span {
    Number count;
    lot::detail::Period period;
    const char* text;
  };
  const Span kSpans[] = {
      {Number::of(0), {1, 1}, "0s"},
      {Number::of(5), {1, 1}, "5s"},
      {Number::of(-5), {60, 1}, "-300s"},
      {Number::of(1500), {1, 1000}, "1.5s"},
      {Number::of(-1500), {1, 1000}, "-1.5s"},
      {Number::of(1000), {1, 1000}, "1s"},
      {Number::of(1001), {1, 1000}, "1.001s"},
      {Number::of(-1), {1, 1000}, "-0.001s"},
      {Number::of(-1'000'000'005), {1, 1'000'000'000}, "-1.000000005s"},
      {Number::of(INT64_MIN), {1, 1'000'000'000}, "-9223372036.854775808s"},
      {Number::of(UINT64_MAX), {1, 1'000'000'000}, "18446744073.709551615s"},
      {Number::of(7), {1, 3}, "7 * 1/3s"},
      {Number::of(-7), {2, 6}, "-7 * 1/3s"},
      {Number::of(7), {3, 3}, "7s"},
      {Number::of(3), {1, 8}, "0.375s"},
      {Number::of(3), {2, 8}, "0.75s"},
      {Number::of(1), {1, 1'000'000'000'000'000'000}, "0.000000000000000001s"},
      {Number::of(1), {1, 2'000'000'000'000'000'000}, "1 * 1/2000000000000000000s"},
      {Number::of(UINT64_MAX), {2, 1}, "18446744073709551615 * 2/1s"},
      {Number::of(UINT64_MAX / 2), {2, 1}, "18446744073709551614s"},
      {Number::of(2.5), {1, 1000}, "0.0025s"},
      {Number::of(-2.5), {60, 1}, "-150s"},
      {Number::of(kInfinity), {1, 1000}, "infs"}};
  for (const auto& [count, period, text] : kSpans) CHECK(seconds_text(count, period) == text);
}

TEST_CASE("a text is UTF-8 by the table of Unicode") {
  for (const char* text :
       {"", "a\x7f", "\xc2\x80", "\xdf\xbf", "\xe0\xa0\x80", "\xe0\xbf\xbf", "\xe1\x80\x80",
        "\xec\xbf\xbf", "\xed\x80\x80", "\xed\x9f\xbf", "\xee\x80\x80", "\xef\xbf\xbf",
        "\xf0\x90\x80\x80", "\xf0\xbf\xbf\xbf", "\xf1\x80\x80\x80", "\xf3\xbf\xbf\xbf",
        "\xf4\x80\x80\x80", "\xf4\x8f\xbf\xbf", "a\xc3\xa4z\xe2\x82\xac!"}) {
    CAPTURE(std::string(text));
    CHECK(is_utf8(text));
  }
  for (const char* text : {"\x80",
                           "\xbf",
                           "\xc0\x80",
                           "\xc1\xbf",
                           "\xc2",
                           "\xc2z",
                           "\xc2\xc0",
                           "\xdf\x7f",
                           "\xe0\x9f\xbf",
                           "\xe0\x80\x80",
                           "\xe1\x80",
                           "\xe1\x80z",
                           "\xe1\x7f\x80",
                           "\xed\xa0\x80",
                           "\xed\xbf\xbf",
                           "\xf0\x8f\xbf\xbf",
                           "\xf0\x80\x80\x80",
                           "\xf1\x80\x80",
                           "\xf1\x80\x80z",
                           "\xf4\x90\x80\x80",
                           "\xf4\xbf\xbf\xbf",
                           "\xf5\x80\x80\x80",
                           "\xff",
                           "a\xc3\xa4\x80"}) {
    CAPTURE(std::string(text));
    CHECK(!is_utf8(text));
  }
  for (const std::string_view text : {"\xc2\x80", "\xe2\x82\xac", "\xf0\x9f\x98\x80"}) {
    for (std::size_t size = 1; size < text.size(); ++size) CHECK(!is_utf8(text.substr(0, size)));
  }
}

namespace {

struct Mixed {
  bool yes;
  char letter, blank, tilde, bell, beyond;
  char name[4];
  std::uint8_t bytes[5];
  float real;
  long double long_real;
  std::int64_t span;
};

/// Of the fields of Mixed, one after the other.
std::string text_of(const Mixed& mixed, const char* field, TextLimits limits = {},
                    std::int64_t denominator = 1000, std::int64_t numerator = 1) {
  Description all;
  all.types.resize(8);
  const auto set = [&](std::size_t place, Kind kind, std::uint64_t size, std::uint32_t element,
                       std::uint64_t count) {
    all.types[place].kind = kind;
    all.types[place].size = size;
    all.types[place].element = element;
    all.types[place].count = count;
  };
  const std::uint32_t none = Description::kNone;
  set(0, Kind::Struct, sizeof(Mixed), none, 0);
  set(1, Kind::Bool, 1, none, 0);
  set(2, Kind::Char, 1, none, 0);
  set(3, Kind::Array, 4, 2, 4);
  set(4, Kind::UInt, 1, none, 0);
  set(5, Kind::Array, 5, 4, 5);
  set(6, Kind::Float, 4, none, 0);
  set(7, Kind::Duration, 8, 8, 0);
  all.types[7].numerator = numerator;
  all.types[7].denominator = denominator;
  all.types.resize(11);
  set(8, Kind::Int, 8, none, 0);
  set(9, Kind::Opaque, 5, none, 0);
  set(10, Kind::Float, 16, none, 0);
  const auto add = [&](const char* name, std::size_t offset, std::uint32_t type) {
    Description::Field f;
    f.name = name;
    f.offset = static_cast<decltype(f.offset)>(offset);
    f.type = type;
    all.types[0].fields.push_back(f);
  };
  add("yes", offsetof(Mixed, yes), 1);
  add("letter", offsetof(Mixed, letter), 2);
  add("blank", offsetof(Mixed, blank), 2);
  add("tilde", offsetof(Mixed, tilde), 2);
  add("bell", offsetof(Mixed, bell), 2);
  add("beyond", offsetof(Mixed, beyond), 2);
  add("name", offsetof(Mixed, name), 3);
  add("bytes", offsetof(Mixed, bytes), 5);
  add("real", offsetof(Mixed, real), 6);
  add("span", offsetof(Mixed, span), 7);
  add("opaque", offsetof(Mixed, bytes), 9);
  add("long_real", offsetof(Mixed, long_real), 10);
  const Value root(all, &mixed, &mixed, &mixed + 1);
  return to_string(*field != '\0' ? root[field] : root, limits);
}

}  // namespace

TEST_CASE("a Value of each kind has its own text, and no more of it than the limits say") {
  Mixed mixed{};
  mixed = {true, 'a',  ' ',  '~', '\a', '\x7f', {'h', 'i', 0, 'x'}, {1, 2, 3, 4, 5},
           0.1F, 0.1L, -1500};
  CHECK(text_of(mixed, "") ==
        "{yes: true, letter: 'a', blank: ' ', tilde: '~', bell: 7, beyond: 127, name: \"hi\", "
        "bytes: [1, 2, 3, 4, 5], real: 0.1, span: -1.5s, opaque: <5 bytes>, "
        "long_real: 0.100000000000000000001}");
  const std::pair<TextLimits, const char*> kBytes[] = {
      {{5, 80, 100}, "[1, 2, 3, 4, 5]"},         {{4, 80, 100}, "[1, 2, 3, 4, ... 5 in all]"},
      {{1, 80, 100}, "[1, ... 5 in all]"},       {{0, 80, 100}, "[... 5 in all]"},
      {{5, 80, 6}, "[1, 2, 3, 4, 5]"},           {{5, 80, 5}, "[1, 2, 3, 4, ...]"},
      {{5, 80, 1}, "[..., ..., ..., ..., ...]"}, {{5, 80, 0}, "..."}};
  for (const auto& [limits, text] : kBytes) CHECK(text_of(mixed, "bytes", limits) == text);
  CHECK(text_of(mixed, "name", {16, 2, 100}) == "\"hi\"");
  CHECK(text_of(mixed, "name", {16, 1, 100}) == "\"h... 2 bytes\"");
  CHECK(text_of(mixed, "name", {16, 0, 100}) == "\"... 2 bytes\"");
  mixed.name[0] = '"';
  mixed.name[1] = '\\';
  mixed.name[2] = '\x1f';
  CHECK(text_of(mixed, "name") == "\"\\\"\\\\\\x1fx\"");
  mixed.name[2] = '\xe4';
  mixed.name[3] = '~';
  CHECK(text_of(mixed, "name") == "\"\\\"\\\\\\xe4~\"");
  mixed.name[1] = ' ';
  mixed.name[2] = '\x7f';
  CHECK(text_of(mixed, "name") == "\"\\\" \\x7f~\"");
  mixed.real = std::nanf("");
  CHECK(text_of(mixed, "real") == "nan");
  mixed.long_real = -std::numeric_limits<long double>::infinity();
  CHECK(text_of(mixed, "long_real") == "-inf");
  CHECK(text_of(mixed, "span", {}, 0) == "<damaged>");
  CHECK(text_of(mixed, "span", {}, -1) == "<damaged>");
  CHECK(text_of(mixed, "span", {}, 1) == "-1500s");
  CHECK(text_of(mixed, "span", {}, 1000, 0) == "<damaged>");
  CHECK(text_of(mixed, "span", {}, 1000, -1) == "<damaged>");
  mixed.yes = false;
  CHECK(text_of(mixed, "yes") == "false");
  reinterpret_cast<unsigned char&>(mixed.yes) = 2;
  CHECK(text_of(mixed, "", {0, 0, 3}) ==
        "{yes: <damaged>, letter: 'a', blank: ..., tilde: ..., bell: ..., beyond: ..., name: ..., "
        "bytes: ..., real: ..., span: ..., opaque: ..., long_real: ...}");
}

TEST_SUITE_END();
