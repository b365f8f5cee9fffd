// SPDX-License-Identifier: Apache-2.0

// The steps that a description becomes, the schema of it, and what is refused: all by hand.

#include "codec/program.hpp"

#include <cerrno>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/error.hpp"

#include "codec/schema.hpp"
#include "description/by_hand.hpp"
#include "support/error_of.hpp"

namespace {

using namespace by_hand;
using lot::codec::Do;
using lot::codec::Program;
using lot::codec::Schema;
using lot::codec::Step;
using lot::testing::error_of;

const Type kU8 = type(Kind::UInt, 1), kU16 = type(Kind::UInt, 2), kU32 = type(Kind::UInt, 4),
           kU64 = type(Kind::UInt, 8), kI16 = type(Kind::Int, 2), kBool = type(Kind::Bool, 1),
           kText = type(Kind::String, 40, "libstdc++"),
           kBoostText = type(Kind::String, 32, "libc++");
/// A vector of the type at that place.
Type vector(std::uint32_t of) { return type(Kind::Vector, 32, "libstdc++", of); }
Type array(std::uint64_t size, std::uint32_t of, std::uint64_t count) {
  return type(Kind::Array, size, "", of, count);
}

/// Follows a way, and says which it is.
struct Way {
  std::string path;
  Way operator[](std::size_t i) const { return {path + "." + std::to_string(i)}; }
};

/// "Numbers 4@8 *3": three numbers aligned to 4, at offset 8. Then what else there is: w the widest
/// alignment, b the steps of the body, s the stride, l the least bytes of an element, v what needs
/// a value.
std::string text_of(const Program& program, const Step& step) {
  static const char* const kNames[] = {"Numbers", "Bools", "Run",  "Blank", "Clear",
                                       "Each",    "Items", "Text", "Bits"};
  const auto more = [](const char* what, std::uint64_t n) {
    return n == 0 ? "" : " " + std::string(what) + std::to_string(n);
  };
  return std::string(kNames[static_cast<int>(step.what)]) + " " + std::to_string(step.align) + "@" +
         std::to_string(step.offset) + more("*", step.count) + more("w", step.widest) +
         more("b", step.body) + more("s", step.stride) + more("l", step.least) +
         (step.is_signed ? " signed" : "") +
         (step.needs_value ? " v" + program.part(Way(), step).path : "");
}

std::string steps_of(const Description& description) {
  const Program program(description);
  std::string all;
  for (const Step& step : program.steps()) {
    all += (all.empty() ? "" : ", ") + text_of(program, step);
  }
  return all;
}

/// A struct of fields at these offsets, of the types that follow.
Description with(std::uint64_t size, std::vector<Field> fields, std::vector<Type> types) {
  Description all{{structure("p::S", size, std::move(fields))}};
  all.types.insert(all.types.end(), types.begin(), types.end());
  return all;
}

std::string refusal(const Description& description) {
  const auto [error, text] = error_of([&] { const Program program(description); });
  CHECK((error == EINVAL || error == EBADMSG));
  return (error == EBADMSG ? "damaged: " : "") + text.substr(5, text.find(" (") - 5);
}

}  // namespace

TEST_SUITE_BEGIN("program");

