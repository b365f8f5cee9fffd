// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <atomic>
#include <chrono>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/boost_containers.hpp>
#include <lot/describe.hpp>
#include <lot/lot.hpp>

#include "by_hand.hpp"
#include "described.hpp"
#include "description/wire.hpp"

using lot::Description;
using lot::Kind;

namespace named {

struct Said {
  int left, right;
};
LOT_DESCRIBE(Said, left, right);

enum class Colour : std::uint16_t { Red };
enum Plain { kNone };

class Secret {
 public:
  int get() const { return value_; }

 private:
  int value_ = 0;
};

struct Empty {};
struct Bits {
  std::uint8_t low : 3;
  std::uint8_t high : 5;
  int whole;
  unsigned wide : 20;
  bool flag : 1;
  Colour colour : 4;
  std::uint8_t last;
};
struct OtherBits {
  std::uint8_t low : 5;
  std::uint8_t high : 3;
  int whole;
  unsigned wide : 20;
  bool flag : 1;
  Colour colour : 4;
  std::uint8_t last;
};
struct Sample {
  std::int16_t first;
  float second;
};
/// The same bytes twice: of the first g++ hands out fields as copies, of the second none.
#define LOT_TEST_PACKED_FIELDS \
  std::uint8_t id;             \
  double x;                    \
  Sample sample;               \
  std::int32_t n;              \
  long double real;            \
  Sample two[2];               \
  Colour colour;               \
  unsigned few : 5;            \
  unsigned rest : 27;          \
  unsigned all : 32;           \
  std::int64_t last;
struct __attribute__((packed)) Packed {
  LOT_TEST_PACKED_FIELDS
};
#pragma pack(push, 1)
struct ByPragma {
  LOT_TEST_PACKED_FIELDS
};
#pragma pack(pop)
#undef LOT_TEST_PACKED_FIELDS
struct BitsBeforeNothing {
  std::uint8_t low : 3;
  [[no_unique_address]] Empty nothing;
  std::uint8_t last;
};
struct BitsInEmptiness {
  unsigned first : 3;
  [[no_unique_address]] Empty nothing;
  [[no_unique_address]] Empty more;
  unsigned second : 3;
  std::uint32_t last;
};
struct __attribute__((packed)) RealBehindBits {
  unsigned few : 5;
  long double real;
  std::array<Sample, 2> two;
};
struct Volatile {
  volatile int changing;
  volatile float too;
  std::array<int, 0> none;
  int last;
};
/// Too large to be copied onto a stack.
struct __attribute__((packed)) PackedPicture {
  std::uint8_t id;
  float pixels[1 << 20];
};
/// No message, but a part of one.
class Shape {
 public:
  virtual ~Shape() = default;
};
struct RefersToShape {
  lot::ShmRef<const Shape> shape;
};
struct BitsBehindNothing {
  [[no_unique_address]] Empty nothing;
  std::uint8_t low : 3;
  [[no_unique_address]] Empty more;
  std::uint8_t last;
};
struct Tree {
  int value;
  lot::ShmVector<Tree> branches;
};
struct Chain {
  lot::ShmRef<Chain> next;
  int value;
};

/// Types with names of their own: shared ones.
struct Shared {
  int value;
};
enum class SharedColour : std::uint8_t { Red };
class SharedSecret {
 public:
  int get() const { return value_; }

 private:
  int value_ = 0;
};
using SharedMap = lot::ShmMap<std::uint16_t, std::uint16_t>;
struct HasShared {
  Shared part;
  SharedColour colour;
  SharedSecret secret;
  SharedMap map;
};
/// Stands before the names: what a function uses counts by what is specialised behind it, too.
inline const Description& describe_shared() { return lot::describe<HasShared>(); }

}  // namespace named

template <>
struct lot::is_trusted_message<named::Secret> : std::true_type {};
template <>
struct lot::is_trusted_message<named::SharedSecret> : std::true_type {};
#define LOT_NAMED(Type, text)                           \
  template <>                                           \
  struct lot::TypeIdentity<Type> {                      \
    static const char* name() { return text; }          \
    static constexpr std::uint64_t hash() { return 0; } \
  }
