# SPDX-License-Identifier: Apache-2.0
# lot_warnings: what every target of this project is compiled with. Never exported to users.
option(LOT_WERROR "Treat warnings as errors" ${PROJECT_IS_TOP_LEVEL})

add_library(lot_warnings INTERFACE)
target_compile_options(lot_warnings INTERFACE
  -Wall -Wextra -Wpedantic -Wconversion -Wshadow
  # g++ 12 sees the capacity of a std::basic_string with a fancy pointer read uninitialised; it is not.
  # With -O3 it also sees "a" + string write over itself; it does not (GCC bug 105651).
  # Without optimisation it takes a compare-and-swap whose failure is ordered more strongly than its
  # success for a mistake; since C++17 it is none.
  $<$<CXX_COMPILER_ID:GNU>:-Wno-maybe-uninitialized;-Wno-restrict;-Wno-invalid-memory-model>
  $<$<BOOL:${LOT_WERROR}>:-Werror>)
