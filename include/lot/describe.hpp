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
    } else if constexpr (std::is_enum_v<T>) {
      type.kind = Kind::Enum;
      type.name = TypeIdentity<T>::name();
      type.element = add<std::underlying_type_t<T>>();
    } else if constexpr (std::is_array_v<T>) {
      fill_array<std::remove_extent_t<T>>(type, std::extent_v<T>);
    } else if constexpr (is_a<T, ShmRef>) {
      type.kind = Kind::Reference;
      type.element = add<typename T::element_type>();
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

  template <class T>
  static constexpr Kind kind_of_number() {
    if constexpr (std::is_same_v<T, bool>) {
      return Kind::Bool;
    } else if constexpr (std::is_same_v<T, char>) {
      return Kind::Char;
    } else if constexpr (std::is_floating_point_v<T>) {
      return Kind::Float;
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
    fill_array<T>(type, N);
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
    std::uint64_t offset_of(const F& field) const {
      return reinterpret_cast<std::uintptr_t>(std::addressof(field)) -
             reinterpret_cast<std::uintptr_t>(bytes_);
    }

   private:
    static constexpr std::align_val_t kAlign{alignof(T)};
    unsigned char* bytes_;
  };

  template <class T, class... F>
  void fill_struct(Description::Type& type, Types<F...>) {
    [[maybe_unused]] constexpr auto names = field_names<T>();  // there may be no field
    const Room<T> room;
    const std::vector<std::uint64_t> offsets = with_fields(room.object(), [&](const auto&... f) {
      return std::vector<std::uint64_t>{room.offset_of(f)...};
    });
    type.fields.reserve(sizeof...(F));
    std::size_t i = 0;
    ((add_field<F>(type, std::string(names[i]), offsets[i]), ++i), ...);
    find_bits(type, room);
  }

  /// Bit-fields have no address, nor have fields that `packed` put where their type may not lie:
  /// g++ hands out copies of them. They lie between those that have one. So each bit there is set
  /// by itself, and the fields are asked which of them has changed.
  template <class T>
  void find_bits(Description::Type& type, const Room<T>& room) {
    std::uint64_t end = 0;  // of what lies before
    for (std::size_t i = 0; i < type.fields.size(); ++i) {
      if (type.fields[i].offset < sizeof(T)) {
        const Description::Type& field = result_.types[type.fields[i].type];
        const bool is_empty = field.kind == Kind::Struct && field.fields.empty();
        end = type.fields[i].offset + (is_empty ? 0 : field.size);
        continue;
      }
      std::size_t next = i;
      while (next < type.fields.size() && type.fields[next].offset >= sizeof(T)) ++next;
      const std::uint64_t before = end;
      end = next < type.fields.size() ? type.fields[next].offset : sizeof(T);
      const std::uint64_t begin = std::min(before, end);  // an empty field may lie anywhere
      for (; i < next; ++i) find_bits(type.fields[i], i, room, begin, end);
      --i;
    }
  }
  template <class T>
  static void find_bits(Description::Field& field, std::size_t i, const Room<T>& room,
                        std::uint64_t begin, std::uint64_t end) {
    std::memset(room.bytes() + begin, 0, end - begin);
    field.bits = 0;
    std::uint64_t size = 0;
    for (std::uint64_t b = 8 * begin; b < 8 * end; ++b) {
      room.bytes()[b / 8] = static_cast<unsigned char>(1U << (b % 8));
      if (const Set set = what_is_set(room.object(), i); set.is_set) {
        if (field.bits == 0) {
          field.offset = b / 8 - set.byte;
          field.bit = b % 8;
        }
        size = set.size;
        ++field.bits;
      }
      room.bytes()[b / 8] = 0;
    }
    if (field.bit == 0 && (size == 0 || field.bits == 8 * size)) field.bits = 0;  // all of its type
  }

  /// What the bit that is set does in a field.
  struct Set {
    bool is_set = false;
    std::uint64_t byte = 0;  ///< where in its type, if that is no number
    std::uint64_t size = 0;  ///< of a number or an enum, which alone can have a part of its bits
  };
  template <class T>
  static Set what_is_set(const T& object, std::size_t i) {
    return with_fields(object, [i](const auto&... f) {
      Set set;
      std::size_t k = 0;
      ((k++ == i ? void(set = what_is_set(f)) : void()), ...);
      return set;
    });
  }
  template <class F>
  static Set what_is_set(const F& value) {
    if constexpr (std::is_integral_v<F> || std::is_enum_v<F>) {
      return {value != F{}, 0, sizeof(F)};
    } else if constexpr (std::is_trivially_copyable_v<F>) {
      const auto* const bytes = reinterpret_cast<const unsigned char*>(std::addressof(value));
      for (std::uint64_t k = 0; k < sizeof(F); ++k) {
        if (bytes[k] != 0) return {true, k, 0};
      }
      return {};
    } else {
      return {};  // has an address
    }
  }

  static constexpr std::size_t kUsual = 32;  ///< most messages have fewer types

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
