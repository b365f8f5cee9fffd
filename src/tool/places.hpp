// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "segment/trust.hpp"

namespace lot::tool {

/// Where to look: a directory, one name in it or all names, and the users whose files the tool
/// opens.
struct Where {
  std::string directory;
  std::string name;  ///< empty: all
  segment::Trust trust;
};

/// What lies in the directory. The tool tells files of others from LOT's by their names and by
/// their first bytes. A file that could belong to any program counts as LOT's only when the user
/// named it.
struct Places {
  std::vector<std::string> segments;    ///< names of files that begin as a segment does
  std::vector<std::string> unfinished;  ///< names X where a file X.new was left by a dead creator
  std::vector<std::string> locks;       ///< names X where there is nothing but X.lock
  std::vector<std::string> doubtful;    ///< names X with an empty X.lock that may be of any program
  /// Something that keeps processes from joining. It lies in the place of the named segment (or the
  /// usual one), of its lock file, or of an unfinished segment.
  struct Obstacle {
    std::string path;
    std::string what;  ///< "it is a directory"

    /// What is wrong, and what to do.
    std::string advice() const;
  };
  std::vector<Obstacle> obstacles;
};

/// Throws lot::Error when the directory can not be read.
Places find_places(const Where& where);

std::string path_of(const Where& where, const std::string& name);
bool exists(const std::string& path);
/// The bytes that the file system holds for the file, as du says it; 0 when the file has gone.
std::uint64_t bytes_on_disk(const std::string& path);
/// True also for a file that the tool may not read and that has a lock file: the tool cannot prove
/// that it is no segment.
bool begins_as_a_segment(const std::string& path);

}  // namespace lot::tool
