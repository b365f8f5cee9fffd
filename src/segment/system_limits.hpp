// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

/// What the system lets a process have: read when a segment is made or joined, and named where it
/// is too little.
///
/// Source: getrlimit(2); "Control Group v2" (memory.max) and "Memory Resource Controller"
///         (memory.limit_in_bytes) in the kernel's documentation.
namespace lot::segment {

inline constexpr std::uint64_t kUnlimited = ~std::uint64_t{0};

/// Bytes that a file may have which this process makes longer (RLIMIT_FSIZE).
std::uint64_t file_limit() noexcept;

/// Bytes of memory that the processes of our control group may have together, of version 1 or 2,
/// with the groups that it lies in. `groups` says which it is, `mount` where they are.
std::uint64_t memory_limit(const std::string& groups = "/proc/self/cgroup",
                           const std::string& mount = "/sys/fs/cgroup");

/// "1000 KiB", "64 MiB".
std::string size_text(std::uint64_t bytes);

/// What to do where there is no memory or no address space: names the limit that is set. The
/// segment is there by then.
std::string advice_on_address_space();
/// The same where the system starts no thread.
std::string advice_on_threads();

}  // namespace lot::segment
