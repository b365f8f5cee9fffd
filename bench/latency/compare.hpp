// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <iosfwd>

#include "result.hpp"

namespace ab {

/// Says what got faster or slower from run a to run b. Cells are compared if all their conditions
/// but the number of messages are the same, by the rule that kCompareRule states. Returns the
/// program's exit status: 0 if nothing is slower, 1 if something is, kNothingInCommon.
inline constexpr int kNothingInCommon = 3;
int compare(std::ostream&, const Run& a, const Run& b);

/// For --help.
extern const char* const kCompareRule;

}  // namespace ab
