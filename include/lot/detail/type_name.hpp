// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#ifdef __cpp_rtti
#include <typeinfo>
#endif

namespace lot::detail {

/// What a mangled name means in C++. Throws std::bad_alloc.
std::string demangle(const char* name);
/// The same of T alone, where the name is that of NameOf<T>::bearer.
std::string demangle_argument(const char* bearer);

/// The name of a type as all programs have it: what typeid(T).name() means.
///
/// A program without RTTI has no typeid. It then takes the name of a symbol that T is a part of
/// from its assembler. Compilers spell that name as typeid does, to the letter. What
/// __PRETTY_FUNCTION__ says differs from compiler to compiler.
template <class T>
struct NameOf {
  [[gnu::visibility("hidden")]] static inline const char bearer = 0;

  /// Throws std::bad_alloc.
  static std::string text() {
#if defined(__cpp_rtti)
    return demangle(typeid(T).name());
#elif defined(__x86_64__)
    const char* name;
    asm(".pushsection .rodata.lot_type_name,\"a\",@progbits\n"
        ".Llot_type_name%=: .asciz \"%c1\"\n"
        ".popsection\n"
        "{lea .Llot_type_name%=(%%rip), %0|lea %0, .Llot_type_name%=[rip]}"
        : "=r"(name)
        : "i"(&bearer));
    return demangle_argument(name);
#else
    static_assert(sizeof(T) == 0,
                  "lot: without RTTI this message has no name on this architecture: specialise "
                  "lot::TypeIdentity for it, with the name that typeid has");
    return {};
#endif
  }
};

}  // namespace lot::detail