TEST_CASE("numbers that lie side by side are one step, and of several sizes a run") {
  const std::pair<Description, const char*> kTypes[] = {
      {{{kU32}}, "Numbers 4@0 *1"},
      {{{kBool}}, "Bools 1@0 *1"},
      {{{type(Kind::Float, 4)}}, "Numbers 4@0 *1"},
      {{{type(Kind::Float, 8)}}, "Numbers 8@0 *1"},
      {with(8, {field("e", 1, 8)}, {structure("E", 0, {})}), "Blank 1@8"},
      {with(8, {field("a", 1, 0), field("b", 1, 4)}, {kU32}), "Numbers 4@0 *2"},
      {with(12, {field("a", 1, 0), field("b", 1, 8)}, {kU32}), "Numbers 4@0 *1, Numbers 4@8 *1"},
      {with(2, {field("a", 1, 0), field("b", 1, 1)}, {kBool}), "Bools 1@0 *2"},
      {with(2, {field("a", 1, 0), field("b", 2, 1)}, {kBool, kU8}), "Bools 1@0 *1, Numbers 1@1 *1"},
      {with(8, {field("a", 1, 0), field("b", 2, 4), field("c", 2, 6)}, {kU32, kU16}),
       "Run 4@0 *8 w4 b2, Numbers 4@0 *1, Numbers 2@4 *2"},
      {with(8, {field("c", 2, 0), field("d", 2, 2), field("a", 1, 4)}, {kU32, kU16}),
       "Run 2@0 *8 w4 b2, Numbers 2@0 *2, Numbers 4@4 *1"},
      {with(8, {field("c", 2, 0), field("a", 1, 4)}, {kU32, kU16}),
       "Numbers 2@0 *1, Numbers 4@4 *1"},
      {with(6, {field("c", 2, 0), field("a", 1, 2)}, {kU32, kU16}),  // packed: not aligned
       "Numbers 2@0 *1, Numbers 4@2 *1"},
      {with(6, {field("a", 1, 0), field("c", 2, 4), field("d", 2, 5)}, {kU32, kU8}),
       "Run 4@0 *6 w4 b2, Numbers 4@0 *1, Numbers 1@4 *2"},
      {with(16, {field("a", 1, 0), field("b", 3, 8), field("c", 3, 9)}, {kU64, kU32, kU8}),
       "Run 8@0 *10 w8 b2, Numbers 8@0 *1, Numbers 1@8 *2"},
      {with(8, {}, {}), "Blank 1@0"},
      {with(8, {field("e", 1, 4)}, {structure("E", 1, {})}), "Blank 1@4"},
      {with(8, {field("s", 1, 4)}, {structure("I", 4, {field("a", 2, 0), field("b", 2, 2)}), kU16}),
       "Numbers 2@4 *2"}};
  for (const auto& [description, steps] : kTypes) CHECK(steps_of(description) == steps);
}

