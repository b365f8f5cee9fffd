// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "lot/detail/control.hpp"

/// Types that this program has no C++ type of. They live as long as the process.
namespace lot::kill {

/// Number as a program has it that does not know the names of its fields.
const detail::MessageType& nameless_number();
/// Number with other names of its fields.
const detail::MessageType& renamed_number();
/// So many of these descriptions fill their table, of half the largest size, and so many of the
/// largest.
inline constexpr std::uint32_t kHalves = 128, kLargest = 64;
/// REQUIRES: n < kHalves, n < kLargest. No two have the same description.
const detail::MessageType& half(std::uint32_t n);
const detail::MessageType& largest(std::uint32_t n);

}  // namespace lot::kill
