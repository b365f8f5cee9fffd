// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <new>
#include <random>
#include <string>
#include <string_view>
#include <vector>

#include "lot/mutable_value.hpp"
#include <lot/lot.hpp>

/// Types and values by chance, for all that ROS 2 has.
namespace lot::testing {

/// Makes the description of a type as a compiler would lay it out, with everything in it that the
/// codec carries.
class RandomType {
 public:
  /// Its structs get names in that namespace.
  RandomType(std::mt19937_64& random, std::string scope)
      : random_(random), scope_(std::move(scope)) {
    (void)add_struct(0);
  }
  Description take() && { return std::move(all_); }

 private:
  struct Laid {
    std::uint32_t place;
    std::uint64_t align;
  };

  std::uint64_t below(std::uint64_t n) { return random_() % n; }

  Laid put(Description::Type type, std::uint64_t align) {
    all_.types.push_back(std::move(type));
    return {static_cast<std::uint32_t>(all_.types.size() - 1), align};
  }
  Laid add_number() {
    static constexpr Kind kKinds[] = {Kind::Bool, Kind::Char,  Kind::Int,  Kind::UInt,
                                      Kind::UInt, Kind::Float, Kind::Float};
    Description::Type type;
    type.kind = kKinds[below(std::size(kKinds))];
    type.size = std::uint64_t{1} << below(4);
    if (type.kind == Kind::Bool || type.kind == Kind::Char) type.size = 1;
    if (type.kind == Kind::Float) type.size = std::uint64_t{4} << below(2);
    return put(type, type.size);
  }
  /// An enum, a duration or a time point.
  Laid add_marked() {
    Description::Type number;
    number.kind = below(2) == 0 ? Kind::Int : Kind::UInt;
    number.size = std::uint64_t{1} << below(4);
    Description::Type type;
    type.element = put(number, number.size).place;
    type.size = number.size;
    type.kind = below(2) == 0 ? Kind::Enum : Kind::Duration;
    type.name = "Colour";
    type.numerator = 1;
    type.denominator = 1000;
    const Laid marked = put(type, number.size);
    if (type.kind == Kind::Enum || below(2) == 0) return marked;
    type.kind = Kind::TimePoint;
    type.name = "system_clock";
    type.element = marked.place;
    return put(type, number.size);
  }
  Laid add_any(int level) {
    const std::uint64_t what = below(level > 3 ? 8 : 16);
    Description::Type type;
    if (what < 6) return add_number();
    if (what == 6) return add_marked();
    if (what == 7) {
      type.kind = Kind::String;
      type.size = 40;
      type.name = "libstdc++";
      return put(type, 8);
    }
    if (what > 13) return add_struct(level + 1);
    const Laid element = below(2) == 0 ? add_number() : add_any(level + 1);
    type.element = element.place;
    if (what > 10) {
      type.kind = Kind::Array;
      type.count = 1 + below(4);
      type.size = type.count * all_.types[element.place].size;
      return put(type, element.align);
    }
    type.kind = Kind::Vector;
    type.size = 32;
    type.name = "libstdc++";
    return put(type, 8);
  }
  Laid add_struct(int level) {
    const Laid own = put({}, 1);
    Description::Type type;
    type.kind = Kind::Struct;
    type.name = scope_ + "::S" + std::to_string(own.place);
    std::uint64_t align = 1;
    const std::uint64_t fields = level == 0 ? 1 + below(8) : below(6);
    for (std::uint64_t i = 0; i < fields; ++i) {
      const Laid its = add_any(level);
      const std::uint64_t beside = (type.size + its.align - 1) / its.align * its.align;
      Description::Field field;
      field.name = "f" + std::to_string(i);
      field.type = its.place;
      field.offset = beside;
      type.size = beside + all_.types[its.place].size;
      align = std::max(align, its.align);
      if (below(8) == 0 && all_.types[its.place].kind == Kind::UInt) {
        field.bits = static_cast<std::uint32_t>(1 + below(8 * all_.types[its.place].size - 1));
      }
      type.fields.push_back(field);
    }
    type.size = std::max<std::uint64_t>((type.size + align - 1) / align * align, 1);
    all_.types[own.place] = std::move(type);
    return {own.place, align};
  }

  std::mt19937_64& random_;
  std::string scope_;
  Description all_;
};

/// Memory for messages of a process alone, which are built by their descriptions.
class Heap {
 public:
  explicit Heap(std::size_t bytes)
      : bytes_(bytes), begin_(static_cast<std::byte*>(::operator new(bytes, kAlign))) {}
  ~Heap() { ::operator delete(begin_, kAlign); }
  Heap(const Heap&) = delete;
  Heap& operator=(const Heap&) = delete;

