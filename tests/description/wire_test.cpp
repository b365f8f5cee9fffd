// SPDX-License-Identifier: Apache-2.0

// Descriptions as bytes: encoded, decoded, cut, and made by an enemy.

#include "description/wire.hpp"

#include <chrono>
#include <cstdint>
#include <string>
#include <utility>

#include <doctest/doctest.h>

#include <lot/describe.hpp>
#include <lot/lot.hpp>

using lot::Description;
using lot::Kind;
using lot::description::decode;
using lot::description::encode;
using lot::description::first_difference;

namespace {

enum class Mode : std::uint16_t { Idle };
struct Point {
  float x, y, z;
};
struct Flags {
  std::uint32_t low : 3, high : 7;
  bool on;
};
struct Node {
  int value;
  lot::ShmVector<Node> children;
};
struct Every {
  bool yes;
  char letter;
  std::uint8_t pixels[3][4];
  Mode mode;
  double real;
  long double wide;
  Point points[5];
  lot::ShmString name;
  lot::ShmVector<Point> cloud;
  lot::ShmVector<lot::ShmString> names;
  lot::ShmRef<const Node> tree;
  std::chrono::microseconds span;
  std::chrono::system_clock::time_point at;
  Flags flags;
  struct Empty {
  } empty;
};
struct Renamed {
  float x, y, depth;
};
struct Retyped {
  float x;
  std::uint32_t y;
  float z;
};

bool is_equal(const Description& a, const Description& b) { return encode(a) == encode(b); }

/// Structs in each other, `levels` deep, each with `width` fields.
Description nested(std::size_t levels, std::size_t width) {
  Description all;
  for (std::size_t i = 0; i < levels; ++i) {
    Description::Type type;
    type.kind = Kind::Struct;
    type.size = 8;
    for (std::size_t f = 0; f < width; ++f) {
      type.fields.push_back({"f", static_cast<std::uint32_t>(i + 1), 0, 0, 0});
    }
    all.types.push_back(type);
  }
  Description::Type leaf;
  leaf.kind = Kind::UInt;
  leaf.size = 8;
  all.types.push_back(leaf);
  return all;
}

Description::Type typed(Kind kind, std::uint64_t size) {
  Description::Type type;
  type.kind = kind;
  type.size = size;
  return type;
}
/// A type that has an element.
Description of(Kind kind, std::uint64_t size, Kind element, std::uint64_t element_size) {
  Description d{{typed(kind, size), typed(element, element_size)}};
  d.types[0].element = 1;
  if (kind == Kind::Duration) d.types[0].numerator = d.types[0].denominator = 1;
  return d;
}

/// Without its checks: as an enemy writes it.
std::string raw(const Description& all) {
  std::string bytes("\1", 1);
  const auto number = [&bytes](std::uint64_t n) {
    for (; n >= 0x80; n >>= 7) bytes += static_cast<char>(0x80 | (n & 0x7f));
    bytes += static_cast<char>(n);
  };
  const auto text = [&](const std::string& t) {
    number(t.size());
    bytes += t;
  };
  number(all.types.size());
  for (const auto& t : all.types) {
    number(static_cast<std::uint64_t>(t.kind));
    number(t.size);
    text(t.name);
    number(t.element == Description::kNone ? 0 : std::uint64_t{t.element} + 1);
    number(t.count);
    number(static_cast<std::uint64_t>(t.numerator));
    number(static_cast<std::uint64_t>(t.denominator));
    number(t.fields.size());
    for (const auto& f : t.fields) {
      text(f.name);
      number(f.type);
      number(f.offset);
      number(f.bit);
      number(f.bits);
    }
  }
  return bytes;
}

}  // namespace

TEST_SUITE_BEGIN("description");

TEST_CASE("a description comes back from its bytes as it was") {
  const Description& every = lot::describe<Every>();
  const std::string bytes = encode(every);
  CHECK(bytes == raw(every));
  const auto back = decode(bytes);
  REQUIRE(back);
  CHECK(encode(*back) == bytes);
  CHECK(back->layout_hash() == every.layout_hash());
  CHECK(back->names_hash() == every.names_hash());
  CHECK(back->root().fields.size() == every.root().fields.size());
  CHECK(first_difference(*back, every).empty());
}