TEST_CASE("arrays of numbers are numbers, other arrays and vectors have steps for an element") {
  const std::pair<Description, const char*> kTypes[] = {
      {{{array(12, 1, 3), kU32}}, "Numbers 4@0 *3"},
      {{{array(3, 1, 3), kBool}}, "Bools 1@0 *3"},
      {{{array(12, 1, 3), array(4, 2, 2), kU16}}, "Numbers 2@0 *6"},
      {{{array(8, 1, 2), structure("P", 4, {field("a", 2, 0), field("b", 2, 2)}), kU16}},
       "Numbers 2@0 *4"},
      {{{array(12, 1, 2), structure("P", 6, {field("a", 2, 0), field("b", 2, 2)}), kU16}},
       "Each 1@0 *2 b1 s6 l4, Numbers 2@0 *2"},
      {{{array(16, 1, 2), structure("P", 8, {field("a", 2, 0), field("b", 3, 4)}), kU32, kU16}},
       "Each 1@0 *2 b3 s8 l6, Run 4@0 *6 w4 b2, Numbers 4@0 *1, Numbers 2@4 *1"},
      {{{array(16, 1, 2), structure("P", 8, {field("a", 2, 0), field("b", 3, 4), field("c", 3, 6)}),
         kU32, kU16}},
       "Each 4@0 *2 w4 b3 s8 l8, Run 4@0 *8 w4 b2, Numbers 4@0 *1, Numbers 2@4 *2"},
      {{{array(24, 1, 2), structure("P", 12, {field("a", 2, 0), field("b", 3, 8)}), kU64, kU32}},
       "Each 8@0 *2 b3 s12 l12, Run 8@0 *12 w8 b2, Numbers 8@0 *1, Numbers 4@8 *1"},
      {{{array(80, 1, 2), kText}}, "Each 1@0 *2 b1 s40 l4 v, Text 1@0 s40 v"},
      {{{array(4, 1, 2), structure("P", 2, {field("a", 2, 0)}), kBool}},
       "Each 1@0 *2 b1 s2 l1, Bools 1@0 *1"},
      {{{array(8, 1, 2), structure("P", 4, {field("a", 2, 2)}), kU16}},
       "Each 1@0 *2 b1 s4 l2, Numbers 2@2 *1"},
      {{{array(8, 1, 2), structure("P", 4, {field("a", 2, 1)}), kU8}},
       "Each 1@0 *2 b1 s4 l1, Numbers 1@1 *1"},
      {{{array(4, 1, 2), structure("P", 2, {field("a", 2, 0), field("b", 3, 1)}), kBool, kU8}},
       "Each 1@0 *2 b2 s2 l2, Bools 1@0 *1, Numbers 1@1 *1"},
      {{{vector(1), structure("P", 4, {field("a", 2, 0), field("e", 3, 3)}), kU32,
         structure("E", 1, {})}},
       "Items 1@0 b2 s4 l5 v, Numbers 4@0 *1, Blank 1@3"},
      {{{vector(1), structure("P", 8, {field("a", 2, 0), field("b", 2, 2), field("c", 3, 4)}), kU16,
         kU32}},
       "Items 2@0 w4 b3 s8 l8 v, Run 2@0 *8 w4 b2, Numbers 2@0 *2, Numbers 4@4 *1"},
      {{{vector(1), array(12, 2, 3), kU32}}, "Items 4@0 w4 b1 s12 l12 v, Numbers 4@0 *3"},
      {{{vector(1), kU32}}, "Items 4@0 w4 b1 s4 l4 v, Numbers 4@0 *1"},
      {{{vector(1), kBool}}, "Items 1@0 b1 s1 l1 v, Bools 1@0 *1"},
      {{{vector(1), vector(2), kU16}},
       "Items 1@0 b2 s32 l4 v, Items 2@0 w2 b1 s2 l2 v, Numbers 2@0 *1"},
      {{{vector(1), kBoostText}}, "Items 1@0 b1 s32 l4 v, Text 1@0 s32 v"},
      {{{type(Kind::Vector, 32, "libc++", 1), kU8}}, "Items 1@0 w1 b1 s1 l1 v, Numbers 1@0 *1"},
      {with(48, {field("n", 1, 0), field("v", 2, 8), field("m", 1, 40)}, {kU64, vector(1)}),
       "Numbers 8@0 *1, Items 8@8 w8 b1 s8 l8 v.1, Numbers 8@0 *1, Numbers 8@40 *1"}};
  for (const auto& [description, steps] : kTypes) CHECK(steps_of(description) == steps);
}

TEST_CASE("what needs a value is found by its way, in a struct, an array and a vector") {
  const Type inner = structure("I", 80, {field("n", 2, 0), field("t", 3, 8), field("u", 3, 40)});
  CHECK(steps_of(with(200, {field("a", 2, 0), field("i", 1, 8), field("v", 4, 100)},
                      {inner, kU64, type(Kind::String, 32, "libc++"), vector(1)})) ==
        "Numbers 8@0 *2, Text 1@16 s32 v.1.1, Text 1@48 s32 v.1.2, Items 1@100 b3 s80 l16 v.2, "
        "Numbers 8@0 *1, Text 1@8 s32 v.1, Text 1@40 s32 v.2");
}

TEST_CASE("sizes that no number holds are the largest number, and parts are counted") {
  const Type empty = structure("E", 1, {});
  const Type four =
      structure("P", 1, {field("a", 3, 0), field("b", 3, 0), field("c", 3, 0), field("d", 3, 0)});
  const std::string blanks = ", Blank 1@0, Blank 1@0, Blank 1@0, Blank 1@0";
  const std::uint64_t many = std::uint64_t{1} << 63;
  CHECK(steps_of({{vector(1), array(many, 2, many), four, empty}}) ==
        "Items 1@0 b5 s9223372036854775808 l18446744073709551615 v, "
        "Each 1@0 *9223372036854775808 b4 s1 l4" +
            blanks);
  const std::string part = " *2305843009213693952 b4 s1 l4" + blanks;
  CHECK(steps_of({{vector(4), array(many / 4, 2, many / 4), four, empty,
                   structure("Q", many / 2, {field("a", 1, 0), field("b", 1, many / 4)})}}) ==
        "Items 1@0 b10 s4611686018427387904 l18446744073709551615 v, Each 1@0" + part +
            ", Each 1@2305843009213693952" + part);
  const auto fields = [&](std::size_t n) {
    return with(1, std::vector<Field>(n, field("e", 1, 0)), {empty});
  };
  CHECK(Program(fields(65535)).steps().size() == 65535);
  CHECK(refusal(fields(65536)) == "e: it has too many parts");
}

