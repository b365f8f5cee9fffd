// SPDX-License-Identifier: Apache-2.0
#pragma once

// It sees each call of fcntl() in this executable and passes it on.
namespace lot::testing {

/// How many locks this process has asked for on files that are no lock file of LOT.
unsigned stray_locks();
/// Closes the descriptor just before its n-th lock or unlock from now on, whichever file it is.
void close_at_lock(int n);

}  // namespace lot::testing