TEST_CASE("bytes of a description that are cut or changed give nothing, or another description") {
  const std::string bytes = encode(lot::describe<Every>());
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    CHECK_FALSE(decode(std::string_view(bytes).substr(0, size)));
  }
  CHECK_FALSE(decode(bytes + '\0'));
  std::size_t accepted = 0;
  for (std::size_t bit = 0; bit < 8 * bytes.size(); ++bit) {
    std::string changed = bytes;
    changed[bit / 8] = static_cast<char>(changed[bit / 8] ^ 1 << bit % 8);
    const auto other = decode(changed);
    if (!other) continue;
    ++accepted;  // a letter of a name, or an offset
    CHECK(encode(*other) == changed);
  }
  CHECK(accepted < 8 * bytes.size());
}

TEST_CASE("a description that an enemy has made is refused, and quickly") {
  const auto decodes = [](const Description& d) { return decode(raw(d)).has_value(); };
  CHECK(decodes(nested(15, 2)));
  CHECK_FALSE(decodes(nested(15, 3)));  // too many steps: 3 to the power of 15
  CHECK_FALSE(decodes(nested(16, 1)));  // too deep
  Description upside_down;              // each type comes before those that hold it
  for (std::uint32_t i = 0; i < 30; ++i) {
    Description::Type type;
    type.kind = i == 1 ? Kind::UInt : Kind::Struct;
    type.size = 8;
    if (i != 1) type.fields.push_back({"f", i == 0 ? 29 : i - 1, 0, 0, 0});
    upside_down.types.push_back(type);
  }
  CHECK_FALSE(decodes(upside_down));
  CHECK(encode(nested(16, 1)).empty());
  Description d = nested(1, 1);
  SUBCASE("a struct within itself") { d.types[0].fields[0].type = 0; }
  SUBCASE("a field behind the end") { d.types[0].fields[0].offset = 1; }
  SUBCASE("an offset without end") { d.types[0].fields[0].offset = ~std::uint64_t{0}; }
  SUBCASE("a type that is not there") { d.types[0].fields[0].type = 2; }
  SUBCASE("a kind that is not there") { d.types[1].kind = static_cast<Kind>(14); }
  SUBCASE("an integer of three bytes") { d.types[1].size = 3; }
  SUBCASE("a number that has fields") { d.types[1].fields = d.types[0].fields; }
  SUBCASE("more bits than the type") { d.types[0].fields[0].bits = 65; }
  SUBCASE("bits of a float") {
    d.types[1].kind = Kind::Float;
    d.types[0].fields[0].bits = 2;
  }
  SUBCASE("an array of nothing") {
    d.types[0] = Description::Type{};
    d.types[0].kind = Kind::Array;
  }
  SUBCASE("an array whose size is not that of its elements") {
    d.types[0].fields.clear();
    d.types[0].kind = Kind::Array;
    d.types[0].element = 1;
    d.types[0].count = 1000;
  }
  SUBCASE("a vector of nothing") {
    d.types[0].fields.clear();
    d.types[0].kind = Kind::Vector;
  }
  CHECK_FALSE(decodes(d));
}

TEST_CASE("a type has the sizes, elements and numbers that its kind can have, and no others") {
  const auto good = [](const Description& d) { return decode(raw(d)).has_value(); };
  const auto leaf = [&](Kind kind, std::uint64_t size) { return good({{typed(kind, size)}}); };
  for (std::uint64_t size = 0; size < 20; ++size) {
    const bool is_power = size == 1 || size == 2 || size == 4 || size == 8;
    CHECK(leaf(Kind::Bool, size) == (size == 1));
    CHECK(leaf(Kind::Char, size) == (size == 1));
    CHECK(leaf(Kind::Int, size) == is_power);
    CHECK(leaf(Kind::UInt, size) == is_power);
    CHECK(leaf(Kind::Float, size) == (size == 4 || size == 8 || size == 12 || size == 16));
    CHECK(leaf(Kind::Struct, size) == (size != 0));
    CHECK(leaf(Kind::Opaque, size) == (size != 0));
    for (const Kind kind : {Kind::String, Kind::Vector, Kind::Reference, Kind::Opaque}) {
      CHECK(good(of(kind, size, Kind::Char, 1)) == (size != 0));
    }
  }
  for (const Kind element :
       {Kind::Bool, Kind::Char, Kind::Int, Kind::UInt, Kind::Float, Kind::Struct, Kind::Opaque}) {
    const bool is_float = element == Kind::Float;
    const bool is_number = element != Kind::Struct && element != Kind::Opaque;
    const std::uint64_t size = is_float ? 4 : 1;
    CHECK(good(of(Kind::Enum, size, element, size)) == (is_number && !is_float));
    CHECK(good(of(Kind::Duration, size, element, size)) == is_number);
    CHECK(!good(of(Kind::TimePoint, size, element, size)));
    CHECK(good(of(Kind::String, 32, element, size)) == (element == Kind::Char));
    CHECK(!good(of(element, size, Kind::Char, 1)) == (element != Kind::Opaque));
  }
  CHECK(!good(of(Kind::Enum, 2, Kind::Int, 4)));
  CHECK(!good(of(Kind::Duration, 4, Kind::Int, 8)));
  for (const Kind kind : {Kind::Enum, Kind::Duration, Kind::TimePoint, Kind::Array, Kind::String,
                          Kind::Vector, Kind::Reference}) {
    CHECK(!leaf(kind, 8));  // of nothing
  }

  Description d = of(Kind::Duration, 8, Kind::Int, 8);
  d.types.push_back(d.types[0]);
  d.types[0] = typed(Kind::TimePoint, 8);
  d.types[0].element = 2;
  d.types[2].element = 1;
  CHECK(good(d));
  d.types[0].size = 4;
  CHECK(!good(d));
  for (const auto number : {&Description::Type::numerator, &Description::Type::denominator}) {
    d = of(Kind::Duration, 8, Kind::Int, 8);
    d.types[0].*number = 0;
    CHECK(!good(d));
    d = of(Kind::Vector, 8, Kind::Int, 8);
    d.types[0].*number = 1;
    CHECK(!good(d));
  }
  d = of(Kind::Vector, 8, Kind::Int, 8);
  d.types[0].count = 1;
  CHECK(!good(d));
  for (const std::uint64_t size : {7U, 8U, 9U, 10U}) {
    d = of(Kind::Array, size, Kind::Int, 2);
    d.types[0].count = 4;
    CHECK(good(d) == (size == 8));
  }
}

