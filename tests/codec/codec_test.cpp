// SPDX-License-Identifier: Apache-2.0

// Messages as CDR and back: bytes by hand, each kind there and back, and what is refused.

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "codec/carried.hpp"
#include "codec/decode.hpp"
#include "codec/encode.hpp"
#include "codec/random_types.hpp"
#include "codec/schema.hpp"
#include "description/readable.hpp"
#include "support/error_of.hpp"
#include "support/seed.hpp"

using lot::Description;
using lot::Kind;
using lot::codec::Encoded;
using lot::codec::Program;
using lot::testing::bytes_of;
using lot::testing::Cloud;
using lot::testing::error_of;
using lot::testing::Flags;
using lot::testing::Heap;
using lot::testing::joined;
using lot::testing::list_of_values;
using lot::testing::names;
using lot::testing::Plain;
using namespace std::string_literals;

namespace {

struct Nested {
  struct Empty {
  } empty;
  Flags flags;
  std::uint16_t grid[2][3];
  lot::ShmVector<lot::ShmVector<std::uint8_t>> rows;
  std::chrono::milliseconds span;
  readable::Colour colour;
  lot::ShmVector<lot::ShmString> texts;
};

struct Image {
  std::uint32_t width;
  lot::ShmString encoding;
  lot::ShmVector<std::uint8_t> data;
  std::array<bool, 1 << 17> mask;
};
/// Numbers of several sizes without a gap.
struct Mixed {
  std::uint64_t a;
  std::uint32_t b;
  std::uint16_t c, d;
};
struct Mixes {
  lot::ShmVector<Mixed> points;
  std::array<std::uint64_t, 1 << 14> numbers;
  std::uint32_t last;
};
struct ThreeBits {
  std::uint8_t low : 3;
};
struct Arrays {
  std::array<lot::ShmString, 2> texts;
  std::array<ThreeBits, 3> bits;
};
struct Bools {
  bool one;
  std::array<bool, 3> more;
};

/// A message of a type in memory of this process.
template <class T>
struct Made {
  explicit Made(std::size_t bytes = 1 << 20)
      : heap(bytes), message(heap.make(lot::describe<T>())) {}
  Heap heap;
  lot::MutableValue message;
  Program program{lot::describe<T>()};

  const T& typed() const { return *static_cast<const T*>(message.value().address()); }
  T& raw() { return const_cast<T&>(typed()); }
};

std::string encoded(const Program& program, const lot::Value& message) {
  Encoded bytes;
  encode(program, message, bytes);
  std::string all = joined(bytes.pieces());
  CHECK(all.size() == bytes.size());
  return all;
}

template <class T>
std::pair<int, std::string> refusal() {
  return error_of([] { Program program(lot::describe<T>()); });
}

Plain* fill_plain(const lot::MutableValue& plain) {
  plain["a"].set(1);
  plain["b"].set(-2);
  plain["c"].set(true);
  plain["d"].set(1.5);
  plain["s"].set("hi");
  plain["v"].resize(2);
  plain.at("v[0]").set(3);
  plain.at("v[1]").set(4);
  plain["e"].set(5);
  return static_cast<Plain*>(const_cast<void*>(plain.value().address()));
}

const std::string kGolden =
    "\x00\x01\x00\x00"                  // XCDR1, little-endian
    "\x01\x00\xfe\xff\x01\x00\x00\x00"  // a, a byte between, b, c, three bytes between
    "\x00\x00\x00\x00\x00\x00\xf8\x3f"  // d
    "\x03\x00\x00\x00hi\x00\x00"        // s, a byte between
    "\x02\x00\x00\x00\x03\x00\x04\x00"  // v
    "\x05"s;                            // e

}  // namespace

TEST_CASE("the bytes of a message are those that the encoding says") {
  Made<Plain> made;
  fill_plain(made.message);
  CHECK(encoded(made.program, made.message) == kGolden);
  Made<Plain> other;
  decode(other.program, bytes_of(kGolden), other.message);
  CHECK(list_of_values(other.message) == list_of_values(made.message));
  CHECK(other.typed().s == "hi");
  CHECK(other.typed().v.size() == 2);
  CHECK(other.typed().e == 5);
}

