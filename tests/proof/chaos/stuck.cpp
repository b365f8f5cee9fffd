// SPDX-License-Identifier: Apache-2.0
#include "stuck.hpp"

#include <filesystem>
#include <fstream>
#include <sstream>

namespace lot::chaos {
namespace {

std::string text_of(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  std::string s = text.str();
  while (!s.empty() && s.back() == '\n') s.pop_back();
  return s;
}

std::string state_in(const std::string& status) {
  const auto at = status.find("State:\t");
  return at == std::string::npos ? "?" : status.substr(at + 7, status.find('\n', at) - at - 7);
}

}  // namespace

std::string where_is(pid_t pid) {
  std::string all;
  std::error_code gone;
  const std::filesystem::path tasks = "/proc/" + std::to_string(pid) + "/task";
  for (const auto& task : std::filesystem::directory_iterator(tasks, gone)) {
    const auto& t = task.path();
    all += "    thread " + t.filename().string() + " (" + text_of(t / "comm") +
           "): " + state_in(text_of(t / "status")) + ", wchan " + text_of(t / "wchan") +
           ", syscall " + text_of(t / "syscall") + "\n";
    std::istringstream stack(text_of(t / "stack"));
    for (std::string line; std::getline(stack, line);) all += "      " + line + "\n";
  }
  return all;
}

}  // namespace lot::chaos