TEST_CASE("a field lies in its struct, also one of some bits") {
  const auto good = [](Kind kind, std::uint64_t size, const Description::Field& field) {
    Description d{{typed(Kind::Struct, 8), typed(kind, size)}};
    d.types[0].fields.push_back(field);
    return decode(raw(d)).has_value();
  };
  CHECK(good(Kind::UInt, 4, {"f", 1, 4, 0, 0}));
  CHECK(!good(Kind::UInt, 4, {"f", 1, 5, 0, 0}));
  CHECK(!good(Kind::UInt, 4, {"f", 1, 0, 1, 0}));  // a bit, and no number of bits
  CHECK(good(Kind::Struct, 8, {"f", 1, 0, 0, 0}));
  CHECK(!good(Kind::Struct, 9, {"f", 1, 0, 0, 0}));
  Description empty{{typed(Kind::Struct, 8), typed(Kind::Array, 0), typed(Kind::UInt, 4)}};
  empty.types[1].element = 2;
  for (const std::uint64_t offset : {7U, 8U, 9U}) {  // no elements: they may lie at the end
    empty.types[0].fields = {{"f", 1, offset, 0, 0}};
    CHECK(decode(raw(empty)).has_value() == (offset <= 8));
  }

  for (const Kind kind : {Kind::UInt, Kind::Int, Kind::Bool, Kind::Char}) {
    CHECK(good(kind, 1, {"f", 1, 7, 0, 8}));
    CHECK(!good(kind, 1, {"f", 1, 7, 0, 9}));
    CHECK(good(kind, 1, {"f", 1, 7, 5, 3}));
    CHECK(!good(kind, 1, {"f", 1, 7, 5, 4}));  // its last bit lies behind the end
    CHECK(!good(kind, 1, {"f", 1, 8, 0, 1}));
    CHECK(!good(kind, 1, {"f", 1, 0, 8, 1}));
  }
  CHECK(good(Kind::UInt, 8, {"f", 1, 0, 0, 64}));
  CHECK(!good(Kind::Struct, 8, {"f", 1, 0, 0, 3}));
  CHECK(!good(Kind::Opaque, 8, {"f", 1, 0, 0, 3}));
}

