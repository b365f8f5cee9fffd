// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace lot::ros {

/// The file that has another copy of lot::ros and came into this process before this one; empty:
/// there is none. All copies of a process find the same first one, even if their symbols are hidden
/// from each other: each copy has a note in its file.
///
/// Source:  dl_iterate_phdr(3), elf(5).
std::string earlier_copy();

}  // namespace lot::ros
