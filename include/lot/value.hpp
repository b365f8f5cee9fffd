// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <limits>
#include <ostream>
#include <string>
#include <string_view>
#include <type_traits>

#include "lot/description.hpp"

/// Reads a message by its description, in place: for programs that do not have the type.
///
///     const lot::Value frame = message.root();                    // lot/any_message.hpp
///     const auto width = frame["width"].as<std::uint32_t>();
///     const auto name = frame.at("labels[2].name").as<std::string>();
///     for (const lot::Value& field : frame) std::cout << field.name() << ": " << field << '\n';
namespace lot {

class Value;
namespace detail {
struct ValueAccess;
}  // namespace detail

/// Bytes that lie side by side in a message.
///
/// Threads: reading is safe from any thread.
/// Errors:  none.
/// Memory:  two words; valid as long as the message.
/// Crash:   as the message.
class Bytes {
 public:
  using value_type = std::byte;
  using const_iterator = const std::byte*;

  constexpr Bytes() noexcept = default;
  /// So many from there on.
  constexpr Bytes(const std::byte* data, std::size_t size) noexcept : data_(data), size_(size) {}
  /// The first of them.
  constexpr const std::byte* data() const noexcept { return data_; }
  /// How many.
  constexpr std::size_t size() const noexcept { return size_; }
  /// The first of them.
  constexpr const std::byte* begin() const noexcept { return data_; }
  /// Behind the last.
  constexpr const std::byte* end() const noexcept { return data_ + size_; }

 private:
  const std::byte* data_ = nullptr;
  std::size_t size_ = 0;
};

/// How much of a value is printed.
struct TextLimits {
  std::uint64_t elements = 16;    ///< of an array or a vector
  std::uint64_t characters = 80;  ///< of a string
  std::uint64_t values = 10'000;  ///< in all
};

namespace detail {

/// The memory that a value may look at: all of its segment. A pointer in a message must lead there.
struct Range {
  const unsigned char* begin = nullptr;
  const unsigned char* end = nullptr;
};

/// How a place was reached from the message: by which field, element or reference at each level.
class Way {
 public:
  /// Messages can refer to each other in a ring: nothing lies deeper than this.
  static constexpr std::size_t kMost = 64;

  Way() noexcept = default;
  Way(const Way& other) noexcept : length_(other.length_) {
    std::copy_n(other.steps_, length_, steps_);
  }
  Way& operator=(const Way& other) noexcept {
    if (this != &other) {
      length_ = other.length_;
      std::copy_n(other.steps_, length_, steps_);
    }
    return *this;
  }
  std::size_t size() const noexcept { return length_; }
  std::uint64_t operator[](std::size_t i) const noexcept { return steps_[i]; }
  /// REQUIRES: there is room.
  void add(std::uint64_t step) noexcept { steps_[length_++] = step; }

 private:
  std::size_t length_ = 0;
  std::uint64_t steps_[kMost];
};

/// A number of any type.
struct Number {
  bool is_real = false;      ///< `real` counts, else `whole`
  bool is_negative = false;  ///< `whole` is the value plus 2^64
  std::uint64_t whole = 0;
  long double real = 0;

  template <class T>
  static Number of(T value) noexcept {
    Number number;
    if constexpr (std::is_floating_point_v<T>) {
      number.is_real = true;
      number.real = value;
    } else {
      number.is_negative = std::is_signed_v<T> && value < T{};
      number.whole = static_cast<std::uint64_t>(value);
    }
    return number;
  }

