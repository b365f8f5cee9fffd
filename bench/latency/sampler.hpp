// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

/// Where this process spends its processor time: SIGPROF to each thread, each millisecond of its
/// own; where perf_event_open() is forbidden, at most one at each tick of the kernel's clock.
namespace ab {

/// Set while a node waits for a message: what is not copying or a system call then is a wait loop.
void sampler_waiting(bool waiting) noexcept;

/// Of the threads that there are now.
void start_sampler();
void stop_sampler();

/// "count waiting symbol" in lines, the most frequent first; symbols are looked up now.
std::string sampled();

}  // namespace ab
