// SPDX-License-Identifier: Apache-2.0

// A message is read by its description.

#if defined(__GNUC__) && !defined(__clang__)
// As in message_test.cpp.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <span>
#include <sstream>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "by_hand.hpp"
#include "description/containers.hpp"
#include "readable.hpp"
#include "support/error_of.hpp"
#include "support/seed.hpp"

namespace {

using namespace readable;
using namespace std::chrono_literals;
using lot::Kind;
using lot::Value;
using lot::testing::error_of;
using lot::testing::names;

// docs/layout.md says so, and containers.hpp.
static_assert(sizeof(lot::ShmVector<int>) == lot::description::kVectorSize);
static_assert(sizeof(lot::ShmRef<int>) == lot::description::ReferenceWords::kSize);
#ifdef _LIBCPP_VERSION
static_assert(sizeof(lot::ShmString) == lot::description::BoostString::kSize);
#else
static_assert(sizeof(lot::ShmString) == lot::description::StdString::kSize);
#endif

/// A message of every kind in a segment.
struct Read : Place {
  Read() : message(engine.make<Everything>()), frame(engine.make<Frame>()) {
    fill(*message);
    frame->stamp = 5;
    frame->encoding = "rgb8";
    target = std::move(frame);
    message->frame = target;
  }
  Value root() { return lot::detail::value_of(lot::describe<Everything>(), message.get()); }

