// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace lot::testing {

/// How many locks this process has asked for on files that are no lock file of LOT. (It sees each
/// call of fcntl() and passes it on.)
unsigned stray_locks();

}  // namespace lot::testing
