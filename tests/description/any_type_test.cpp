// SPDX-License-Identifier: Apache-2.0

// Types that are made while a program runs: they are what the compiler makes of the C++ types.

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "segment/layout.hpp"
#include "support/error_of.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace robot {

enum class Mode : std::uint16_t { Idle, Moving };
struct Empty {};
struct Point {
  float x = 0, y = 0;
};
struct Mixed {
  bool flag = false;
  double wide = 0;
  std::int8_t small = 0;
  std::uint64_t large = 0;
  char letter = 0;
  long double longest = 0;
  std::int16_t halves[3] = {};
};
struct Nested {
  std::uint8_t first = 0;
  std::array<Mixed, 2> mixed;
  Point point;
  Empty empty;
  Mode mode = Mode::Idle;
  std::array<std::array<std::uint16_t, 2>, 3> grid = {};
};
struct Label {
  lot::ShmString text;
  std::uint8_t weight = 0;
};
struct Frame {
  std::uint32_t width = 0, height = 0;
  lot::ShmString encoding;
  lot::ShmVector<std::uint8_t> data;
  lot::ShmVector<Label> labels;
  lot::ShmVector<lot::ShmVector<float>> rows;
  std::array<Label, 2> ends;
  lot::ShmRef<const Point> origin;
  std::chrono::duration<std::int64_t, std::nano> age{};
  std::chrono::duration<double> since{};
  std::chrono::time_point<std::chrono::steady_clock,
                          std::chrono::duration<std::int64_t, std::micro>>
      when;
};
struct Secret {
  Secret() = default;
  explicit Secret(int) {}

 private:
  [[maybe_unused]] std::uint32_t words_[3] = {};
};
struct Holder {
  std::uint8_t before = 0;
  Secret secret;
};

}  // namespace robot

template <>
struct lot::is_trusted_message<robot::Secret> : std::true_type {};

