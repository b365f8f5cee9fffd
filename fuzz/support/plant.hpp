// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>
#include <string_view>

/// A check that cannot fail proves nothing. Each target can make a few mistakes of its own in what
/// it tests, behind its model's back; can_fail.cmake sees that each of them is found.
namespace lot::fuzz {

/// True when the mistake of this name is to be made: LOT_FUZZ_PLANT names it.
inline bool planted(std::string_view mistake) {
  static const char* const name = std::getenv("LOT_FUZZ_PLANT");
  return name != nullptr && mistake == name;
}

}  // namespace lot::fuzz
