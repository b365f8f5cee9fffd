// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

namespace lot::detail {

/// One word to sleep on, and the value that it must still have when the kernel looks (futex(2)).
struct FutexWait {
  const void* word;
  std::uint32_t value;
};
using FutexWaits = std::vector<FutexWait>;

}  // namespace lot::detail
