// SPDX-License-Identifier: Apache-2.0

// Where two descriptions differ first, in the words for people, for each kind of type.

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "by_hand.hpp"
#include "description/wire.hpp"

namespace {

using namespace by_hand;
using lot::description::compare_names;
using lot::description::encode;
using lot::description::first_difference;

const Type kByte = type(Kind::UInt, 1);
const Type kMilliseconds = duration(8, 2, 1, 1000);

/// A struct with one field x of this type. Type 2 is the number in it, type 3 what may lie between.
Description with(Type x, Type number = kByte, Type between = kByte) {
  return {{structure("S", 64, {field("x", 1, 0)}), std::move(x), std::move(number),
           std::move(between)}};
}

struct Case {
  Description topic, here;
  const char* says;
};
void check(const std::vector<Case>& cases) {
  for (std::size_t n = 0; n < cases.size(); ++n) {
    CAPTURE(n);
    CHECK(first_difference(cases[n].topic, cases[n].here) == cases[n].says);
  }
}

}  // namespace

TEST_SUITE_BEGIN("difference");

TEST_CASE("a type is told by its kind, and by what people know it") {
  const std::pair<Description, const char*> kTypes[] = {
      {with(type(Kind::Bool, 1)), "bool"},
      {with(type(Kind::Char, 1)), "char"},
      {with(type(Kind::Int, 8)), "int64"},
      {with(type(Kind::UInt, 2)), "uint16"},
      {with(type(Kind::Float, 4)), "float32"},
      {with(type(Kind::Enum, 1, "E", 2)), "enum E of uint8"},
      {with(kMilliseconds, type(Kind::Int, 8)), "duration of int64 in 1/1000 s"},
      {with(type(Kind::TimePoint, 8, "steady_clock", 3), type(Kind::Int, 4), kMilliseconds),
       "time of steady_clock, duration of int32 in 1/1000 s"},
      {with(type(Kind::Array, 3, "", 2, 3)), "array of 3 uint8"},
      {with(structure("Inner", 8, {})), "struct Inner"},
      {with(type(Kind::String, 32, "libc++")), "string of libc++"},
      {with(type(Kind::Vector, 32, "libstdc++", 2)), "vector of uint8, of libstdc++"},
      {with(type(Kind::Reference, 16, "", 2)), "reference to uint8"},
      {with(type(Kind::Opaque, 12, "Blob")), "Blob, 12 bytes"},
      {{{structure("S", 64, {field("x", 1, 0)}), type(Kind::Reference, 16, "", 2),
         type(Kind::Reference, 16, "", 3), type(Kind::Reference, 16, "", 4),
         type(Kind::Reference, 16, "", 5), type(Kind::Reference, 16, "", 6), kByte}},
       "reference to reference to reference to reference to reference to ..."}};
  for (const auto& [there, text] : kTypes) {
    const Kind other = there.types[1].kind == Kind::Bool ? Kind::Char : Kind::Bool;
    CHECK(first_difference(there, with(type(other, 1))) ==
          std::string("x: the topic has ") + text + "; this side has " +
              (other == Kind::Bool ? "bool" : "char"));
    CHECK(first_difference(there, there).empty());
  }
  CHECK(first_difference({{kByte}}, {{type(Kind::Bool, 1)}}) ==
        "the message: the topic has uint8; this side has bool");
}

TEST_CASE("types of one kind differ by what a reader of the message would notice") {
  const Type blob = type(Kind::Opaque, 12, "Blob");
  check({
      {with(kByte), with(type(Kind::UInt, 2)), "x: the topic has uint8; this side has uint16"},
      {with(type(Kind::Enum, 1, "E", 2)), with(type(Kind::Enum, 1, "F", 2)), ""},
      {with(type(Kind::Enum, 1, "E", 2)), with(type(Kind::Enum, 1, "E", 2), type(Kind::Int, 1)),
       "x: the topic has uint8; this side has int8"},
      {with(blob), with(type(Kind::Opaque, 12, "Bulb")),
       "x: the topic has Blob, 12 bytes; this side has Bulb, 12 bytes"},
      {with(blob), with(type(Kind::Opaque, 13, "Blob")),
       "x: the topic has Blob, 12 bytes; this side has Blob, 13 bytes"},
      {with(blob), with(type(Kind::Opaque, 12, "Blob", 2)),
       "x: the topic has Blob, 12 bytes; this side has Blob, 12 bytes"},
      {with(type(Kind::Opaque, 12, "Blob", 2)), with(type(Kind::Opaque, 12, "Blob", 2), blob),
       "x[]: the topic has uint8; this side has Blob, 12 bytes"},
      {with(type(Kind::Array, 4, "", 2, 4)),
       with(type(Kind::Array, 4, "", 2, 2), type(Kind::UInt, 2)),
       "x[]: the topic has uint8; this side has uint16"},
      {with(type(Kind::Array, 4, "", 2, 4)), with(type(Kind::Array, 4, "", 2, 3)),
       "x: the topic has array of 4 uint8; this side has array of 3 uint8"},
      {with(type(Kind::Vector, 32, "a", 2)), with(type(Kind::Vector, 32, "a", 2), blob),
       "x[]: the topic has uint8; this side has Blob, 12 bytes"},
      {with(type(Kind::Vector, 32, "a", 2)), with(type(Kind::Vector, 32, "b", 2)),
       "x: the topic has vector of uint8, of a; this side has vector of uint8, of b"},
      {with(kMilliseconds), with(duration(8, 2, 1, 60)),
       "x: the topic has duration of uint8 in 1/1000 s; this side has duration of uint8 in 1/60 s"},
      {with(kMilliseconds), with(duration(8, 2, 2, 1000)),
       "x: the topic has duration of uint8 in 1/1000 s; this side has duration of uint8 in 2/1000 "
       "s"},
      {with(type(Kind::Reference, 16, "", 2)), with(type(Kind::Reference, 16, "", 2), blob),
       "x: the topic has uint8; this side has Blob, 12 bytes"},
      {with(type(Kind::String, 32, "a")), with(type(Kind::String, 40, "a")),
       "x: the topic has string of a; this side has string of a"},
  });
}

