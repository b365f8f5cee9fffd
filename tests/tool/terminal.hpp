// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <sstream>
#include <string>
#include <sys/stat.h>
#include <utility>
#include <vector>

#include "command.hpp"

namespace lot::testing {

/// A terminal without a window: a tmux server of this test's own, whose socket lies in the room.
class Terminal {
 public:
  /// Runs the shell's command in it. Both end with this object, or with the test.
  Terminal(const Room& room, unsigned width, unsigned height, const std::string& command)
      : socket_(room.path() + "/tmux" + std::to_string(++count_)), server_([this] {
          unsetenv("TMUX");  // the test may run in tmux itself
          execlp("tmux", "tmux", "-D", "-S", socket_.c_str(), "-f", "/dev/null", nullptr);
        }) {
    const std::vector<std::string> words = {
        "-N", "new-session",          "-d",   "-x", std::to_string(width),
        "-y", std::to_string(height), command};
    must(eventually([&] { return tmux(words).exit == 0; }), "tmux has started");
  }
  ~Terminal() { tmux({"kill-server"}); }
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;

  void press(const std::string& key) const {
    must(tmux({"send-keys", key}).exit == 0, "send-keys");
  }
  void resize(unsigned width, unsigned height) const {
    must(tmux({"resize-window", "-x", std::to_string(width), "-y", std::to_string(height)}).exit ==
             0,
         "resize-window");
  }
  /// What one sees; `how`: further options of capture-pane.
  std::string text(const std::vector<std::string>& how = {}) const {
    std::vector<std::string> words = {"capture-pane", "-p"};
    words.insert(words.end(), how.begin(), how.end());
    return tmux(std::move(words)).out;
  }
  bool shows(const std::string& what) const {
    return eventually([&] { return text().find(what) != std::string::npos; }, 30s);
  }
  bool shows_no(const std::string& what) const {
    return eventually([&] { return text().find(what) == std::string::npos; }, 30s);
  }
  std::vector<std::string> lines() const {
    std::istringstream stream(text());
    std::vector<std::string> lines;
    for (std::string line; std::getline(stream, line);) lines.push_back(line);
    return lines;
  }
  /// The first line that has these words; empty: none.
  std::string line_with(const std::string& words) const {
    for (const auto& line : lines()) {
      if (line.find(words) != std::string::npos) return line;
    }
    return "";
  }
  /// The number of the line that has these words; -1: none.
  int place_of(const std::string& words) const {
    const auto all = lines();
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (all[i].find(words) != std::string::npos) return static_cast<int>(i);
    }
    return -1;
  }
  std::string title() const { return asked("#{pane_title}"); }
  bool cursor_is_visible() const { return asked("#{cursor_flag}") == "1"; }

 private:
  std::string asked(const std::string& format) const {
    std::string answer = tmux({"display-message", "-p", format}).out;
    answer.erase(answer.find_last_not_of('\n') + 1);
    return answer;
  }
  Ran tmux(std::vector<std::string> words) const {
    words.insert(words.begin(), {"tmux", "-S", socket_});
    return run_program(std::move(words));
  }

  static inline int count_ = 0;
  std::string socket_;
  Child server_;
};

}  // namespace lot::testing