  lot::ShmUniquePtr<Everything> message;
  lot::ShmUniquePtr<Frame> frame;
  lot::ShmSharedPtr<const Frame> target;
};

/// A T in this process's own memory, which is all that its values may look at.
template <class T>
struct Own {
  Value root() const { return {lot::describe<T>(), &object, &object, &object + 1}; }
  T object{};
};

TEST_CASE("a Value reads each kind of number, exactly") {
  Read read;
  const Value root = read.root();
  const Everything& e = *read.message;
  CHECK(root["yes"].as<bool>());
  CHECK(root["letter"].as<char>() == 'x');
  CHECK(root["i8"].as<std::int8_t>() == -8);
  CHECK(root["u8"].as<int>() == 200);
  CHECK(root["i16"].as<std::int16_t>() == -1600);
  CHECK(root["u16"].as<std::uint64_t>() == 65000);
  CHECK(root["i32"].as<std::int64_t>() == e.i32);
  CHECK(root["u32"].as<std::uint32_t>() == e.u32);
  CHECK(root["i64"].as<std::int64_t>() == INT64_MIN);
  CHECK(root["u64"].as<std::uint64_t>() == UINT64_MAX);
  CHECK(root["byte"].as<std::byte>() == std::byte{0xfe});
  CHECK(root["f32"].as<float>() == 0.1F);
  CHECK(root["f32"].as<double>() == double{0.1F});
  CHECK(root["f64"].as<double>() == 0.1);
  CHECK(root["f64"].as<float>() == 0.1F);
  CHECK(root["real"].as<long double>() == 0.1L);
  CHECK(root["colour"].as<Colour>() == Colour::None);
  CHECK(root["colour"].as<int>() == -1);
  CHECK(root["wide"].as<Wide>() == Wide::All);
  CHECK(root["points"][1]["y"].as<int>() == 4);
}

TEST_CASE("a Value does not cut a number to the type that is asked for") {
  Read read;
  const Value root = read.root();
  CHECK(error_of([&] { (void)root["u8"].as<std::int8_t>(); }).first == ERANGE);
  CHECK(error_of([&] { (void)root["i8"].as<std::uint64_t>(); }).first == ERANGE);
  CHECK(error_of([&] { (void)root["i64"].as<std::uint64_t>(); }).first == ERANGE);
  CHECK(error_of([&] { (void)root["u64"].as<std::int64_t>(); }).first == ERANGE);
  CHECK(error_of([&] { (void)root["u64"].as<double>(); }).first == ERANGE);
  CHECK(root["i64"].as<double>() == -0x1p63);
  CHECK(error_of([&] { (void)root["f64"].as<int>(); }).first == ERANGE);
  read.message->f64 = 1e300;
  const auto [error, text] = error_of([&] { (void)root["f64"].as<float>(); });
  CHECK(error == ERANGE);
  CHECK(names(text, "lot: f64: it is 1e+300, which the type"));
  CHECK(error_of([&] { (void)root["f64"].as<std::uint64_t>(); }).first == ERANGE);
  read.message->f64 = std::numeric_limits<double>::quiet_NaN();
  CHECK(std::isnan(root["f64"].as<float>()));
  CHECK(error_of([&] { (void)root["f64"].as<int>(); }).first == ERANGE);
  read.message->f64 = -0x1p63;
  CHECK(root["f64"].as<std::int64_t>() == INT64_MIN);
  read.message->f64 = 0x1p63;
  CHECK(error_of([&] { (void)root["f64"].as<std::int64_t>(); }).first == ERANGE);
  CHECK(root["f64"].as<std::uint64_t>() == std::uint64_t{1} << 63);
}

TEST_CASE("a bool that its publisher has not set is an error, which says so") {
  Read read;
  std::memset(static_cast<void*>(&read.message->yes), 0xaa, 1);
  const auto [error, text] = error_of([&] { (void)read.root()["yes"].as<bool>(); });
  CHECK(error == EBADMSG);
  CHECK(names(text, "lot: yes: a bool is 170"));
  CHECK(names(text, "its publisher has not set it"));
  CHECK(names(to_string(read.root()), "{yes: <damaged>, letter: "));
}

TEST_CASE("a field has its place as a second name, unless another one is called so") {
  Read read;
  const Value root = read.root();
  CHECK(root["_0"].path() == "yes");
  CHECK(root["_2"].as<int>() == root["i8"].as<int>());
  CHECK(root.at("pair._1").as<double>() == 2.5);
  CHECK(root.has("_0"));
  for (const char* none : {"_", "_00", "_02", "_x", "_0x", "_-1", "_31", "_99999999999999999999"}) {
    CAPTURE(none);
    CHECK(!root.has(none));
    CHECK(error_of([&] { (void)root[none]; }).first == EINVAL);
  }
  struct Numbered {
    int _1, x;
  };
  const Numbered numbered{5, 6};
  const auto* const at = reinterpret_cast<const unsigned char*>(&numbered);
  const Value value(lot::describe<Numbered>(), at, at, at + sizeof(numbered));
  CHECK(value["_1"].as<int>() == 5);
  CHECK(value["_0"].as<int>() == 5);
  CHECK(value["x"].as<int>() == 6);
}

TEST_CASE("a Value reads bit-fields, with and without a sign") {
  Read read;
  const Value bits = read.root()["bits"];
  CHECK(bits[0].as<int>() == 5);
  CHECK(bits["_1"].as<int>() == 17);
  CHECK(bits["_2"].as<int>() == -4);
  CHECK(bits["_3"].as<int>() == -9);
  CHECK(bits["_4"].as<bool>());
  CHECK(bits["_5"].as<Small>() == Small::Seven);
  CHECK(bits["_6"].as<std::uint64_t>() == (1UL << 63) - 2);
  CHECK(bits["_6"].path() == "bits._6");
}

TEST_CASE("a Value reads durations and time points, exactly") {
  Read read;
  const Value root = read.root();
  CHECK(root["span"].as<std::chrono::milliseconds>() == -1500ms);
  CHECK(root["span"].as<std::chrono::nanoseconds>() == -1500ms);
  CHECK(root["span"].as<std::chrono::duration<float>>() == std::chrono::duration<float>(-1.5F));
  CHECK(root["span"].as<int>() == -1500);
  CHECK(error_of([&] { (void)root["span"].as<std::chrono::seconds>(); }).first == ERANGE);
  CHECK(root["seconds"].as<std::chrono::milliseconds>() == 250ms);
  CHECK(root["when"].as<When>() == read.message->when);
  CHECK(root["when"].as<std::chrono::nanoseconds>() == read.message->when.time_since_epoch());
  const auto [error, text] =
      error_of([&] { (void)root["when"].as<std::chrono::steady_clock::time_point>(); });
  CHECK(error == EINVAL);
  CHECK(names(text, "lot: when: it is a time point of system_clock"));
  read.message->span = std::chrono::milliseconds::max();
  CHECK(error_of([&] { (void)root["span"].as<std::chrono::nanoseconds>(); }).first == ERANGE);
  read.message->span = std::chrono::milliseconds::min();
  CHECK(root["span"].as<std::chrono::milliseconds>() == std::chrono::milliseconds::min());
  CHECK(error_of([&] { (void)root["u64"].as<std::chrono::seconds>(); }).first == EINVAL);
}

TEST_CASE("a Value reads strings, vectors and arrays") {
  Read read;
  const Value root = read.root();
  CHECK(root["text"].as<std::string_view>() == kLong);
  CHECK(root["text"].size() == std::strlen(kLong));
  CHECK(root.at("labels[0].name").as<std::string>() == "short");
  CHECK(root.at("labels[0].notes[0]").as<std::string>() == "");
  CHECK(root.at("labels[0].notes[1]").as<std::string>() == kLong);
  CHECK(root.at("labels[1].name").as<std::string>() == kLong);
  CHECK(root["labels"].size() == 2);
  CHECK(root["rows"][0].size() == 0);
  CHECK(root["rows"][1][4].as<int>() == 4);
  CHECK(root["numbers"].size() == 3);
  CHECK(root["numbers"][1].as<int>() == -2);
  CHECK(root["tree"].at("branches[1].branches[0].number").as<int>() == 4);
  CHECK(root["nothing"].size() == 0);
  CHECK(root["pair"]["second"].as<double>() == 2.5);
}

TEST_CASE("a Value lends the bytes of plain elements, without a copy") {
  Read read;
  const Value root = read.root();
  const lot::Bytes floats = root["floats"].bytes();
  CHECK(static_cast<const void*>(floats.data()) == read.message->floats.data());
  CHECK(floats.size() == 3 * sizeof(float));
  CHECK(static_cast<const void*>(root["points"].bytes().data()) == read.message->points);
  CHECK(root["text"].bytes().size() == std::strlen(kLong));
  CHECK(root["rows"][0].bytes().size() == 0);
  const std::span<const std::byte> span = root["floats"].bytes();
  CHECK(span.size() == 12);
  const auto [error, text] = error_of([&] { (void)root["labels"].bytes(); });
  CHECK(error == EINVAL);
  CHECK(names(text, "labels: a vector of readable::Label does not lie in one piece"));
  CHECK(error_of([&] { (void)root.bytes(); }).first == EINVAL);
  CHECK(error_of([&] { (void)root["bits"][0].bytes(); }).first == EINVAL);
}

TEST_CASE("the bytes of a packed struct lie where they lie") {
  struct __attribute__((packed)) Packed {
    std::uint8_t id;
    float values[2];
  };
  Packed packed{1, {1.5F, -2}};
  const lot::Description& description = lot::describe<Packed>();
  const auto* const at = reinterpret_cast<const unsigned char*>(&packed);
  const Value value(description, at, at, at + sizeof(packed));
  const lot::Bytes bytes = value[1].bytes();
  REQUIRE(bytes.size() == 2 * sizeof(float));
  CHECK(static_cast<const void*>(bytes.data()) == at + 1);
  CHECK(value[1][1].as<float>() == -2);
}

TEST_CASE("a Value follows references, and says which lead nowhere") {
  Read read;
  const Value root = read.root();
  CHECK(root["frame"].kind() == Kind::Reference);
  CHECK(root["frame"]["stamp"].as<int>() == 5);
  CHECK(root.at("frame.encoding").as<std::string>() == "rgb8");
  CHECK(root.at("frame.encoding").path() == "frame.encoding");
  CHECK(root["frame"][std::size_t{0}].as<int>() == 5);
  CHECK(root["frame"].target().kind() == Kind::Struct);
  CHECK(root["frame"].target().address() == read.target.get());
  CHECK(!root["frame"].is_null());
  read.message->frame = nullptr;
  CHECK(root["frame"].is_null());
  const auto [error, text] = error_of([&] { (void)root.at("frame.stamp"); });
  CHECK(error == EINVAL);
  CHECK(names(text, "lot: frame: it refers to nothing"));
}

TEST_CASE("references in a ring come to an end") {
  Place place;
  auto chain = place.engine.make<Chain>();
  chain->number = 3;
  lot::ShmSharedPtr<Chain> shared = std::move(chain);
  shared->next = shared;
  Value value = lot::detail::value_of(lot::describe<Chain>(), shared.get());
  const auto [error, text] = error_of([&] {
    while (true) {
      const int number = value["number"].as<int>();
      CHECK(number == 3);
      value = value["next"].target();
    }
  });
  CHECK(error == ELOOP);
  CHECK(names(text, "more than 64 levels deep"));
  CHECK(to_string(lot::detail::value_of(lot::describe<Chain>(), shared.get())).size() < 4000);
  shared->next = nullptr;
}

TEST_CASE("at() says which part of a path is wrong, and what there is") {
  Read read;
  const Value root = read.root();
  const auto why = [&](const char* path) {
    const auto [error, text] = error_of([&] { (void)root.at(path); });
    CHECK(error == EINVAL);
    return text;
  };
  CHECK(names(why("labels[0].nam"), "lot: labels[0]: there is no field \"nam\""));
  CHECK(names(why("labels[0].nam"), "there are name, score, notes"));
  CHECK(names(why("labels[2]"), "lot: labels: it has 2 elements, and no [2]"));
  CHECK(names(why("labels[x]"), "there is no number in [ ], in the path at \"[x]\""));
  CHECK(names(why("labels[-1]"), "there is no number in [ ]"));
  CHECK(names(why("labels[1"), "a ] is missing"));
  CHECK(names(why("labels[0]name"), "a . or [ is missing, in the path at \"name\""));
  CHECK(names(why("labels..name"), "a name is missing"));
  CHECK(names(why(".yes"), "a name is missing"));
  CHECK(names(why("yes."), "lot: yes: a name is missing"));
  CHECK(names(why("yes.no"), "lot: yes: it is a bool, and has no field \"no\""));
  CHECK(names(why("yes[0]"), "lot: yes: it is a bool, and has no elements"));
  CHECK(names(why("labels.name"), "it is a vector of readable::Label, and has no field \"name\""));
  CHECK(names(why("labels[18446744073709551616]"), "there is no number in [ ]"));
  CHECK(root.at("").address() == read.message.get());
  CHECK(root.has("yes"));
  CHECK(!root.has("no"));
  CHECK(error_of([&] { (void)root["yes"].as<std::string>(); }).first == EINVAL);
  CHECK(error_of([&] { (void)root["text"].as<int>(); }).first == EINVAL);
  CHECK(error_of([&] { (void)root[99]; }).first == EINVAL);
}

TEST_CASE("a loop over a Value sees its fields, or its elements") {
  Read read;
  const Value root = read.root();
  std::string fields;
  for (const Value& field : root) fields += field.name() + " ";
  CHECK(fields.find("yes letter i8 ") == 0);
  CHECK(std::distance(root.begin(), root.end()) == 31);
  std::vector<float> floats;
  for (const Value& item : root["floats"]) floats.push_back(item.as<float>());
  CHECK(floats == std::vector<float>{1.5F, -2, 3});
  CHECK(root["floats"][2].name() == "[2]");
  CHECK(root["nothing"].begin() == root["nothing"].end());
  CHECK(root["yes"].begin() == root["yes"].end());
  CHECK(root.name() == "");
}

TEST_CASE("a Value says what its type is") {
  Read read;
  const Value root = read.root();
  CHECK(root.type_name() == "readable::Everything");
  CHECK(root["u16"].type_name() == "uint16");
  CHECK(root["real"].type_name() == "long double");
  CHECK(root["points"].type_name() == "readable::Point[2]");
  CHECK(root["rows"].type_name() == "vector of vector of uint16");
  CHECK(root["frame"].type_name() == "reference to readable::Frame");
  CHECK(root["tree"].type_name() == "readable::Tree");
}

TEST_CASE("a Value is printed on one line, and not all of it when it is long") {
  Read read;
  std::ostringstream out;
  out << read.root();
  CHECK(out.str() ==
        "{yes: true, letter: 'x', i8: -8, u8: 200, i16: -1600, u16: 65000, i32: -2000000000, "
        "u32: 4000000000, i64: -9223372036854775808, u64: 18446744073709551615, byte: 254, "
        "f32: 0.1, f64: 0.1, real: 0.100000000000000000001, colour: -1, "
        "wide: 18446744073709551615, span: -1.5s, seconds: 0.25s, when: 1700000000.123456789s, "
        "numbers: [1, -2, 3], name: \"hi\", points: [{x: 1, y: 2}, {x: 3, y: 4}], nothing: {}, "
        "bits: {_0: 5, _1: 17, _2: -4, _3: -9, _4: true, _5: 7, _6: 9223372036854775806}, "
        "text: \"a text that is much too long for the small string in place\", "
        "floats: [1.5, -2, 3], labels: [{name: \"short\", score: 0.5, notes: [\"\", "
        "\"a text that is much too long for the small string in place\"]}, "
        "{name: \"a text that is much too long for the small string in place\", score: 1, "
        "notes: [\"\", \"\"]}], rows: [[], [0, 1, 2, 3, 4]], "
        "frame: {stamp: 5, encoding: \"rgb8\", data: []}, "
        "tree: {number: 1, branches: [{number: 2, branches: []}, {number: 3, branches: "
        "[{number: 4, branches: []}]}]}, pair: {first: 9, second: 2.5}}");
  CHECK(to_string(read.root()["floats"], {1, 80, 100}) == "[1.5, ... 3 in all]");
  CHECK(to_string(read.root()["text"], {1, 6, 100}) == "\"a text... 58 bytes\"");
  CHECK(to_string(read.root()["points"], {16, 80, 2}) == "[{x: ..., y: ...}, ...]");
  read.message->text = "\"\\\n\x7f";
  CHECK(to_string(read.root()["text"]) == "\"\\\"\\\\\\x0a\\x7f\"");
  read.message->f64 = -std::numeric_limits<double>::infinity();
  CHECK(to_string(read.root()["f64"]) == "-inf");
}

TEST_CASE("a Value reads forty fields, opaque bytes, and a message that is one number") {
  Own<Forty> forty;
  forty.object.h9 = 39;
  std::size_t n = 0;
  for ([[maybe_unused]] const Value& field : forty.root()) ++n;
  CHECK(n == 40);
  CHECK(forty.root()["h9"].as<int>() == 39);
  CHECK(forty.root()["i9"].as<std::string>() == "");

  Own<HasSecret> secret;
  CHECK(secret.root()["secret"].kind() == Kind::Opaque);
  CHECK(secret.root()["secret"].size() == 4);
  CHECK(secret.root()["secret"].bytes().size() == 4);
  CHECK(to_string(secret.root()) == "{before: 0, secret: <4 bytes>, more: []}");

  Own<double> number;
  number.object = 2;
  CHECK(number.root().as<int>() == 2);
  CHECK(number.root().path() == "");
}

TEST_CASE("strings and vectors of libc++ are read wherever they were made, and of no third one") {
  using namespace lot::description;
  lot::Description all;
  all.types.resize(4);
  auto& root = all.types[0];
  root.kind = Kind::Struct;
  root.size = BoostString::kSize + kVectorSize;
  root.fields = {{"text", 1, 0, 0, 0}, {"items", 2, BoostString::kSize, 0, 0}};
  all.types[1].kind = Kind::String;
  all.types[1].size = BoostString::kSize;
  all.types[1].name = "libc++";
  all.types[2].kind = Kind::Vector;
  all.types[2].size = kVectorSize;
  all.types[2].name = "libc++";
  all.types[2].element = 3;
  all.types[3].kind = Kind::UInt;
  all.types[3].size = 1;
  alignas(8) unsigned char memory[128] = {};
  const auto put = [&](std::size_t at, std::uint64_t word) { std::memcpy(memory + at, &word, 8); };
  put(0, kNull);
  memory[8] = 5 << 1 | 1;
  std::memcpy(memory + 9, "hello", 6);
  put(32, 100 - 32);  // begin
  put(40, 103 - 40);  // end
  put(48, 110 - 48);  // capacity
  put(56, kNull);     // the allocator
  memory[102] = 77;
  const Value value(all, memory, memory, memory + sizeof memory);
  CHECK(value["text"].as<std::string>() == "hello");
  CHECK(value["items"].size() == 3);
  CHECK(value["items"][2].as<int>() == 77);
  put(8, 20 << 1);  // a long one
  put(16, 21);
  put(24, 80 - 24);
  std::memcpy(memory + 80, "twenty bytes of text", 20);
  CHECK(value["text"].as<std::string>() == "twenty bytes of text");
  memory[8] = 23 << 1 | 1;
  CHECK(error_of([&] { (void)value["text"].size(); }).first == EBADMSG);
  all.types[1].name = "another";
  CHECK(error_of([&] { (void)value["text"].size(); }).first == EINVAL);
  all.types[2].name = "another";
  CHECK(error_of([&] { (void)value["items"].size(); }).first == EINVAL);
}

TEST_CASE("the words of a vector and a string that lead elsewhere are EBADMSG") {
  Read read;
  const Value root = read.root();
  auto* const vector = reinterpret_cast<std::uint64_t*>(&read.message->floats);
#ifdef _LIBCPP_VERSION
  constexpr std::size_t kBegin = 0;
#else
  constexpr std::size_t kBegin = 1;
#endif
  const auto with = [&](std::size_t word, std::uint64_t bad) {
    const std::uint64_t good = std::exchange(vector[word], bad);
    const auto [error, text] = error_of([&] { (void)root["floats"][0].as<float>(); });
    CHECK(names(text, "lot: floats: "));
    vector[word] = good;
    return error;
  };
  CHECK(with(kBegin, std::uint64_t{1} << 40) == EBADMSG);
  CHECK(with(kBegin, ~std::uint64_t{0} >> 1) == EBADMSG);
  CHECK(with(kBegin, 1) == EBADMSG);
  CHECK(with(kBegin + 1, 1) == EBADMSG);
  CHECK(with(kBegin + 1, vector[kBegin] - 16) == EBADMSG);
  CHECK(with(kBegin + 1, vector[kBegin + 1] + 1) == EBADMSG);
  CHECK(root["floats"][0].as<float>() == 1.5F);
  CHECK(names(to_string(root), "floats: [1.5"));
  const std::uint64_t good = std::exchange(vector[kBegin], vector[kBegin] + 1);
  vector[kBegin + 1] += 1;
  CHECK(error_of([&] { (void)root["floats"].bytes(); }).first == EBADMSG);  // not aligned
  CHECK(root["floats"].size() == 3);
  vector[kBegin] = good;
  vector[kBegin + 1] -= 1;
  read.message->yes = true;
  std::memset(&read.message->yes, 2, 1);
  CHECK(error_of([&] { (void)root["yes"].as<bool>(); }).first == EBADMSG);
  CHECK(names(to_string(root), "{yes: <damaged>, letter: 'x'"));
  std::memset(&read.message->yes, 1, 1);
}

/// Reads all of a value that can be read. It ends, however the values lead to each other.
void look(const Value& value, std::size_t& left) {
  if (left == 0) return;
  --left;
  try {
    switch (value.kind()) {
      case Kind::String:
        left -= std::min(left, std::size_t{std::string(value.as<std::string_view>()).empty()});
        break;
      case Kind::Reference:
        if (!value.is_null()) look(value.target(), left);
        break;
      case Kind::Struct:
      case Kind::Array:
      case Kind::Vector:
        for (const Value& part : value) {
          if (left == 0) return;
          look(part, left);
        }
        break;
      case Kind::Opaque:
        (void)value.bytes();
        break;
      case Kind::Duration:
        (void)value.as<std::chrono::duration<double>>();
        break;
      case Kind::Bool:
        (void)value.as<bool>();
        break;
      default:
        (void)value.as<long double>();
    }
  } catch (const lot::Error&) {
    // it is damaged here
  }
}

TEST_CASE("damaged messages give values or errors, and no byte outside of them is looked at") {
  Read read;
  const std::uint64_t seed = lot::testing::seed();
  CAPTURE(seed);
  std::mt19937_64 random(seed);
  const Fenced fenced;
  const Value root = fenced.copy_of(read.root());
  REQUIRE(to_string(root) == to_string(read.root()));
  const std::vector<unsigned char> whole(fenced.begin(), fenced.next());
  std::size_t damaged = 0;
  for (int i = 0; i < 1000; ++i) {
    std::copy(whole.begin(), whole.end(), fenced.begin());
    const std::uint64_t words = 1 + random() % 8;
    for (std::uint64_t n = 0; n < words; ++n) {
      const std::size_t at = random() % (whole.size() / 8) * 8;
      std::uint64_t word = random() >> (random() % 64);
      if (random() % 2 == 0) word = random() % Fenced::kBytes - at;  // leads to another part
      if (random() % 8 == 0) word = ~std::uint64_t{0} >> (random() % 4);
      std::memcpy(fenced.begin() + at, &word, sizeof word);
    }
    std::size_t left = 20'000;
    look(root, left);
    damaged += names(to_string(root, {4, 16, 1000}), "<damaged>") ? 1 : 0;
  }
  CHECK(damaged > 100);
  CHECK(damaged < 1000);
}

TEST_CASE("a description that lies about its fields is an error") {
  lot::Description all = lot::describe<Point>();
  Own<Point> point;
  const Value value(all, &point.object, &point.object, &point.object + 1);
  CHECK(value["y"].as<double>() == 0);
  all.types[0].fields[1].offset = 9;
  CHECK(error_of([&] { (void)value["y"].as<double>(); }).first == EBADMSG);
  all.types[0].fields[1].type = 99;
  CHECK(error_of([&] { (void)value["y"].as<double>(); }).first == EBADMSG);
  all.types.push_back(all.types[1]);
  all.types.pop_back();  // what lies behind the last type looks like one
  all.types[0].fields[1].offset = 4;
  all.types[0].fields[1].type = static_cast<std::uint32_t>(all.types.size());
  CHECK(error_of([&] { (void)value["y"].as<double>(); }).first == EBADMSG);
  all.types[0].size = 1 << 20;
  CHECK(error_of([&] { (void)value["x"].as<double>(); }).first == EBADMSG);
}

TEST_CASE("a vector that is not aligned is an error") {
  alignas(8) const unsigned char zeros[64] = {};
  const Value value(lot::describe<lot::ShmVector<float>>(), zeros + 4, zeros, zeros + sizeof zeros);
  const auto [error, text] = error_of([&] { (void)value.size(); });
  CHECK(error == EBADMSG);
  CHECK(names(text, "it is not aligned"));
}

/// A description as no parser lets it through.
lot::Description lie(std::mt19937_64& random) {
  lot::Description all = lot::describe<Everything>();
  for (std::uint64_t n = 1 + random() % 3; n != 0; --n) {
    lot::Description::Type& type = all.types[random() % all.types.size()];
    const std::uint64_t number = random() >> (random() % 64);
    const auto place = static_cast<std::uint32_t>(random() % (all.types.size() + 1));
    switch (random() % 6) {
      case 0:
        type.kind = static_cast<Kind>(random() % 14);
        break;
      case 1:
        type.size = number;
        break;
      case 2:
        type.count = number;
        break;
      case 3:
        type.element = place;
        break;
      case 4:
        type.numerator = static_cast<std::int64_t>(number);
        break;
      default:
        if (type.fields.empty()) break;
        lot::Description::Field& field = type.fields[random() % type.fields.size()];
        field.offset = random() % 2 == 0 ? number : random() % 512;
        field.type = place;
        field.bit = static_cast<std::uint32_t>(random() % 16);
        field.bits = random() % 4 == 0 ? static_cast<std::uint32_t>(random() % 80) : 0;
    }
  }
  return all;
}

TEST_CASE("a description that lies gives values or errors, and nothing outside is looked at") {
  Read read;
  const std::uint64_t seed = lot::testing::seed();
  CAPTURE(seed);
  std::mt19937_64 random(seed);
  const Fenced fenced;
  const void* const message = fenced.copy_of(read.root()).address();
  const std::vector<unsigned char> whole(fenced.begin(), fenced.next());
  for (int i = 0; i < 1000; ++i) {
    const lot::Description all = lie(random);
    const Value root(all, message, fenced.begin(), fenced.begin() + Fenced::kBytes);
    std::size_t left = 20'000;
    look(root, left);
    (void)to_string(root, {4, 16, 1000});
    (void)error_of([&] { fenced.at_begin(all).construct(); });
    std::copy(whole.begin(), whole.end(), fenced.begin());
  }
}

TEST_CASE("an AnyMessage shares a message, and gives it back as its type, and as no other") {
  Place place;
  auto frame = place.engine.make<Frame>();
  frame->stamp = 9;
  frame->data.resize(3);
  const lot::ShmSharedPtr<const Frame> shared = std::move(frame);
  lot::AnyMessage any = shared;
  CHECK(shared.use_count() == 2);
  {
    const std::vector<lot::AnyMessage> copies(1, any);
    const lot::AnyMessage& copy = copies.front();
    CHECK(shared.use_count() == 3);
    CHECK(copy.root()["stamp"].as<int>() == 9);
    CHECK(copy.root()["data"].size() == 3);
  }
  CHECK(shared.use_count() == 2);
  CHECK(any.type().name() == "readable::Frame");
  CHECK(any.as<Frame>() == shared);
  CHECK(any.as<const Frame>() == shared);
  CHECK(any.as<Point>() == nullptr);
  CHECK(any.as<Everything>() == nullptr);

  // What another program has described, with names and without.
  lot::Description other = lot::describe<Frame>();
  const auto of = [&](const std::string& name, std::uint64_t align) {
    struct Other : lot::detail::MessageType {
      lot::detail::Described known;
    } type{lot::detail::message_type<Frame>(), lot::detail::make_described(other)};
    type.name = name.c_str();
    type.align = align;
    type.described = [](const lot::detail::MessageType& self) -> const lot::detail::Described& {
      return static_cast<const Other&>(self).known;
    };
    return lot::AnyMessage(shared, lot::AnyType(lot::detail::make_known_type(type, other)));
  };
  CHECK(of("readable::Frame", alignof(Frame)).as<Frame>() == shared);
  CHECK(of("readable::Farm", alignof(Frame)).as<Frame>() == nullptr);
  CHECK(of("readable::Frame", 64).as<Frame>() == nullptr);
  other.types[0].fields[0].name = "";
  CHECK(of("readable::Frame", alignof(Frame)).as<Frame>() == shared);
  other.types[0].fields[0].name = "time";
  CHECK(of("readable::Frame", alignof(Frame)).as<Frame>() == nullptr);
  other.types[0].fields[0].name = "stamp";
  other.types[0].fields[0].offset = 8;
  CHECK(of("readable::Frame", alignof(Frame)).as<Frame>() == nullptr);
  CHECK(shared.use_count() == 2);
  any.reset();
  CHECK(!any);
  CHECK(any.as<Frame>() == nullptr);
  CHECK(shared.use_count() == 1);
  const lot::AnyMessage null = lot::ShmSharedPtr<Frame>();
  CHECK(!null);
}

/// Bytes of this process, and a description of them that a test writes down.
struct Hand {
  explicit Hand(std::vector<by_hand::Type> types) { all.types = std::move(types); }
  Value root() const { return {all, bytes, bytes, bytes + sizeof bytes}; }
  void put(std::size_t at, std::uint64_t word) { std::memcpy(bytes + at, &word, sizeof word); }

