// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace lot::testing {

/// From now on, this process opens lock files so slowly that others can do something meanwhile.
void open_lock_files_slowly();
/// True when such a file was opened, and open() has not returned yet.
bool is_opening_slowly();

}  // namespace lot::testing
