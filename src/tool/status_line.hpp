// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <string_view>
#include <sys/ioctl.h>
#include <unistd.h>
#include <utility>

namespace lot::tool {

/// A line on standard error that is renewed, where that is a terminal; else there is none. Other
/// lines are written behind clear().
///
/// Threads: one.
class StatusLine {
 public:
  StatusLine() = default;
  ~StatusLine() { clear(); }
  StatusLine(const StatusLine&) = delete;
  StatusLine& operator=(const StatusLine&) = delete;

  bool can_be_shown() const { return is_terminal_; }
  /// REQUIRES: the text is ASCII.
  void show(const std::string& text) {
    if (!is_terminal_) return;
    std::fprintf(stderr, "%s%s", kBegin, text.substr(0, width()).c_str());
    std::fflush(stderr);
    is_shown_ = true;
  }
  void clear() {
    if (!std::exchange(is_shown_, false)) return;
    std::fputs(kBegin, stderr);
    std::fflush(stderr);
  }

 private:
  /// To the begin of the line, which is made empty.
  static constexpr const char* kBegin = "\r\033[K";

  static bool is_terminal() {
    const char* const kind = std::getenv("TERM");
    return isatty(STDERR_FILENO) == 1 && kind != nullptr && std::string_view(kind) != "dumb";
  }
  /// A text that fills the line would begin another one.
  static std::size_t width() {
    winsize size{};
    const bool is_known = ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col != 0;
    return is_known ? std::max<std::size_t>(size.ws_col, 2) - 1 : 79;
  }

  const bool is_terminal_ = is_terminal();
  bool is_shown_ = false;
};

}  // namespace lot::tool
