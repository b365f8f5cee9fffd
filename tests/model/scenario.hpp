// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <initializer_list>
#include <vector>

#include "world.hpp"

namespace lot::model {

struct Scenario {
  const char* name;
  const char* says;  ///< what must hold, as a sentence
  bool (*simulate)(rl::test_params&);
  /// How many forced switches the bounded search affords in a minute; 0: it is not searched.
  unsigned bound = 0;
};

/// All scenarios of the program: each file enters its own, so that a program may have few of them.
inline std::vector<Scenario>& scenarios() {
  static std::vector<Scenario> all;
  return all;
}

struct Entered {
  Entered(std::initializer_list<Scenario> more) {
    scenarios().insert(scenarios().end(), more.begin(), more.end());
  }
};

}  // namespace lot::model
