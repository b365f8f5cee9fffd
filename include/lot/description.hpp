// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "lot/detail/field_names.hpp"

/// What a message type is made of, as data: for programs that do not have the type.
///
///     const lot::Description& frame = lot::describe<Frame>();
///     for (const auto& field : frame.root().fields) std::cout << field.name << '\n';
///
/// `lot/describe.hpp` has describe(). From C++20 on the compiler names the fields. In C++17 one
/// line does, beside the type:
///
///     struct Frame { std::uint32_t width, height; lot::ShmVector<std::uint8_t> data; };
///     LOT_DESCRIBE(Frame, width, height, data)
namespace lot {

/// What a value is. The numbers never change their meaning.
enum class Kind : std::uint8_t {
  Opaque = 0,     ///< bytes whose meaning only the type's own programs know
  Bool = 1,       ///< one byte, 0 or 1
  Char = 2,       ///< one byte of text
  Int = 3,        ///< a signed integer in two's complement, or a part of one (a bit-field)
  UInt = 4,       ///< an unsigned integer or a byte, or a part of one
  Float = 5,      ///< IEEE 754, of 4 or 8 bytes; or what the machine has for long double
  Enum = 6,       ///< lies as its element, an Int, UInt, Bool or Char
  Duration = 7,   ///< lies as its element, which counts numerator / denominator seconds
  TimePoint = 8,  ///< lies as its element, a Duration since the epoch of the clock `name`
  Array = 9,      ///< `count` elements, one behind the other
  Struct = 10,    ///< fields at offsets
  String = 11,    ///< text of any length, which lies elsewhere in the message
  Vector = 12,    ///< any number of elements, which lie elsewhere in the message
  Reference = 13  ///< leads to another message, or to a part of one, which is an element
};

/// The types that a message type is made of. The first one is the message's own; they name each
/// other by their places in the list. A type may lie within itself: behind a vector or a reference.
///
/// Threads: reading is safe from any thread.
/// Errors:  none; what builds one may throw std::bad_alloc.
/// Memory:  on the heap of this process.
/// Crash:   nothing of it is shared.
struct Description {
  /// The place of a type that is not there.
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};

  /// A member of a struct.
  struct Field {
    std::string name;          ///< empty where the program has none
    std::uint32_t type = 0;    ///< its place in the list
    std::uint64_t offset = 0;  ///< from the begin of the struct, in bytes
    std::uint32_t bit = 0;     ///< of a bit-field: the first bit in the byte at `offset`
    std::uint32_t bits = 0;    ///< of a bit-field: how many it has; 0: it is none
  };

  /// One type.
  struct Type {
    Kind kind = Kind::Opaque;  ///< what a value is
    std::uint64_t size = 0;    ///< bytes of a value
    /// Of a struct, enum or opaque type what TypeIdentity says, by default its C++ name; the name
    /// of a clock; whose a string or vector is ("libstdc++", "libc++"): they lie in other bytes.
    std::string name;
    std::uint32_t element = kNone;  ///< the type of what it holds
    std::uint64_t count = 0;        ///< elements of an array
    std::int64_t numerator = 0;     ///< of a duration's period, in seconds
    std::int64_t denominator = 0;   ///< the same
    std::vector<Field> fields;      ///< of a struct, in the order of its declaration
  };

  std::vector<Type> types;  ///< the list

  /// The message's own type. Throws nothing. REQUIRES: there is one.
  const Type& root() const { return types.front(); }
  /// A hash of how a message lies: of kinds, sizes and offsets to any depth, and of the names of
  /// opaque types. Equal where g++ and clang, and all levels of optimisation, lay a type out alike.
  /// Names of fields, structs and enums do not count. Never 0. Throws std::bad_alloc.
  std::uint64_t layout_hash() const;
  /// A hash of the names of all fields to any depth. 0: some field has no name, and a topic's two
  /// ends compare name by name. Throws std::bad_alloc.
  std::uint64_t names_hash() const;
};

}  // namespace lot

/// Names the fields of a struct, all of them and in their order: what a C++17 compiler cannot tell.
/// It stands behind the struct, in its namespace. A name that is wrong, missing, or at another
/// place does not compile. A semicolon may follow. Structs with bit-fields cannot have it, and have
/// no names in C++20 either.
#define LOT_DESCRIBE(Type, ...)                                                               \
  [[maybe_unused]] constexpr auto lot_field_names(const Type*) noexcept {                     \
    constexpr auto names = std::array{LOT_DETAIL_EACH(LOT_DETAIL_TEXT, Type, __VA_ARGS__)};   \
    static_assert(names.size() == ::lot::detail::Fields<Type>::count,                         \
                  "lot: LOT_DESCRIBE must name each field of the struct");                    \
    static_assert(::lot::detail::all_differ(names), "lot: LOT_DESCRIBE names a field twice"); \
    _Pragma("GCC diagnostic push")                                                            \
        _Pragma("GCC diagnostic ignored \"-Winvalid-offsetof\"") static_assert(               \
            ::lot::detail::in_order({LOT_DETAIL_EACH(LOT_DETAIL_OFFSET, Type, __VA_ARGS__)}), \
            "lot: LOT_DESCRIBE must name the fields in the order of the struct");             \
    _Pragma("GCC diagnostic pop") return names;                                               \
  }