LOT_NAMED(named::Shared, "shared/Part");
LOT_NAMED(named::SharedColour, "shared/Colour");
LOT_NAMED(named::SharedSecret, "shared/Secret");
LOT_NAMED(named::SharedMap, "shared/Map");
LOT_NAMED(named::HasShared, "shared/Whole");

namespace {

/// The type of that field of the message's own type.
const Description::Type& field_type(const Description& all, std::size_t i) {
  return all.types.at(all.root().fields.at(i).type);
}
const Description::Type& element(const Description& all, const Description::Type& type) {
  return all.types.at(type.element);
}

template <class T>
Kind kind_of() {
  return lot::describe<T>().root().kind;
}

/// The layout and the names of two types are alike.
template <class A, class B>
std::pair<bool, bool> alike() {
  const Description& a = lot::describe<A>();
  const Description& b = lot::describe<B>();
  return {a.layout_hash() == b.layout_hash(), a.names_hash() == b.names_hash()};
}
constexpr std::pair kBoth{true, true};
constexpr std::pair kNeither{false, false};
constexpr std::pair kLayoutOnly{true, false};
constexpr std::pair kNamesOnly{false, true};

TEST_CASE("a description has the kind and the size of a number") {
  CHECK(kind_of<bool>() == Kind::Bool);
  CHECK(kind_of<char>() == Kind::Char);
  CHECK(kind_of<signed char>() == Kind::Int);
  CHECK(kind_of<std::int64_t>() == Kind::Int);
  CHECK(kind_of<unsigned char>() == Kind::UInt);
  CHECK(kind_of<std::byte>() == Kind::UInt);
  CHECK(kind_of<char32_t>() == Kind::UInt);
  CHECK(kind_of<float>() == Kind::Float);
  CHECK(kind_of<double>() == Kind::Float);
  CHECK(lot::describe<std::int16_t>().root().size == 2);
  CHECK(lot::describe<double>().root().size == 8);
}

TEST_CASE("a description names the fields of a struct, and says where they lie") {
  struct Local {
    std::uint8_t first;
    std::uint64_t second;
    named::Empty third;
  };
  const Description& all = lot::describe<Local>();
  CHECK(all.root().kind == Kind::Struct);
  CHECK(all.root().size == sizeof(Local));
  REQUIRE(all.root().fields.size() == 3);
  CHECK(all.root().fields[0].name == "first");
  CHECK(all.root().fields[0].offset == offsetof(Local, first));
  CHECK(all.root().fields[1].name == "second");
  CHECK(all.root().fields[1].offset == offsetof(Local, second));
  CHECK(all.root().fields[1].bits == 0);
  CHECK(all.root().fields[2].name == "third");
  CHECK(field_type(all, 2).kind == Kind::Struct);
  CHECK(field_type(all, 2).fields.empty());
  CHECK(field_type(all, 2).name == "named::Empty");
}

TEST_CASE("a description tells enums, arrays, pairs, tuples, times and atomics") {
  struct Parts {
    named::Colour colour;
    named::Plain plain;
    int grid[2][3];
    std::array<std::byte, 5> bytes;
    std::pair<char, double> pair;
    std::tuple<std::uint8_t, std::uint32_t> tuple;
    std::complex<float> complex;
    std::chrono::milliseconds wait;
    std::chrono::system_clock::time_point at;
    std::atomic<std::uint32_t> counter;
  };
  const Description& all = lot::describe<Parts>();
  const auto& colour = field_type(all, 0);
  CHECK(colour.kind == Kind::Enum);
  CHECK(colour.name == "named::Colour");
  CHECK(element(all, colour).kind == Kind::UInt);
  CHECK(element(all, colour).size == 2);
  CHECK(element(all, field_type(all, 1)).size == 4);
  const auto& grid = field_type(all, 2);
  CHECK(grid.kind == Kind::Array);
  CHECK(grid.count == 2);
  CHECK(element(all, grid).count == 3);
  CHECK(element(all, element(all, grid)).kind == Kind::Int);
  CHECK(field_type(all, 3).count == 5);
  const auto& pair = field_type(all, 4);
  CHECK(pair.kind == Kind::Struct);
  CHECK(pair.fields.at(0).name == "first");
  CHECK(pair.fields.at(1).name == "second");
  CHECK(pair.fields.at(1).offset == 8);
  const std::tuple<std::uint8_t, std::uint32_t> tuple;
  const auto& fields = field_type(all, 5).fields;
  CHECK(fields.at(0).name == "0");
  for (std::size_t i = 0; i < 2; ++i) CHECK(fields[i].offset < sizeof tuple);
  CHECK(fields[0].offset ==
        static_cast<std::size_t>(reinterpret_cast<const char*>(&std::get<0>(tuple)) -
                                 reinterpret_cast<const char*>(&tuple)));
  CHECK(field_type(all, 6).fields.at(1).name == "imag");
  CHECK(field_type(all, 6).fields.at(1).offset == 4);
  const auto& wait = field_type(all, 7);
  CHECK(wait.kind == Kind::Duration);
  CHECK(wait.numerator == 1);
  CHECK(wait.denominator == 1000);
  const auto& at = field_type(all, 8);
  CHECK(at.kind == Kind::TimePoint);
  CHECK(at.name == "system_clock");
  CHECK(element(all, at).kind == Kind::Duration);
  CHECK(field_type(all, 9).kind == Kind::UInt);
}

TEST_CASE("a description tells strings, vectors and references; other containers are opaque") {
  struct Parts {
    lot::ShmString text;
    lot::ShmVector<named::Said> said;
    lot::ShmRef<named::Said> other;
    lot::ShmMap<int, int> map;
    named::Secret secret;
  };
  const Description& all = lot::describe<Parts>();
  CHECK(field_type(all, 0).kind == Kind::String);
  CHECK(field_type(all, 1).kind == Kind::Vector);
  CHECK(element(all, field_type(all, 1)).name == "named::Said");
  CHECK(field_type(all, 2).kind == Kind::Reference);
  CHECK(field_type(all, 2).element == field_type(all, 1).element);
  CHECK(field_type(all, 3).kind == Kind::Opaque);
  CHECK(field_type(all, 3).name.find("map") != std::string::npos);
  CHECK(field_type(all, 4).kind == Kind::Opaque);
  CHECK(field_type(all, 4).name == "named::Secret");
  CHECK(field_type(all, 4).size == sizeof(named::Secret));
}

TEST_CASE("a type has the name of its TypeIdentity, at the root and inside") {
  const Description& all = named::describe_shared();
  CHECK(all.root().name == "shared/Whole");
  CHECK(lot::AnyType::of<named::HasShared>().name() == "shared/Whole");
  CHECK(field_type(all, 0).kind == Kind::Struct);
  CHECK(field_type(all, 0).name == "shared/Part");
  CHECK(field_type(all, 1).kind == Kind::Enum);
  CHECK(field_type(all, 1).name == "shared/Colour");
  CHECK(field_type(all, 2).kind == Kind::Opaque);
  CHECK(field_type(all, 2).name == "shared/Secret");
  CHECK(field_type(all, 3).kind == Kind::Opaque);
  CHECK(field_type(all, 3).name == "shared/Map");
  CHECK(lot::describe<named::SharedSecret>().root().name == "shared/Secret");
}

TEST_CASE("a description finds each bit of a bit-field, and only those") {
  named::Bits bits{};
  const Description& all = lot::describe<named::Bits>();
  const auto& fields = all.root().fields;
  REQUIRE(fields.size() == 7);
  CHECK(std::pair(fields[0].bits, fields[1].bits) == std::pair(3U, 5U));
  CHECK(fields[2].bits == 0);
  CHECK(fields[2].offset == offsetof(named::Bits, whole));
  CHECK(fields[3].bits == 20);
  CHECK(fields[4].bits == 1);
  CHECK(fields[5].bits == 4);
  CHECK(fields[6].offset == offsetof(named::Bits, last));
  // What is written there is read as the field.
  const auto* bytes = reinterpret_cast<const unsigned char*>(&bits);
  bits.flag = true;
  CHECK(bytes[fields[4].offset] == 1U << fields[4].bit);
  bits.high = 1;
  CHECK(bytes[fields[1].offset] == 1U << fields[1].bit);
  for (const auto& field : fields) CHECK(field.name.empty());
  // An empty field takes no room: the bits may lie where it does.
  CHECK(lot::describe<named::BitsBehindNothing>().root().fields.at(1).bits == 3);
  CHECK(all.names_hash() == 0);
}

TEST_CASE("a description finds the fields of a packed struct, where they have no address") {
  const Description& all = lot::describe<named::Packed>();
  const auto& fields = all.root().fields;
  const std::uint64_t offsets[] = {0,
                                   offsetof(named::Packed, x),
                                   offsetof(named::Packed, sample),
                                   offsetof(named::Packed, n),
                                   offsetof(named::Packed, real),
                                   offsetof(named::Packed, two),
                                   offsetof(named::Packed, colour),
                                   offsetof(named::Packed, colour) + sizeof(named::Colour),
                                   offsetof(named::Packed, colour) + sizeof(named::Colour),
                                   offsetof(named::Packed, last) - 4,
                                   offsetof(named::Packed, last)};
  REQUIRE(fields.size() == std::size(offsets));
  for (std::size_t i = 0; i < fields.size(); ++i) {
    CAPTURE(i);
    CHECK(fields[i].offset == offsets[i]);
    CHECK(fields[i].bits == (i == 7 ? 5U : i == 8 ? 27U : 0U));
  }
  CHECK(all.layout_hash() == lot::describe<named::ByPragma>().layout_hash());

  named::Packed packed{};
  packed.x = 1.5;
  packed.two[1] = {-2, 0.25F};
  packed.last = -3;
  const auto* const bytes = reinterpret_cast<const unsigned char*>(&packed);
  const lot::Value value(all, bytes, bytes, bytes + sizeof(packed));
  CHECK(value[1].as<double>() == 1.5);
  CHECK(value[5][1][1].as<float>() == 0.25F);
  CHECK(value[10].as<std::int64_t>() == -3);
}

TEST_CASE("a bit-field beside an empty field has its place") {
  const auto& fields = lot::describe<named::BitsBeforeNothing>().root().fields;
  REQUIRE(fields.size() == 3);
  CHECK(fields[0].offset == 0);
  CHECK(fields[0].bits == 3);
  CHECK(fields[2].offset == offsetof(named::BitsBeforeNothing, last));
  CHECK(fields[2].bits == 0);
  named::BitsInEmptiness bits{};
  const auto& beside = lot::describe<named::BitsInEmptiness>().root().fields;
  REQUIRE(beside.size() == 5);
  CHECK(beside[3].bits == 3);
  bits.second = 1;
  CHECK(reinterpret_cast<const unsigned char*>(&bits)[beside[3].offset] == 1U << beside[3].bit);
  const auto& real = lot::describe<named::RealBehindBits>().root().fields;
  REQUIRE(real.size() == 3);
  CHECK(real[0].bits == 5);
  CHECK(real[1].offset == offsetof(named::RealBehindBits, real));
  CHECK(real[2].offset == offsetof(named::RealBehindBits, two));
}

TEST_CASE("types that no walk can explain have a description that every reader takes") {
  using lot::description::decode;
  using lot::description::encode;
  const Description& all = lot::describe<named::Volatile>();
  REQUIRE(all.root().fields.size() == 4);
  CHECK(field_type(all, 2).kind == Kind::Struct);
  CHECK(field_type(all, 2).fields.empty());
  CHECK(lot::describe<named::PackedPicture>().root().kind == Kind::Opaque);
  const Description& refers = lot::describe<named::RefersToShape>();
  CHECK(refers.types.at(field_type(refers, 0).element).kind == Kind::Opaque);
  CHECK(refers.types.at(field_type(refers, 0).element).name.find("Shape") != std::string::npos);
  for (const Description* d :
       {&all, &refers, &lot::describe<named::PackedPicture>(), &lot::describe<named::Packed>(),
        &lot::describe<named::BitsBeforeNothing>(), &lot::describe<named::BitsBehindNothing>()}) {
    CAPTURE(d->root().name);
    CHECK(decode(encode(*d)).has_value());
  }
}

TEST_CASE("a description of a type within itself ends") {
  const Description& tree = lot::describe<named::Tree>();
  REQUIRE(tree.root().fields.size() == 2);
  CHECK(field_type(tree, 1).kind == Kind::Vector);
  CHECK(field_type(tree, 1).element == 0);
  CHECK(tree.layout_hash() != 0);
  CHECK(field_type(lot::describe<named::Chain>(), 0).element == 0);
}

TEST_CASE("describe() takes the names that LOT_DESCRIBE has said, and one description a type") {
  const Description& all = lot::describe<named::Said>();
  CHECK(all.root().fields.at(0).name == "left");
  CHECK(all.root().fields.at(1).name == "right");
  CHECK(&lot::describe<named::Said>() == &all);
}

TEST_CASE("a description is the same in C++17 and C++20") {
  const Description& then = described::frame_in_17();
  const Description& now = lot::describe<described::Frame>();
  CHECK(&then != &now);
  CHECK(then.layout_hash() == now.layout_hash());
  CHECK(then.names_hash() == now.names_hash());
  CHECK(then.names_hash() != 0);
  REQUIRE(then.types.size() == now.types.size());
  for (std::size_t i = 0; i < then.root().fields.size(); ++i) {
    CHECK(then.root().fields[i].name == now.root().fields[i].name);
    CHECK(then.root().fields[i].offset == now.root().fields[i].offset);
  }
  const Description& nameless = described::nameless_in_17();
  CHECK(nameless.root().fields.at(0).name.empty());
  CHECK(nameless.names_hash() == 0);
  CHECK(nameless.layout_hash() == lot::describe<described::Nameless>().layout_hash());
}

TEST_CASE("the hashes of a description differ where a reader would find something else") {
  struct Base {
    int a;
    float b;
    long long c;
  };
  struct Same {
    int a;
    float b;
    long c;
  };
  struct Renamed {
    int a;
    float d;
    long long c;
  };
  struct Swapped {
    float b;
    int a;
    long long c;
  };
  struct Unsigned {
    unsigned a;
    float b;
    long long c;
  };
  struct Fewer {
    int a;
    float b;
  };
  struct Padded {
    int a;
    alignas(8) float b;
    long long c;
  };
  CHECK(alike<Base, Same>() == kBoth);
  CHECK(alike<Base, Renamed>() == kLayoutOnly);
  CHECK(alike<Base, Swapped>() == kNeither);
  CHECK(alike<Base, Unsigned>() == kNamesOnly);
  CHECK(alike<Base, Fewer>() == kNeither);
  CHECK(alike<Base, Padded>() == kNamesOnly);

  struct Deep {
    int n;
    std::array<lot::ShmVector<std::pair<int, float>>, 2> parts;
  };
  struct OtherDeep {
    int n;
    std::array<lot::ShmVector<std::pair<int, int>>, 2> parts;
  };
  CHECK(alike<Deep, OtherDeep>() == kNamesOnly);
  CHECK(alike<named::Bits, named::OtherBits>() == kNamesOnly);  // of neither are names known
  CHECK(alike<std::chrono::seconds, std::chrono::milliseconds>().first == false);
  CHECK(alike<int[2], int[3]>().first == false);
  CHECK(alike<int[2], std::array<int, 2>>().first);
  CHECK(
      alike<std::chrono::system_clock::time_point, std::chrono::steady_clock::time_point>().first ==
      false);
}

TEST_CASE("the hashes of a description do not depend on how often a type is met, or where") {
  struct One {
    int x;
  };
  struct Two {
    int x;
  };
  struct Twice {
    One a, b;
  };
  struct Each {
    One a;
    Two b;
  };
  CHECK(alike<Twice, Each>() == kBoth);

  // A type within itself, seen from outside and from within.
  struct Holder {
    named::Tree first, second;
  };
  struct Around {
    lot::ShmVector<named::Tree> branches;
    int value;
  };
  CHECK(alike<Holder, Holder>() == kBoth);
  CHECK(alike<Around, named::Tree>().first == false);
}

TEST_CASE("the hashes of descriptions made by hand are these numbers, in every program") {
  using by_hand::duration;
  using by_hand::field;
  using by_hand::kNone;
  using by_hand::structure;
  using by_hand::type;
  struct Golden {
    const char* what;
    std::vector<Description::Type> types;
    std::uint64_t layout, names;
  };
  const std::vector<Golden> all{
      {"a number", {type(Kind::Int, 4)}, 0x6db266c0cb3deb14, 0xaf63bd4c29620a93},
      {"an opaque type of seven letters",
       {type(Kind::Opaque, 12, "Private")},
       0xe9b1a96692eb9409,
       0xaf63bd4c29620a93},
      {"a name of eight letters",
       {type(Kind::Opaque, 12, "Private8")},
       0x60012458bff3179e,
       0xaf63bd4c29620a93},
      {"a name of nine letters, one beyond ASCII",
       {type(Kind::Opaque, 12, "Privat9\xc3\xa9")},
       0xcdd05f869191be15,
       0xaf63bd4c29620a93},
      {"an enum, whose name does not count",
       {type(Kind::Enum, 4, "Colour", 1), type(Kind::Int, 4)},
       0xdbab563234a71496,
       0xd9506df2e4363726},
      {"an array",
       {type(Kind::Array, 12, "", 1, 3), type(Kind::Int, 4)},
       0xe59a7c0769f024b3,
       0xd9506df2e4363726},
      {"a time point",
       {type(Kind::TimePoint, 8, "system_clock", 1), duration(8, 2, 1, 1000000000),
        type(Kind::Int, 8)},
       0xa62bac5b308df4e8,
       0x65ba6a2ca2674cb8},
      {"a duration that counts backwards",
       {duration(8, 1, -3, 7), type(Kind::Float, 8)},
       0x17497c6801ce096a,
       0xd9506df2e4363726},
      {"a struct",
       {structure("Point", 8, {field("x", 1, 0), field("y", 1, 4)}), type(Kind::Int, 4)},
       0xa0d360ac3e2dc072,
       0x6d3527846bfce3f2},
      {"a field without a name",
       {structure("Point", 8, {field("x", 1, 0), field("", 1, 4)}), type(Kind::Int, 4)},
       0xa0d360ac3e2dc072,
       0},
      {"bit-fields",
       {structure("Bits", 4, {field("low", 1, 0, 3, 0), field("high_part", 1, 1, 9, 5)}),
        type(Kind::UInt, 4)},
       0x547b72e306c8f92e,
       0xda7a095d0652e943},
      {"an empty struct", {structure("Empty", 1, {})}, 0xd2d8e24c0c9d72b3, 0xaf63bd4c29620a93},
      {"strings in a vector",
       {type(Kind::Vector, 32, "libstdc++", 1), type(Kind::String, 32, "libstdc++")},
       0x02899110e88b904f,
       0xd9506df2e4363726},
      {"a list",
       {structure("Node", 16, {field("next", 1, 0), field("value", 2, 8)}),
        type(Kind::Reference, 8, "", 0), type(Kind::Int, 4)},
       0x703583f8719a1f95,
       0xee7e2a33a3c0f282},
      {"a tree, seen from outside twice",
       {structure("Holder", 80, {field("first", 1, 0), field("second", 1, 40)}),
        structure("Tree", 40, {field("branches", 2, 0), field("number", 3, 32)}),
        type(Kind::Vector, 32, "libstdc++", 1), type(Kind::Int, 4)},
       0x2287b25401e563ea,
       0xb4a582a68ac12ea2},
      {"two that hold each other, and one of them again",
       {structure("Left", 24, {field("right", 1, 0), field("again", 3, 8), field("self", 4, 16)}),
        type(Kind::Reference, 8, "", 2),
        structure("Right", 16, {field("left", 4, 0), field("right", 1, 8)}),
        type(Kind::Reference, 8, "", 2), type(Kind::Reference, 8, "", 0)},
       0xadaf2b8210c9c2e6,
       0x6f29c3b7099fdaec},
  };
  for (const Golden& golden : all) {
    CAPTURE(golden.what);
    Description description;
    description.types = golden.types;
    CHECK(description.layout_hash() == golden.layout);
    CHECK(description.names_hash() == golden.names);
  }
}

}  // namespace