namespace {

using namespace lot::testing;
using lot::AnyType;
using lot::Kind;
using Fields = std::vector<AnyType::Field>;

[[maybe_unused]] const std::string& prefix_taken = prefix();

AnyType real(std::size_t size) { return AnyType::number(Kind::Float, size); }
AnyType whole(std::size_t size) { return AnyType::number(Kind::Int, size); }
AnyType natural(std::size_t size) { return AnyType::number(Kind::UInt, size); }

AnyType point() { return AnyType::structure("robot::Point", {{"x", real(4)}, {"y", real(4)}}); }
AnyType mixed() {
  return AnyType::structure("robot::Mixed", {{"flag", AnyType::number(Kind::Bool, 1)},
                                             {"wide", real(8)},
                                             {"small", whole(1)},
                                             {"large", natural(8)},
                                             {"letter", AnyType::number(Kind::Char, 1)},
                                             {"longest", real(sizeof(long double))},
                                             {"halves", AnyType::array(whole(2), 3)}});
}
AnyType nested() {
  return AnyType::structure("robot::Nested",
                            {{"first", natural(1)},
                             {"mixed", AnyType::array(mixed(), 2)},
                             {"point", point()},
                             {"empty", AnyType::structure("robot::Empty", {})},
                             {"mode", AnyType::enumeration("robot::Mode", natural(2))},
                             {"grid", AnyType::array(AnyType::array(natural(2), 2), 3)}});
}
AnyType label() {
  return AnyType::structure("robot::Label", {{"text", AnyType::string()}, {"weight", natural(1)}});
}
AnyType frame() {
  return AnyType::structure(
      "robot::Frame",
      {{"width", natural(4)},
       {"height", natural(4)},
       {"encoding", AnyType::string()},
       {"data", AnyType::vector(natural(1))},
       {"labels", AnyType::vector(label())},
       {"rows", AnyType::vector(AnyType::vector(real(4)))},
       {"ends", AnyType::array(label(), 2)},
       {"origin", AnyType::reference(point())},
       {"age", AnyType::duration(whole(8), 1, 1'000'000'000)},
       {"since", AnyType::duration(real(8), 1, 1)},
       {"when", AnyType::time_point("steady_clock", AnyType::duration(whole(8), 1, 1'000'000))}});
}

/// As the two ends of a topic see it, and as the segment keeps it.
template <class T>
void check_same(const AnyType& made) {
  const AnyType compiled = AnyType::of<T>();
  CAPTURE(compiled.name());
  CHECK(made.name() == compiled.name());
  CHECK(made.size() == sizeof(T));
  CHECK(made.alignment() == alignof(T));
  CHECK(made.description().layout_hash() == compiled.description().layout_hash());
  CHECK(made.description().names_hash() == compiled.description().names_hash());
  CHECK(made.is_same(compiled));
  CHECK(made.encoded() == compiled.encoded());
}

}  // namespace

TEST_SUITE_BEGIN("any_type");

TEST_CASE("a type that is made is the same as the compiler's, and so are its bytes") {
  check_same<bool>(AnyType::number(Kind::Bool, 1));
  check_same<std::int8_t>(whole(1));
  check_same<std::uint64_t>(natural(8));
  check_same<double>(real(8));
  check_same<lot::ShmString>(AnyType::string());
  check_same<robot::Empty>(AnyType::structure("robot::Empty", {}));
  check_same<robot::Point>(point());
  check_same<robot::Mixed>(mixed());
  check_same<robot::Nested>(nested());
  check_same<robot::Label>(label());
  check_same<robot::Mode>(AnyType::enumeration("robot::Mode", natural(2)));
  check_same<robot::Secret>(AnyType::opaque("robot::Secret", 12, 4));
  check_same<robot::Holder>(AnyType::structure(
      "robot::Holder",
      {{"before", natural(1)}, {"secret", AnyType::opaque("robot::Secret", 12, 4)}}));
  check_same<lot::ShmVector<float>>(AnyType::vector(real(4)));
  check_same<lot::ShmVector<lot::ShmVector<robot::Label>>>(
      AnyType::vector(AnyType::vector(label())));
  check_same<std::array<double, 3>>(AnyType::array(real(8), 3));
  check_same<std::array<lot::ShmVector<float>, 2>>(AnyType::array(AnyType::vector(real(4)), 2));
  check_same<std::chrono::milliseconds>(AnyType::duration(whole(8), 1, 1000));
}

TEST_CASE("a type with containers, references and times is the same as the compiler's") {
  const AnyType made = frame();
  const AnyType compiled = AnyType::of<robot::Frame>();
  CHECK(made.is_same(compiled));
  CHECK(made.size() == sizeof(robot::Frame));
  CHECK(made.description().layout_hash() == compiled.description().layout_hash());
  CHECK(made.description().names_hash() == compiled.description().names_hash());
  CHECK(made.encoded() == compiled.encoded());
}

TEST_CASE("other names, another order or another type make another type") {
  const AnyType compiled = AnyType::of<robot::Point>();
  CHECK(point().is_same(compiled));
  CHECK_FALSE(AnyType::structure("Point", {{"x", real(4)}, {"y", real(4)}}).is_same(compiled));
  CHECK_FALSE(
      AnyType::structure("robot::Point", {{"y", real(4)}, {"x", real(4)}}).is_same(compiled));
  CHECK_FALSE(
      AnyType::structure("robot::Point", {{"x", real(4)}, {"y", whole(4)}}).is_same(compiled));
  CHECK_FALSE(AnyType::structure("robot::Point", {{"x", real(8)}}).is_same(compiled));
  // Fields without names meet any names.
  CHECK(AnyType::structure("robot::Point", {{"", real(4)}, {"", real(4)}}).is_same(compiled));
  CHECK_FALSE(AnyType::structure("robot::Point", {{"", real(4)}}).is_same(compiled));
  // A segment has room for so much of a name.
  const std::string long_name(lot::segment::kTypeNameBytes - 1, 'x');
  const AnyType cut = AnyType::structure(long_name, {{"x", real(4)}});
  CHECK(AnyType::structure(long_name + "y", {{"x", real(4)}}).is_same(cut));
  CHECK_FALSE(AnyType::structure(long_name.substr(1), {{"x", real(4)}}).is_same(cut));
  CHECK_FALSE(compiled.is_same(AnyType()));
  CHECK_FALSE(AnyType().is_same(compiled));
  CHECK(AnyType().is_same(AnyType()));
}

TEST_CASE("a type is taken apart, and its parts make the same type again") {
  const AnyType compiled = AnyType::of<robot::Nested>();
  Fields fields;
  for (std::size_t i = 0; i < compiled.description().root().fields.size(); ++i) {
    fields.push_back({compiled.description().root().fields[i].name, compiled.field(i)});
  }
  CHECK(AnyType::structure(compiled.name(), fields).is_same(compiled));
  CHECK(compiled.field(1).element().is_same(AnyType::of<robot::Mixed>()));
  CHECK_FALSE(compiled.field(2).element());
  CHECK(error_of([&] { (void)compiled.field(6); }).first == EINVAL);

  const AnyType decoded =
      AnyType::decoded(compiled.name(), compiled.alignment(), compiled.encoded());
  CHECK(decoded.is_same(compiled));
}

TEST_CASE("what can be no type is refused by lot::Error") {
  const auto number_of = [](auto&& make) { return error_of(make).first; };
  CHECK(number_of([] { (void)AnyType::number(Kind::UInt, 3); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::number(Kind::Vector, 32); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::vector({}); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::array(real(8), 0); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::array(real(8), ~std::size_t{0} / 4); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::enumeration("e", real(8)); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::duration(whole(8), -1, 1); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::time_point("steady_clock", whole(8)); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::structure("", {}); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::structure("s", {{"x", {}}}); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::opaque("o", 8, 16); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::opaque("o", 8192, 8192); }) == EINVAL);
  CHECK(number_of([] { (void)AnyType::decoded("d", 8, "nonsense"); }) == EINVAL);
  Fields many;
  for (int i = 0; i < 1000; ++i)
    many.push_back({"a rather long name " + std::to_string(i), real(8)});
  CHECK(number_of([&] { (void)AnyType::structure("s", many); }) == EINVAL);
}

TEST_CASE("which numbers there are: by kind and size") {
  struct Row {
    Kind kind;
    std::vector<std::pair<std::size_t, AnyType>> sizes;
  };
  const std::vector<Row> rows{
      {Kind::Bool, {{1, AnyType::of<bool>()}}},
      {Kind::Char, {{1, AnyType::of<char>()}}},
      {Kind::Int,
       {{1, AnyType::of<std::int8_t>()},
        {2, AnyType::of<std::int16_t>()},
        {4, AnyType::of<std::int32_t>()},
        {8, AnyType::of<std::int64_t>()}}},
      {Kind::UInt,
       {{1, AnyType::of<std::uint8_t>()},
        {2, AnyType::of<std::uint16_t>()},
        {4, AnyType::of<std::uint32_t>()},
        {8, AnyType::of<std::uint64_t>()}}},
      {Kind::Float,
       {{4, AnyType::of<float>()}, {8, AnyType::of<double>()}, {16, AnyType::of<long double>()}}},
  };
  for (const Row& row : rows) {
    for (std::size_t size = 0; size <= 33; ++size) {
      CAPTURE(static_cast<unsigned>(row.kind));
      CAPTURE(size);
      AnyType made;
      const auto [error, text] = error_of([&] { made = AnyType::number(row.kind, size); });
      const auto found = std::find_if(row.sizes.begin(), row.sizes.end(),
                                      [&](const auto& pair) { return pair.first == size; });
      if (found == row.sizes.end()) {
        CHECK(error == EINVAL);
        CHECK(lot::testing::names(
            text, ("no number of this kind has " + std::to_string(size) + " bytes").c_str()));
      } else {
        REQUIRE(made);
        CHECK(made.name() == found->second.name());
        CHECK(made.is_same(found->second));
      }
    }
  }
  const auto [error, text] = error_of([] { (void)AnyType::number(Kind::Struct, 8); });
  CHECK(error == EINVAL);
  CHECK(lot::testing::names(text, "this kind is no number"));
}

TEST_CASE("what a refusal of a type says, at each bound") {
  const auto says = [](auto&& make, const char* what) {
    const auto [error, text] = error_of(make);
    CHECK_MESSAGE((error == EINVAL && lot::testing::names(text, what)), text);
  };
  for (const std::size_t align : {1U, 2U, 64U, 4096U}) {
    const AnyType type = AnyType::opaque("o", 8192, align);
    CHECK(type.size() == 8192);
    CHECK(type.alignment() == align);
    CHECK(AnyType::decoded("o", align, type.encoded()).is_same(type));
  }
  const std::string bytes = AnyType::opaque("o", 24, 8).encoded();
  says([] { (void)AnyType::opaque("o", 24, 3); }, "its alignment is 3");
  says([] { (void)AnyType::opaque("o", 16384, 8192); }, "its alignment is 8192");
  says([] { (void)AnyType::opaque("o", 24, 0); }, "no multiple of its alignment, 0");
  says([] { (void)AnyType::opaque("o", 24, 16); }, "no multiple of its alignment, 16");
  says([&] { (void)AnyType::decoded("o", 0, bytes); }, "its alignment is 0");
  says([&] { (void)AnyType::decoded("o", 16, bytes); }, "no multiple of its alignment, 16");
  says([&] { (void)AnyType::decoded("o", 8, bytes.substr(1)); }, "these bytes are no description");
  says([] { (void)AnyType::opaque("", 8, 8); }, "a type has a name of one byte or more");
  says([] { (void)AnyType::opaque(std::string("a\0b", 3), 8, 8); }, "without a zero");
  says([] { (void)AnyType::duration(whole(8), 0, 1); }, "its unit is 0/1 seconds");
  says([] { (void)AnyType::duration(whole(8), 1, 0); }, "its unit is 1/0 seconds");
  CHECK(AnyType::duration(whole(8), 1, 1).size() == 8);
  says([] { (void)AnyType::array(real(8), 0); }, "an array cannot have 0 elements");
  says([] { (void)AnyType::array(real(8), std::size_t{1} << 61); }, "an array cannot have");
  CHECK(AnyType::array(real(8), 1).size() == 8);
  says([] { (void)AnyType::array({}, 1); }, "a part of it is no type");
  says([] { (void)AnyType::duration({}, 1, 1); }, "a part of it is no type");
  says([] { (void)AnyType::time_point("c", {}); }, "a part of it is no type");
  says([] { (void)AnyType::enumeration("e", {}); }, "a part of it is no type");
  says([] { (void)AnyType::reference({}); }, "a part of it is no type");
  says([] { (void)AnyType::structure("s", {{"x", {}}}); }, "s.x");
  says([] { (void)AnyType::of<robot::Point>().field(2); }, "it has no field 2");
}

TEST_CASE("where the fields of a made struct lie, and what it is called in containers") {
  struct Row {
    Fields fields;
    std::vector<std::uint64_t> offsets;
    std::size_t size, alignment;
  };
  for (const Row& row :
       {Row{{}, {}, 1, 1}, Row{{{"a", whole(1)}}, {0}, 1, 1},
        Row{{{"a", whole(1)}, {"b", whole(8)}, {"c", whole(1)}}, {0, 8, 16}, 24, 8},
        Row{{{"a", whole(8)}, {"b", whole(1)}, {"c", whole(2)}}, {0, 8, 10}, 16, 8},
        Row{{{"a", real(16)}, {"b", whole(4)}}, {0, 16}, 32, 16}}) {
    const AnyType type = AnyType::structure("s", row.fields);
    CHECK(type.size() == row.size);
    CHECK(type.alignment() == row.alignment);
    const auto& fields = type.description().root().fields;
    REQUIRE(fields.size() == row.offsets.size());
    for (std::size_t i = 0; i < fields.size(); ++i) {
      CHECK(fields[i].offset == row.offsets[i]);
      CHECK(fields[i].name == row.fields[i].name);
      CHECK(type.field(i).is_same(row.fields[i].type));
    }
  }
  const AnyType bytes = AnyType::vector(natural(1));
  CHECK(AnyType::vector(bytes).name() ==
        AnyType::of<lot::ShmVector<lot::ShmVector<std::uint8_t>>>().name());
  CHECK(
      AnyType::reference(bytes).is_same(AnyType::of<lot::ShmRef<lot::ShmVector<std::uint8_t>>>()));
  CHECK(AnyType::vector(AnyType::array(bytes, 2)).name() ==
        AnyType::of<lot::ShmVector<std::array<lot::ShmVector<std::uint8_t>, 2>>>().name());
}

TEST_CASE("what the parts of a type are called") {
  const Fields fields{{"a", AnyType::number(Kind::Bool, 1)},
                      {"b", AnyType::number(Kind::Char, 1)},
                      {"c", whole(4)},
                      {"d", natural(2)},
                      {"e", real(8)},
                      {"f", AnyType::enumeration("robot::Mode", natural(2))},
                      {"g", AnyType::opaque("robot::Secret", 12, 4)},
                      {"h", point()},
                      {"i", AnyType::string()},
                      {"j", AnyType::array(real(4), 3)}};
  const AnyType type = AnyType::structure("s", fields);
  for (std::size_t i = 0; i < fields.size(); ++i) {
    CAPTURE(i);
    const bool is_named = i < 8;
    CHECK(type.field(i).name() == (is_named ? fields[i].type.name() : "part of a message"));
    CHECK(type.field(i).size() == fields[i].type.size());
    CHECK(type.field(i).alignment() == fields[i].type.alignment());
  }
  CHECK_FALSE(type.element());
  CHECK(type.field(9).element().name() == real(4).name());
  const auto [error, text] = error_of([] { (void)AnyType::opaque("", 8, 8); });
  CHECK(text.starts_with("lot: type: a type has a name"));
}

TEST_CASE("a subscriber with a made type comes first, and gets what a ShmPusher publishes") {
  lot::ShmEngine engine(fresh());
  auto puller = engine.subscribe_any("/frames", frame());
  auto pusher = engine.advertise<robot::Frame>("/frames");
  auto sent = pusher.loan();
  sent->width = 640;
  sent->labels.resize(2);
  sent->labels[1].text = "a text that is longer than a string has in itself";
  must_go(pusher.push(std::move(sent)));
  const auto seen = puller.try_pull();
  REQUIRE(seen);
  CHECK(seen.root()["width"].as<int>() == 640);
  CHECK(seen.root().at("labels[1].text").as<std::string>().size() == 49);
  CHECK(seen.as<robot::Frame>()->width == 640);

  const auto wrong = error_of([&] { (void)engine.subscribe_any("/frames", point()); });
  CHECK(wrong.first == EPROTOTYPE);
  CHECK(error_of([&] { (void)engine.subscribe_any("/frames", AnyType()); }).first == EINVAL);
}

TEST_CASE("a publisher with a made type sends to a ShmPuller; a loan of an opaque type is zero") {
  lot::ShmEngine engine(fresh());
  auto puller = engine.subscribe<robot::Frame>("/frames");
  auto pusher = engine.advertise_any("/frames", frame());
  auto loan = pusher.loan();
  loan.root().at("rows").resize(3);
  loan.root().at("rows[2]").resize(5);
  loan.root().at("rows[2][4]").set(2.5);
  must_go(pusher.push(std::move(loan)));
  const auto seen = puller.try_pull();
  REQUIRE(seen);
  CHECK(seen->rows.at(2).at(4) == 2.5F);
  CHECK(error_of([&] { (void)pusher.loan_zeroed(); }).first == EINVAL);

  auto secrets = engine.advertise_any("/secrets", AnyType::opaque("robot::Secret", 12, 4));
  auto borrower = engine.subscribe_any("/secrets");
  CHECK(error_of([&] { (void)secrets.loan(); }).first == EINVAL);
  auto secret = secrets.loan_zeroed();
  auto* const words = static_cast<std::uint32_t*>(secret.data());
  CHECK(words[2] == 0);
  words[2] = 7;
  must_go(secrets.push(std::move(secret)));
  const auto borrow = borrower.try_borrow();
  REQUIRE(borrow);
  CHECK(static_cast<const std::uint32_t*>(borrow.data())[2] == 7);
}
