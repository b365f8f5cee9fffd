// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "tool/machine.hpp"

namespace lot::tool {

/// What one check of `lot doctor` says.
struct Finding {
  enum class Verdict { Ok, Warning, Problem };
  std::string check;  ///< its name
  Verdict verdict = Verdict::Ok;
  std::string seen;
  std::string means;  ///< empty where all is well
  std::string
      advice;  ///< what to type or to change; of a finding that is well: what could be better
};
const char* to_string(Finding::Verdict verdict);

/// All checks, in the order in which people read them. Each looks at plain values, and nothing
/// else.
std::vector<Finding> diagnose(const Machine& machine);

}  // namespace lot::tool
