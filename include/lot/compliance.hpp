// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <complex>
#include <cstddef>
#include <cstdlib>
#include <forward_list>
#include <functional>
#include <initializer_list>
#include <list>
#include <map>
#include <memory>
#include <set>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include <lot/detail/fields.hpp>

/// Refuses, while compiling, messages that another process could not read.
///
/// A message is written once, into a segment that every process maps at an address of its own. A
/// pointer, a reference, a vtable or a std::string inside it means something to its writer only.
/// C++ compiles such a message without a word, and the reader crashes, sometimes. So LOT searches
/// each message type member by member and says what it found and what to use instead:
///
///     struct Bad { std::uint64_t stamp; std::string text; };
///     lot::assert_message<Bad>();
///     // error: lot: this message has a container or string whose memory is private to this
///     //        process (std::allocator); use lot::ShmString / lot::ShmVector
///     // note:  ... Refused<lot::detail::Fault<kPrivateMemory, std::string, Bad>>
///
/// The Fault in the note lists the culprit, the type that holds it, the type
/// that holds that one, and so on out to the message.
///
/// Accepted are: arithmetic types, enums, std::byte; arrays, std::array,
/// std::pair, std::tuple, std::complex, durations and time points of accepted
/// types; lock-free std::atomic; containers of accepted types whose allocator is
/// an is_shm_allocator; aggregates of up to 40 accepted members; and whatever
/// is_trusted_message vouches for.
///
/// Limits:  values are not looked at. An integer that holds an address, or an index into something
///          private, passes. A trusted class that begins with an untrusted union is refused inside
///          an aggregate: the search sees the union through the class. Trust the union too.
namespace lot {

template <class T>
class ShmUniquePtr;
template <class T>
class ShmSharedPtr;
template <class T>
class ShmWeakPtr;

/// Says that A allocates in shared memory and that its pointers may be read by other processes.
///
/// Specialise it to true_type for an allocator whose `pointer` is relative.
template <typename A>
struct is_shm_allocator : std::false_type {};

/// Says that every byte of a T means the same in another process, without a search.
///
/// Specialise it to true_type for types that cannot be searched (classes with
/// constructors or private members, unions, structs with bases):
///
///     template <> struct lot::is_trusted_message<Quaternion> : std::true_type {};
template <typename T>
struct is_trusted_message : std::false_type {};

namespace detail {

/// Why a type was refused. The texts are in Refused.
enum class Reason {
  kNone,
  kQualified,
  kNotObject,
  kOverAligned,
  kNotDestructible,
  kRawPointer,
  kFunctionPointer,
  kMemberPointer,
  kReference,
  kVirtual,
  kPrivateMemory,
  kNodeContainer,
  kVectorBool,
  kSmartPointer,
  kShmPointer,
  kView,
  kFunction,
  kLockedAtomic,
  kUnion,
  kNotAggregate,
  kBaseClass,
  kTooManyMembers,
  kUnclearMembers,
  kCompilersOwn,
};

/// The largest alignment a segment gives: its mapping begins on a page.
inline constexpr std::size_t kMaxAlignment = 4096;

/// What the search found: Culprit, inside Holders..., innermost first.
template <Reason Why, typename Culprit, typename... Holders>
struct Fault {};
using NoFault = Fault<Reason::kNone, void>;

/// Whether T is an instance of the class template Template.
template <typename T, template <typename...> class Template>
inline constexpr bool is_a = false;
template <template <typename...> class Template, typename... A>
inline constexpr bool is_a<Template<A...>, Template> = true;

/// The types inside a standard type whose bytes are just theirs.
template <typename T>
struct StdParts {
  static constexpr bool known = false;
};
template <typename... Part>
struct KnownParts {
  static constexpr bool known = true;
  using type = Types<Part...>;
};
template <typename T, std::size_t N>
struct StdParts<T[N]> : KnownParts<T> {};
template <typename T, std::size_t N>
struct StdParts<std::array<T, N>> : KnownParts<T> {};
template <typename A, typename B>
struct StdParts<std::pair<A, B>> : KnownParts<A, B> {};
template <typename... T>
struct StdParts<std::tuple<T...>> : KnownParts<T...> {};
template <typename T>
struct StdParts<std::complex<T>> : KnownParts<T> {};
template <typename Rep, typename Period>
struct StdParts<std::chrono::duration<Rep, Period>> : KnownParts<Rep> {};
template <typename Clock, typename Duration>
struct StdParts<std::chrono::time_point<Clock, Duration>> : KnownParts<Duration> {};
template <typename T>
struct StdParts<std::atomic<T>> : KnownParts<T> {};

/// Whether T is a std::atomic that may take a lock, which the library keeps outside the object.
template <typename T>
inline constexpr bool is_locked_atomic = false;
template <typename T>
inline constexpr bool is_locked_atomic<std::atomic<T>> = !std::atomic<T>::is_always_lock_free;

template <typename T>
inline constexpr bool is_vector_bool = false;
template <typename A>
inline constexpr bool is_vector_bool<std::vector<bool, A>> = true;

/// Whether T is a class that names its allocator and its elements.
template <typename T, typename = void>
struct Container {
  static constexpr bool known = false;
  static constexpr bool shared = false;
};
template <typename T>
struct Container<T, std::void_t<typename T::allocator_type, typename T::value_type>> {
  static constexpr bool known = !std::is_aggregate_v<T>;
  static constexpr bool shared = known && is_shm_allocator<typename T::allocator_type>::value;
};

/// What a container holds of the function that it orders, hashes or compares its keys by: a
/// stateless one has nothing in the message.
template <typename F>
using StateOf = std::conditional_t<std::is_empty_v<F>, Types<>, Types<F>>;
template <typename T>
constexpr StateOf<typename T::key_compare> order_of(int) {
  return {};
}
template <typename T>
constexpr Types<> order_of(...) {
  return {};
}
template <typename T>
constexpr StateOf<typename T::hasher> hash_of(int) {
  return {};
}
template <typename T>
constexpr Types<> hash_of(...) {
  return {};
}
template <typename T>
constexpr StateOf<typename T::key_equal> equality_of(int) {
  return {};
}
template <typename T>
constexpr Types<> equality_of(...) {
  return {};
}
template <typename... A, typename... B, typename... C>
constexpr Types<A..., B..., C...> together(Types<A...>, Types<B...>, Types<C...>) {
  return {};
}

/// Whether T is a standard container that links its nodes.
///
/// libstdc++ links them by raw pointers even if the allocator's pointers are
/// relative, so the allocator alone does not make these safe.
template <typename T>
inline constexpr bool is_node_container =
    is_a<T, std::list> || is_a<T, std::forward_list> || is_a<T, std::map> ||
    is_a<T, std::multimap> || is_a<T, std::set> || is_a<T, std::multiset> ||
    is_a<T, std::unordered_map> || is_a<T, std::unordered_multimap> ||
    is_a<T, std::unordered_set> || is_a<T, std::unordered_multiset>;

/// Whether T looks like a span: a small copyable class with data() and size().
///
/// Only picks the better text: a class that is not an aggregate is refused anyway.
template <typename T, typename = void>
inline constexpr bool is_view = is_a<T, std::basic_string_view> || is_a<T, std::initializer_list>;
template <typename T>
inline constexpr bool
    is_view<T, std::enable_if_t<std::is_pointer_v<decltype(std::declval<T&>().data())>,
                                std::void_t<decltype(std::declval<T&>().size())>>> =
        !std::is_aggregate_v<T> && std::is_trivially_copyable_v<T> &&
        sizeof(T) <= 2 * sizeof(void*);

/// Whether std::tuple_size<T> exists, in which case structured bindings do not show the members.
template <typename T, typename = void>
inline constexpr bool is_tuple_like = false;
template <typename T>
inline constexpr bool is_tuple_like<T, std::void_t<decltype(std::tuple_size<T>::value)>> = true;

/// The probe (see fields.hpp) for a union that no is_trusted_message vouches for, named or not.
struct AnyUntrustedUnion {
  template <typename U,
            typename = std::enable_if_t<std::is_union_v<U> && !is_trusted_message<U>::value>>
  operator U() const noexcept {
    std::abort();
  }
};

/// What speaks against the pointer-like type T.
template <typename T>
constexpr Reason reason_against_pointer() {
  if constexpr (std::is_member_pointer_v<T>) {
    return Reason::kMemberPointer;
  } else if constexpr (std::is_function_v<std::remove_pointer_t<T>>) {
    return Reason::kFunctionPointer;
  } else {
    return Reason::kRawPointer;
  }
}

/// What speaks against the aggregate T as a whole, before its members are looked at.
template <typename T>
constexpr Reason reason_against_aggregate() {
  if constexpr (is_tuple_like<T>) {
    return Reason::kNotAggregate;
  } else if constexpr (has_base<T>) {
    return Reason::kBaseClass;
  } else if constexpr (!Fields<T>::clear) {
    return Reason::kUnclearMembers;
  } else if constexpr (Fields<T>::count > kMaxFields) {
    return Reason::kTooManyMembers;
  } else if constexpr (some_field_takes<T, AnyUntrustedUnion>) {
    return Reason::kUnion;  // Asked first: an anonymous union cannot be bound to a name.
  } else {
    return Reason::kNone;
  }
}

/// What speaks against the class T as a whole, before anything inside it is looked at.
template <typename T>
constexpr Reason reason_against_class() {
  // NOLINTBEGIN(bugprone-branch-clone): answers recur because the order of questions matters.
  if constexpr (std::is_polymorphic_v<T>) {
    return Reason::kVirtual;
  } else if constexpr (std::is_union_v<T>) {
    return Reason::kUnion;
  } else if constexpr (is_locked_atomic<T>) {
    return Reason::kLockedAtomic;
  } else if constexpr (StdParts<T>::known) {
    return Reason::kNone;
  } else if constexpr (is_vector_bool<T>) {
    return Reason::kVectorBool;
  } else if constexpr (Container<T>::known && !Container<T>::shared) {
    return Reason::kPrivateMemory;
  } else if constexpr (is_node_container<T>) {
    return Reason::kNodeContainer;
  } else if constexpr (Container<T>::shared) {
    return Reason::kNone;
  } else if constexpr (is_a<T, std::shared_ptr> || is_a<T, std::weak_ptr> ||
                       is_a<T, std::unique_ptr>) {
    return Reason::kSmartPointer;
  } else if constexpr (is_a<T, ShmUniquePtr> || is_a<T, ShmSharedPtr> || is_a<T, ShmWeakPtr>) {
    return Reason::kShmPointer;
  } else if constexpr (is_a<T, std::function>) {
    return Reason::kFunction;
  } else if constexpr (is_a<T, std::reference_wrapper>) {
    return Reason::kReference;
  } else if constexpr (is_view<T>) {
    return Reason::kView;
  } else if constexpr (!std::is_aggregate_v<T>) {
    return Reason::kNotAggregate;
  } else {
    return reason_against_aggregate<T>();
  }
  // NOLINTEND(bugprone-branch-clone)
}

/// What speaks against T as a whole, before anything inside it is looked at.
template <typename T>
constexpr Reason reason_against() {
  if constexpr (std::is_reference_v<T>) {
    return Reason::kReference;
  } else if constexpr (!std::is_object_v<T> || (std::is_array_v<T> && std::extent_v<T> == 0)) {
    return Reason::kNotObject;
  } else if constexpr (alignof(T) > kMaxAlignment) {
    return Reason::kOverAligned;  // No trust helps here: the segment has no such address.
  } else if constexpr (is_trusted_message<T>::value || std::is_arithmetic_v<T> ||
                       std::is_enum_v<T> || std::is_array_v<T>) {
    return Reason::kNone;
  } else if constexpr (std::is_pointer_v<T> || std::is_member_pointer_v<T> ||
                       std::is_null_pointer_v<T>) {
    return reason_against_pointer<T>();
  } else if constexpr (!std::is_destructible_v<T>) {
    return Reason::kNotDestructible;
  } else if constexpr (std::is_class_v<T> || std::is_union_v<T>) {
    return reason_against_class<T>();
  } else {
    return Reason::kCompilersOwn;
  }
}

/// The types inside T that must be searched too. REQUIRES: reason_against<T>() is kNone.
template <typename T>
constexpr auto parts_of() {
  if constexpr (is_trusted_message<T>::value || std::is_arithmetic_v<T> || std::is_enum_v<T>) {
    return Types<>{};
  } else if constexpr (StdParts<T>::known) {
    return typename StdParts<T>::type{};
  } else if constexpr (Container<T>::shared) {
    return together(Types<typename T::value_type>{}, order_of<T>(0),
                    together(hash_of<T>(0), equality_of<T>(0), Types<>{}));
  } else {
    return field_types<T>{};
  }
}

template <typename T, typename... Holders>
constexpr auto find_fault(Types<Holders...> holders);

/// The first fault among Part..., or NoFault.
template <typename... Holders>
constexpr NoFault first_fault(Types<>, Types<Holders...>) {
  return {};
}
template <typename Part, typename... Rest, typename... Holders>
constexpr auto first_fault(Types<Part, Rest...>, Types<Holders...> holders) {
  using Found = decltype(find_fault<Part>(holders));
  if constexpr (std::is_same_v<Found, NoFault>) {
    return first_fault(Types<Rest...>{}, holders);
  } else {
    return Found{};
  }
}

/// Searches T, which lies inside Holders..., to any depth.
///
/// A type that lies inside itself (a tree node with a ShmVector of nodes) is
/// searched once: the outer search already answers for it.
template <typename T, typename... Holders>
constexpr auto find_fault(Types<Holders...>) {
  using Plain = std::remove_cv_t<T>;
  if constexpr ((std::is_same_v<Plain, Holders> || ...)) {
    return NoFault{};
  } else if constexpr (reason_against<Plain>() != Reason::kNone) {
    return Fault<reason_against<Plain>(), Plain, Holders...>{};
  } else {
    return first_fault(decltype(parts_of<Plain>()){}, Types<Plain, Holders...>{});
  }
}

/// Searches the message type T; unlike a member it must be a plain type.
template <typename T>
constexpr auto find_message_fault() {
  if constexpr (std::is_reference_v<T> || std::is_const_v<T> || std::is_volatile_v<T>) {
    return Fault<Reason::kQualified, T>{};
  } else {
    return find_fault<T>(Types<>{});
  }
}

/// Turns a Fault into the compiler's error. All texts are here.
template <typename F>
struct Refused;
template <Reason Why, typename Culprit, typename... Holders>
struct Refused<Fault<Why, Culprit, Holders...>> {
  static_assert(Why != Reason::kQualified,
                "lot: this message type is const, volatile or a reference; name the plain type");
  static_assert(Why != Reason::kNotObject,
                "lot: this message has something that is no object of known size (void, a "
                "function, an array without a bound); use a struct or an array with a bound");
  static_assert(Why != Reason::kOverAligned,
                "lot: this message has an alignment over 4096, which a page-aligned segment "
                "cannot give; use alignas(4096) or less");
  static_assert(Why != Reason::kNotDestructible,
                "lot: this message has a member that cannot be destroyed; use a type with a "
                "public destructor");
  static_assert(Why != Reason::kRawPointer,
                "lot: this message has a raw pointer: other processes map the segment elsewhere; "
                "use lot::ShmRef or lot::ShmVector");
  static_assert(Why != Reason::kFunctionPointer,
                "lot: this message has a function pointer: other processes load their code "
                "elsewhere; use an enum that names the function");
  static_assert(Why != Reason::kMemberPointer,
                "lot: this message has a member pointer: other programs may lay the class out "
                "otherwise; use an enum that names the member");
  static_assert(Why != Reason::kReference,
                "lot: this message has a reference, which is a raw pointer inside; hold the value "
                "itself or use lot::ShmRef");
  static_assert(Why != Reason::kVirtual,
                "lot: this message has virtual functions: its hidden pointer leads to a table in "
                "this process only; use a plain struct and an enum that names the kind");
  static_assert(Why != Reason::kPrivateMemory,
                "lot: this message has a container or string whose memory is private to this "
                "process (std::allocator); use lot::ShmString / lot::ShmVector");
  static_assert(Why != Reason::kNodeContainer,
                "lot: this message has a standard container that links its nodes by raw pointers "
                "whatever its allocator; use lot::ShmVector, sorted if need be, or Boost's, as in "
                "lot/boost_containers.hpp");
  static_assert(Why != Reason::kVectorBool,
                "lot: this message has a std::vector<bool>, which has no bools to read in place; "
                "use lot::ShmVector<std::uint8_t>");
  static_assert(Why != Reason::kSmartPointer,
                "lot: this message has a smart pointer to memory of this process; hold the value "
                "itself or use lot::ShmRef");
  static_assert(Why != Reason::kShmPointer,
                "lot: this message has a ShmUniquePtr, ShmSharedPtr or ShmWeakPtr, which belongs "
                "to this process; use lot::ShmRef");
  static_assert(Why != Reason::kView,
                "lot: this message has a view (string_view, span), which is a raw pointer and a "
                "size; use lot::ShmString / lot::ShmVector");
  static_assert(Why != Reason::kFunction,
                "lot: this message has a std::function: its code and captures lie in this process "
                "only; use an enum that names the function");
  static_assert(Why != Reason::kLockedAtomic,
                "lot: this message has a std::atomic that is not lock-free: its lock is private to "
                "each process; use an atomic of at most 8 bytes");
  static_assert(Why != Reason::kUnion,
                "lot: this message has a union, and nothing says which member is alive; use a "
                "struct, or give the union a name and specialise lot::is_trusted_message<T> if "
                "every byte of it means the same in another process");
  static_assert(Why != Reason::kNotAggregate,
                "lot: this message has a class that is not a plain aggregate and cannot be "
                "searched; use a struct of public members, or specialise "
                "lot::is_trusted_message<T> if every byte of it means the same in another process");
  static_assert(Why != Reason::kBaseClass,
                "lot: this message has a struct with a base class, which cannot be searched; hold "
                "the base as a member, or specialise lot::is_trusted_message<T> if every byte of "
                "it means the same in another process");
  static_assert(Why != Reason::kTooManyMembers,
                "lot: this message has a struct of over 40 members, which cannot be searched; "
                "group them into nested structs, or specialise lot::is_trusted_message<T> if every "
                "byte of it means the same in another process");
  static_assert(Why != Reason::kUnclearMembers,
                "lot: this message has a struct whose members cannot be told apart, because "
                "several, or the elements of an array, have no default constructor; give them "
                "one, or specialise lot::is_trusted_message<T> if every byte of it means the same "
                "in another process");
  static_assert(Why != Reason::kCompilersOwn,
                "lot: this message has a type that C++ does not know, such as __int128 without "
                "-std=gnu++17, or a vector of the compiler; use an array of numbers, or specialise "
                "lot::is_trusted_message<T> if every byte of it means the same in another process");
};

}  // namespace detail

/// Whether a T can live in shared memory and be read there by another process.
///
/// Never an error by itself, so it may be used to choose an overload.
/// REQUIRES: T and what it holds are complete types.
template <typename T>
inline constexpr bool is_message_v =
    std::is_same_v<decltype(detail::find_message_fault<T>()), detail::NoFault>;

/// Stops the compiler, with the reason and the remedy, unless is_message_v<T>.
///
/// Otherwise it does nothing, and says true: `static_assert(lot::assert_message<Frame>());`
template <typename T>
constexpr bool assert_message() noexcept {
  return sizeof(detail::Refused<decltype(detail::find_message_fault<T>())>) != 0;
}

}  // namespace lot
