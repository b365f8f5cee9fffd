// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>

namespace lot::testing {

/// A variable of the environment, while it lives.
struct Variable {
  Variable(const char* n, const char* value) : name(n) { setenv(n, value, 1); }
  ~Variable() { unsetenv(name); }
  Variable(const Variable&) = delete;
  Variable& operator=(const Variable&) = delete;
  const char* name;
};

}  // namespace lot::testing
