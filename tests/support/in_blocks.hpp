// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <lot/options.hpp>

namespace lot::testing {

/// For a test of what blocks do: small messages, too, travel in blocks, and not in slots.
inline PusherOptions in_blocks(PusherOptions options = {}) {
  options.fast_lane = false;
  return options;
}

}  // namespace lot::testing
