// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <new>
#include <string>

#include "lot/detail/type_name.hpp"

namespace lot {

/// What must be equal at both ends of a topic beside size, alignment and description. Specialise it
/// to give a message a name of your own (say, one that all languages share) and a hash of its
/// definition. A type in a message has its name from here, too: two that are opaque
/// (is_trusted_message) and alike meet if their names are equal. Specialise it where the type is
/// declared, before its first use.
template <class T>
struct TypeIdentity {
  /// The name of the type, which lives as long as the process. The default is the C++ name,
  /// the same with RTTI and without, and throws std::bad_alloc at its first call.
  static const char* name();
  /// A hash of the definition; 0 by default. Counts for a message, not for what lies in it. Throws
  /// nothing.
  static constexpr std::uint64_t hash() { return 0; }
};

template <class T>
const char* TypeIdentity<T>::name() {
  // Never destroyed: static objects may publish in their destructors.
  static const auto* const name = new std::string(detail::NameOf<T>::text());
  return name->c_str();
}

}  // namespace lot
