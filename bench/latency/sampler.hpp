// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

/// Where this process spends its processor time: SIGPROF each millisecond of it.
namespace ab {

/// Set while a node waits for a message: what is not copying or a system call then is a wait loop.
void sampler_waiting(bool waiting) noexcept;

void start_sampler();
void stop_sampler();

/// "count waiting symbol" in lines, the most frequent first; symbols are looked up now.
std::string sampled();

}  // namespace ab
