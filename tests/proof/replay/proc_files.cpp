// SPDX-License-Identifier: Apache-2.0
#include "proc_files.hpp"

#include <cstddef>
#include <initializer_list>
#include <sstream>

namespace lot::replay {
namespace {

/// The lines that begin with one of those words.
std::string lines_of(const std::string& text, std::initializer_list<const char*> words) {
  std::istringstream lines(text);
  std::string kept;
  for (std::string line; std::getline(lines, line);) {
    for (const char* word : words) {
      if (line.rfind(word, 0) == 0) kept += line + '\n';
    }
  }
  return kept;
}

/// "PID (NAME) STATE PPID PGRP SESSION TTY TPGID FLAGS", and no more.
std::string short_stat(const std::string& text) {
  const std::size_t end = text.rfind(')');
  if (end == std::string::npos) return text;
  std::istringstream words(text.substr(end + 1));
  std::string state, parent, group, session, terminal, owner, flags;
  words >> state >> parent >> group >> session >> terminal >> owner >> flags;
  if (state == "t" || state == "T") state = "S";  // it stands still for the conductor only
  return text.substr(0, end + 1) + ' ' + state + " 1 0 0 0 0 " + flags + '\n';
}

}  // namespace

void ProcFiles::opened(pid_t process, int fd, const std::string& path) {
  closed(process, fd);
  const auto ends_in = [&path](const std::string& end) {
    return path.size() >= end.size() &&
           path.compare(path.size() - end.size(), end.size(), end) == 0;
  };
  if (path.rfind("/proc/", 0) != 0) return;
  if (ends_in("/stat")) open_[{process, fd}] = Kind::Stat;
  if (ends_in("/status")) open_[{process, fd}] = Kind::Status;
  if (path.find("/fdinfo/") != std::string::npos) open_[{process, fd}] = Kind::FdInfo;
}

std::string ProcFiles::instead(pid_t process, int fd, const std::string& text) const {
  if (text.empty()) return text;  // the end of the file
  switch (open_.at({process, fd})) {
    case Kind::Stat:
      return short_stat(text);
    case Kind::Status:
      return lines_of(text, {"SigPnd:", "ShdPnd:"});
    case Kind::FdInfo:
      return lines_of(text, {"lock:"});
  }
  return text;
}

}  // namespace lot::replay
