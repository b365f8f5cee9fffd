// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <sys/types.h>

#include "lot/options.hpp"

namespace lot::segment {

/// Whose files a process joins, cleans or looks into, and how open they may be (docs/security.md).
///
/// The questions are about an open descriptor, not a name: by the next call a name may lead to
/// another file. A file is trusted when all of these are true:
/// - It is a regular file with one name.
/// - It belongs to the effective user, to root, or to the user or the group that was named.
/// - It gives no right that was not asked for, and none to another group than the named one.
///
/// Threads: a value.
/// Source:  fstat(2).
struct Trust {
  std::optional<uid_t> user{};   ///< the user that was named, beside the effective one and root
  std::optional<gid_t> group{};  ///< the group that was named; new files get it
  mode_t mode = 0600;            ///< the mode of new files; no wider file is trusted
  /// The process does not join a narrow file of its own user either: users that it should let in
  /// would wait for ever. Another user's file may be as narrow as that user wants it.
  bool wants_all = false;

  /// The trust that these options say. Throws lot::Error (EINVAL) in three cases: there is no such
  /// user or group; a group is named to which the permissions give nothing; the permissions give a
  /// class only one of the two rights. To join takes both rights, and a user with only the read
  /// right could hold the gate by a read lock of the lock file.
  static Trust of(const EngineOptions& options);

  /// Throws lot::Error (EPERM) if the file is not trusted. The error says whose it is, and what to
  /// do.
  void require(int fd, const std::string& path) const;
  /// Why a trusted file is narrow, or "".
  std::string shortfall(int fd) const;
  /// True when what is at path, whatever it is, belongs to one of these users: it may be removed.
  /// False as well when nothing is there.
  bool owns(const std::string& path) const noexcept;
};

/// What lies at path when it is no regular file: "a symbolic link", "a directory", "a FIFO" ...
/// "" for a regular file, and when nothing is there.
std::string kind_of(const std::string& path);
/// "uid 1000 (ann), gid 1000, mode 0600" of what is at path. "" when it cannot be looked at.
std::string owner_and_mode(const std::string& path);
/// What a user can do where the system does not let this process open the file.
std::string way_in(const std::string& path);
/// "`LOT_GROUP=1002 lot clean --segment LOTROS`": the command for the segment at path, as a shell
/// takes it, with the variables that it needs. The path may also be the segment's lock file or its
/// unfinished file.
std::string command(const std::string& words, const std::string& path);
/// False when another user owns what is at path, in a directory where each user can remove only his
/// own files, as in /dev/shm. See unlink(2), "sticky bit".
bool may_remove(const std::string& path);

}  // namespace lot::segment