TEST_CASE("a head may have options, and up to three bytes may follow") {
  Made<Plain> made;
  std::string bytes = kGolden;
  bytes[3] = 3;
  decode(made.program, bytes_of(bytes + "\1\2\3"s), made.message);
  CHECK(error_of([&] { decode(made.program, bytes_of(kGolden + "1234"s), made.message); }).first ==
        EBADMSG);
  bytes[1] = 0;
  CHECK(error_of([&] { decode(made.program, bytes_of(bytes), made.message); }).first == ENOTSUP);
  CHECK(error_of([&] { decode(made.program, {}, made.message); }).first == EBADMSG);
}

TEST_CASE("fields side by side are copied at once where the position allows it, or one by one") {
  for (std::size_t length = 0; length < 9; ++length) {
    Made<Cloud> made;
    made.message["name"].set(std::string(length, 'n'));
    made.message["points"].resize(3);
    lot::testing::RandomValues random_values = [] {
      static std::mt19937_64 random(lot::testing::seed());
      return lot::testing::RandomValues(random);
    }();
    for (const char* const part : {"first", "pair", "points[0]", "points[1]", "points[2]"}) {
      random_values.fill(made.message.at(part));
    }
    const std::string bytes = encoded(made.program, made.message);
    // the text, then x at a multiple of 4, z at one of 8, and so on: six of these
    std::size_t end = 4 + length + 1;
    for (int i = 0; i < 6; ++i) {
      if (i == 3) end = (end + 3) / 4 * 4 + 4;
      end = ((end + 3) / 4 * 4 + 8 + 7) / 8 * 8 + 8;
    }
    CHECK(bytes.size() == 4 + end);
    Made<Cloud> other;
    decode(other.program, bytes_of(bytes), other.message);
    CHECK(list_of_values(other.message) == list_of_values(made.message));
  }
}

TEST_CASE("empty structs, bit-fields, arrays in arrays, vectors in vectors, times, enums") {
  Made<Nested> made;
  made.message["flags"][0].set(5);
  made.message["flags"][1].set(-200);
  made.message.at("grid[1][2]").set(77);
  made.message["rows"].resize(2);
  made.message.at("rows[1]").resize(1);
  made.message.at("rows[1][0]").set(9);
  made.message["span"].set(std::chrono::seconds(-2));
  made.message["colour"].set(readable::Colour::Red);
  made.message["texts"].resize(1);
  const std::string expected =
      "\x00\x01\x00\x00"
      "\x00\x00\x05\x00\x38\xff"                          // empty, low, high: -200
      "\0\0\0\0\0\0\0\0\0\0\x4d\x00"                      // grid
      "\0\0\x02\x00\x00\x00\0\0\0\0\x01\x00\x00\x00\x09"  // rows
      "\0\0\0\0\0\0\0"
      "\x30\xf8\xff\xff\xff\xff\xff\xff"                    // span: -2000
      "\x07\x00\0\0\x01\x00\x00\x00\x01\x00\x00\x00\x00"s;  // colour, texts
  CHECK(encoded(made.program, made.message) == expected);
  Made<Nested> other;
  decode(other.program, bytes_of(expected), other.message);
  CHECK(list_of_values(other.message) == list_of_values(made.message));
  std::string wide = expected;
  wide[7] = 1;  // 261 in three bits
  CHECK(error_of([&] { decode(other.program, bytes_of(wide), other.message); }).first == ERANGE);
}

TEST_CASE("an array has no count before its texts, nor before its bit-fields") {
  Made<Arrays> made;
  made.message.at("texts[0]").set("a");
  for (std::size_t i = 0; i < 3; ++i) made.message["bits"][i][std::size_t{0}].set(i + 1);
  const std::string expected =
      "\x00\x01\x00\x00"
      "\x02\x00\x00\x00"
      "a\x00\0\0"
      "\x01\x00\x00\x00\x00"
      "\x01\x02\x03"s;
  CHECK(encoded(made.program, made.message) == expected);
  Made<Arrays> other;
  decode(other.program, bytes_of(expected), other.message);
  CHECK(list_of_values(other.message) == list_of_values(made.message));
}

