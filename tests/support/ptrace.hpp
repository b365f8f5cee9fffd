// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <csignal>
#include <cstdint>
#include <sys/ptrace.h>
#include <sys/types.h>

namespace lot::testing {

/// ptrace(2), with numbers in the place of pointers.
inline long trace(int request, pid_t thread, std::uintptr_t address = 0, std::uintptr_t data = 0) {
  return ptrace(static_cast<__ptrace_request>(request), thread, reinterpret_cast<void*>(address),
                reinterpret_cast<void*>(data));
}

/// Which event a stop is, of those that PTRACE_SETOPTIONS asks for. `status`: what waitpid() said.
inline bool is_event(int status, int event) { return status >> 8 == (SIGTRAP | (event << 8)); }

}  // namespace lot::testing
