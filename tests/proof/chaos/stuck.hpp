// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <sys/types.h>

namespace lot::chaos {

/// Where each thread of a process is, as /proc tells it.
std::string where_is(pid_t pid);

}  // namespace lot::chaos
