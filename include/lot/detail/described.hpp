// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include "lot/description.hpp"

namespace lot::detail {

/// What two ends of a topic compare of a type, and what the segment keeps of it. A program makes it
/// once for each type.
struct Described {
  std::uint64_t layout = 0;  ///< Description::layout_hash()
  std::uint64_t names = 0;   ///< Description::names_hash()
  bool has_names = false;    ///< some field has a name
  /// The description as the segment keeps it (docs/layout.md). Empty: it is too large.
  std::string bytes;
};

/// Throws std::bad_alloc.
Described make_described(const Description& description);

}  // namespace lot::detail
