// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <map>
#include <string>
#include <sys/types.h>
#include <utility>

namespace lot::replay {

/// What /proc says of processes is another text in each run: times, sizes, and that each process
/// stands still for a tracer. A worker gets only what the library looks for.
class ProcFiles {
 public:
  /// A process has opened a file.
  void opened(pid_t process, int fd, const std::string& path);
  void closed(pid_t process, int fd) { open_.erase({process, fd}); }
  bool has(pid_t process, int fd) const { return open_.count({process, fd}) != 0; }
  /// What the process reads there in the place of `text`. It is no longer.
  std::string instead(pid_t process, int fd, const std::string& text) const;

 private:
  enum class Kind { Stat, Status, FdInfo };
  std::map<std::pair<pid_t, int>, Kind> open_;
};

}  // namespace lot::replay
