// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "result.hpp"

namespace ab {

Machine this_machine();
/// The cores that this process may use, rising.
std::vector<int> usable_cores();
unsigned socket_of(int core);
/// Bytes that can be had in /dev/shm without taking them from others.
std::uint64_t free_memory();
/// Now, in UTC, ISO 8601.
std::string utc_now();

}  // namespace ab