TEST_CASE("bit-fields, enums, times, and what ROS 1 has in front of its messages") {
  const Type milliseconds = duration(8, 2, 1, 1000);
  const std::pair<Description, const char*> kTypes[] = {
      {with(4, {field("a", 1, 0, 3, 0), field("b", 1, 0, 5, 3)}, {kU16}),
       "Bits 2@0 *2 s1 v.0, Bits 2@0 *2 s1 v.1"},
      {with(1, {field("a", 1, 0, 8, 0)}, {kU8}), "Bits 1@0 *1 s1 v.0"},
      {with(8, {field("a", 1, 0, 64, 0)}, {kU64}), "Bits 8@0 *8 s8 v.0"},
      {with(1, {field("a", 1, 0, 3, 0)}, {type(Kind::Char, 1)}), "Bits 1@0 *1 s1 signed v.0"},
      {with(4, {field("a", 1, 1, 9, 7)}, {kI16}), "Bits 2@1 *2 s2 signed v.0"},
      {with(4, {field("a", 1, 1, 10, 7)}, {kI16}), "Bits 2@1 *2 s3 signed v.0"},
      {with(1, {field("a", 1, 0, 1, 7)}, {kBool}), "Bits 1@0 *1 s1 v.0"},
      {{{type(Kind::Enum, 2, "E", 1), kI16}}, "Numbers 2@0 *1"},
      {{{type(Kind::Enum, 1, "E", 1), kBool}}, "Bools 1@0 *1"},
      {{{type(Kind::TimePoint, 8, "system_clock", 1), milliseconds, kU64}}, "Numbers 8@0 *1"},
      {{{structure("std_msgs/Header", 8, {field("seq", 1, 0), field("stamp", 1, 4)}), kU32}},
       "Numbers 4@0 *2"},
      {{{structure("std_msgs/Header", 12,
                   {field("seq", 1, 0), field("stamp", 1, 4), field("frame_id", 1, 8)}),
         kU32}},
       "Clear 1@0 *4, Numbers 4@4 *2"},
      {with(40, {field("a", 2, 0), field("h", 1, 16)},
            {structure("std_msgs/Header", 12,
                       {field("seq", 2, 8), field("stamp", 2, 0), field("frame_id", 2, 4)}),
             kU32}),
       "Numbers 4@0 *1, Clear 1@24 *4, Numbers 4@16 *2"},
      {{{vector(1),
         structure("std_msgs/Header", 12,
                   {field("seq", 2, 0), field("stamp", 2, 4), field("frame_id", 2, 8)}),
         kU32}},
       "Items 1@0 b2 s12 l8 v, Clear 1@0 *4, Numbers 4@4 *2"}};
  for (const auto& [description, steps] : kTypes) CHECK(steps_of(description) == steps);
}

