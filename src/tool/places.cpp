// SPDX-License-Identifier: Apache-2.0
#include "tool/places.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <set>
#include <string_view>
#include <sys/stat.h>
#include <unistd.h>

#include "lot/error.hpp"

#include "liveness/lock_file.hpp"
#include "segment/layout.hpp"
#include "segment/segment.hpp"

namespace lot::tool {
namespace {

constexpr std::string_view kUnfinished = ".new";
constexpr std::string_view kLock = ".lock";

bool is_regular(const std::string& path) {
  struct stat status {};
  return lstat(path.c_str(), &status) == 0 && S_ISREG(status.st_mode);
}

std::vector<std::string> files_in(const std::string& directory) {
  std::error_code error;
  std::vector<std::string> names;
  for (std::filesystem::directory_iterator i(directory, error), end; !error && i != end;
       i.increment(error)) {
    names.push_back(i->path().filename());
  }
  if (error) {
    throw Error(error.value(), directory, "cannot read the segment directory",
                "name another with --dir or LOT_DIR");
  }
  std::sort(names.begin(), names.end());
  return names;
}

/// Why the file at this path is no file of LOT; "" where there is no file, or one of LOT.
std::string objection(const std::string& path, bool is_lock) {
  struct stat status {};
  if (lstat(path.c_str(), &status) == -1) return "";
  if (const std::string kind = segment::kind_of(path); !kind.empty()) return "it is " + kind;
  if (is_lock ? status.st_size == 0 : begins_as_a_segment(path)) return "";
  if (!exists(path)) return "";  // a process removed it meanwhile
  if (!is_lock && access(path.c_str(), R_OK) == -1 && errno == EACCES) {
    return "it cannot be read, and has no lock file: it belongs to " +
           segment::owner_and_mode(path);
  }
  return "it is a file of " + std::to_string(status.st_size) + " bytes, and no " +
         (is_lock ? "lock file" : "segment");
}

/// The same for an unfinished segment. A process that makes a new segment removes it first, if it
/// is trusted.
std::string objection_to_unfinished(const std::string& path, const segment::Trust& trust) {
  struct stat status {};
  if (lstat(path.c_str(), &status) == -1) return "";
  if (S_ISDIR(status.st_mode)) return "it is a directory";
  return trust.owns(path) ? "" : "it belongs to " + segment::owner_and_mode(path);
}

std::vector<Places::Obstacle> find_obstacles(const Where& where) {
  std::vector<Places::Obstacle> found;
  const std::string path =
      path_of(where, where.name.empty() ? EngineOptions().segment : where.name);
  for (const bool is_lock : {false, true}) {
    const std::string its = is_lock ? path + std::string(kLock) : path;
    const std::string what = objection(its, is_lock);
    if (!what.empty()) found.push_back({its, what});
  }
  const std::string unfinished = path + std::string(kUnfinished);
  const std::string what = exists(path) ? "" : objection_to_unfinished(unfinished, where.trust);
  if (!what.empty()) found.push_back({unfinished, what});
  return found;
}

}  // namespace

std::string Places::Obstacle::advice() const {
  return what +
         ", and no process can join: remove it if it is yours, or use another name (LOT_SEGMENT)";
}

std::string path_of(const Where& where, const std::string& name) {
  return where.directory + "/" + name;
}

bool exists(const std::string& path) {
  struct stat status {};
  return lstat(path.c_str(), &status) == 0;
}

std::uint64_t bytes_on_disk(const std::string& path) {
  struct stat status {};
  if (lstat(path.c_str(), &status) == -1) return 0;
  return static_cast<std::uint64_t>(status.st_blocks) * 512;
}

bool begins_as_a_segment(const std::string& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
  if (fd == -1) return errno == EACCES && exists(path + std::string(kLock));
  char magic[sizeof(segment::kMagic)] = {};
  const bool read = pread(fd, magic, sizeof(magic), 0) == sizeof(magic);
  ::close(fd);
  return read && std::memcmp(magic, segment::kMagic, sizeof(magic)) == 0;
}

Places find_places(const Where& where) {
  Places places;
  std::set<std::string> segments;
  const auto names = files_in(where.directory);
  const auto stem_of = [](const std::string& name, std::string_view suffix) -> std::string {
    return name.size() > suffix.size() && name.ends_with(suffix)
               ? name.substr(0, name.size() - suffix.size())
               : "";
  };
  const auto wanted = [&where](const std::string& name) {
    return segment::is_name(name) && (where.name.empty() || where.name == name);
  };
  for (const auto& name : names) {
    const std::string path = path_of(where, name);
    if (!is_regular(path)) continue;
    const std::string unfinished = stem_of(name, kUnfinished);
    const bool has_lock = exists(path + std::string(kLock));
    if (!unfinished.empty() && !has_lock) {
      const bool ours =
          begins_as_a_segment(path) ||
          liveness::LockProbe(path_of(where, unfinished) + std::string(kLock)).is_lock_file();
      if (ours && wanted(unfinished)) places.unfinished.push_back(unfinished);
    } else if (begins_as_a_segment(path)) {
      segments.insert(name);
      if (wanted(name)) places.segments.push_back(name);
    }
  }
  for (const auto& name : names) {
    const std::string stem = stem_of(name, kLock);
    if (!wanted(stem) || exists(path_of(where, stem)) || segments.contains(name) ||
        std::count(places.unfinished.begin(), places.unfinished.end(), stem) != 0 ||
        !liveness::LockProbe(path_of(where, name)).is_lock_file()) {
      continue;
    }
    (where.name.empty() ? places.doubtful : places.locks).push_back(stem);
  }
  places.obstacles = find_obstacles(where);
  return places;
}

}  // namespace lot::tool