TEST_CASE("a number in the bytes of a description has one spelling, and 64 bits") {
  const std::string bytes = raw({{typed(Kind::UInt, 8)}});
  REQUIRE(decode(bytes));
  const auto with_format = [&](const std::string& format) {
    return decode(format + bytes.substr(1)).has_value();
  };
  CHECK(with_format("\1"));
  CHECK(!with_format(std::string("\0", 1)));
  CHECK(!with_format("\2"));
  CHECK(!with_format(std::string("\x81\0", 2)));
  CHECK(!with_format(std::string("\x81\x80\0", 3)));
  CHECK(!with_format(std::string("\x81\x80\x80\x80\x80\x80\x80\x80\x80\x02")));
  CHECK(!with_format(std::string(10, '\x80') + '\1'));
  // A name that is one byte longer than what follows it, where that makes sense without a name.
  std::string nameless = bytes;
  REQUIRE(nameless.size() == 10);
  nameless[4] = 6;
  CHECK(!decode(nameless));
  for (const std::uint64_t size : {127U, 128U, 129U, 16383U, 16384U}) {
    const Description d{{typed(Kind::Struct, size)}};
    CHECK(encode(d) == raw(d));
    REQUIRE(decode(raw(d)));
    CHECK(decode(raw(d))->types[0].size == size);
  }
  // So many types are said to follow, and do not.
  CHECK(!decode(std::string("\1\2", 2) + bytes.substr(2)));
  CHECK(!decode(std::string("\1\0", 2)));
}

TEST_CASE("a description whose walk would have no end is refused") {
  // Each level leads to the next one many times, and the last one back: nothing may be noted.
  Description d = nested(14, 40);
  d.types.back().kind = Kind::Vector;
  d.types.back().element = 0;
  CHECK_FALSE(decode(raw(d)));
  CHECK(encode(d).empty());
}

TEST_CASE("a description that is too large has no bytes") {
  Description d = nested(1, 4000);
  CHECK(encode(d).empty());
  CHECK_FALSE(decode(std::string(lot::description::kMostBytes + 1, '\1')));
}

TEST_CASE("the first field that differs is told, as each side has it") {
  const Description& point = lot::describe<Point>();
  CHECK(first_difference(point, point).empty());
  CHECK(first_difference(point, lot::describe<Retyped>()) ==
        (point.names_hash() == 0 ? "_1" : "y") +
            std::string(": the topic has float32; this side has uint32"));
  const Description& renamed = lot::describe<Renamed>();
  if (point.names_hash() != 0) {
    CHECK(first_difference(point, renamed) ==
          "field 3: the topic has z, float32 at byte 8; this side has depth, float32 at byte 8");
  }
  const Description inner = nested(2, 1);
  Description other = inner;
  other.types[2].kind = Kind::Int;
  CHECK(first_difference(inner, other) == "f.f: the topic has uint64; this side has int64");
  other = inner;
  other.types[1].fields.clear();
  CHECK(first_difference(inner, other) ==
        "field 1 of f: the topic has f, uint64 at byte 0; this side has none");
  CHECK(first_difference(lot::describe<Node>(), lot::describe<Node>()).empty());
  CHECK(is_equal(inner, inner));
}

// ---- limits, to the byte

/// A number as the first type, and behind it types that nothing leads to: one of `levels` structs
/// in each other, each with one field, and `leaf` in the last one.
Description beside(std::size_t levels, const Description::Type& leaf, bool upside_down) {
  Description d{{typed(Kind::UInt, 8)}};
  const auto place = [&](std::size_t level) {
    return static_cast<std::uint32_t>(upside_down ? levels + 1 - level : level + 1);
  };
  d.types.resize(levels + 2);
  for (std::size_t level = 0; level < levels; ++level) {
    d.types[place(level)] = typed(Kind::Struct, 64);
    d.types[place(level)].fields = {{"", place(level + 1), 0, 0, 0}};
  }
  d.types[place(levels)] = leaf;
  return d;
}

TEST_CASE("types lie in each other sixteen deep, also those that nothing leads to") {
  const auto good = [](const Description& d) {
    const bool is_good = decode(raw(d)).has_value();
    CHECK(encode(d).empty() == !is_good);
    return is_good;
  };
  for (const bool upside_down : {false, true}) {
    CAPTURE(upside_down);
    for (const std::size_t levels : {1U, 15U, 16U, 17U, 18U, 19U}) {
      CAPTURE(levels);
      CHECK(good(beside(levels, typed(Kind::UInt, 8), upside_down)) == (levels <= 16));
      for (const Kind kind : {Kind::String, Kind::Vector, Kind::Reference, Kind::Opaque}) {
        CAPTURE(static_cast<int>(kind));
        // What it holds lies elsewhere, and is no level.
        Description d = beside(levels, typed(kind, 32), upside_down);
        d.types[upside_down ? 1 : levels + 1].element = static_cast<std::uint32_t>(levels + 2);
        d.types.push_back(typed(Kind::Char, 1));
        CHECK(good(d) == (levels <= 16));
      }
      // An array's elements lie in it.
      Description d = beside(levels, typed(Kind::Array, 8), upside_down);
      d.types[upside_down ? 1 : levels + 1].element = 0;
      d.types[upside_down ? 1 : levels + 1].count = 1;
      CHECK(good(d) == (levels <= 15));
    }
  }
  Description within{{typed(Kind::UInt, 8), typed(Kind::Array, 8)}};
  within.types[1].element = 1;
  within.types[1].count = 1;
  CHECK(!good(within));
  within.types[1].kind = Kind::Vector;
  within.types[1].count = 0;
  CHECK(good(within));
}

