// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

namespace lot::fuzz::window {

/// Where the library's next segment is mapped: between areas that nobody may touch, so that an
/// access through a wrong offset ends the run instead of hitting something else. In builds with
/// AddressSanitizer free granules are poisoned as well.
///
/// The library knows nothing of it: its calls of mmap, munmap, Segment::claim_run and
/// RobustMutex::lock_for come by here first (ld --wrap). The last one is cut short: a lock word
/// that names a living thread for ever would cost seconds of patience each time.

/// From now on. (It is not for segments that other processes use: their claims are not seen here.)
void install();

/// The segment that is mapped now; null when there is none.
unsigned char* base();
std::size_t size();

/// Granules whose tag is 0 may not be touched, all others may. Called between operations; while one
/// runs, what it claims becomes usable.
void poison_free_granules();

/// True when all of these bytes lie in the segment, and in no free granule.
bool is_usable(const void* address, std::size_t bytes);

}  // namespace lot::fuzz::window
