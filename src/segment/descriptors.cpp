// SPDX-License-Identifier: Apache-2.0
#include "segment/descriptors.hpp"

#include <cerrno>
#include <fcntl.h>
#include <unistd.h>

namespace lot::segment {
namespace {

constexpr int kFirstOwn = STDERR_FILENO + 1;

/// /dev/null in the place of those of 0, 1 and 2 that are closed, for as long as it lives.
class StandIns {
 public:
  StandIns() noexcept {
    for (int standard = 0; standard < kFirstOwn; ++standard) {
      if (fcntl(standard, F_GETFD) != -1) continue;
      const int null = ::open("/dev/null", O_RDWR | O_CLOEXEC);
      if (null == -1) return;
      if (null >= kFirstOwn) {  // another thread has opened them
        ::close(null);
        return;
      }
      is_ours_[null] = true;
    }
  }
  ~StandIns() {
    const int error = errno;
    for (int standard = 0; standard < kFirstOwn; ++standard) {
      if (is_ours_[standard]) ::close(standard);
    }
    errno = error;
  }
  StandIns(const StandIns&) = delete;
  StandIns& operator=(const StandIns&) = delete;

 private:
  bool is_ours_[kFirstOwn] = {};
};

}  // namespace

int open_file(const std::string& path, int flags, mode_t mode) noexcept {
  const StandIns stand_ins;
  return above_standard(::open(path.c_str(), flags | O_CLOEXEC, mode));
}

int above_standard(int fd) noexcept {
  if (fd == -1 || fd >= kFirstOwn) return fd;
  const int above = fcntl(fd, F_DUPFD_CLOEXEC, kFirstOwn);
  const int error = errno;
  ::close(fd);
  errno = error;
  return above;
}

}  // namespace lot::segment