TEST_CASE("what ROS 2 does not have is refused when a type is compiled, by its path") {
  const std::pair<int, std::string> reference = refusal<readable::Chain>();
  CHECK(reference.first == EINVAL);
  CHECK(names(reference.second, "lot: next: it leads to another message"));
  CHECK(names(refusal<readable::HasSecret>().second, "lot: secret: a "));
  CHECK(names(refusal<readable::Tree>().second,
              "lot: branches[]: readable::Tree lies within itself"));
  CHECK(
      names(refusal<readable::Everything>().second, "lot: real: ROS 2 has no number of 16 bytes"));
  Description forged = lot::describe<Bools>();
  forged.types[0].fields[1].offset = 0;
  CHECK(names(error_of([&] { Program program(forged); }).second, "share bytes"));
  forged.types[0].fields[1].offset = 2;
  CHECK(names(error_of([&] { Program program(forged); }).second, "outside of the struct"));
  CHECK(error_of([] { Program program{Description()}; }).first == EBADMSG);
}

TEST_CASE("a message of another description is refused") {
  Made<Plain> made;
  Made<Image> other;
  CHECK(error_of([&] { (void)encoded(made.program, other.message); }).first == EINVAL);
  CHECK(error_of([&] { decode(made.program, bytes_of(kGolden), other.message); }).first == EINVAL);
  CHECK(error_of([&] { (void)encoded(made.program, made.message["s"]); }).first == EINVAL);
}

TEST_CASE("bytes that end early are an error, wherever they are cut") {
  Made<Plain> made;
  for (std::size_t size = 0; size < kGolden.size(); ++size) {
    const std::string cut =
        kGolden.substr(0, size);  // with no byte behind it, for AddressSanitizer
    CHECK(error_of([&] { decode(made.program, bytes_of(cut), made.message); }).first == EBADMSG);
  }
}

TEST_CASE("a forged count is refused before memory is taken") {
  Made<Plain> made;
  for (const std::size_t at : {20U, 28U}) {  // of s, and of v
    for (const char* const count : {"\xff\xff\xff\xff", "\x00\x00\x00\x80", "\x40\x00\x00\x01"}) {
      std::string bytes = kGolden;
      bytes.replace(at, 4, count, 4);
      const std::size_t before = made.heap.used();
      CHECK(error_of([&] { decode(made.program, bytes_of(bytes), made.message); }).first ==
            EBADMSG);
      CHECK(made.heap.used() - before <= bytes.size());
    }
  }
}

TEST_CASE("a text ends with a zero, and may have others in it") {
  Made<Plain> made;
  std::string bytes = kGolden;
  bytes[26] = 'x';
  CHECK(names(error_of([&] { decode(made.program, bytes_of(bytes), made.message); }).second,
              "lot: s: its text does not end with a zero byte"));
  bytes = kGolden;
  bytes[24] = '\0';
  decode(made.program, bytes_of(bytes), made.message);
  CHECK(made.typed().s == std::string_view("\0i", 2));
  CHECK(encoded(made.program, made.message) == bytes);
}

TEST_CASE("a text without any byte is empty") {
  Made<Plain> made;
  const std::string bytes = kGolden.substr(0, 20) + "\0\0\0\0\0\0\0\0\x05"s;
  decode(made.program, bytes_of(bytes), made.message);
  CHECK(made.typed().s.empty());
  CHECK(made.typed().v.empty());
  CHECK(made.typed().e == 5);
}

