// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <memory>
#include <new>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "lot/compliance.hpp"
#include "lot/description.hpp"
#include "lot/detail/type_name.hpp"
#include "lot/message.hpp"
#include "lot/type_identity.hpp"

/// Makes the Description of a message type, by the walk that compliance.hpp checks it by.
namespace lot {
namespace detail {

/// Says what a type is made of that the walk below does not understand: say, one that
/// is_trusted_message vouches for, which is opaque otherwise. A specialisation has `known` = true
/// and fills a Type by a Describer, with its kind, its name and what lies in it:
///
///     template <class D>
///     static void fill(D& describer, Description::Type& type);  // throws std::bad_alloc
template <class T>
struct DescribedBy {
  static constexpr bool known = false;
};

inline namespace LOT_NAMES {

/// What makes a description: types that were met before are not described again.
class Describer {
 public:
  Describer() { result_.types.reserve(kUsual); }
  /// The place of T in the list.
  template <class T>
  std::uint32_t add() {
    using Plain = std::remove_cv_t<T>;
    const auto [known, is_new] =
        places_.emplace(&key<Plain>, static_cast<std::uint32_t>(result_.types.size()));
    const std::uint32_t place = known->second;
    if (is_new) {
      result_.types.emplace_back();
      Description::Type type = of<Plain>();  // the list may grow meanwhile
      result_.types[place] = std::move(type);
    }
    return place;
  }
  Description take() && { return std::move(result_); }

  // For fill().
  template <class F>
  void add_field(Description::Type& type, std::string name, std::uint64_t offset) {
    Description::Field field;
    field.name = std::move(name);
    field.offset = offset;
    field.type = add<F>();
    type.fields.push_back(std::move(field));
  }
  template <class Element>
  void fill_array(Description::Type& type, std::uint64_t count) {
    type.kind = Kind::Array;
    type.count = count;
    type.element = add<Element>();
  }

 private:
  /// Its address stands for T.
  template <class T>
  static inline constexpr char key = 0;

  template <class T>
  Description::Type of() {
    Description::Type type;
    type.size = sizeof(T);
    if constexpr (std::is_arithmetic_v<T> || std::is_same_v<T, std::byte>) {
      type.kind = kind_of_number<T>();
      if (type.kind == Kind::Opaque) type.name = TypeIdentity<T>::name();
    } else if constexpr (std::is_enum_v<T>) {
      type.kind = Kind::Enum;
      type.name = TypeIdentity<T>::name();
      type.element = add<std::underlying_type_t<T>>();
    } else if constexpr (std::is_array_v<T>) {
      fill_array<std::remove_extent_t<T>>(type, std::extent_v<T>);
    } else if constexpr (is_a<T, ShmRef>) {
      type.kind = Kind::Reference;
      type.element = add_target<typename T::element_type>();
    } else if constexpr (DescribedBy<T>::known) {
      DescribedBy<T>::fill(*this, type);
    } else if constexpr (is_trusted_message<T>::value) {
      type.name = TypeIdentity<T>::name();
    } else if constexpr (StdParts<T>::known) {
      fill_standard(type, static_cast<const T*>(nullptr));
    } else if constexpr (Container<T>::known) {
      fill_container<T>(type);
    } else {
      type.kind = Kind::Struct;
      type.name = TypeIdentity<T>::name();
      fill_struct<T>(type, field_types<T>{});
    }
    return type;
  }

  /// A reference may lead to a part of another message, which need not be a message.
  template <class T>
  std::uint32_t add_target() {
    using Plain = std::remove_cv_t<T>;
    if constexpr (is_message_v<Plain>) {
      return add<Plain>();
    } else {
      const auto [known, is_new] =
          places_.emplace(&key<Plain>, static_cast<std::uint32_t>(result_.types.size()));
      if (is_new) {
        Description::Type& type = result_.types.emplace_back();
        type.size = sizeof(Plain);
        type.name = TypeIdentity<Plain>::name();
      }
      return known->second;
    }
  }

  /// Opaque: a number that C++ does not name, such as __int128 and __float128.
  template <class T>
  static constexpr Kind kind_of_number() {
    constexpr bool is_real =
        std::is_same_v<T, float> || std::is_same_v<T, double> || std::is_same_v<T, long double>;
    if constexpr (std::is_same_v<T, bool>) {
      return Kind::Bool;
    } else if constexpr (std::is_same_v<T, char>) {
      return Kind::Char;
    } else if constexpr (is_real) {
      return Kind::Float;
    } else if constexpr (std::is_floating_point_v<T> || sizeof(T) > sizeof(std::uint64_t)) {
      return Kind::Opaque;
    } else if constexpr (std::is_signed_v<T>) {
      return Kind::Int;
    } else {
      return Kind::UInt;
    }
  }

  // ---- standard types whose bytes are just those of their parts ----

  /// A container that has its elements in itself.
  template <class T>
  void fill_standard(Description::Type& type, const T*) {
    fill_opaque_container<T>(type);
  }

  template <class T, std::size_t N>
  void fill_standard(Description::Type& type, const std::array<T, N>*) {
    if constexpr (N == 0) {  // which takes a byte or more
      type.kind = Kind::Struct;
      type.name = TypeIdentity<std::array<T, 0>>::name();
    } else {
      fill_array<T>(type, N);
    }
  }
  template <class A, class B>
  void fill_standard(Description::Type& type, const std::pair<A, B>*) {
    using Pair = std::pair<A, B>;
    type.kind = Kind::Struct;
    type.name = TypeIdentity<Pair>::name();
    const Room<Pair> room;
    add_field<A>(type, "first", room.offset_of(room.object().first));
    add_field<B>(type, "second", room.offset_of(room.object().second));
  }
  template <class... T>
  void fill_standard(Description::Type& type, const std::tuple<T...>*) {
    type.kind = Kind::Struct;
    type.name = TypeIdentity<std::tuple<T...>>::name();
    fill_tuple<T...>(type, std::index_sequence_for<T...>{});
  }
  template <class T>
  void fill_standard(Description::Type& type, const std::complex<T>*) {
    type.kind = Kind::Struct;
    type.name = TypeIdentity<std::complex<T>>::name();
    add_field<T>(type, "real", 0);
    add_field<T>(type, "imag", sizeof(T));
  }
  template <class Rep, class Period>
  void fill_standard(Description::Type& type, const std::chrono::duration<Rep, Period>*) {
    type.kind = Kind::Duration;
    type.element = add<Rep>();
    type.numerator = Period::num;
    type.denominator = Period::den;
  }
  template <class Clock, class Span>
  void fill_standard(Description::Type& type, const std::chrono::time_point<Clock, Span>*) {
    type.kind = Kind::TimePoint;
    type.name = name_of_clock<Clock>();
    type.element = add<Span>();
  }
  /// As what it holds, where that lies alike; it may have padding.
  template <class T>
  void fill_standard(Description::Type& type, const std::atomic<T>*) {
    if constexpr (sizeof(T) == sizeof(std::atomic<T>)) {
      type = of<T>();
    } else {
      type.kind = Kind::Struct;
      type.name = TypeIdentity<std::atomic<T>>::name();
      add_field<T>(type, "value", 0);
    }
  }

  template <class... T, std::size_t... I>
  void fill_tuple(Description::Type& type, std::index_sequence<I...>) {
    const Room<std::tuple<T...>> room;
    (add_field<T>(type, std::to_string(I), room.offset_of(std::get<I>(room.object()))), ...);
  }

  /// The C++ libraries put their clocks into namespaces of their own.
  template <class Clock>
  static std::string name_of_clock() {
    if (std::is_same_v<Clock, std::chrono::system_clock>) return "system_clock";
    if (std::is_same_v<Clock, std::chrono::steady_clock>) return "steady_clock";
    return NameOf<Clock>::text();
  }

  // ---- containers ----

#ifdef _LIBCPP_VERSION
  static constexpr const char* kLibrary = "libc++";
#else
  static constexpr const char* kLibrary = "libstdc++";
#endif

  template <class T>
  void fill_container(Description::Type& type) {
    if constexpr (std::is_base_of_v<ShmString, T>) {  // one of ROS has another name
      type.kind = Kind::String;
      type.name = kLibrary;
      type.element = add<char>();
    } else if constexpr (is_a<T, std::vector>) {
      type.kind = Kind::Vector;
      type.name = kLibrary;
      type.element = add<typename T::value_type>();
    } else {
      fill_opaque_container<T>(type);
    }
  }
  template <class T>
  void fill_opaque_container(Description::Type& type) {
    type.name = TypeIdentity<T>::name();
    type.element = add<typename T::value_type>();
  }

  // ---- structs ----

  /// Room for a T that is never built: only the addresses of its fields are asked for, and bits
  /// that it sets itself.
  template <class T>
  class Room {
   public:
    Room() : bytes_(static_cast<unsigned char*>(::operator new(sizeof(T), kAlign))) {}
    ~Room() { ::operator delete(bytes_, kAlign); }
    Room(const Room&) = delete;
    Room& operator=(const Room&) = delete;
    const T& object() const { return *reinterpret_cast<const T*>(bytes_); }
    unsigned char* bytes() const { return bytes_; }
    /// Of a copy elsewhere: sizeof(T) or more.
    template <class F>
    LOT_MAY_BE_PACKED std::uint64_t offset_of(const F& field) const {
      return reinterpret_cast<std::uintptr_t>(__builtin_addressof(field)) -
             reinterpret_cast<std::uintptr_t>(bytes_);
    }

   private:
    static constexpr std::align_val_t kAlign{alignof(T)};
    unsigned char* bytes_;
  };

  template <class T, class... F>
  void fill_struct(Description::Type& type, Types<F...>) {
    constexpr std::size_t not_aligned =
        (std::size_t{0} + ... + (alignof(F) > alignof(T) ? sizeof(F) : 0));
    if constexpr (not_aligned > kMostCopied) {
      type.kind = Kind::Opaque;  // g++ may copy such fields of a packed struct onto the stack
      return;
    }
    [[maybe_unused]] constexpr auto names = field_names<T>();  // there may be no field
    const Room<T> room;
    const std::vector<std::uint64_t> offsets =
        with_fields(room.object(), [&](const auto&... f) LOT_MAY_BE_PACKED {
          return std::vector<std::uint64_t>{room.offset_of(f)...};
        });
    type.fields.reserve(sizeof...(F));
    std::size_t i = 0;
    ((add_field<F>(type, std::string(names[i]), offsets[i]), ++i), ...);
    find_bits(type, room);
  }

  /// Bit-fields have no address, nor have fields that `packed` put where their type may not lie:
  /// g++ hands out copies of them. Such a field is asked what has changed in it while the bytes of
  /// a room change.
  template <class T>
  void find_bits(Description::Type& type, const Room<T>& room) {
    std::uint64_t from = 0;  // the first bit behind the fields before
    bool is_first = true;
    for (std::size_t i = 0; i < type.fields.size(); ++i) {
      Description::Field& field = type.fields[i];
      const Description::Type& its = result_.types[field.type];
      if (field.offset >= sizeof(T)) {
        if (std::exchange(is_first, false)) std::memset(room.bytes(), 0, sizeof(T));
        if (!look_at(room, i).is_number) {
          field.offset = place_of(i, its.size, room);
        } else if (!find_bits(field, i, room, from) && !find_bits(field, i, room, 0)) {
          field.offset = 0;  // it has no bits
        }
      }
      const bool is_empty = its.kind == Kind::Struct && its.fields.empty();
      from = field.bits != 0 ? 8 * field.offset + field.bit + field.bits
                             : 8 * (field.offset + (is_empty ? 0 : its.size));
    }
  }
  /// A number or an enum may have a part of its bits. Each bit is set by itself, from that one on:
  /// the field lies behind those before it, but beside an empty one, or in the padding of another,
  /// it may lie anywhere. False: it is not there. REQUIRES: all bytes are zero.
  template <class T>
  static bool find_bits(Description::Field& field, std::size_t i, const Room<T>& room,
                        std::uint64_t from) {
    std::uint64_t size = 0;
    std::uint32_t bits = 0;
    for (std::uint64_t b = from; b < 8 * sizeof(T); ++b) {
      room.bytes()[b / 8] = static_cast<unsigned char>(1U << (b % 8));
      const Look look = look_at(room, i);
      room.bytes()[b / 8] = 0;
      if (!look.is_set && bits != 0) break;
      if (look.is_set && bits++ == 0) {
        size = look.size;
        field.offset = b / 8;
        field.bit = b % 8;
      }
    }
    const bool is_whole = field.bit == 0 && bits == 8 * size;
    field.bits = is_whole ? 0 : bits;
    return bits != 0;
  }
  /// Anything else begins with a byte of its own: each byte of the room is told where it lies,
  /// digit by digit. Leaves all bytes zero.
  template <class T>
  static std::uint64_t place_of(std::size_t i, std::uint64_t size, const Room<T>& room) {
    std::uint64_t place = 0;
    for (std::uint64_t digit = 0; digit == 0 || (sizeof(T) - 1) >> digit != 0; digit += 8) {
      for (std::uint64_t k = 0; k < sizeof(T); ++k) {
        room.bytes()[k] = static_cast<unsigned char>(k >> digit);
      }
      place |= std::uint64_t{look_at(room, i).first} << digit;
    }
    std::memset(room.bytes(), 0, sizeof(T));
    return place <= sizeof(T) - size ? place : 0;
  }

  /// What stands in a field.
  struct Look {
    bool is_number = false;   ///< or an enum
    bool is_set = false;      ///< of a number
    std::uint64_t size = 0;   ///< of its type
    unsigned char first = 0;  ///< its first byte
  };
  template <class T>
  LOT_MAY_BE_PACKED static Look look_at(const Room<T>& room, std::size_t i) {
    return with_fields(room.object(), [i](const auto&... f) LOT_MAY_BE_PACKED {
      Look look;
      std::size_t k = 0;
      ((k++ == i ? void(look = look_at(f)) : void()), ...);
      return look;
    });
  }
  template <class F>
  LOT_MAY_BE_PACKED static Look look_at(const F& value) {
    if constexpr (std::is_integral_v<F> || std::is_enum_v<F>) {
      return {true, value != F{}, sizeof(F), 0};
    } else {
      return {false, false, sizeof(F),
              *reinterpret_cast<const volatile unsigned char*>(__builtin_addressof(value))};
    }
  }

  static constexpr std::size_t kUsual = 32;  ///< most messages have fewer types
  static constexpr std::size_t kMostCopied = std::size_t{1} << 20;

  Description result_;
  std::map<const char*, std::uint32_t> places_;
};

}  // namespace LOT_NAMES
}  // namespace detail

inline namespace LOT_NAMES {

/// What T is made of. It is made once in a program, or shared object, by the first call, and lives
/// as long as the process. The compiler refuses a T that is no message. The first call throws
/// std::bad_alloc.
template <class T>
[[gnu::visibility("hidden")]] const Description& describe() {
  static_assert(assert_message<T>());
  // Never destroyed: static objects may publish in their destructors.
  static const auto* const description = [] {
    detail::Describer describer;
    describer.add<T>();
    return new Description(std::move(describer).take());
  }();
  return *description;
}

}  // namespace LOT_NAMES
}  // namespace lot
