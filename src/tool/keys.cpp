// SPDX-License-Identifier: Apache-2.0
#include "tool/keys.hpp"

#include <poll.h>
#include <unistd.h>

namespace lot::tool {

Keys::Keys() {
  termios now{};
  // A program in the background would be stopped.
  if (tcgetpgrp(STDIN_FILENO) != getpgrp() || tcgetattr(STDIN_FILENO, &now) != 0) return;
  const termios before = now;
  now.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
  if (tcsetattr(STDIN_FILENO, TCSANOW, &now) == 0) before_ = before;
}

Keys::~Keys() {
  if (before_) tcsetattr(STDIN_FILENO, TCSANOW, &*before_);
}

std::optional<char> Keys::next() {
  if (!before_) return std::nullopt;
  pollfd input{STDIN_FILENO, POLLIN, 0};
  char key = 0;
  if (poll(&input, 1, 0) != 1 || (input.revents & POLLIN) == 0) return std::nullopt;
  if (read(STDIN_FILENO, &key, 1) != 1) return std::nullopt;
  return key;
}

}  // namespace lot::tool
