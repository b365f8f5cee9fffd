// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include <termios.h>

namespace lot::tool {

/// The keys that are pressed in the terminal of standard input, each at once. Where that is no
/// terminal, or another program's by now, no key comes. The destructor gives the terminal back.
///
/// Threads: one.
class Keys {
 public:
  Keys();
  ~Keys();
  Keys(const Keys&) = delete;
  Keys& operator=(const Keys&) = delete;

  bool can_come() const { return before_.has_value(); }
  /// The next one; nothing: none was pressed since the last call.
  std::optional<char> next();

 private:
  std::optional<termios> before_;
};

}  // namespace lot::tool
