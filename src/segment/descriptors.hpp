// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <sys/types.h>

/// Descriptors that are never 0, 1 or 2, also in a process that was started without them (`>&-` of
/// a shell). open(2) gives the lowest free number. With 1 or 2 what the process prints would go
/// into the segment or its lock file.
namespace lot::segment {

/// open(2): -1 and errno if it fails. While it opens, those of 0, 1 and 2 that are closed stand for
/// /dev/null, so that no other thread can print into the file.
int open_file(const std::string& path, int flags, mode_t mode = 0) noexcept;

/// `fd`, or a copy of it above 2 in its place; `fd` is closed then. -1 and errno if there is none:
/// `fd` is closed, or is -1. For what is no file, such as an eventfd.
int above_standard(int fd) noexcept;

}  // namespace lot::segment
