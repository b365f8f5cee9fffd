// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

#include "lot/description.hpp"

/// A description as bytes, for the segment (docs/layout.md).
namespace lot::description {

inline constexpr std::size_t kMostBytes = 16 << 10;
/// Types lie in each other so deep at most. A type that lies within itself is not counted again.
inline constexpr std::size_t kMostLevels = 16;
/// So many types a reader meets at most that walks the whole message once.
inline constexpr std::size_t kMostSteps = 1 << 16;

/// True when a walk over all parts ends within the limits above.
bool is_small(const Description& description);

/// Empty: the description is larger than the limits, or has what decode() would refuse. Throws
/// std::bad_alloc.
std::string encode(const Description& description);
/// Nothing: the bytes are no description. They may have come from anywhere: each number is checked,
/// types lie in each other as in memory, and is_small() holds. Throws std::bad_alloc.
std::optional<Description> decode(std::string_view bytes);

/// Where two descriptions differ first, in words for people: what the topic has there, and what
/// this side has. Empty: they lie alike, and have the same names where both have names. Throws
/// std::bad_alloc.
std::string first_difference(const Description& topic, const Description& here);

/// True when some field has a name. Throws nothing.
bool has_names(const Description& description) noexcept;

/// What two descriptions of one layout know of the names of fields.
struct Names {
  bool differ = false;            ///< a field has a name at each side, and they are not the same
  bool topic_knows_more = false;  ///< some field has a name there alone
  bool here_knows_more = false;   ///< some field has a name here alone
  /// Where each side knows more than the other: the description with the names of both, and their
  /// hash (Description::names_hash()).
  std::string merged = {};
  std::uint64_t merged_names = 0;
};
/// All is false where the bytes are the same, or no description. Throws std::bad_alloc.
Names compare_names(std::string_view topic, std::string_view here);

}  // namespace lot::description