TEST_CASE("structs differ in a field: its place, its bits, its name, or in their size") {
  const auto all = [](std::vector<Field> fields, std::uint64_t size = 64) {
    return Description{{structure("S", size, std::move(fields)), kByte}};
  };
  const auto nested = [](std::vector<Field> fields, std::uint64_t size = 8) {
    return with(structure("Inner", size, std::move(fields)));
  };
  const Field x = field("x", 1, 0);
  check({
      {all({x}), all({x, field("y", 1, 4)}),
       "field 2: the topic has none; this side has y, uint8 at byte 4"},
      {all({x, field("", 1, 4)}), all({x}),
       "field 2: the topic has uint8 at byte 4; this side has none"},
      {all({x}), all({field("x", 1, 3)}),
       "field 1: the topic has x, uint8 at byte 0; this side has x, uint8 at byte 3"},
      {all({field("x", 1, 0, 3, 1)}), all({field("x", 1, 0, 4, 1)}),
       "field 1: the topic has x, uint8 of 3 bits at byte 0, bit 1; this side has x, uint8 of 4 "
       "bits at byte 0, bit 1"},
      {all({field("x", 1, 0, 3, 1)}), all({field("x", 1, 0, 3, 0)}),
       "field 1: the topic has x, uint8 of 3 bits at byte 0, bit 1; this side has x, uint8 of 3 "
       "bits at byte 0, bit 0"},
      {all({x}), all({field("y", 1, 0)}),
       "field 1: the topic has x, uint8 at byte 0; this side has y, uint8 at byte 0"},
      {all({x}), all({field("", 1, 0)}), ""},
      {all({field("", 1, 0)}), all({x}), ""},
      {all({x}), all({x}, 60), "the message: the topic has 64 bytes; this side has 60 bytes"},
      {nested({}), nested({}, 9), "x: the topic has 8 bytes; this side has 9 bytes"},
      {nested({field("a", 2, 0)}), nested({field("a", 2, 1)}),
       "field 1 of x: the topic has a, uint8 at byte 0; this side has a, uint8 at byte 1"},
  });
  // A field without a name has its place for one, and the other side's name where that has one.
  const auto path = [&](const char* topic, const char* here) {
    const Description a{{structure("S", 64, {field("", 1, 0), field(topic, 2, 1)}), kByte, kByte}};
    Description b = a;
    b.types[0].fields[1].name = here;
    b.types[2] = type(Kind::Int, 1);
    const std::string says = first_difference(a, b);
    return says.substr(0, says.find(':'));
  };
  CHECK(path("", "") == "_1");
  CHECK(path("y", "") == "y");
  CHECK(path("", "z") == "z");
  // Two levels, and a type within itself.
  Description deep =
      with(structure("A", 8, {field("y", 2, 0)}), structure("B", 8, {field("z", 3, 0)}));
  Description other = deep;
  other.types[3] = type(Kind::Int, 1);
  CHECK(first_difference(deep, other) == "x.y.z: the topic has uint8; this side has int8");
  deep.types[3] = type(Kind::Vector, 32, "a", 0);
  CHECK(first_difference(deep, deep).empty());
}

TEST_CASE("of two descriptions each may know names that the other one does not") {
  const auto names = [](const char* a, const char* b) {
    return Description{{structure("S", 2, {field(a, 1, 0), field(b, 1, 1)}), kByte}};
  };
  const auto text = [](const Description& topic, const Description& here) {
    const auto n = compare_names(encode(topic), encode(here));
    return std::string(n.differ ? "differ " : "") + (n.topic_knows_more ? "topic " : "") +
           (n.here_knows_more ? "here " : "") + (n.merged.empty() ? "" : "merged ") +
           (n.merged_names != 0 ? "hash" : "");
  };
  CHECK(text(names("a", "b"), names("a", "b")).empty());
  CHECK(text(names("a", "b"), names("a", "")) == "topic ");
  CHECK(text(names("a", ""), names("a", "b")) == "here ");
  CHECK(text(names("", ""), names("", "b")) == "here ");
  CHECK(text(names("", "b"), names("", "")) == "topic ");
  CHECK(text(names("a", "b"), names("", "c")) == "differ topic ");
  CHECK(text(names("", "b"), names("a", "c")) == "differ here ");
  CHECK(text(names("a", ""), names("", "b")) == "topic here merged hash");
  CHECK(text(names("", "b"), names("a", "")) == "topic here merged hash");
  const auto both = compare_names(encode(names("a", "")), encode(names("", "b")));
  CHECK(both.merged == encode(names("a", "b")));
  CHECK(both.merged_names == names("a", "b").names_hash());
  Description wide = names("a", "");
  wide.types[0].size = 3;
  CHECK(text(wide, names("", "b")) == "differ topic here ");
  CHECK(compare_names("", encode(names("a", "b"))).here_knows_more == false);
  CHECK(compare_names(encode(names("a", "b")), "nonsense").topic_knows_more == false);
  CHECK(lot::description::has_names(names("", "b")));
  CHECK(!lot::description::has_names(names("", "")));
  CHECK(!lot::description::has_names({{kByte}}));
}

TEST_SUITE_END();
