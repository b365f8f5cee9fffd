// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include <fnmatch.h>

namespace lot::record {

/// Whether it has a character by which a shell knows patterns.
inline bool is_pattern(const std::string& name) {
  return name.find_first_of("*?[\\") != std::string::npos;
}
/// Whether the name, or pattern of a shell, is that name. `*` matches `/` as well.
inline bool matches(const std::string& pattern, const std::string& name) {
  return pattern == name || fnmatch(pattern.c_str(), name.c_str(), 0) == 0;
}
/// Whether one of them is.
inline bool matches_any(const std::vector<std::string>& patterns, const std::string& name) {
  return std::ranges::any_of(patterns,
                             [&](const std::string& pattern) { return matches(pattern, name); });
}

}  // namespace lot::record
