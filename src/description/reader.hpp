// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

#include "lot/mutable_value.hpp"
#include "lot/value.hpp"

namespace lot::detail {

/// The steps by which a Value is read and written.
///
/// Invariants
///   - No byte is looked at before inside() or is_inside() has found it in the range.
///   - A word of the message that leads on, or says how much there is, is loaded once (load()):
///   what
///     is checked is what is used.
struct ValueAccess {
  using Type = Description::Type;
  using Items = Value::Items;

  [[noreturn]] static void damaged(const Value& v, const std::string& what);
  [[noreturn]] static void refuse(const Value& v, int error, const std::string& what,
                                  const std::string& advice = "");

  // ---- memory ----

  static bool is_inside(const Value& v, const unsigned char* at, std::uint64_t bytes) noexcept;
  /// Checks the bytes of the value itself, and returns its type.
  static const Type& inside(const Value& v);
  /// Loads what may change meanwhile: the compiler takes it from memory once.
  template <class T>
  static T load(const unsigned char* at) noexcept {
    T loaded;
    std::memcpy(&loaded, at, sizeof loaded);
    if constexpr (sizeof(T) <= 8) asm volatile("" : "+r"(loaded));
    return loaded;
  }
  /// A word of a container. REQUIRES: inside().
  static std::uint64_t word(const Value& v, std::uint64_t offset);
  /// What the pointer in that word leads to: `bytes` of memory; null for a null pointer.
  static const unsigned char* follow(const Value& v, std::uint64_t offset);

  // ---- types ----

  static const Type& type_at(const Value& v, std::uint32_t place);
  /// The number or char that an enum, a duration or a time point lies as.
  static const Type& scalar(const Value& v);
  struct Facts {
    bool is_plain = true;    ///< has no pointer in it: its bytes are all of it
    bool is_opaque = false;  ///< has something opaque in it
    bool has_bool = false;   ///< has a byte in it that is 0 or 1
  };
  static Facts facts(const Value& v, std::uint32_t place);
  /// What the elements of a vector are aligned to. 1 for structs: they may be packed.
  static std::uint64_t align(const Value& v, std::uint32_t place);
  static std::string name_of(const Description& all, std::uint32_t place, int levels);

  // ---- parts ----

  static Value child(const Value& v, std::uint64_t step, const unsigned char* at,
                     std::uint32_t place);
  static Value field(const Value& v, const Type& type, std::uint64_t i);
  static Value item(const Value& v, const Items& items, std::uint64_t i);
  /// Of an array or a vector.
  static Items items(const Value& v);
  static Items vector_items(const Value& v, const Type& type);
  /// A field with that name; else the one at that place (`_0`, `_1`, ...), or type.fields.size().
  static std::uint64_t find(const Type& type, std::string_view name);

  static const unsigned char* address(const Value& v) noexcept { return v.at_; }
  static std::string_view text(const Value& v) { return v.text(); }
  static Number number(const Value& v) { return v.number(); }
  static std::uint32_t bits(const Value& v) noexcept { return v.bits_; }
  static std::uint32_t bit(const Value& v) noexcept { return v.bit_; }
  static std::uint32_t place(const Value& v) noexcept { return v.place_; }
  /// So many periods, as of a duration that says so.
  static void set_ticks(const MutableValue& to, const Number& count, Period period);
  /// Nothing lies in it that a Value could lead to.
  static bool is_deepest(const Value& v) noexcept { return v.way_.size() == Way::kMost; }
  static const Description& description(const Value& v) noexcept { return *v.all_; }
  /// Whether a reference lies on the way to it.
  static bool leads_away(const Value& v);
};

/// "_3", or the name that the field has.
std::string name_of_field(const Description::Type& type, std::uint64_t i);

}  // namespace lot::detail
