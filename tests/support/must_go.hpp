// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <stdexcept>
#include <string>

#include "lot/error.hpp"

namespace lot::testing {

/// A push or put that must find room: where it does not, the test ends, also in a child process or
/// a thread of its own, where doctest's assertions would be lost, and in loops that they would
/// slow.
inline void must_go(Status status) {
  if (status != Status::Ok) {
    throw std::runtime_error(std::string("a message did not go: ") + to_string(status));
  }
}

}  // namespace lot::testing