  /// False: a T cannot have that value. A real number is rounded to a shorter T.
  template <class T>
  bool to(T& result) const noexcept {
    static_assert(sizeof(T) <= 8 || std::is_floating_point_v<T>);
    if constexpr (std::is_floating_point_v<T>) {
      if (!is_real) {
        result =
            is_negative ? static_cast<T>(static_cast<std::int64_t>(whole)) : static_cast<T>(whole);
        Number back;
        back.is_real = true;
        back.real = result;
        std::int64_t negative = 0;
        std::uint64_t positive = 0;
        return is_negative ? back.to(negative) && static_cast<std::uint64_t>(negative) == whole
                           : back.to(positive) && positive == whole;
      }
      result = static_cast<T>(real);
      return !std::isfinite(real) || std::isfinite(result);
    } else if (is_real) {
      const long double end = std::ldexp(1.0L, std::numeric_limits<T>::digits);
      if (!(real < end && real >= (std::is_signed_v<T> ? -end : 0.0L))) return false;
      result = static_cast<T>(real);
      return static_cast<long double>(result) == real;
    } else {
      result = static_cast<T>(whole);
      if constexpr (std::is_signed_v<T>) {
        return static_cast<std::uint64_t>(result) == whole && (result < T{}) == is_negative;
      } else {
        return static_cast<std::uint64_t>(result) == whole && !is_negative;
      }
    }
  }
};

/// A ratio of two whole numbers.
struct Period {
  std::int64_t numerator;
  std::int64_t denominator;
};

/// Whether T is a duration or a time point of a clock that all programs have.
template <class T>
struct Chrono {
  static constexpr bool is_duration = false;
  static constexpr bool is_time_point = false;
};
template <class Rep, class P>
struct Chrono<std::chrono::duration<Rep, P>> {
  static constexpr bool is_duration = true;
  static constexpr bool is_time_point = false;
  static constexpr Period period{P::num, P::den};
};
template <class Clock, class Span>
struct Chrono<std::chrono::time_point<Clock, Span>> {
  static constexpr bool is_duration = false;
  static constexpr bool is_time_point = true;
  static_assert(std::is_same_v<Clock, std::chrono::system_clock> ||
                    std::is_same_v<Clock, std::chrono::steady_clock>,
                "lot: read a time point of this clock as the duration since its epoch");
  static constexpr const char* clock =
      std::is_same_v<Clock, std::chrono::system_clock> ? "system_clock" : "steady_clock";
};

}  // namespace detail

/// A place in a message, to be read, and the type of what lies there.
///
/// A reference stands for what it refers to: all members but kind(), type(), type_name() and
/// target() look there.
///
/// The message need not be trusted: each size and each pointer in it is read once for a call, and
/// is checked before it is used. What is wrong is an error, and no byte outside of the segment is
/// looked at. A value that its publisher still writes may come out torn.
///
/// Threads: any number may read one message.
/// Errors:  lot::Error, which names the path: EBADMSG when the message is damaged, or the
///          description; ELOOP for what lies more than 64 levels deep; EINVAL when there is no such
///          field or element, when a reference refers to nothing, and when the value is of another
///          kind; ERANGE when the type that is asked for cannot have the value. std::bad_alloc
///          where there is a text.
/// Memory:  valid as long as the message and its description, of which it has neither.
/// Crash:   a message that is held stays as it is when any process dies.
class Value {
 public:
  /// A message that lies there. [begin, end) is the memory that its vectors, strings and references
  /// may lead to. Throws nothing here; the first use of a message that does not lie in that memory
  /// does. REQUIRES: the description has a type.
  Value(const Description& description, const void* message, const void* begin,
        const void* end) noexcept
      : all_(&description),
        range_{static_cast<const unsigned char*>(begin), static_cast<const unsigned char*>(end)},
        at_(static_cast<const unsigned char*>(message)) {}

  // ---- what it is ----

  /// What lies there. Throws lot::Error.
  Kind kind() const { return type().kind; }
  /// All that the description says of it. Throws lot::Error.
  const Description::Type& type() const;
  /// Its type in words: "uint32", "float64[3]", "vector of string", or the C++ name of a struct.
  /// Throws lot::Error and std::bad_alloc.
  std::string type_name() const;
  /// The field that it is; `_0`, `_1`, ... where the program gave no names. Of an element "[2]", of
  /// the message "". Throws lot::Error and std::bad_alloc.
  std::string name() const;
  /// The way to it from the message: "labels[2].name". Throws lot::Error and std::bad_alloc.
  std::string path() const;

  // ---- its parts ----

  /// How many fields, elements or bytes of text it has; bytes of an opaque value; else 0. Throws
  /// lot::Error.
  std::size_t size() const;
  /// An element, or a field by its number. Throws lot::Error.
  Value operator[](std::size_t i) const;
  /// A field by its name, or by its place (`_0`, `_1`, ...) where none is called so. Throws
  /// lot::Error.
  Value operator[](std::string_view field) const;
  /// A field of a field, an element of a vector and so on: "labels[2].name". Throws lot::Error,
  /// which says what is wrong with the path, and which fields there are.
  Value at(std::string_view path) const;
  /// Whether it is a struct that has such a field. Throws lot::Error.
  bool has(std::string_view field) const;

  class Iterator;
  /// The first field or element. Throws lot::Error.
  Iterator begin() const;
  /// Behind the last.
  Iterator end() const noexcept;

  // ---- references ----

  /// True for a reference that refers to nothing. Throws lot::Error.
  bool is_null() const;
  /// What a reference refers to; else itself. Throws lot::Error.
  Value target() const;