TEST_CASE("a walk over a type has 65536 steps at most") {
  const auto good = [](std::size_t more) {
    Description d{{typed(Kind::UInt, 8)}};
    for (std::uint32_t i = 0; i < 15; ++i) {
      d.types.push_back(typed(Kind::Struct, 8));
      d.types.back().fields = {{"", i, 0, 0, 0}, {"", i, 0, 0, 0}};
    }
    d.types.push_back(typed(Kind::Struct, 8));
    d.types.back().fields = {{"", 15, 0, 0, 0}};
    for (std::size_t i = 0; i < more; ++i) d.types.back().fields.push_back({"", 0, 0, 0, 0});
    return decode(raw(d)).has_value();
  };
  CHECK(good(0));  // 1 and 65535
  CHECK(!good(1));
  CHECK(!good(2));
}

TEST_CASE("a description has 16 KiB at most, to the byte") {
  Description d{{typed(Kind::Struct, 8)}};
  d.types[0].name = std::string(16'000, 'x');
  const std::size_t beside = raw(d).size() - 16'000;
  d.types[0].name = std::string(lot::description::kMostBytes - beside, 'x');
  REQUIRE(raw(d).size() == 16384);
  CHECK(encode(d) == raw(d));
  CHECK(decode(raw(d)));
  d.types[0].name += 'x';
  CHECK(encode(d).empty());
  CHECK_FALSE(decode(raw(d)));
}

TEST_CASE("sizes end at 2 to the power of 48") {
  constexpr std::uint64_t kMost = std::uint64_t{1} << 48;
  for (const Kind kind : {Kind::Struct, Kind::Opaque}) {
    for (const std::uint64_t size : {kMost - 1, kMost, kMost + 1, kMost + 2}) {
      CHECK(decode(raw({{typed(kind, size)}})).has_value() == (size <= kMost));
    }
  }
}

TEST_CASE("fields without names take five bytes each, and nothing but a struct has some") {
  Description d{{typed(Kind::UInt, 8), typed(Kind::Struct, 8)}};
  for (std::size_t n = 0; n < 40; ++n) {
    const auto back = decode(raw(d));
    REQUIRE(back);
    CHECK(back->types[1].fields.size() == n);
    d.types[1].fields.push_back({"", 0, 0, 0, 0});
  }
  for (const Kind kind : {Kind::UInt, Kind::Opaque, Kind::Float, Kind::Bool}) {
    const std::uint64_t size = kind == Kind::Bool ? 1 : 8;
    Description other{{typed(Kind::UInt, 8), typed(kind, size), typed(Kind::UInt, 1)}};
    CHECK(decode(raw(other)));
    other.types[1].fields = {{"", 2, 0, 0, 0}};
    CHECK_FALSE(decode(raw(other)));
  }
}

TEST_CASE("bits lie in a number of their own size or an enum, and begin in their first byte") {
  const auto good = [](const Description::Type& type, std::uint64_t offset, std::uint32_t bit,
                       std::uint32_t bits) {
    Description d{{typed(Kind::Struct, 8), type, typed(Kind::UInt, 1)}};
    d.types[0].fields = {{"f", 1, offset, bit, bits}};
    return decode(raw(d)).has_value();
  };
  const auto byte = typed(Kind::UInt, 1);
  CHECK(good(byte, 0, 7, 1));
  CHECK(good(byte, 0, 7, 8));
  CHECK(!good(byte, 0, 8, 1));
  CHECK(!good(byte, 0, 0, 9));  // more than the number has
  CHECK(!good(byte, 0, 7, 9));
  CHECK(good(typed(Kind::UInt, 2), 0, 0, 16));
  CHECK(!good(typed(Kind::UInt, 2), 0, 0, 17));
  CHECK(good(byte, 7, 0, 1));
  for (const std::uint64_t offset : {8U, 9U, 10U, 100U}) CHECK(!good(byte, offset, 0, 1));
  auto mode = typed(Kind::Enum, 1);
  mode.element = 2;
  CHECK(good(mode, 3, 2, 5));
  CHECK(!good(mode, 3, 0, 9));
}