TEST_CASE("a description that contradicts itself, or has what ROS 2 lacks, is refused by path") {
  const auto one = [](Type x, std::vector<Type> more = {}) {
    more.insert(more.begin(), std::move(x));
    return with(64, {field("x", 1, 0)}, std::move(more));
  };
  const std::string bits = "damaged: x: its description has bits of no number";
  const std::string outside = "damaged: x: its description has a field outside of the struct";
  const std::string shared = "damaged: message: its description has fields that share bytes";
  const std::pair<Description, std::string> kRefusals[] = {
      {{}, "damaged: message: its description names a type that is not there"},
      {with(8, {field("x", 9, 0)}, {}),
       "damaged: x: its description names a type that is not there"},
      {one(array(8, 9, 1)), "damaged: x: its description names a type that is not there"},
      {one(type(Kind::Reference, 16, "", 1)),
       "x: it leads to another message, which has bytes of its own"},
      {one(type(Kind::Opaque, 8, "Blob")), "x: a Blob is known only to its own programs"},
      {one(vector(0)), "x[]: p::S lies within itself, which no type of ROS 2 does"},
      {one(type(Kind::Float, 16)), "x: ROS 2 has no number of 16 bytes like it"},
      {one(type(Kind::Float, 2)), "x: ROS 2 has no number of 2 bytes like it"},
      {one(type(Kind::Int, 16)), "x: ROS 2 has no number of 16 bytes like it"},
      {one(type(Kind::UInt, 3)), "x: ROS 2 has no number of 3 bytes like it"},
      {one(type(Kind::UInt, 0)), "x: ROS 2 has no number of 0 bytes like it"},
      {one(type(Kind::Bool, 2)), "damaged: x: its description has a bool of many bytes"},
      {one(type(Kind::Enum, 2, "E", 2), {kU32}),
       "damaged: x: its description has a number that is none"},
      {one(type(Kind::Enum, 2, "E", 9)), "damaged: x: its description has a number that is none"},
      {one(type(Kind::Enum, 40, "E", 2), {kText}),
       "damaged: x: its description has a number that is none"},
      {one(array(12, 2, 4), {kU32}),
       "damaged: x: its description has more elements than fit, or none"},
      {one(type(Kind::String, 32, "mine")), "x: it is a string of another library: mine"},
      {one(type(Kind::String, 40, "mine")), "x: it is a string of another library: mine"},
      {one(type(Kind::String, 32, "libstdc++")), "x: it is a string of another library: libstdc++"},
      {one(type(Kind::String, 40, "libc++")), "x: it is a string of another library: libc++"},
      {one(type(Kind::Vector, 32, "mine", 2), {kU8}), "x: it is a vector of another library: mine"},
      {one(type(Kind::Vector, 24, "libc++", 2), {kU8}),
       "x: it is a vector of another library: libc++"},
      {one(vector(2), {type(Kind::UInt, 0)}),
       "damaged: x: its description has elements without a size"},
      {one(array(8, 2, 0), {kU8}),
       "damaged: x: its description has more elements than fit, or none"},
      {one(array(8, 2, 9), {kU8}),
       "damaged: x: its description has more elements than fit, or none"},
      {one(array(8, 2, 2), {array(4, 3, 5), kU8}),
       "damaged: x[]: its description has more elements than fit, or none"},
      {with(8, {field("x", 1, 0, 9, 0)}, {kU8}), bits},
      {with(8, {field("x", 1, 0, 3, 0)}, {type(Kind::Float, 4)}), bits},
      {with(2, {field("x", 1, 3)}, {kU8}), outside},
      {with(2, {field("x", 1, 1)}, {kU16}), outside},
      {with(8, {field("x", 1, 0, 8, 8)}, {kU64}), outside},
      {with(16, {field("x", 1, 0, 65, 0)}, {kU64}), outside},
      {with(1, {field("x", 1, 0, 2, 7)}, {kU16}), outside},
      {with(8, {field("a", 1, 0), field("b", 1, 3)}, {kU32}), shared},
      {with(8, {field("b", 1, 3), field("a", 1, 0)}, {kU32}), shared},
      {with(8, {field("a", 1, 0, 3, 0), field("b", 2, 0)}, {kU8, kU8}), shared},
      {with(8, {field("b", 2, 0), field("a", 1, 1, 3, 0)}, {kU8, kU16}), shared},
      {with(64, {field("a", 1, 0), field("b", 2, 31)}, {vector(2), kU8}), shared},
      {with(64, {field("a", 1, 0), field("b", 2, 39)}, {kText, kU8}), shared},
      {with(64, {field("a", 1, 0), field("b", 3, 79 - 40)}, {array(40, 2, 1), kText, kU8}),
       shared}};
  for (const auto& [description, text] : kRefusals) CHECK(refusal(description) == text);
  CHECK(steps_of(with(64, {field("a", 1, 0), field("b", 2, 32)}, {vector(2), kU8})).size() > 0);
  CHECK(steps_of(with(64, {field("a", 1, 0), field("b", 2, 40)}, {kText, kU8})).size() > 0);
  const auto deep = [&](std::size_t levels) {
    Description all;
    for (std::uint32_t i = 0; i + 1 < levels; ++i) {
      all.types.push_back(structure("D", 1, {field("d", i + 1, 0)}));
    }
    all.types.push_back(kU8);
    return all;
  };
  CHECK(steps_of(deep(16)) == "Numbers 1@0 *1");
  CHECK(refusal(deep(17)).ends_with("d.d: it lies too deep"));
}

