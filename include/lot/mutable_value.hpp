// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <type_traits>

#include "lot/value.hpp"

/// Builds a message by its description, in place: for programs that do not have the type.
namespace lot {

namespace detail {

/// Where the strings and vectors of a message get their memory: its arena.
struct MessageMemory {
  void* arena = nullptr;  ///< what the containers' allocators lead to
  /// Throws what the arena throws.
  void* (*allocate)(void* arena, std::size_t bytes, std::size_t align) = nullptr;
  void (*deallocate)(void* arena, void* piece, std::size_t bytes) noexcept = nullptr;
};

}  // namespace detail

/// A place in a message that this process builds, and the type of what lies there. It writes what
/// the type's own code would: programs that have the type read, copy and destroy the result, and
/// can make it grow.
///
///     frame.at("width").set(640);
///     frame.at("labels").resize(2);
///     frame.at("labels[0].name").set("left");
///
/// A reference cannot be set, nor what only the type's own programs know (Kind::Opaque). What needs
/// such a part to be made, a message or an element of a vector, cannot be made.
///
/// Threads: one thread at a time builds a message.
/// Errors:  lot::Error, which names the path: as Value; ERANGE for what does not fit; EINVAL for a
///          value of the wrong kind and what cannot be set. What a container's growth throws:
///          lot::OutOfMemory, and lot::Error as ShmAllocator says. A call that throws has changed
///          nothing.
/// Memory:  valid as long as the message and its description, of which it has neither.
/// Crash:   another process frees a message that is only loaned.
class MutableValue {
 public:
  /// A message that lies there, which this process builds. [begin, end) is as for a Value. Throws
  /// nothing.
  MutableValue(const Description& description, void* message, const void* begin, const void* end,
               const detail::MessageMemory& memory) noexcept
      : value_(description, message, begin, end), memory_(memory) {}

  /// Makes the value anew, over bytes that mean nothing: numbers are zero, strings and vectors
  /// empty, references refer to nothing. A default that the type gives to a field is not known
  /// here. Throws lot::Error.
  void construct() const;

  /// The same place, to be read.
  const Value& value() const noexcept { return value_; }
  /// The same place, to be read.
  operator const Value&() const noexcept { return value_; }

  /// An element, or a field by its number. Throws lot::Error.
  MutableValue operator[](std::size_t i) const { return {own(value_[i]), memory_}; }
  /// A field. Throws lot::Error.
  MutableValue operator[](std::string_view field) const { return {own(value_[field]), memory_}; }
  /// As Value::at(). Throws lot::Error.
  MutableValue at(std::string_view path) const { return {own(value_.at(path)), memory_}; }
  /// How many parts it has: as Value::size(). Throws lot::Error.
  std::size_t size() const { return value_.size(); }

  /// Changes the value: a number, bool, char, enum, text, duration or time point. A number must fit
  /// the type; but a double is rounded to a float. A duration must be a whole number of the type's
  /// periods. A text goes into a string, or into an array of char, whose rest is zero. Throws
  /// lot::Error and lot::OutOfMemory.
  template <class T>
  void set(const T& value) const {
    if constexpr (std::is_convertible_v<const T&, std::string_view>) {
      set_text(value);
    } else if constexpr (std::is_enum_v<T>) {
      set(static_cast<std::underlying_type_t<T>>(value));
    } else if constexpr (detail::Chrono<T>::is_duration) {
      set_ticks(detail::Number::of(value.count()), detail::Chrono<T>::period);
    } else if constexpr (detail::Chrono<T>::is_time_point) {
      require_clock(detail::Chrono<T>::clock);
      set(value.time_since_epoch());
    } else {
      static_assert(std::is_arithmetic_v<T>,
                    "lot: a value can be a number, bool, char, enum, text, duration or time point");
      set_number(detail::Number::of(value));
    }
  }
  /// Gives a vector so many elements. Those that come are as construct() makes them. Throws
  /// lot::Error and lot::OutOfMemory.
  void resize(std::size_t count) const;
  /// Gives a vector these bytes for elements, or an array. Throws lot::Error and lot::OutOfMemory,
  /// also where the elements have vectors, strings or references (EINVAL), and for a bool that is
  /// neither 0 nor 1 (ERANGE).
  void assign(Bytes bytes) const;

 private:
  friend struct detail::ValueAccess;
  MutableValue(const Value& value, const detail::MessageMemory& memory) noexcept
      : value_(value), memory_(memory) {}

  /// A value in this message. Throws lot::Error for one behind a reference.
  const Value& own(const Value& value) const;
  void set_number(const detail::Number& number) const;
  void set_ticks(const detail::Number& count, detail::Period period) const;
  void require_clock(const char* name) const { value_.require_clock(name); }
  void set_text(std::string_view text) const;

  Value value_;
  detail::MessageMemory memory_;
};

}  // namespace lot