TEST_CASE("a bool that is neither 0 nor 1 is refused, both ways") {
  Made<Bools> made;
  const std::string good = "\x00\x01\x00\x00\x01\x00\x01\x01"s;
  decode(made.program, bytes_of(good), made.message);
  CHECK(made.typed().one);
  CHECK(!made.typed().more[0]);
  for (std::size_t at = 4; at < good.size(); ++at) {
    std::string bytes = good;
    bytes[at] = 2;
    CHECK(error_of([&] { decode(made.program, bytes_of(bytes), made.message); }).first == EBADMSG);
  }
  std::memset(static_cast<void*>(&made.raw().more[2]), 0xff, 1);
  CHECK(
      names(error_of([&] { (void)encoded(made.program, made.message); }).second, "a bool is 255"));
}

TEST_CASE("a damaged message is an error, as for a Value") {
  Made<Plain> made;
  Plain* const plain = fill_plain(made.message);
  auto* const words = reinterpret_cast<std::uint64_t*>(&plain->v);
  const std::uint64_t end = std::exchange(words[2], std::uint64_t{1} << 40);
  CHECK(error_of([&] { (void)encoded(made.program, made.message); }).first == EBADMSG);
  words[2] = end;
  CHECK(encoded(made.program, made.message) == kGolden);
  Encoded small(Encoded::kCopyAll, kGolden.size() - 1);
  CHECK(error_of([&] { encode(made.program, made.message, small); }).first == EMSGSIZE);
  Encoded enough(Encoded::kCopyAll, kGolden.size());
  encode(made.program, made.message, enough);
}

TEST_CASE("what is large stays in the message, and bools do not") {
  Made<Image> made(8 << 20);
  made.message["encoding"].set("rgb8");
  made.message["data"].resize(3 << 20);
  Encoded whole;
  Encoded parts(64 << 10);
  for (int i = 0; i < 2; ++i) {  // the second time in memory that is there
    encode(made.program, made.message, whole);
    encode(made.program, made.message, parts);
  }
  REQUIRE(whole.pieces().size() == 1);
  const auto pieces = parts.pieces();
  REQUIRE(pieces.size() == 3);
  CHECK(pieces[1].data() == reinterpret_cast<const std::byte*>(made.typed().data.data()));
  CHECK(pieces[1].size() == 3 << 20);
  CHECK(joined(pieces) == joined(whole.pieces()));
  CHECK(parts.size() == whole.size());
  Made<Image> other(8 << 20);
  const std::string bytes = joined(pieces);
  decode(other.program, bytes_of(bytes), other.message);
  CHECK(encoded(other.program, other.message) == bytes);
}

TEST_CASE("numbers of several sizes without a gap are one piece, which stays in the message") {
  Made<Mixes> made(8 << 20);
  for (const std::size_t count : {std::size_t{1} << 14, std::size_t{0}}) {
    made.message["points"].resize(count);
    Encoded parts(64 << 10);
    encode(made.program, made.message, parts);
    const Mixes& typed = made.typed();
    std::vector<std::pair<const void*, std::size_t>> large;
    for (const auto piece : parts.pieces()) {
      if (piece.size() >= 64 << 10) large.emplace_back(piece.data(), piece.size());
    }
    std::vector<std::pair<const void*, std::size_t>> expected;
    if (count != 0) expected.emplace_back(typed.points.data(), count * sizeof(Mixed));
    expected.emplace_back(typed.numbers.data(), sizeof(typed.numbers) + sizeof(typed.last));
    CHECK(large == expected);
  }
}

TEST_CASE("types and values by chance come back as they were") {
  std::mt19937_64 random(lot::testing::seed());
  Heap heap(4 << 20);
  for (int i = 0; i < 300; ++i) {
    heap.clear();
    const Description type = lot::testing::RandomType(random, "t").take();
    CAPTURE(lot::codec::schema_of(type).msg);
    const Program program(type);
    const lot::MutableValue message = heap.make(type);
    lot::testing::RandomValues(random).fill(message);
    const std::string bytes = encoded(program, message);
    const lot::MutableValue other = heap.make(type);
    decode(program, bytes_of(bytes), other);
    CHECK(list_of_values(other) == list_of_values(message));
    CHECK(encoded(program, other) == bytes);
    const std::string cut = bytes.substr(0, random() % bytes.size());
    CHECK(error_of([&] { decode(program, bytes_of(cut), other); }).first == EBADMSG);
  }
}

