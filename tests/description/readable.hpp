// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string_view>
#include <sys/mman.h>
#include <utility>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "support/processes.hpp"

/// Messages that tests read and build by their descriptions.
namespace readable {

enum class Colour : std::int16_t { None = -1, Red = 7 };
enum class Small : std::uint8_t { Seven = 7 };
enum class Wide : std::uint64_t { All = ~0ULL };
using When = std::chrono::time_point<std::chrono::system_clock, std::chrono::nanoseconds>;
struct Empty {};
struct Point {
  double x, y;
};
struct Bits {
  std::uint8_t low : 3;
  std::uint8_t high : 5;
  int whole;
  signed int few : 5;
  bool flag : 1;
  Small small : 4;
  unsigned long most : 63;
};
struct Label {
  lot::ShmString name;
  float score;
  std::array<lot::ShmString, 2> notes;
};
struct Tree {
  std::uint32_t number;
  lot::ShmVector<Tree> branches;
};
struct Frame {
  std::uint64_t stamp;
  lot::ShmString encoding;
  lot::ShmVector<std::uint8_t> data;
};
struct Chain {
  lot::ShmRef<const Chain> next;
  std::uint32_t number;
};

struct Everything {
  bool yes;
  char letter;
  std::int8_t i8;
  std::uint8_t u8;
  std::int16_t i16;
  std::uint16_t u16;
  std::int32_t i32;
  std::uint32_t u32;
  std::int64_t i64;
  std::uint64_t u64;
  std::byte byte;
  float f32;
  double f64;
  long double real;
  Colour colour;
  Wide wide;
  std::chrono::milliseconds span;
  std::chrono::duration<double> seconds;
  When when;
  std::int16_t numbers[3];
  char name[8];
  Point points[2];
  Empty nothing;
  Bits bits;
  lot::ShmString text;
  lot::ShmVector<float> floats;
  lot::ShmVector<Label> labels;
  lot::ShmVector<lot::ShmVector<std::uint16_t>> rows;
  lot::ShmRef<const Frame> frame;
  Tree tree;
  std::pair<std::uint8_t, double> pair;
};

struct Forty {
  std::uint8_t f0, f1, f2, f3, f4, f5, f6, f7, f8, f9;
  std::uint16_t g0, g1, g2, g3, g4, g5, g6, g7, g8, g9;
  std::uint32_t h0, h1, h2, h3, h4, h5, h6, h7, h8, h9;
  lot::ShmString i0, i1, i2, i3, i4, i5, i6, i7, i8, i9;
};

class Secret {
 public:
  std::uint32_t get() const { return value_; }

 private:
  std::uint32_t value_ = 17;
};
struct HasSecret {
  std::uint32_t before;
  Secret secret;
  lot::ShmVector<Secret> more;
};

inline const char* const kLong = "a text that is much too long for the small string in place";

inline void fill(Everything& e) {
  e.yes = true;
  e.letter = 'x';
  e.i8 = -8;
  e.u8 = 200;
  e.i16 = -1600;
  e.u16 = 65000;
  e.i32 = -2'000'000'000;
  e.u32 = 4'000'000'000;
  e.i64 = INT64_MIN;
  e.u64 = UINT64_MAX;
  e.byte = std::byte{0xfe};
  e.f32 = 0.1F;
  e.f64 = 0.1;
  e.real = 0.1L;
  e.colour = Colour::None;
  e.wide = Wide::All;
  e.span = std::chrono::milliseconds(-1500);
  e.seconds = std::chrono::duration<double>(0.25);
  e.when = When(std::chrono::nanoseconds(1'700'000'000'123'456'789));
  e.numbers[0] = 1;
  e.numbers[1] = -2;
  e.numbers[2] = 3;
  for (char& c : e.name) c = '\0';
  e.name[0] = 'h';
  e.name[1] = 'i';
  e.points[0] = {1, 2};
  e.points[1] = {3, 4};
  e.bits.low = 5;
  e.bits.high = 17;
  e.bits.whole = -4;
  e.bits.few = -9;
  e.bits.flag = true;
  e.bits.small = Small::Seven;
  e.bits.most = (1UL << 63) - 2;
  e.text = kLong;
  e.floats.resize(3);
  e.floats[0] = 1.5F;
  e.floats[1] = -2;
  e.floats[2] = 3;
  e.labels.resize(2);
  e.labels[0].name = "short";
  e.labels[0].score = 0.5F;
  e.labels[0].notes[1] = kLong;
  e.labels[1].name = kLong;
  e.labels[1].score = 1;
  e.rows.resize(2);
  e.rows[1].resize(5);
  for (std::uint16_t i = 0; i < 5; ++i) e.rows[1][i] = i;
  e.tree.number = 1;
  e.tree.branches.resize(2);
  e.tree.branches[0].number = 2;
  e.tree.branches[1].number = 3;
  e.tree.branches[1].branches.resize(1);
  e.tree.branches[1].branches[0].number = 4;
  e.pair = {9, 2.5};
}

/// A segment with an engine.
struct Place {
  explicit Place(std::uint64_t size = 64 << 20)
      : options(lot::testing::fresh(size)), engine(options) {}
  lot::EngineOptions options;
  lot::ShmEngine engine;
};

/// Builds a copy of a message, by its description alone.
inline void copy(const lot::Value& from, const lot::MutableValue& to) {
  switch (from.kind()) {
    case lot::Kind::Struct:
      for (std::size_t i = 0; i < from.size(); ++i) copy(from[i], to[i]);
      break;
    case lot::Kind::Vector:
      to.resize(from.size());
      [[fallthrough]];
    case lot::Kind::Array:
      for (std::size_t i = 0; i < from.size(); ++i) copy(from[i], to[i]);
      break;
    case lot::Kind::String:
      to.set(from.as<std::string_view>());
      break;
    case lot::Kind::Float:
      to.set(from.as<long double>());
      break;
    case lot::Kind::Duration:
    case lot::Kind::TimePoint:
      if (from.type_name() == "duration" && from.name() == "seconds") {
        to.set(from.as<double>());
        break;
      }
      [[fallthrough]];
    case lot::Kind::Bool:
    case lot::Kind::Char:
    case lot::Kind::Int:
    case lot::Kind::Enum:
      if (from.type().size < 8 || from.name() != "wide") {
        to.set(from.as<std::int64_t>());
        break;
      }
      [[fallthrough]];
    case lot::Kind::UInt:
      to.set(from.as<std::uint64_t>());
      break;
    case lot::Kind::Reference:
    case lot::Kind::Opaque:
      break;
  }
}

/// Memory for a message, between two pages that no code may touch.
class Fenced {
 public:
  static constexpr std::size_t kBytes = 64 << 10;

