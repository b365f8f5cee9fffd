// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <climits>
#include <cstddef>
#include <cstdint>
#include <linux/futex.h>
#include <sys/syscall.h>
#include <thread>
#include <unistd.h>

#include "support/processes.hpp"

namespace lot::testing {

/// How many sleep on the word, which has this value: as many as the kernel moves from the word to
/// itself.
inline std::size_t asleep_on(const void* word, std::uint32_t value) {
  const long n = syscall(SYS_futex, word, FUTEX_CMP_REQUEUE, 0, INT_MAX, word, value);
  return n < 0 ? 0 : static_cast<std::size_t>(n);
}
inline void await_asleep(const void* word, std::uint32_t value, std::size_t count) {
  while (asleep_on(word, value) != count) std::this_thread::sleep_for(1ms);
}

}  // namespace lot::testing
