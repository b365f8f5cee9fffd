// SPDX-License-Identifier: Apache-2.0
#pragma once

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

std::vector<Scenario> ring_scenarios();
std::vector<Scenario> ownership_scenarios();
std::vector<Scenario> crash_scenarios();

}  // namespace lot::model