  // ---- what it says ----

  /// The value as a T: a number, bool, char, enum, std::string, std::string_view, duration or time
  /// point. A number must be one that a T can have; but a double becomes a float, rounded. A
  /// duration becomes one of another period if it is a whole number of these. The number of a
  /// duration is its count. A time point is a duration since the epoch of its clock, too. Throws
  /// lot::Error and std::bad_alloc.
  template <class T>
  T as() const {
    if constexpr (std::is_same_v<T, std::string_view>) {
      return text();
    } else if constexpr (std::is_same_v<T, std::string>) {
      return std::string(text());
    } else if constexpr (std::is_enum_v<T>) {
      return static_cast<T>(as<std::underlying_type_t<T>>());
    } else if constexpr (detail::Chrono<T>::is_duration) {
      using Rep = typename T::rep;
      return T(number_as<Rep>(ticks(detail::Chrono<T>::period, std::is_floating_point_v<Rep>)));
    } else if constexpr (detail::Chrono<T>::is_time_point) {
      require_clock(detail::Chrono<T>::clock);
      return T(as<typename T::duration>());
    } else {
      static_assert(std::is_arithmetic_v<T>,
                    "lot: a value can be a number, bool, char, enum, std::string, "
                    "std::string_view, duration or time point");
      return number_as<T>(number());
    }
  }
  /// The bytes as they lie, without a copy: of a string its text, of a vector or an array all
  /// elements; of anything else its own. They lie as the elements' alignment wants it, but for
  /// structs, which may be packed. Throws lot::Error, also for what has vectors, strings or
  /// references in it (EINVAL).
  Bytes bytes() const;
  /// Where it lies. Throws nothing.
  const void* address() const noexcept { return at_; }

 private:
  friend class MutableValue;
  friend struct detail::ValueAccess;

  /// What an array or a vector has.
  struct Items {
    const unsigned char* data = nullptr;
    std::uint64_t count = 0;
    std::uint64_t stride = 0;
    std::uint32_t type = 0;
  };

  template <class T>
  T number_as(const detail::Number& number) const {
    T result{};
    if (!number.to(result)) cannot_have(number);
    return result;
  }
  detail::Number number() const;
  detail::Number ticks(detail::Period wanted, bool rounded) const;
  void require_clock(const char* name) const;
  std::string_view text() const;
  [[noreturn]] void cannot_have(const detail::Number& number) const;

  const Description* all_;
  detail::Range range_;
  const unsigned char* at_;
  std::uint32_t place_ = 0;  ///< of its type
  std::uint32_t bit_ = 0;    ///< of a bit-field: the first bit
  std::uint32_t bits_ = 0;   ///< of a bit-field: how many; 0: it is none
  detail::Way way_;
};

/// Goes over the fields of a struct, or the elements of an array or a vector.
///
/// Threads: one at a time.
/// Errors:  as Value.
/// Memory:  valid as long as the message and its description.
/// Crash:   as Value.
class Value::Iterator {
 public:
  using iterator_category = std::input_iterator_tag;
  using value_type = Value;
  using difference_type = std::ptrdiff_t;
  using pointer = void;
  using reference = Value;

  /// The field or element. Throws lot::Error.
  Value operator*() const;
  /// The next. Throws nothing.
  Iterator& operator++() noexcept {
    ++next_;
    return *this;
  }
  /// The next. Throws nothing.
  Iterator operator++(int) noexcept {
    Iterator before = *this;
    ++next_;
    return before;
  }
  friend bool operator==(const Iterator& a, const Iterator& b) noexcept {
    return a.left() == b.left();
  }
  friend bool operator!=(const Iterator& a, const Iterator& b) noexcept { return !(a == b); }

 private:
  friend class Value;
  Iterator(const Value& of, const Items& items) noexcept : of_(of), items_(items) {}
  std::uint64_t left() const noexcept { return items_.count - next_; }

  Value of_;
  Items items_;
  std::uint64_t next_ = 0;
};

inline Value::Iterator Value::end() const noexcept { return {*this, Items{}}; }

/// The value as a text of one line: `{width: 640, name: "left", data: [1, 2, 3, ... 921600 in
/// all]}`. What is damaged is said in place: `<damaged>`. Throws std::bad_alloc.
std::string to_string(const Value& value, const TextLimits& limits = TextLimits());
/// Prints it. Throws std::bad_alloc, and what the stream throws.
inline std::ostream& operator<<(std::ostream& out, const Value& value) {
  return out << to_string(value);
}

}  // namespace lot
