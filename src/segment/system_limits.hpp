// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

/// What the system lets a process have. LOT reads it when it makes or joins a segment, and its
/// errors name a limit that is too low.
///
/// Source: getrlimit(2); "Control Group v2" (memory.max) and "Memory Resource Controller"
///         (memory.limit_in_bytes) in the kernel's documentation.
namespace lot::segment {

inline constexpr std::uint64_t kUnlimited = ~std::uint64_t{0};

/// The most bytes to which this process may extend a file (RLIMIT_FSIZE).
std::uint64_t file_limit() noexcept;

/// The most bytes of memory that the processes of our control group may have together. Counts the
/// groups that it lies in. Control groups of version 1 or 2. `groups` is the file that names the
/// group, `mount` the directory of the groups.
std::uint64_t memory_limit(const std::string& groups = "/proc/self/cgroup",
                           const std::string& mount = "/sys/fs/cgroup");

/// "1000 KiB", "64 MiB".
std::string size_text(std::uint64_t bytes);

/// What a user can do where there is no memory or no address space. Names the limits that are set.
/// By then the segment exists.
std::string advice_on_address_space();
/// What a user can do where the system starts no thread.
std::string advice_on_threads();

}  // namespace lot::segment
