// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <new>
#include <type_traits>

#include "lot/describe.hpp"
#include "lot/detail/control.hpp"
#include "lot/detail/described.hpp"
#include "lot/detail/quiet_death.hpp"
#include "lot/type_identity.hpp"

namespace lot::detail {

template <class T>
void destroy_message(void* message) noexcept {
  static_cast<T*>(message)->~T();
}

/// Says whose containers a message has: those of libc++ lie in other bytes, which no size tells.
#ifdef _LIBCPP_VERSION
inline constexpr std::uint64_t kContainers = 0x6c69'6263'2b2b;  // "libc++"
#else
inline constexpr std::uint64_t kContainers = 0;
#endif

inline namespace LOT_NAMES {

/// Made by the first call, and never destroyed: static objects may publish in their destructors.
template <class T>
[[gnu::visibility("hidden")]] const Described& described(const MessageType&) {
  static const auto* const made = new Described(make_described(describe<T>()));
  return *made;
}

/// The one MessageType of T in this program, or shared object: hidden, so that no other one's
/// destroy_message() is called, which may be of another version, or use another copy of the
/// library.
template <class T>
[[gnu::visibility("hidden")]] const MessageType& message_type() {
  constexpr bool kPlain = std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>;
  static const MessageType type{sizeof(T),
                                alignof(T),
                                TypeIdentity<T>::hash() ^ (kPlain ? 0 : kContainers),
                                TypeIdentity<T>::name(),
                                dies_quietly<T>() ? nullptr : &destroy_message<T>,
                                kPlain,
                                &described<T>};
  return type;
}

}  // namespace LOT_NAMES
}  // namespace lot::detail
