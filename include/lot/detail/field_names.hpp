// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>

#include "lot/detail/fields.hpp"

/// The names of an aggregate's fields: from LOT_DESCRIBE, or, from C++20 on, from the compiler.
///
/// C++ cannot say the name of a member. But a compiler says what a template argument is, and a
/// pointer to a member of an object may be one. The object needs no definition, so its type may be
/// anything:
///
///     extern const Nowhere<Frame> nowhere;
///     spelled<Pointer{&nowhere.value.width}>()   "... {&nowhere.value.width}]"
///
/// clang 14 takes such a pointer only within a struct; all others take it so, too.
///
/// Limits:  no field of a struct with bit-fields has a name: to name one the compiler would read
///          the bit-fields beside it, of an object that is not there.
/// Source:  the way of S. Liu's reflect-cpp and of glaze.
namespace lot::detail {

/// What LOT_DESCRIBE has said of T.
template <typename T, typename = void>
struct SaidNames {
  static constexpr bool known = false;
};
template <typename T>
struct SaidNames<T, std::void_t<decltype(lot_field_names(static_cast<const T*>(nullptr)))>> {
  static constexpr bool known = true;
  static constexpr auto names = lot_field_names(static_cast<const T*>(nullptr));
};

/// Whether each offset is at least the one before it.
template <std::size_t N>
constexpr bool in_order(const std::size_t (&offsets)[N]) {
  for (std::size_t i = 1; i < N; ++i) {
    if (offsets[i] < offsets[i - 1]) return false;
  }
  return true;
}
/// Whether no name occurs twice.
template <std::size_t N>
constexpr bool all_differ(const std::array<std::string_view, N>& names) {
  for (std::size_t i = 0; i < N; ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      if (names[i] == names[j]) return false;
    }
  }
  return true;
}

// Both may be in one program: what has names is not what has none.
#if __cplusplus >= 202002L
#define LOT_NAMES named_by_compiler
#else
#define LOT_NAMES named_by_hand
#endif

inline namespace LOT_NAMES {

#if __cplusplus >= 202002L

#pragma GCC diagnostic push
#ifdef __clang__  // nowhere is never defined: only its address is named
#pragma GCC diagnostic ignored "-Wundefined-var-template"
#pragma GCC diagnostic ignored "-Wundefined-internal"
#endif

template <typename T>
struct Nowhere {
  T value;
};
template <typename T>
extern const Nowhere<T> nowhere;

template <typename T>
struct Pointer {
  const T* to;
};

/// The compiler's words for what P points to.
template <Pointer P>
constexpr std::string_view spelled() {
  return __PRETTY_FUNCTION__;
}

/// Field I of that object.
template <std::size_t I, typename T>
constexpr auto pointer_to_field(const T& object) {
  return with_fields(object, [](const auto&... field) {
    const auto& chosen = std::get<I>(std::tie(field...));
    return Pointer<std::remove_const_t<std::remove_reference_t<decltype(chosen)>>>{&chosen};
  });
}

/// The identifier at the end of a pointer in the compiler's words.
constexpr std::string_view last_name(std::string_view words) {
#ifdef __clang__
  constexpr std::string_view kEnd = "}]";  // ... [P = Pointer<int>{&nowhere.value.width}]
#else
  // ... [with ... P = Pointer<int>{(& nowhere<Frame>.Nowhere<Frame>::value.Frame::width)}; ...]
  constexpr std::string_view kEnd = ")}";
#endif
  words = words.substr(0, words.rfind(kEnd));
  return words.substr(words.find_last_of(".:") + 1);
}

/// The name of field I of T, or nothing if the compiler has none.
template <typename T, std::size_t I>
constexpr std::string_view name_of_field() {
  if constexpr (requires { spelled<pointer_to_field<I>(nowhere<T>.value)>(); }) {
    return last_name(spelled<pointer_to_field<I>(nowhere<T>.value)>());
  } else {
    return {};
  }
}

#pragma GCC diagnostic pop

#else

/// C++17 cannot tell.
template <typename T, std::size_t I>
constexpr std::string_view name_of_field() {
  return {};
}

#endif

template <typename T, std::size_t... I>
constexpr std::array<std::string_view, sizeof...(I)> names_of_fields(std::index_sequence<I...>) {
  return {name_of_field<T, I>()...};
}

/// The names of T's fields, in order; empty ones where neither has them.
///
/// REQUIRES: as field_types.
template <typename T>
constexpr auto field_names() {
  if constexpr (SaidNames<T>::known) {
    return SaidNames<T>::names;
  } else {
    return names_of_fields<T>(std::make_index_sequence<Fields<T>::count>{});
  }
}

}  // namespace LOT_NAMES
}  // namespace lot::detail

