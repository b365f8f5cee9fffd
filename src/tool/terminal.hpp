// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <optional>
#include <vector>

#include "tool/board.hpp"

namespace lot::tool {

/// The terminal as a screen, by ncurses. The destructor gives it back as it was. So does the end of
/// the process by a signal, a failed assertion or an exception that nothing catches.
///
/// Threads: one, and one Terminal at a time.
/// Errors:  the constructor throws lot::Error where ncurses does not know the terminal.
class Terminal {
 public:
  Terminal();
  ~Terminal();
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;

  std::size_t width() const;
  std::size_t height() const;
  /// The next key (a character, or Key of board.hpp); nothing when none came in time.
  std::optional<int> key(std::chrono::milliseconds most);
  void show(const std::vector<Line>& lines);
  /// True when Ctrl-C was pressed, or the terminal has gone.
  bool has_ended() const;

 private:
  struct Screen;
  Screen* screen_;
};

}  // namespace lot::tool
