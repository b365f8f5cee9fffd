// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <new>
#include <string>
#include <type_traits>

#include "lot/detail/control.hpp"
#include "lot/detail/quiet_death.hpp"
#include "lot/detail/type_name.hpp"

namespace lot {

/// What must be equal at both ends of a topic beside size and alignment. Specialise it to give a
/// message a name of your own (say, one that all languages share) and a hash of its definition.
template <class T>
struct TypeIdentity {
  /// The name of the type, which lives as long as the process. The default is the C++ name,
  /// the same with RTTI and without, and throws std::bad_alloc at its first call.
  static const char* name();
  /// A hash of the definition; 0 by default. Throws nothing.
  static constexpr std::uint64_t hash() { return 0; }
};

namespace detail {

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
                                kPlain};
  return type;
}

}  // namespace detail

template <class T>
const char* TypeIdentity<T>::name() {
  // Never destroyed: static objects may publish in their destructors.
  static const auto* const name = new std::string(detail::NameOf<T>::text());
  return name->c_str();
}

}  // namespace lot
