// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <iterator>

#include "segment/layout.hpp"

namespace lot::test {

/// True when the home of the block has asked a holder to tell it when it lets go.
inline bool home_waits(const segment::BlockWords& words) {
  return std::any_of(std::begin(words.own), std::end(words.own),
                     [](const auto& own) { return (own.load() & refcount::kWanted) != 0; });
}

}  // namespace lot::test
