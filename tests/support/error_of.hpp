// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <utility>

#include "lot/error.hpp"

namespace lot::testing {

/// The errno and the text of what f throws. An OutOfMemory has no errno.
template <class F>
std::pair<int, std::string> error_of(F&& f) {
  try {
    f();
  } catch (const Error& e) {
    return {e.error_number(), e.what()};
  } catch (const OutOfMemory& e) {
    return {0, e.what()};
  }
  return {0, "no error"};
}

inline bool names(const std::string& text, const char* setting) {
  return text.find(setting) != std::string::npos;
}

}  // namespace lot::testing