// clang-format off
#define LOT_DETAIL_EACH_1(m, t, a) m(t, a)
#define LOT_DETAIL_EACH_2(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_1(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_3(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_2(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_4(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_3(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_5(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_4(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_6(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_5(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_7(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_6(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_8(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_7(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_9(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_8(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_10(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_9(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_11(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_10(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_12(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_11(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_13(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_12(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_14(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_13(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_15(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_14(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_16(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_15(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_17(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_16(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_18(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_17(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_19(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_18(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_20(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_19(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_21(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_20(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_22(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_21(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_23(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_22(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_24(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_23(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_25(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_24(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_26(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_25(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_27(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_26(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_28(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_27(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_29(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_28(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_30(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_29(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_31(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_30(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_32(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_31(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_33(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_32(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_34(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_33(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_35(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_34(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_36(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_35(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_37(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_36(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_38(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_37(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_39(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_38(m, t, __VA_ARGS__)
#define LOT_DETAIL_EACH_40(m, t, a, ...) m(t, a), LOT_DETAIL_EACH_39(m, t, __VA_ARGS__)
#define LOT_DETAIL_PICK(_1, _2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13, _14, _15, _16, \
  _17, _18, _19, _20, _21, _22, _23, _24, _25, _26, _27, _28, _29, _30, _31, _32, _33, _34,    \
  _35, _36, _37, _38, _39, _40, chosen, ...) chosen
#define LOT_DETAIL_EACH(m, t, ...) LOT_DETAIL_PICK(__VA_ARGS__, LOT_DETAIL_EACH_40, \
  LOT_DETAIL_EACH_39, LOT_DETAIL_EACH_38, LOT_DETAIL_EACH_37, LOT_DETAIL_EACH_36,   \
  LOT_DETAIL_EACH_35, LOT_DETAIL_EACH_34, LOT_DETAIL_EACH_33, LOT_DETAIL_EACH_32,   \
  LOT_DETAIL_EACH_31, LOT_DETAIL_EACH_30, LOT_DETAIL_EACH_29, LOT_DETAIL_EACH_28,   \
  LOT_DETAIL_EACH_27, LOT_DETAIL_EACH_26, LOT_DETAIL_EACH_25, LOT_DETAIL_EACH_24,   \
  LOT_DETAIL_EACH_23, LOT_DETAIL_EACH_22, LOT_DETAIL_EACH_21, LOT_DETAIL_EACH_20,   \
  LOT_DETAIL_EACH_19, LOT_DETAIL_EACH_18, LOT_DETAIL_EACH_17, LOT_DETAIL_EACH_16,   \
  LOT_DETAIL_EACH_15, LOT_DETAIL_EACH_14, LOT_DETAIL_EACH_13, LOT_DETAIL_EACH_12,   \
  LOT_DETAIL_EACH_11, LOT_DETAIL_EACH_10, LOT_DETAIL_EACH_9, LOT_DETAIL_EACH_8,     \
  LOT_DETAIL_EACH_7, LOT_DETAIL_EACH_6, LOT_DETAIL_EACH_5, LOT_DETAIL_EACH_4,       \
  LOT_DETAIL_EACH_3, LOT_DETAIL_EACH_2, LOT_DETAIL_EACH_1, 0)(m, t, __VA_ARGS__)
#define LOT_DETAIL_TEXT(type, field) std::string_view(#field)
#define LOT_DETAIL_OFFSET(type, field) offsetof(type, field)
// clang-format on
