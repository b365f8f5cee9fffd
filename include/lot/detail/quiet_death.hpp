// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <type_traits>
#include <vector>

#include "lot/compliance.hpp"

namespace lot::detail {

template <typename T, typename... Holders>
constexpr bool dies_quietly();

template <typename... Part, typename... Holders>
constexpr bool all_die_quietly(Types<Part...>, Types<Holders...>) {
  return (dies_quietly<std::remove_cv_t<Part>, Holders...>() && ...);
}

template <typename... Part>
constexpr bool all_die_trivially(Types<Part...>) {
  return (std::is_trivially_destructible_v<Part> && ...);
}

/// Whether a T's destructor only frees strings and vectors. Then the library frees a dead message
/// as a whole and does not walk through its elements. (The destructor of std::vector walks through
/// them byte by byte, if the allocator is not std's: 4 ms for a frame of 16 MiB.)
///
/// An aggregate may declare a destructor of its own. It then has no implicit move constructor, and
/// copying a string or a vector may throw. So an aggregate of strings or vectors that moves without
/// throwing declares no destructor. One whose fields need no destructor has one of its own. The
/// search looks at a type that lies inside itself once.
/// REQUIRES: T is a message.
template <typename T, typename... Holders>
constexpr bool dies_quietly() {
  if constexpr (std::is_trivially_destructible_v<T> || (std::is_same_v<T, Holders> || ...)) {
    return true;
  } else if constexpr (is_trusted_message<T>::value) {
    return false;
  } else if constexpr (std::is_array_v<T>) {
    return all_die_quietly(Types<std::remove_extent_t<T>>{}, Types<T, Holders...>{});
  } else if constexpr (StdParts<T>::known) {
    return all_die_quietly(typename StdParts<T>::type{}, Types<T, Holders...>{});
  } else if constexpr (is_a<T, std::vector> || is_a<T, std::basic_string>) {
    return all_die_quietly(Types<typename T::value_type>{}, Types<T, Holders...>{});
  } else if constexpr (std::is_aggregate_v<T> && std::is_nothrow_move_constructible_v<T>) {
    return !all_die_trivially(field_types<T>{}) &&
           all_die_quietly(field_types<T>{}, Types<T, Holders...>{});
  } else {
    return false;
  }
}

}  // namespace lot::detail