TEST_CASE("the schema of a type is its text as .msg and as IDL") {
  const lot::codec::Schema schema = lot::codec::schema_of(lot::describe<readable::Label>());
  CHECK(schema.name == "readable/msg/Label");
  CHECK(schema.msg == "string name\nfloat32 score\nstring[2] notes\n");
  CHECK(schema.idl ==
        "module readable {\nmodule msg {\nstruct Label {\n  string name;\n  float score;\n"
        "  string notes[2];\n};\n};\n};\n");
  const lot::codec::Schema nested = lot::codec::schema_of(lot::describe<Nested>());
  CHECK(names(nested.msg, "uint16[6] grid\n"));
  CHECK(names(nested.msg, "lot/Items[] rows\n"));
  CHECK(names(nested.msg, "MSG: lot/Items\nuint8[] items\n"));
  CHECK(names(nested.msg, "int64 span  # unit: 1/1000 s\n"));
  CHECK(names(nested.msg, "int16 colour  # readable::Colour\n"));
  CHECK(names(nested.msg, "uint16 field_0\nint16 field_1\n"));
  CHECK(names(nested.msg, "uint8 structure_needs_at_least_one_member\n"));
  CHECK(lot::codec::schema_of(lot::describe<lot::ShmString>()).msg == "string data\n");
  CHECK(lot::codec::schema_of(lot::describe<std::pair<std::uint8_t, double>>()).name ==
        "std/msg/PairUnsignedCharDouble");
  Description renamed = lot::describe<readable::Label>();
  renamed.types[0].name = "Acme/3DLabel";  // a package has no capitals, a name begins with a letter
  CHECK(lot::codec::schema_of(renamed).name == "acme/msg/DLabel");
}

TEST_CASE("ROS 1's header has no seq, and its time is ROS 2's") {
  struct Time {
    std::uint32_t sec, nsec;
  };
  struct Header {
    std::uint32_t seq;
    Time stamp;
    lot::ShmString frame_id;
  };
  Description type = lot::describe<Header>();
  type.types[0].name = "std_msgs/Header";
  for (Description::Type& one : type.types) {
    if (one.fields.size() == 2) one.name = "time";
  }
  const lot::codec::Schema schema = lot::codec::schema_of(type);
  CHECK(schema.name == "std_msgs/msg/Header");
  CHECK(schema.msg == "builtin_interfaces/Time stamp\nstring frame_id\n" + std::string(80, '=') +
                          "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n");
  Heap heap(4096);
  const Program program(type);
  const lot::MutableValue message = heap.make(type);
  const std::string bytes =
      "\x00\x01\x00\x00\x07\x00\x00\x00\x08\x00\x00\x00\x02\x00\x00\x00m\x00"s;
  message["seq"].set(9);
  decode(program, bytes_of(bytes), message);
  CHECK(message.value()["seq"].as<int>() == 0);
  CHECK(message.value().at("stamp.sec").as<int>() == 7);
  CHECK(message.value()["frame_id"].as<std::string>() == "m");
  message["seq"].set(9);
  CHECK(encoded(program, message) == bytes);
}

TEST_CASE("bytes become a message that is loaned, which the type's own code reads") {
  const readable::Place place;
  lot::ShmEngine engine(place.options);
  auto seen = engine.subscribe<Plain>("/golden");
  auto typed = engine.advertise<Plain>("/golden");
  const lot::AnyType type = engine.type_of("/golden");
  auto pusher = engine.advertise_any("/golden", type);
  const Program program(type.description());
  lot::AnyLoan loan = pusher.loan();
  decode(program, bytes_of(kGolden), loan.root());
  REQUIRE(pusher.push(std::move(loan)) == lot::Status::Ok);
  const auto golden = seen.try_pull();
  REQUIRE(golden);
  CHECK(golden->d == 1.5);
  CHECK(golden->v[1] == 4);
  const lot::AnyMessage message = golden;
  const Program again(message.type().description());
  CHECK(encoded(again, message.root()) == kGolden);
}
