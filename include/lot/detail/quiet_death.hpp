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

/// Whether a T's destructor only frees strings and vectors, so that a dead message is freed as a
/// whole and nobody walks through its elements (a destructor of std::vector does, byte by byte, if
/// the allocator is not std's: 4 ms for a frame of 16 MiB).
///
/// An aggregate may have a destructor of its own. Who declares one has no implicit move
/// constructor, and copying a string or a vector may throw: so an aggregate of those that moves
/// without throwing has none. A type that lies inside itself is looked at once.
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
    return all_die_quietly(field_types<T>{}, Types<T, Holders...>{});
  } else {
    return false;
  }
}

}  // namespace lot::detail
