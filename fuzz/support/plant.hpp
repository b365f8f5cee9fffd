// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>
#include <string_view>

/// A check that cannot fail proves nothing. Each target can make a few mistakes of its own in what
/// it tests, behind its model's back; can_fail.cmake sees that each of them is found.
namespace lot::fuzz {

/// The mistake that is to be made, or "".
inline std::string_view plant() {
  static const char* const name = std::getenv("LOT_FUZZ_PLANT");
  return name != nullptr ? name : "";
}
inline bool planted(std::string_view mistake) { return plant() == mistake; }

}  // namespace lot::fuzz
