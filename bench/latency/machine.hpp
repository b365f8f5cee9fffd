// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "result.hpp"

namespace ab {

Machine this_machine();
/// The cores that this process may use, rising.
std::vector<int> usable_cores();
unsigned socket_of(int core);
/// Now, in UTC, ISO 8601.
std::string utc_now();

}  // namespace ab
