// SPDX-License-Identifier: Apache-2.0
#include "lock_spy.hpp"

#include <atomic>
#include <cstdarg>
#include <cstdio>
#include <linux/fcntl.h>
#include <string_view>
#include <sys/syscall.h>
#include <unistd.h>

namespace {

std::atomic<unsigned> strays{0};
std::atomic<int> until_close{0};

bool is_stray(int fd) {
  char link[32];
  std::snprintf(link, sizeof(link), "/proc/self/fd/%d", fd);
  char target[512];
  const ssize_t n = readlink(link, target, sizeof(target));
  if (n <= 0) return false;  // closed: nobody's
  std::string_view path(target, static_cast<std::size_t>(n));
  constexpr std::string_view kRemoved = " (deleted)";
  if (path.ends_with(kRemoved)) path.remove_suffix(kRemoved.size());
  return !path.ends_with(".lock");
}

}  // namespace

/// Instead of the C library's, for all that is linked into this executable.
extern "C" int fcntl(int fd, int command, ...) {
  va_list arguments;
  va_start(arguments, command);
  void* argument = va_arg(arguments, void*);
  va_end(arguments);
  if (command == F_OFD_SETLK && until_close > 0 && --until_close == 0) close(fd);
  if (command == F_OFD_SETLK && is_stray(fd)) ++strays;
  return static_cast<int>(syscall(SYS_fcntl, fd, command, argument));
}

namespace lot::testing {
unsigned stray_locks() { return strays; }
void close_at_lock(int n) { until_close = n; }
}  // namespace lot::testing
