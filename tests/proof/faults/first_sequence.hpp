// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace lot::testing {

/// The sequence number at which the rings begin that are made from now on, by this process and its
/// children; 0: where they begin by themselves. (It changes what publishers ask Registry::open()
/// for.)
void begin_rings_at(std::uint64_t sequence);

}  // namespace lot::testing