TEST_CASE("the schema of a type names packages, classes and fields as ROS 2 has them") {
  const auto name = [](const char* of) {
    return lot::codec::schema_of({{structure(of, 1, {field("x", 1, 0)}), kU8}}).name;
  };
  const std::pair<const char*, const char*> kNames[] = {{"robot::Frame", "robot/msg/Frame"},
                                                        {"robot/Frame", "robot/msg/Frame"},
                                                        {"AZaz09::AZaz09", "azaz09/msg/AZaz09"},
                                                        {"p::a_z", "p/msg/AZ"},
                                                        {"p::@a[Z`b{c/d", "p_a_z_b_c/msg/D"},
                                                        {"p::x@a[Z`b{c", "p/msg/XAZBC"},
                                                        {"a/b/c", "a_b/msg/C"},
                                                        {"a::b::Frame", "a_b/msg/Frame"},
                                                        {"Frame", "lot/msg/Frame"},
                                                        {"", "lot/msg/Message"},
                                                        {"::", "lot/msg/Message"},
                                                        {"robot::", "robot/msg/Message"},
                                                        {"Big::frame", "big/msg/Frame"},
                                                        {"a::b<c::d>::E", "a_b_c_d/msg/E"},
                                                        {"a::b(c::d)::E", "a_b_c_d/msg/E"},
                                                        {"a::B<c::d>", "a/msg/BCD"},
                                                        {"a::B<c::D<e::F>>", "a/msg/BCDEF"},
                                                        {"9a::3B_c9", "a/msg/BC9"},
                                                        {"__a__b__::_c_", "a_b/msg/C"},
                                                        {"a9/b", "a9/msg/B"},
                                                        {"a:b", "lot/msg/AB"},
                                                        {"a:", "lot/msg/A"},
                                                        {"+::+", "lot/msg/Message"}};
  for (const auto& [of, expected] : kNames) CHECK(name(of) == expected);
}

TEST_CASE("the schema of a type has a line for each field, in .msg and in IDL") {
  const Schema schema = lot::codec::schema_of(
      with(256, {field("flag", 1, 0),       field("letter", 2, 1),   field("real", 3, 4),
                 field("long", 4, 8),       field("Struct", 5, 16),  field("when", 6, 24),
                 field("span", 7, 32),      field("e", 8, 40),       field("grid", 9, 48),
                 field("texts", 11, 64),    field("rows", 12, 96),   field("", 5, 128),
                 field("field_11", 5, 129), field("_x", 5, 130),     field("x_", 5, 131),
                 field("a-b", 5, 132),      field("a_1", 5, 133),    field("1a", 5, 134),
                 field("inner", 13, 136),   field("again", 13, 140), field("empty", 15, 144),
                 field("minutes", 16, 152)},
           {kBool, type(Kind::Char, 1), type(Kind::Float, 4), type(Kind::Float, 8), kU8,
            type(Kind::TimePoint, 8, "steady\\clock\n", 7), duration(8, 14, 1, 1000),
            type(Kind::Enum, 2, "E ~\x7f", 17), array(12, 10, 2), array(6, 17, 3), vector(18),
            vector(11), structure("q::In", 4, {field("n", 17, 0)}), type(Kind::Int, 8),
            structure("q::In", 1, {}), duration(8, 14, 60, 1), kI16, kText}));
  CHECK(schema.name == "p/msg/S");
  CHECK("\n" + schema.msg == R"(
bool flag
char letter
float32 real
float64 long
uint8 Struct
int64 when  # unit: 1/1000 s, since the epoch of steady?clock?
int64 span  # unit: 1/1000 s
int16 e  # E ~?
int16[6] grid
string[] texts
lot/Items[] rows
uint8 field_11
uint8 field_11_2
uint8 field_13
uint8 field_14
uint8 field_15
uint8 a_1
uint8 field_17
q/In inner
q/In again
q/In2 empty
int64 minutes  # unit: 60 s
================================================================================
MSG: q/In2
uint8 structure_needs_at_least_one_member
================================================================================
MSG: q/In
int16 n
================================================================================
MSG: lot/Items
string[] items
)");
  CHECK("\n" + schema.idl == R"(
module lot {
module msg {
struct Items {
  sequence<string> items;
};
};
};
module q {
module msg {
struct In {
  int16 n;
};
};
};
module q {
module msg {
struct In2 {
  uint8 structure_needs_at_least_one_member;
};
};
};
module p {
module msg {
struct S {
  boolean flag;
  char letter;
  float real;
  double _long;
  uint8 _Struct;
  int64 when;  // unit: 1/1000 s, since the epoch of steady?clock?
  int64 span;  // unit: 1/1000 s
  int16 e;  // E ~?
  int16 grid[6];
  sequence<string> texts;
  sequence<lot::msg::Items> rows;
  uint8 field_11;
  uint8 field_11_2;
  uint8 field_13;
  uint8 field_14;
  uint8 field_15;
  uint8 a_1;
  uint8 field_17;
  q::msg::In inner;
  q::msg::In again;
  q::msg::In2 empty;
  int64 minutes;  // unit: 60 s
};
};
};
)");
}