  lot::Description all;
  alignas(16) unsigned char bytes[256] = {};
};

/// The text of what f throws.
template <class F>
std::string why_of(F&& f) {
  return error_of(f).second;
}

TEST_CASE("a Value names the type of each kind, eight levels deep") {
  using by_hand::type;
  const auto name_of = [](const by_hand::Type& first, const by_hand::Type& second) {
    return Hand({first, second}).root().type_name();
  };
  const by_hand::Type int16 = type(Kind::Int, 2);
  CHECK(name_of(type(Kind::Bool, 1), int16) == "bool");
  CHECK(name_of(type(Kind::Char, 1), int16) == "char");
  CHECK(name_of(int16, int16) == "int16");
  CHECK(name_of(type(Kind::UInt, 8), int16) == "uint64");
  CHECK(name_of(type(Kind::Float, 4), int16) == "float32");
  CHECK(name_of(type(Kind::Float, 8), int16) == "float64");
  CHECK(name_of(type(Kind::Float, 9), int16) == "long double");
  CHECK(name_of(type(Kind::Duration, 8), int16) == "duration");
  CHECK(name_of(type(Kind::TimePoint, 8, "a_clock"), int16) == "time point of a_clock");
  CHECK(name_of(type(Kind::Array, 6, "", 1, 3), int16) == "int16[3]");
  CHECK(name_of(type(Kind::String, 40, "libc++"), int16) == "string");
  CHECK(name_of(type(Kind::Vector, 32, "libc++", 1), int16) == "vector of int16");
  CHECK(name_of(type(Kind::Reference, 32, "", 1), int16) == "reference to int16");
  CHECK(name_of(type(Kind::Opaque, 4, "a::Secret"), int16) == "a::Secret");
  CHECK(name_of(type(Kind::Enum, 4, "a::Mode"), int16) == "a::Mode");
  CHECK(name_of(type(Kind::Struct, 4, "a::Point"), int16) == "a::Point");
  CHECK(name_of(type(Kind::Array, 6, "", 2, 3), int16) == "?[3]");
  CHECK(name_of(type(Kind::Array, 6, "", by_hand::kNone, 3), int16) == "?[3]");
  CHECK(name_of(type(Kind::Array, 1, "", 0, 1), int16) == "?[1][1][1][1][1][1][1][1]");
}

TEST_CASE("an error lists twelve fields, and says how many more there are") {
  const auto why = [](std::size_t fields) {
    std::vector<by_hand::Field> all;
    for (std::size_t i = 0; i < fields; ++i)
      all.push_back(by_hand::field("f" + std::to_string(i), 1, i));
    if (fields > 1) all[1].name = "";
    const Hand hand({by_hand::structure("S", 20, all), by_hand::type(Kind::UInt, 1)});
    return why_of([&] { (void)hand.root()["no"]; });
  };
  const std::string begin = "lot: message: there is no field \"no\" (Invalid argument); there are ";
  const std::string most = "f0, _1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11";
  CHECK(why(0) == begin + "no fields");
  CHECK(why(1) == begin + "f0");
  CHECK(why(11) == begin + most.substr(0, most.size() - 5));
  CHECK(why(12) == begin + most);
  CHECK(why(13) == begin + most + " and 1 more");
  CHECK(why(15) == begin + most + " and 3 more");
}

TEST_CASE("a field is found by its name, or by its number where it has none") {
  std::vector<by_hand::Field> fields;
  for (std::size_t i = 0; i < 12; ++i) fields.push_back(by_hand::field("", 1, i));
  fields[3].name = "three";
  Hand hand({by_hand::structure("S", 12, fields), by_hand::type(Kind::UInt, 1)});
  for (unsigned i = 0; i < 12; ++i) hand.bytes[i] = static_cast<unsigned char>(100 + i);
  const Value root = hand.root();
  CHECK(root["_0"].as<int>() == 100);
  CHECK(root["_9"].as<int>() == 109);
  CHECK(root["_10"].as<int>() == 110);
  CHECK(root["_11"].as<int>() == 111);
  CHECK(root["three"].as<int>() == 103);
  for (const char* const name : {"", "_", "_12", "_01", "_00", "_010", "_1x", "_x", "_1.", "11",
                                 "x1", "x11", "_-1", "_99999999999999999999", "thre"}) {
    CAPTURE(name);
    CHECK(!root.has(name));
    CHECK(error_of([&] { (void)root[name]; }).first == EINVAL);
  }
  CHECK(root.has("_11"));
  CHECK(!root["_1"].has("_0"));
  CHECK(why_of([&] { (void)root[12]; }) ==
        "lot: message: it has 12 fields, and no field 12 (Invalid argument)");
  CHECK(root["three"].name() == "three");
  CHECK(root[11].path() == "_11");
  auto next = root.begin();
  for (int i = 0; i < 11; ++i) ++next;
  CHECK((*next).as<int>() == 111);
  ++next;
  CHECK(why_of([&] { (void)*next; }) ==
        "lot: message: an iterator is behind its last field (Invalid argument)");
}

TEST_CASE("a path has names and whole numbers, and its parts have names") {
  using by_hand::field;
  using by_hand::type;
  Hand hand({by_hand::structure("S", 8, {field("in", 1, 0), field("rows", 3, 4)}),
             by_hand::structure("In", 4, {field("a", 2, 0), field("b", 2, 1)}), type(Kind::UInt, 1),
             type(Kind::Array, 4, "", 2, 4)});
  for (unsigned i = 0; i < 8; ++i) hand.bytes[i] = static_cast<unsigned char>(i + 1);
  const Value root = hand.root();
  CHECK(root.at("in.b").as<int>() == 2);
  CHECK(root.at("rows[0]").as<int>() == 5);
  CHECK(root.at("rows[3]").as<int>() == 8);
  CHECK(root.at("in.b").name() == "b");
  CHECK(root.at("in.b").path() == "in.b");
  CHECK(root.at("rows[3]").name() == "[3]");
  const auto why = [&](const char* path) { return why_of([&] { (void)root.at(path); }); };
  const std::string advice = "\" (Invalid argument); a path looks like labels[2].name";
  CHECK(why("rows[1x]") == "lot: rows: there is no number in [ ], in the path at \"[1x]" + advice);
  CHECK(why("rows[]") == "lot: rows: there is no number in [ ], in the path at \"[]" + advice);
  CHECK(why("rows[1") == "lot: rows: a ] is missing, in the path at \"[1" + advice);
  CHECK(why("rows[1]x") == "lot: rows[1]: a . or [ is missing, in the path at \"x" + advice);
  CHECK(why("in..a") == "lot: in: a name is missing, in the path at \".a" + advice);
  CHECK(why("rows[4]") == "lot: rows: it has 4 elements, and no [4] (Invalid argument)");
  CHECK(why("in[0]") == "lot: in: it is a In, and has no elements (Invalid argument)");
  CHECK(root.at("in.a").size() == 0);
  CHECK(root["rows"].size() == 4);
  CHECK(why_of([&] { (void)root.as<int>(); }) ==
        "lot: message: it is a S, and no number (Invalid argument)");
  CHECK(why_of([&] { (void)root.as<std::string>(); }) ==
        "lot: message: it is a S, and no string (Invalid argument)");
}

TEST_CASE("bit-fields are read at each bound, and what lies outside of the struct is not") {
  const auto read = [](std::uint64_t size, std::uint64_t offset, std::uint32_t bits,
                       std::uint32_t bit, std::uint64_t of = 8, Kind kind = Kind::UInt) {
    Hand hand({by_hand::structure("S", size, {by_hand::field("f", 1, offset, bits, bit)}),
               by_hand::type(kind, of)});
    const unsigned char bytes[] = {0x81, 0x42, 0x24, 0x18, 0xff, 0x00, 0xa5, 0x5a, 0xc3};
    std::memcpy(hand.bytes, bytes, sizeof bytes);
    try {
      return std::to_string(hand.root()[0].as<std::uint64_t>());
    } catch (const lot::Error& e) {
      return std::string(e.what());
    }
  };
  const std::string outside =
      "lot: message: its description has a field outside of the struct (Bad message); "
      "end the process that writes into the segment where it should not";
  CHECK(read(1, 0, 1, 0) == "1");
  CHECK(read(1, 0, 1, 7) == "1");
  CHECK(read(1, 0, 2, 6) == "2");
  CHECK(read(1, 0, 8, 0) == "129");
  CHECK(read(1, 0, 8, 1) == outside);
  CHECK(read(1, 0, 2, 7) == outside);
  CHECK(read(2, 0, 2, 7) == "1");
  CHECK(read(2, 0, 9, 7) == "133");
  CHECK(read(2, 0, 10, 7) == outside);
  CHECK(read(2, 1, 8, 0) == "66");
  CHECK(read(2, 2, 1, 0) == outside);
  CHECK(read(2, 3, 1, 0) == outside);
  CHECK(read(3, 0, 1, 8) == outside);
  CHECK(read(8, 0, 64, 0) == std::to_string(0x5aa500ff18244281U));
  CHECK(read(9, 0, 64, 7) == std::to_string((0x5aa500ff18244281U >> 7) | (0xc3ULL << 57)));
  CHECK(read(8, 0, 64, 7) == outside);
  CHECK(read(16, 0, 65, 0) == outside);
  CHECK(read(8, 0, 0, 0) == std::to_string(0x5aa500ff18244281U));
  CHECK(read(8, 1, 0, 0) == outside);
  CHECK(read(7, 0, 0, 0) == outside);
  CHECK(read(9, 8, 0, 0, 1) == "195");
  CHECK(read(9, 9, 0, 0, 1) == outside);
}

TEST_CASE("a bit-field at the end of the segment is read, and none behind it") {
  Hand hand({by_hand::structure("S", 2, {by_hand::field("f", 1, 1, 8, 0)}),
             by_hand::type(Kind::UInt, 4)});
  hand.bytes[1] = 7;
  const Value value(hand.all, hand.bytes, hand.bytes, hand.bytes + 2);
  CHECK(value["f"].as<int>() == 7);
  const Value cut(hand.all, hand.bytes, hand.bytes, hand.bytes + 1);
  CHECK(why_of([&] { (void)cut["f"]; }) ==
        "lot: message: it lies outside of the segment (Bad message); "
        "end the process that writes into the segment where it should not");
  const Value before(hand.all, hand.bytes, hand.bytes + 1, hand.bytes + 3);
  CHECK(error_of([&] { (void)before.size(); }).first == EBADMSG);
}

TEST_CASE("what lies in a bit-field of a struct has no bits of its own") {
  Hand hand({by_hand::structure("S", 8, {by_hand::field("f", 1, 0, 3, 1)}),
             by_hand::structure("In", 8, {by_hand::field("g", 2, 0)}), by_hand::type(Kind::UInt, 8),
             by_hand::type(Kind::UInt, 1)});
  hand.put(0, 0x1ff);
  CHECK(hand.root()["f"]["g"].as<int>() == 0x1ff);
  hand.all.types[1] = by_hand::type(Kind::Array, 8, "", 3, 8);
  CHECK(hand.root()["f"][0].as<int>() == 0xff);
  CHECK(hand.root()["f"][1].as<int>() == 1);
}

TEST_CASE("numbers of other sizes than a machine has are not read") {
  using by_hand::type;
  for (const std::uint64_t size : {0U, 3U, 5U, 6U, 7U, 9U, 16U}) {
    const Hand hand({type(Kind::Int, size)});
    CHECK(why_of([&] { (void)hand.root().as<int>(); }) ==
          "lot: message: an integer of " + std::to_string(size) +
              " bytes is not read (Invalid argument)");
  }
  for (const std::uint64_t size : {0U, 2U, 3U, 10U, 15U, 17U}) {
    const Hand hand({type(Kind::Float, size)});
    CHECK(why_of([&] { (void)hand.root().as<double>(); }) ==
          "lot: message: a float of " + std::to_string(size) +
              " bytes is not read (Invalid argument)");
  }
  Hand hand({type(Kind::Int, 1)});
  hand.bytes[0] = 0xff;
  for (const auto& [kind, size, number] :
       {std::tuple(Kind::Int, 1, -1), std::tuple(Kind::Int, 2, 255), std::tuple(Kind::UInt, 1, 255),
        std::tuple(Kind::Char, 1, int{static_cast<char>(0xff)})}) {
    hand.all.types[0] = type(kind, static_cast<std::uint64_t>(size));
    CHECK(hand.root().as<int>() == number);
  }
}

TEST_CASE("an enum, a duration and a time point are of their number's size, three levels deep") {
  using by_hand::type;
  Hand hand({type(Kind::Enum, 4, "E", 1), type(Kind::Enum, 4, "E", 2), type(Kind::Enum, 4, "E", 3),
             type(Kind::Int, 4), type(Kind::Enum, 4, "E", 0)});
  hand.bytes[0] = 5;
  CHECK(hand.root().as<int>() == 5);
  hand.all.types[2].element = 4;
  CHECK(why_of([&] { (void)hand.root().as<int>(); }) ==
        "lot: message: it is a E, and no number (Invalid argument)");
  hand.all.types[2].element = 3;
  hand.all.types.push_back(type(Kind::Int, 4));
  hand.all.types[3] = type(Kind::Enum, 4, "E", 5);
  CHECK(error_of([&] { (void)hand.root().as<int>(); }).first == EINVAL);
  hand.all.types[3] = type(Kind::Int, 8);
  CHECK(why_of([&] { (void)hand.root().as<int>(); }) ==
        "lot: message: its description is of another size (Bad message); "
        "end the process that writes into the segment where it should not");
  hand.all.types[2].element = 6;
  CHECK(why_of([&] { (void)hand.root().as<int>(); }) ==
        "lot: message: its description names a type that is not there (Bad message); "
        "end the process that writes into the segment where it should not");
}

TEST_CASE("a duration has a period, and only a time point has a clock") {
  Hand hand({by_hand::duration(8, 1, 1, 1000), by_hand::type(Kind::Int, 8)});
  hand.put(0, 3000);
  CHECK(hand.root().as<std::chrono::seconds>() == 3s);
  for (const auto& [numerator, denominator] :
       {std::pair(0, 1), std::pair(-1, 1), std::pair(1, 0), std::pair(1, -1), std::pair(-1, -1)}) {
    hand.all.types[0] = by_hand::duration(8, 1, numerator, denominator);
    CHECK(why_of([&] { (void)hand.root().as<std::chrono::seconds>(); }) ==
          "lot: message: its description has no period (Bad message); "
          "end the process that writes into the segment where it should not");
  }
  hand.all.types[0] = by_hand::duration(8, 1, 1, 1);
  hand.all.types[0].name = "system_clock";
  CHECK(why_of([&] { (void)hand.root().as<std::chrono::system_clock::time_point>(); }) ==
        "lot: message: it is a duration, and no time point of system_clock (Invalid argument)");
  CHECK(hand.root().as<std::chrono::seconds>() == 3000s);
}

TEST_CASE("an array has no more elements than fit, and a vector elements with a size") {
  using by_hand::type;
  const std::string more =
      "lot: message: its description has more elements than fit (Bad message); "
      "end the process that writes into the segment where it should not";
  Hand hand({type(Kind::Array, 8, "", 1, 4), type(Kind::UInt, 2)});
  CHECK(hand.root().size() == 4);
  hand.all.types[0].size = 9;
  CHECK(hand.root().size() == 4);
  hand.all.types[0].size = 7;
  CHECK(why_of([&] { (void)hand.root().size(); }) == more);
  hand.all.types[0] = type(Kind::Array, 8, "", 1, 5);
  CHECK(why_of([&] { (void)hand.root().size(); }) == more);
  hand.all.types[1].size = 0;
  hand.all.types[0].count = 0;
  CHECK(why_of([&] { (void)hand.root().size(); }) == more);

  hand.all.types = {type(Kind::Vector, 32, "libstdc++", 1), type(Kind::UInt, 2)};
  hand.put(8, 64 - 8);
  hand.put(16, 70 - 16);
  CHECK(hand.root().size() == 3);
  hand.put(16, 71 - 16);
  CHECK(names(why_of([&] { (void)hand.root().size(); }), "its last element is not whole"));
  hand.put(16, 62 - 16);
  CHECK(names(why_of([&] { (void)hand.root().size(); }), "it ends before it begins"));
  hand.put(8, 256 - 8);
  hand.put(16, 256 - 16);
  CHECK(hand.root().size() == 0);  // at the end of the segment
  hand.put(16, 257 - 16);
  CHECK(names(why_of([&] { (void)hand.root().size(); }), "it leads out of the segment"));
  hand.put(8, lot::description::kNull);
  hand.put(16, lot::description::kNull);
  CHECK(hand.root().size() == 0);
  hand.all.types[1].size = 0;
  CHECK(names(why_of([&] { (void)hand.root().size(); }),
              "its description has elements without a size"));
  hand.all.types[1].size = 2;
  for (const std::uint64_t size : {24U, 31U, 33U, 40U}) {
    hand.all.types[0].size = size;
    CHECK(why_of([&] { (void)hand.root().size(); }) ==
          "lot: message: it is a vector of another library: libstdc++ (Invalid argument)");
  }
}

TEST_CASE("a reference leads to its target, which has the size and the path of what it is") {
  using by_hand::type;
  Hand hand({by_hand::structure("S", 32, {by_hand::field("to", 1, 0)}),
             type(Kind::Reference, 32, "", 2), type(Kind::Array, 4, "", 3, 4),
             type(Kind::UInt, 1)});
  hand.put(8, 64 - 8);
  hand.bytes[66] = 9;
  const Value to = hand.root()["to"];
  CHECK(to.size() == 4);
  CHECK(to[2].as<int>() == 9);
  CHECK(to[2].path() == "to[2]");
  CHECK(to.target().path() == "to");
  CHECK(!to.is_null());
  CHECK(to.target().address() == hand.bytes + 64);
  CHECK(!hand.root().is_null());
  hand.put(8, lot::description::kNull);
  CHECK(to.is_null());
  CHECK(!hand.root().is_null());
  CHECK(why_of([&] { (void)to.target(); }) == "lot: to: it refers to nothing (Invalid argument)");
  hand.all.types[1].size = 24;
  CHECK(!to.is_null());
  CHECK(why_of([&] { (void)to.target(); }) ==
        "lot: to: its description is of another size (Bad message); "
        "end the process that writes into the segment where it should not");
  // One that leads to itself.
  hand.all.types = {type(Kind::Reference, 32, "", 0)};
  hand.put(8, std::uint64_t{0} - 8);
  const auto [error, text] = error_of([&] { (void)hand.root().target(); });
  CHECK(error == ELOOP);
  CHECK(text ==
        "lot: message: what it holds lies more than 64 levels deep (Too many levels of "
        "symbolic links)");
}

TEST_CASE("strings have the size of their library's") {
  using by_hand::type;
  Hand hand({type(Kind::String, 40, "libstdc++")});
  hand.put(8, 64 - 8);
  hand.put(16, 5);
  std::memcpy(hand.bytes + 64, "hello", 5);
  CHECK(hand.root().as<std::string>() == "hello");
  CHECK(hand.root().bytes().size() == 5);
  const std::string outside =
      "lot: message: its text does not lie in the segment (Bad message); "
      "end the process that writes into the segment where it should not";
  hand.put(16, 256 - 64);
  CHECK(hand.root().size() == 192);
  hand.put(16, 256 - 63);
  CHECK(why_of([&] { (void)hand.root().size(); }) == outside);
  hand.put(8, lot::description::kNull);
  hand.put(16, 0);
  CHECK(why_of([&] { (void)hand.root().size(); }) == outside);
  for (const auto& [name, size] :
       {std::pair("libstdc++", 32), std::pair("libc++", 40), std::pair("libstdc++", 41),
        std::pair("other", 40), std::pair("other", 32)}) {
    hand.all.types[0] = type(Kind::String, static_cast<std::uint64_t>(size), name);
    CHECK(why_of([&] { (void)hand.root().size(); }) ==
          "lot: message: it is a string of another library: " + std::string(name) +
              " (Invalid argument)");
  }
}

TEST_CASE("bytes are there of what lies in one piece, and is aligned") {
  using by_hand::field;
  using by_hand::type;
  const auto why = [](const std::vector<by_hand::Type>& types) {
    return why_of([&] { (void)Hand(types).root().bytes(); });
  };
  const by_hand::Type s = by_hand::structure("S", 80, {field("n", 2, 0), field("a", 1, 8)});
  const by_hand::Type byte = type(Kind::UInt, 1);
  const std::string refused =
      "lot: message: a S does not lie in one piece (Invalid argument); look at its parts";
  CHECK(why({s, byte, byte}) == "no error");
  CHECK(why({s, type(Kind::Bool, 1), byte}) == "no error");
  CHECK(why({s, type(Kind::Opaque, 4), byte}) == "no error");
  CHECK(why({s, type(Kind::Array, 4, "", 2, 4), byte}) == "no error");
  CHECK(why({s, type(Kind::Struct, 80, "T"), byte}) == "no error");
  for (const Kind kind : {Kind::String, Kind::Vector, Kind::Reference}) {
    CHECK(why({s, type(kind, 32, "libc++", 2), byte}) == refused);
    CHECK(why({s, type(Kind::Array, 64, "", 3, 2), byte, type(kind, 32, "libc++", 2)}) == refused);
  }
  CHECK(why({by_hand::structure("S", 8, {field("n", 0, 0)})}) == "no error");  // has itself
  CHECK(why({by_hand::structure("S", 8, {field("n", 9, 0)})}) ==
        "lot: message: its description names a type that is not there (Bad message); "
        "end the process that writes into the segment where it should not");
  Hand bits({by_hand::structure("S", 8, {field("n", 1, 0, 3, 0)}), byte});
  CHECK(why_of([&] { (void)bits.root()["n"].bytes(); }) ==
        "lot: n: a uint8 does not lie in one piece (Invalid argument); look at its parts");

  const auto at = [](std::uint64_t begin, std::uint64_t bytes,
                     const std::vector<by_hand::Type>& elements) {
    std::vector<by_hand::Type> types = {type(Kind::Vector, 32, "libc++", 1)};
    types.insert(types.end(), elements.begin(), elements.end());
    Hand hand(types);
    hand.put(0, begin);
    hand.put(8, begin + bytes - 8);
    return why_of([&] { CHECK(hand.root().bytes().size() == bytes); });
  };
  const std::string crooked =
      "lot: message: its elements are not aligned (Bad message); "
      "end the process that writes into the segment where it should not";
  CHECK(at(64, 8, {type(Kind::UInt, 4)}) == "no error");
  CHECK(at(68, 8, {type(Kind::UInt, 4)}) == "no error");
  CHECK(at(66, 8, {type(Kind::UInt, 4)}) == crooked);
  CHECK(at(65, 8, {type(Kind::UInt, 4)}) == crooked);
  CHECK(at(65, 8, {type(Kind::UInt, 1)}) == "no error");
  CHECK(at(66, 12, {type(Kind::UInt, 6)}) == "no error");
  CHECK(at(65, 12, {type(Kind::UInt, 6)}) == crooked);
  CHECK(at(65, 8, {type(Kind::Struct, 8, "S")}) == "no error");
  CHECK(at(65, 8, {type(Kind::Array, 8, "", 2, 8), type(Kind::UInt, 1)}) == "no error");
  CHECK(at(65, 8, {type(Kind::Array, 8, "", 2, 4), type(Kind::UInt, 2)}) == crooked);
  CHECK(at(66, 8, {type(Kind::Array, 8, "", 2, 4), type(Kind::UInt, 2)}) == "no error");
  CHECK(at(66, 8, {type(Kind::Array, 8, "", 1, 1)}) ==
        "lot: message: its description has no end (Bad message); "
        "end the process that writes into the segment where it should not");
  for (const std::uint32_t levels : {63U, 64U, 65U}) {
    std::vector<by_hand::Type> deep;
    for (std::uint32_t i = 0; i < levels; ++i) deep.push_back(type(Kind::Array, 8, "", i + 2, 1));
    deep.push_back(type(Kind::UInt, 8));
    CHECK(names(at(64, 8, deep), levels > 64 ? "has no end" : "no error"));
  }
}

TEST_CASE("a char is as signed as the machine's, also in bits") {
  Hand hand(
      {by_hand::structure("S", 2, {by_hand::field("c", 1, 0), by_hand::field("b", 1, 1, 4, 0)}),
       by_hand::type(Kind::Char, 1)});
  hand.bytes[0] = 0x80;
  hand.bytes[1] = 0xf8;
  CHECK(hand.root()["c"].as<int>() == (std::numeric_limits<char>::is_signed ? -128 : 128));
  CHECK(hand.root()["b"].as<int>() == (std::numeric_limits<char>::is_signed ? -8 : 8));
}

}  // namespace
