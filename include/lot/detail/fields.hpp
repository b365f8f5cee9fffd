// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdlib>
#include <type_traits>
#include <utility>

/// Names the fields of an aggregate, so that compliance.hpp can look at each one.
///
/// C++17 cannot list members. It can say whether `T{a, b, c}` compiles, and it
/// can take a T apart with structured bindings once the number of fields is
/// known. So the fields are counted by initialising one more of them at a time
/// from a *probe*, an object that claims to convert to everything:
///
///     struct Frame { int id; char name[32]; Empty tag; };
///     Frame{{any}}                     compiles: a first field, in braces
///     Frame{{any}, {any}}              compiles: a second; its braces hold name in one piece
///     Frame{{any}, {any}, {any}}       does not: nothing is inside an Empty
///     Frame{{any}, {any}, any}         compiles: a third, without braces
///     Frame{{any}, {any}, any, any}    does not, in any form: three fields
///
/// Braces come first because a bare probe cannot become a C array: the language
/// would then spread it over the elements ("brace elision") and 16 MiB of bytes
/// would count as 16 Mi fields.
///
/// Nothing here is ever evaluated; everything is a type or a constant. The probes
/// have bodies only because clang may look at a constructor that would call them.
///
/// Limits:  kMaxFields fields. A type with an anonymous union or an anonymous
///          struct (a GNU extension) cannot be bound: see some_field_takes().
///          g++ 12 stops, instead of answering no, at `T{}` if T holds an array
///          of a class whose only constructor takes a std::initializer_list.
/// Source:  A. Polukhin, Boost.PFR, for counting by conversion.
namespace lot::detail {

/// The most fields that field_types can name.
inline constexpr std::size_t kMaxFields = 40;

/// A list of types, as a value that can be passed to a function.
template <typename... T>
struct Types {};

/// The probe for a field of Owner that is made from a value, movable or not.
template <typename Owner>
struct AnyValue {
  template <typename U, typename = std::enable_if_t<!std::is_same_v<U, Owner>>>
  operator U() const noexcept {
    std::abort();
  }
};

/// The probe for a field of Owner that is an lvalue reference.
template <typename Owner>
struct AnyRef {
  template <typename U, typename = std::enable_if_t<!std::is_same_v<U, Owner>>>
  operator U&() const noexcept {
    std::abort();
  }
};

/// Whether `{}` makes a U where an initialiser was left out; explicit constructors do not count.
template <typename U, typename = void>
inline constexpr bool may_be_left_out = false;
template <typename U>
inline constexpr bool
    may_be_left_out<U, std::void_t<decltype(std::declval<void (&)(const U&)>()({}))>> = true;

/// The probe for a field of Owner that must not be left out.
template <typename Owner>
struct AnyMandatory {
  template <typename U,
            typename = std::enable_if_t<!std::is_same_v<U, Owner> && !may_be_left_out<U>>>
  operator U() const noexcept {
    std::abort();
  }
};

/// The probe that only a base class of Owner can be made from.
template <typename Owner>
struct AnyBase {
  template <typename U,
            typename = std::enable_if_t<std::is_base_of_v<U, Owner> && !std::is_same_v<U, Owner>>>
  operator U() const noexcept {
    std::abort();
  }
};

/// One place in an initialiser list: `{probe}`, a bare `probe`, or nothing at all.
///
/// Each of the two lists holds at most one probe. An empty list leaves no trace
/// in the initialiser, which is what lets FitsExactly mix the forms freely.
template <typename InBraces, typename Bare>
struct Slot {};
template <typename Probe>
using Braced = Slot<Types<Probe>, Types<>>;
template <typename Probe>
using Bare = Slot<Types<>, Types<Probe>>;
using Unused = Slot<Types<>, Types<>>;

// clang-format off
// LOT_LISTn(x) is x(0), x(1), ... x(n-1). Undefined again at the end of this file.
#define LOT_LIST1(x) x(0)
#define LOT_LIST2(x) LOT_LIST1(x), x(1)
#define LOT_LIST3(x) LOT_LIST2(x), x(2)
#define LOT_LIST4(x) LOT_LIST3(x), x(3)
#define LOT_LIST5(x) LOT_LIST4(x), x(4)
#define LOT_LIST6(x) LOT_LIST5(x), x(5)
#define LOT_LIST7(x) LOT_LIST6(x), x(6)
#define LOT_LIST8(x) LOT_LIST7(x), x(7)
#define LOT_LIST9(x) LOT_LIST8(x), x(8)
#define LOT_LIST10(x) LOT_LIST9(x), x(9)
#define LOT_LIST11(x) LOT_LIST10(x), x(10)
#define LOT_LIST12(x) LOT_LIST11(x), x(11)
#define LOT_LIST13(x) LOT_LIST12(x), x(12)
#define LOT_LIST14(x) LOT_LIST13(x), x(13)
#define LOT_LIST15(x) LOT_LIST14(x), x(14)
#define LOT_LIST16(x) LOT_LIST15(x), x(15)
#define LOT_LIST17(x) LOT_LIST16(x), x(16)
#define LOT_LIST18(x) LOT_LIST17(x), x(17)
#define LOT_LIST19(x) LOT_LIST18(x), x(18)
#define LOT_LIST20(x) LOT_LIST19(x), x(19)
#define LOT_LIST21(x) LOT_LIST20(x), x(20)
#define LOT_LIST22(x) LOT_LIST21(x), x(21)
#define LOT_LIST23(x) LOT_LIST22(x), x(22)
#define LOT_LIST24(x) LOT_LIST23(x), x(23)
#define LOT_LIST25(x) LOT_LIST24(x), x(24)
#define LOT_LIST26(x) LOT_LIST25(x), x(25)
#define LOT_LIST27(x) LOT_LIST26(x), x(26)
#define LOT_LIST28(x) LOT_LIST27(x), x(27)
#define LOT_LIST29(x) LOT_LIST28(x), x(28)
#define LOT_LIST30(x) LOT_LIST29(x), x(29)
#define LOT_LIST31(x) LOT_LIST30(x), x(30)
#define LOT_LIST32(x) LOT_LIST31(x), x(31)
#define LOT_LIST33(x) LOT_LIST32(x), x(32)
#define LOT_LIST34(x) LOT_LIST33(x), x(33)
#define LOT_LIST35(x) LOT_LIST34(x), x(34)
#define LOT_LIST36(x) LOT_LIST35(x), x(35)
#define LOT_LIST37(x) LOT_LIST36(x), x(36)
#define LOT_LIST38(x) LOT_LIST37(x), x(37)
#define LOT_LIST39(x) LOT_LIST38(x), x(38)
#define LOT_LIST40(x) LOT_LIST39(x), x(39)
#define LOT_LIST41(x) LOT_LIST40(x), x(40)

#define LOT_PACKS(n) typename... B##n, typename... P##n
#define LOT_SLOT(n) Slot<Types<B##n...>, Types<P##n...>>
#define LOT_INIT(n) {B##n{}}..., P##n{}...
// clang-format on

// GCC's -Wconversion remarks even on an initialiser that is only asked about: one that prefers
// std::optional's own converting constructor to the probe.
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wconversion"
/// Whether `T{slots...}` compiles. Takes exactly kMaxFields + 1 slots.
template <typename T, typename SlotList, typename = void>
struct FitsExactly : std::false_type {};
template <typename T, LOT_LIST41(LOT_PACKS)>
struct FitsExactly<T, Types<LOT_LIST41(LOT_SLOT)>, std::void_t<decltype(T{LOT_LIST41(LOT_INIT)})>>
    : std::true_type {};
#pragma GCC diagnostic pop

template <std::size_t>
using UnusedAt = Unused;

template <typename T, typename... S, std::size_t... I>
constexpr bool fits_padded(std::index_sequence<I...>) {
  return FitsExactly<T, Types<S..., UnusedAt<I>...>>::value;
}

/// Whether `T{slots...}` compiles. REQUIRES: at most kMaxFields + 1 slots.
template <typename T, typename... S>
inline constexpr bool fits =
    fits_padded<T, S...>(std::make_index_sequence<kMaxFields + 1 - sizeof...(S)>{});

/// Whether `T{slots..., filler, filler, ...}` compiles for some number of fillers.
template <typename T, typename Filler, typename... S>
constexpr bool fits_filled() {
  if constexpr (fits<T, S...>) {
    return true;
  } else if constexpr (sizeof...(S) <= kMaxFields) {
    return fits_filled<T, Filler, S..., Filler>();
  } else {
    return false;
  }
}

/// Whether the field after those in Found... can be made from Next.
///
/// Later fields that must not be left out (references, classes without a default
/// constructor) are filled in, so that they do not hide this one.
template <typename T, typename Next, typename... Found>
constexpr bool next_fits() {
  if constexpr (fits<T, Found..., Next>) {
    return true;
  } else if constexpr (fits<T, Found...>) {
    return false;  // Nothing later is missing, so it is Next that does not fit.
  } else {
    return fits_filled<T, Bare<AnyValue<T>>, Found..., Next>() ||
           fits_filled<T, Bare<AnyRef<T>>, Found..., Next>();
  }
}

/// What slots_of() returns when it cannot tell where the next field ends.
struct Unclear {};

/// One slot for each field of the aggregate T, up to kMaxFields + 1, in order; or Unclear.
///
/// Where braces fail, a bare value may have gone to one field, or to the first
/// element of an array whose next elements must not be left out. It went to a
/// field if nothing must follow it, or if it may be left out itself. Else the two
/// cannot be told apart.
template <typename T, typename... Found>
constexpr auto slots_of() {
  // NOLINTBEGIN(bugprone-branch-clone): answers recur because the order of questions matters.
  if constexpr (sizeof...(Found) > kMaxFields) {
    return Types<Found...>{};
  } else if constexpr (next_fits<T, Braced<AnyValue<T>>, Found...>()) {
    return slots_of<T, Found..., Braced<AnyValue<T>>>();
  } else if constexpr (fits<T, Found..., Bare<AnyValue<T>>>) {
    return slots_of<T, Found..., Bare<AnyValue<T>>>();
  } else if constexpr (next_fits<T, Bare<AnyMandatory<T>>, Found...>()) {
    return Unclear{};
  } else if constexpr (next_fits<T, Bare<AnyValue<T>>, Found...>()) {
    return slots_of<T, Found..., Bare<AnyValue<T>>>();
  } else if constexpr (next_fits<T, Bare<AnyRef<T>>, Found...>()) {
    return slots_of<T, Found..., Bare<AnyRef<T>>>();
  } else if constexpr (fits<T, Found...>) {
    return Types<Found...>{};
  } else {
    return Unclear{};
  }
  // NOLINTEND(bugprone-branch-clone)
}

/// The number of T's fields, where it is clear; kMaxFields + 1 means "that many or more".
template <typename T, typename SlotList = decltype(slots_of<T>())>
struct Fields {
  static constexpr bool clear = false;
};
template <typename T, typename... S>
struct Fields<T, Types<S...>> {
  static constexpr bool clear = true;
  static constexpr std::size_t count = sizeof...(S);
};

/// Whether the aggregate T has a base class.
template <typename T>
inline constexpr bool has_base = next_fits<T, Bare<AnyBase<T>>>();

template <typename T, typename Probe, typename... Before, typename First, typename... Rest>
constexpr bool some_slot_takes(Types<Before...>, Types<First, Rest...>) {
  if constexpr (next_fits<T, Bare<Probe>, Before...>()) {
    return true;
  } else {
    return some_slot_takes<T, Probe>(Types<Before..., First>{}, Types<Rest...>{});
  }
}
template <typename T, typename Probe, typename... Before>
constexpr bool some_slot_takes(Types<Before...>, Types<>) {
  return false;
}

/// Whether some field of T, or the first thing inside it, can be made from Probe.
///
/// Unlike field_types this needs no structured binding, and so it may be asked
/// first about what would make a structured binding ill-formed.
/// REQUIRES: Fields<T> is clear.
template <typename T, typename Probe>
inline constexpr bool some_field_takes = some_slot_takes<T, Probe>(Types<>{},
                                                                   decltype(slots_of<T>()){});

template <typename T>
Types<> bind_fields(T&, std::integral_constant<std::size_t, 0>);
template <typename T, typename Use>
constexpr auto with_fields(const T&, Use&& use, std::integral_constant<std::size_t, 0>) {
  return use();
}

/// A function that only hands on where a field lies: a packed struct has some that are not aligned.
#define LOT_MAY_BE_PACKED __attribute__((no_sanitize("alignment")))

// clang-format off
#define LOT_NAME(n) f##n
#define LOT_TYPE(n) decltype(f##n)
#define LOT_BIND(n)                                                                                \
  template <typename T>                                                                            \
  auto bind_fields(T& object, std::integral_constant<std::size_t, n>) {                            \
    [[maybe_unused]] auto& [LOT_LIST##n(LOT_NAME)] = object;                                       \
    return Types<LOT_LIST##n(LOT_TYPE)>{};                                                         \
  }                                                                                                \
  template <typename T, typename Use>                                                              \
  LOT_MAY_BE_PACKED constexpr auto with_fields(const T& object, Use&& use,                         \
                                               std::integral_constant<std::size_t, n>) {           \
    const auto& [LOT_LIST##n(LOT_NAME)] = object;                                                  \
    return use(LOT_LIST##n(LOT_NAME));                                                             \
  }
LOT_BIND(1) LOT_BIND(2) LOT_BIND(3) LOT_BIND(4) LOT_BIND(5)
LOT_BIND(6) LOT_BIND(7) LOT_BIND(8) LOT_BIND(9) LOT_BIND(10)
LOT_BIND(11) LOT_BIND(12) LOT_BIND(13) LOT_BIND(14) LOT_BIND(15)
LOT_BIND(16) LOT_BIND(17) LOT_BIND(18) LOT_BIND(19) LOT_BIND(20)
LOT_BIND(21) LOT_BIND(22) LOT_BIND(23) LOT_BIND(24) LOT_BIND(25)
LOT_BIND(26) LOT_BIND(27) LOT_BIND(28) LOT_BIND(29) LOT_BIND(30)
LOT_BIND(31) LOT_BIND(32) LOT_BIND(33) LOT_BIND(34) LOT_BIND(35)
LOT_BIND(36) LOT_BIND(37) LOT_BIND(38) LOT_BIND(39) LOT_BIND(40)

/// The declared types of T's fields, in order, as a Types<...>; references stay references.
///
/// REQUIRES: T is an aggregate without base classes, anonymous members and
/// std::tuple_size; Fields<T> is clear and counts at most kMaxFields.
template <typename T>
using field_types = decltype(bind_fields(
    std::declval<T&>(), std::integral_constant<std::size_t, Fields<T>::count>{}));
// clang-format on

/// Calls `use` with T's fields, in order, as const references. A bit-field comes as a copy.
///
/// REQUIRES: as field_types.
template <typename T, typename Use>
constexpr auto with_fields(const T& object, Use&& use) {
  return with_fields(object, use, std::integral_constant<std::size_t, Fields<T>::count>{});
}

#undef LOT_BIND
#undef LOT_TYPE
#undef LOT_NAME
#undef LOT_INIT
#undef LOT_SLOT
#undef LOT_PACKS
#undef LOT_LIST1
#undef LOT_LIST2
#undef LOT_LIST3
#undef LOT_LIST4
#undef LOT_LIST5
#undef LOT_LIST6
#undef LOT_LIST7
#undef LOT_LIST8
#undef LOT_LIST9
#undef LOT_LIST10
#undef LOT_LIST11
#undef LOT_LIST12
#undef LOT_LIST13
#undef LOT_LIST14
#undef LOT_LIST15
#undef LOT_LIST16
#undef LOT_LIST17
#undef LOT_LIST18
#undef LOT_LIST19
#undef LOT_LIST20
#undef LOT_LIST21
#undef LOT_LIST22
#undef LOT_LIST23
#undef LOT_LIST24
#undef LOT_LIST25
#undef LOT_LIST26
#undef LOT_LIST27
#undef LOT_LIST28
#undef LOT_LIST29
#undef LOT_LIST30
#undef LOT_LIST31
#undef LOT_LIST32
#undef LOT_LIST33
#undef LOT_LIST34
#undef LOT_LIST35
#undef LOT_LIST36
#undef LOT_LIST37
#undef LOT_LIST38
#undef LOT_LIST39
#undef LOT_LIST40
#undef LOT_LIST41

}  // namespace lot::detail
