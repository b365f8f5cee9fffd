// SPDX-License-Identifier: Apache-2.0
#include "tool/output.hpp"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <poll.h>
#include <unistd.h>
#include <utility>

#include "lot/error.hpp"

namespace lot::tool {
namespace {

constexpr int kLookMilliseconds = 100;

}  // namespace

bool write_out(std::string_view text, const StopToken& stop) {
  for (bool has_waited = false; !text.empty();) {
    if (std::exchange(has_waited, true) && stop.stop_requested()) return false;
    pollfd ready{STDOUT_FILENO, POLLOUT, 0};
    if (poll(&ready, 1, kLookMilliseconds) == 1) {
      // As much as a pipe that is ready takes at once: a signal that comes just before does not
      // wait for a reader.
      const std::size_t part = std::min<std::size_t>(text.size(), PIPE_BUF);
      const ssize_t n = ::write(STDOUT_FILENO, text.data(), part);
      if (n >= 0) {
        text.remove_prefix(static_cast<std::size_t>(n));
        has_waited = false;
      } else if (errno == EPIPE) {
        return false;
      } else if (errno != EINTR && errno != EAGAIN) {
        throw Error(errno, "standard output", "the text can not be written", "");
      }
    }
  }
  return true;
}

bool output_is_gone() {
  pollfd ready{STDOUT_FILENO, 0, 0};
  return poll(&ready, 1, 0) == 1 && (ready.revents & POLLERR) != 0;
}

}  // namespace lot::tool
