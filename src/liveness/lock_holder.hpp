// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <sys/types.h>

namespace lot::liveness {

/// The process that holds a byte of a lock file. For messages to people only: no question whether a
/// process lives depends on a process id.
struct LockHolder {
  pid_t pid;         ///< as this process sees it
  std::string name;  ///< of its main thread
  bool is_stopped;   ///< by SIGSTOP, Ctrl-Z or a debugger

  /// "process 1234 (camera)"
  std::string describe() const;
  /// What a user can do when the process is stopped.
  std::string advice() const;
  /// Looks at the open files of every process that /proc shows. None: the holder belongs to another
  /// user or another namespace, or has gone meanwhile.
  static std::optional<LockHolder> find(const std::string& path, ino_t inode, std::uint32_t byte);
};

/// True when /proc shows that a process with that id is being killed, or ends. Only a hint how long
/// to wait for its death: in another namespace the id may be another process's, or nobody's.
bool is_being_killed(pid_t pid) noexcept;

}  // namespace lot::liveness
