// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <sys/types.h>

#include "lot/options.hpp"

namespace lot::segment {

/// Whose files a process joins, cleans or looks into, and how open they may be (docs/security.md).
///
/// What is asked is an open descriptor, not a name: a name may lead to another file by the next
/// call. A file is trusted when it is a regular one with one name, belongs to the effective user,
/// to root, or to the user or the group that was named, and gives no right that was not asked for,
/// and none to another group than the one that was named.
///
/// Threads: a value.
/// Source:  fstat(2).
struct Trust {
  std::optional<uid_t> user{};   ///< that was named, beside the effective one and root
  std::optional<gid_t> group{};  ///< that was named; new files get it
  mode_t mode = 0600;            ///< of new files; no wider one is trusted
  /// Of one's own files no narrower one is joined either: those whom it was to let in would wait
  /// for ever. What is another's is as that one wants it.
  bool wants_all = false;

  /// Of these options. Throws lot::Error (EINVAL) where there is no such user or group, a group is
  /// named that the permissions give nothing, or they give a class one right alone: to join takes
  /// both, and a user who may only read could hold the gate by a read lock of the lock file.
  static Trust of(const EngineOptions& options);

  /// Throws lot::Error (EPERM) that says whose it is, and what to do, if it is not trusted.
  void require(int fd, const std::string& path) const;
  /// Why a file that is trusted is narrow, or "".
  std::string shortfall(int fd) const;
  /// What is at path belongs to one of these users, whatever it is: it may be removed. False as
  /// well when nothing is there.
  bool owns(const std::string& path) const noexcept;
};

/// What lies at path, where it is no regular file: "a symbolic link", "a directory", "a FIFO" ...
/// Else "", also when nothing is there.
std::string kind_of(const std::string& path);
/// "uid 1000 (ann), gid 1000, mode 0600", of what is at path; "" when nothing can be said.
std::string owner_and_mode(const std::string& path);
/// What to do, for people, where the system does not let this process open it.
std::string way_in(const std::string& path);
/// "`LOT_GROUP=1002 lot clean --segment LOTROS`": the command on the segment at path (or whose lock
/// file, or unfinished file, is there), as a shell takes it, with the variables that let it in.
std::string command(const std::string& words, const std::string& path);
/// False: it belongs to another user, in a directory where each removes his own files only, as in
/// /dev/shm. See unlink(2), "sticky bit".
bool may_remove(const std::string& path);

}  // namespace lot::segment