  /// The memory is used anew. A message gets what was there before: it is not zeroed.
  void clear() { used_ = 0; }
  std::size_t used() const { return used_; }
  MutableValue make(const Description& description) {
    void* const at = take(description.root().size, 64);
    std::memset(at, 0xa5, description.root().size);
    const detail::MessageMemory memory{this,
                                       [](void* heap, std::size_t bytes, std::size_t align) {
                                         void* const piece =
                                             static_cast<Heap*>(heap)->take(bytes, align);
                                         std::memset(piece, 0xa5, bytes);
                                         return piece;
                                       },
                                       [](void*, void*, std::size_t) noexcept {}};
    const MutableValue made(description, at, begin_, begin_ + bytes_, memory);
    made.construct();
    return made;
  }

 private:
  static constexpr std::align_val_t kAlign{4096};

  /// Throws lot::OutOfMemory.
  void* take(std::size_t bytes, std::size_t align) {
    const std::size_t at = (used_ + align - 1) / align * align;
    if (at > bytes_ || bytes > bytes_ - at) throw OutOfMemory("the heap of the test is full");
    used_ = at + bytes;
    return begin_ + at;
  }

  std::size_t bytes_;
  std::byte* begin_;
  std::size_t used_ = 0;
};

/// Gives a message values by chance.
class RandomValues {
 public:
  explicit RandomValues(std::mt19937_64& random) : random_(random) {}

  void fill(const MutableValue& value) {
    const Value& here = value;
    switch (here.kind()) {
      case Kind::Vector:
        value.resize(random_() % 5);
        [[fallthrough]];
      case Kind::Array:
      case Kind::Struct:
        for (std::size_t i = 0; i < here.size(); ++i) fill(value[i]);
        return;
      case Kind::String:
        return value.set(text());
      case Kind::Float:
        return value.set(static_cast<float>(static_cast<std::int64_t>(random_()) % 1000) / 8);
      case Kind::Bool:
        return value.set(random_() % 2 == 0);
      default:
        return fill_whole(value);
    }
  }

 private:
  std::string text() {
    std::string result(random_() % 3 == 0 ? random_() % 40 : random_() % 5, ' ');
    for (char& c : result) c = static_cast<char>('!' + random_() % 90);
    return result;
  }
  static bool takes(const MutableValue& value, auto number) {
    try {
      value.set(number);
      return true;
    } catch (const Error&) {
      return false;
    }
  }
  /// As many bits as the value can have; of what has a sign, every other one is negative.
  void fill_whole(const MutableValue& value) {
    const std::uint64_t bits = random_();
    const Value& here = value;
    for (auto less = 64 - 8 * static_cast<int>(here.type().size); less < 64; ++less) {
      if (takes(value, static_cast<std::int64_t>(bits) >> less)) return;
      if (takes(value, bits >> less)) return;
    }
  }

  std::mt19937_64& random_;
};

/// The numbers, counts and texts of a message in their order, one in a line: a real number as its
/// bits, a text as the numbers of its bytes.
inline void list_values(const Value& value, std::string& lines) {
  const auto line = [&](auto number) { lines += std::to_string(number) + '\n'; };
  switch (value.kind()) {
    case Kind::Vector:
      line(value.size());
      [[fallthrough]];
    case Kind::Array:
    case Kind::Struct:
      for (std::size_t i = 0; i < value.size(); ++i) list_values(value[i], lines);
      if (value.kind() == Kind::Struct && value.size() == 0) line(0);
      return;
    case Kind::String:
      line(value.as<std::string_view>().size());
      for (const char c : value.as<std::string_view>()) line(static_cast<unsigned char>(c));
      return;
    case Kind::Float:
      if (value.type().size == 4) return line(std::bit_cast<std::uint32_t>(value.as<float>()));
      return line(std::bit_cast<std::uint64_t>(value.as<double>()));
    case Kind::Char:
      return line(static_cast<unsigned char>(value.as<char>()));
    default:
      try {
        return line(value.as<std::int64_t>());
      } catch (const Error&) {
        return line(value.as<std::uint64_t>());
      }
  }
}
inline std::string list_of_values(const Value& message) {
  std::string lines;
  list_values(message, lines);
  return lines;
}

/// The bytes of what lies in several pieces.
inline std::string joined(const std::vector<Bytes>& pieces) {
  std::string all;
  for (const Bytes& piece : pieces) {
    all.append(reinterpret_cast<const char*>(piece.data()), piece.size());
  }
  return all;
}
inline Bytes bytes_of(std::string_view text) {
  return {reinterpret_cast<const std::byte*>(text.data()), text.size()};
}

}  // namespace lot::testing
