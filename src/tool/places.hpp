// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "segment/trust.hpp"

namespace lot::tool {

/// Where to look: a directory, and one name in it or all; and whose files are looked into.
struct Where {
  std::string directory;
  std::string name;  ///< empty: all
  segment::Trust trust;
};

/// What lies in the directory. Files of others are told from ours by their first bytes; a file that
/// could be anybody's is only ours when its name was asked for.
struct Places {
  std::vector<std::string> segments;    ///< names of files that begin as a segment does
  std::vector<std::string> unfinished;  ///< names X where a file X.new was left by a dead creator
  std::vector<std::string> locks;       ///< names X where there is nothing but X.lock
  std::vector<std::string> doubtful;    ///< the same, but the empty file may be anybody's
  /// What lies in the place of the segment that was named, or of the usual one, of its lock file,
  /// or of an unfinished one, and keeps processes from joining.
  struct Obstacle {
    std::string path;
    std::string what;  ///< "it is a directory"
  };
  std::vector<Obstacle> obstacles;
};

/// Throws lot::Error when the directory can not be read.
Places find_places(const Where& where);

std::string path_of(const Where& where, const std::string& name);
bool exists(const std::string& path);
/// True also of a file that may not be read and has a lock file: nobody can say that it is none.
bool begins_as_a_segment(const std::string& path);

}  // namespace lot::tool