  Fenced() {
    void* const mapped =
        mmap(nullptr, kBytes + 2 * kPage, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    REQUIRE(mapped != MAP_FAILED);
    begin_ = next_ = static_cast<unsigned char*>(mapped) + kPage;
    REQUIRE(mprotect(begin_, kBytes, PROT_READ | PROT_WRITE) == 0);
  }
  ~Fenced() { munmap(begin_ - kPage, kBytes + 2 * kPage); }
  Fenced(const Fenced&) = delete;
  Fenced& operator=(const Fenced&) = delete;

  unsigned char* begin() const { return begin_; }
  /// Behind what is used.
  unsigned char* next() const { return next_; }

  /// A message that begins as a default-constructed one.
  lot::MutableValue make(const lot::Description& description) const {
    void* const at = take(description.root().size, 64);
    std::memset(at, 0xa5, description.root().size);
    lot::MutableValue made = at_place(description, at);
    made.construct();
    return made;
  }
  /// The message that was made first.
  lot::MutableValue at_begin(const lot::Description& description) const {
    return at_place(description, begin_);
  }
  /// A copy of a message of everything, with a frame that it refers to.
  lot::Value copy_of(const lot::Value& everything) const {
    const lot::MutableValue made = make(lot::describe<Everything>());
    copy(everything, made);
    const lot::MutableValue frame = make(lot::describe<Frame>());
    copy(everything["frame"].target(), frame);
    const auto* const reference =
        static_cast<const unsigned char*>(made["frame"].value().address());
    const std::ptrdiff_t distance =
        static_cast<const unsigned char*>(frame.value().address()) - (reference + 8);
    std::memcpy(const_cast<unsigned char*>(reference) + 8, &distance, sizeof distance);
    return made;
  }

 private:
  static constexpr std::size_t kPage = 4096;

  lot::MutableValue at_place(const lot::Description& description, void* at) const {
    const lot::detail::MessageMemory memory{
        const_cast<Fenced*>(this),
        [](void* fenced, std::size_t bytes, std::size_t align) {
          return static_cast<const Fenced*>(fenced)->take(bytes, align);
        },
        [](void* fenced, void* piece, std::size_t bytes) noexcept {
          REQUIRE(piece >= static_cast<const Fenced*>(fenced)->begin_);
          std::memset(piece, 0xa5, bytes);
        }};
    return {description, at, begin_, begin_ + kBytes, memory};
  }
  void* take(std::size_t bytes, std::size_t align) const {
    const auto at = (reinterpret_cast<std::uintptr_t>(next_) + align - 1) & ~(align - 1);
    next_ = reinterpret_cast<unsigned char*>(at + bytes);
    REQUIRE(next_ <= begin_ + kBytes);
    return reinterpret_cast<void*>(at);
  }

  unsigned char* begin_;
  mutable unsigned char* next_;
};

}  // namespace readable

#if __cplusplus < 202002L
#error "the compiler names the fields from C++20 on"
#endif

template <>
struct lot::is_trusted_message<readable::Secret> : std::true_type {};
