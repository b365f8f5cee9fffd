// SPDX-License-Identifier: Apache-2.0
#include "slow_open.hpp"

#include <atomic>
#include <cstdarg>
#include <linux/fcntl.h>
#include <string_view>
#include <sys/syscall.h>
#include <unistd.h>

namespace {

std::atomic<bool> slow{false};
std::atomic<bool> opening{false};

}  // namespace

/// Instead of the C library's, for all that is linked into this executable.
extern "C" int open(const char* path, int flags, ...) {
  unsigned mode = 0;
  if ((flags & O_CREAT) != 0) {
    va_list arguments;
    va_start(arguments, flags);
    mode = va_arg(arguments, unsigned);
    va_end(arguments);
  }
  const auto fd = static_cast<int>(syscall(SYS_openat, AT_FDCWD, path, flags, mode));
  if (slow && std::string_view(path).ends_with(".lock")) {
    opening = true;
    usleep(200000);
    opening = false;
  }
  return fd;
}

namespace lot::testing {
void open_lock_files_slowly() { slow = true; }
bool is_opening_slowly() { return opening; }
}  // namespace lot::testing
