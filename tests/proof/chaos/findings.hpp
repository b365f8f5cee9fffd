// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace lot::chaos {

/// What can be wrong.
enum class Finding : std::uint8_t {
  Lost,     ///< neither delivered nor counted as missed, or counted wrongly
  Torn,     ///< not the bytes that were published, or changed while held
  Twice,    ///< delivered again, or out of order
  Leaked,   ///< a word of the segment names no living participant
  Files,    ///< a file of the segment is left
  Wedged,   ///< no progress
  Crashed,  ///< ended by itself
};

inline constexpr std::array kFindingNames{"lost",  "torn",   "twice",  "leaked",
                                          "files", "wedged", "crashed"};
inline constexpr std::size_t kFindings = kFindingNames.size();

}  // namespace lot::chaos