TEST_CASE("the schema of what is no struct has one field, of ROS 1's types those of ROS 2") {
  CHECK(lot::codec::schema_of({{kU8}}).msg == "uint8 data\n");
  CHECK(lot::codec::schema_of({{kU8}}).name == "lot/msg/Message");
  CHECK(lot::codec::schema_of({{array(12, 1, 2), array(6, 2, 3), kU16}}).msg == "uint16[6] data\n");
  CHECK(lot::codec::schema_of({{vector(1), vector(2), kU16}}).msg ==
        "lot/Items[] data\n" + std::string(80, '=') + "\nMSG: lot/Items\nuint16[] items\n");
  CHECK(lot::codec::schema_of(
            {{structure("lot::Items", 32, {field("x", 1, 0)}), vector(2), vector(3), kU16}})
            .msg ==
        "lot/Items2[] x\n" + std::string(80, '=') + "\nMSG: lot/Items2\nuint16[] items\n");
  const Type time = structure("time", 8, {field("sec", 2, 0), field("nsec", 2, 4)});
  const Type span = structure("duration", 8, {field("sec", 3, 0), field("nsec", 3, 4)});
  const Type header = structure(
      "std_msgs/Header", 60, {field("seq", 2, 0), field("stamp", 1, 4), field("frame_id", 4, 16)});
  const Schema ros = lot::codec::schema_of({{header, time, kU32, type(Kind::Int, 4), kText}});
  CHECK(ros.msg == "builtin_interfaces/Time stamp\nstring frame_id\n" + std::string(80, '=') +
                       "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n");
  CHECK(lot::codec::schema_of(
            {{structure("S", 8, {field("d", 1, 0)}), span, kU32, type(Kind::Int, 4)}})
            .msg == "builtin_interfaces/Duration d\n" + std::string(80, '=') +
                        "\nMSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n");
  for (const Type& other :
       {structure("time", 8, {field("sec", 2, 0), field("nsecs", 2, 4)}),
        structure("time", 8, {field("secs", 2, 0), field("nsec", 2, 4)}),
        structure("time", 8, {field("sec", 2, 0, 3), field("nsec", 2, 4)}),
        structure("times", 8, {field("sec", 2, 0), field("nsec", 2, 4)}),
        structure("time", 8, {field("sec", 2, 0), field("nsec", 3, 4)}),
        structure("time", 9, {field("sec", 2, 0), field("nsec", 2, 4), field("x", 2, 8)}),
        structure("time", 4, {field("sec", 2, 0)})}) {
    CHECK(lot::codec::schema_of({{other, kU32, kU32, kU8}}).name.starts_with("lot/msg/Time"));
  }
}

TEST_SUITE_END();
