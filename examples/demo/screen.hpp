// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <string>
#include <unistd.h>
#include <vector>

#include "process.hpp"

namespace demo {

/// A line that is written over and over on a terminal, and now and then elsewhere.
class Progress {
 public:
  explicit Progress(std::string title) : title_(std::move(title)) {}
  ~Progress() {
    if (terminal_) std::printf("\r\033[K");
    std::fflush(stdout);
  }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  void show(const std::string& text) {
    const auto now = std::chrono::steady_clock::now();
    if (!terminal_ && now < next_) return;
    next_ = now + std::chrono::seconds(2);
    std::printf(terminal_ ? "\r\033[K%s: %s" : "%s: %s\n", title_.c_str(), text.c_str());
    std::fflush(stdout);
  }

 private:
  std::string title_;
  bool terminal_ = isatty(STDOUT_FILENO) == 1;
  std::chrono::steady_clock::time_point next_{};
};

/// How many frames a child has sent or received, as far as it has said.
inline std::uint64_t frames_of(const Child& child) {
  const auto at = child.said.find("at");
  return at == child.said.end() ? 0 : at->second.at("frames").get<std::uint64_t>();
}

/// "camera 45, consumers 45 45 30 45 45"
inline std::string how_far(Family& family) {
  std::string text = "camera " + std::to_string(frames_of(family["camera"])) + ", consumers";
  for (unsigned i = 1; i <= kConsumers; ++i) {
    text += ' ';
    text += std::to_string(frames_of(family[consumer_name(i)]));
  }
  return text;
}

/// Prints the head of one frame, by the command `lot`. False: it ended badly. Throws Interrupted.
bool echo_a_frame(const std::string& segment);

/// The files that a segment still has.
inline std::vector<std::string> files_of(const std::string& path) {
  std::vector<std::string> found;
  const std::filesystem::path segment(path);
  for (const auto& entry : std::filesystem::directory_iterator(segment.parent_path())) {
    const std::string name = entry.path().filename();
    const std::string stem = segment.filename();
    if (name == stem || name.rfind(stem + ".", 0) == 0) found.push_back(name);
  }
  return found;
}

}  // namespace demo
