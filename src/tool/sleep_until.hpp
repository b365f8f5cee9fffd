// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>

#include "lot/stop_token.hpp"

#include "futex/futex.hpp"

namespace lot::tool {

/// Sleeps until then. False: it was told to stop.
inline bool sleep_until(std::chrono::steady_clock::time_point time, const StopToken& stop) {
  while (!stop.stop_requested()) {
    if (std::chrono::steady_clock::now() >= time) return true;
    const detail::FutexWait word = stop.word()->wait();
    futex::wait(word.word, word.value, time);
  }
  return false;
}

}  // namespace lot::tool
