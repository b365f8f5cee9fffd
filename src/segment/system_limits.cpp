// SPDX-License-Identifier: Apache-2.0
#include "segment/system_limits.hpp"

#include <algorithm>
#include <fstream>
#include <sys/resource.h>
#include <utility>

namespace lot::segment {
namespace {

std::uint64_t limit_of(int resource) noexcept {
  rlimit limit{};
  if (getrlimit(static_cast<__rlimit_resource_t>(resource), &limit) == -1) return kUnlimited;
  return limit.rlim_cur == RLIM_INFINITY ? kUnlimited : std::uint64_t{limit.rlim_cur};
}

/// The number in a file. "max" is no limit, nor is a file that is not there.
std::uint64_t number_in(const std::string& path) {
  std::ifstream file(path);
  std::uint64_t number = 0;
  return file >> number ? number : kUnlimited;
}

/// The least limit of a group and of the groups above it. In a container the group's own directory
/// may be the mount.
std::uint64_t least_above(const std::string& mount, std::string group, const std::string& file) {
  std::uint64_t least = number_in(mount + "/" + file);
  while (group.size() > 1) {
    least = std::min(least, number_in(mount + group + "/" + file));
    group.erase(std::min(group.rfind('/'), group.size()));
  }
  return least;
}

/// The memory limits of this process that are set.
std::string memory_limits() {
  std::string text;
  for (const auto& [resource, name] : {std::pair(RLIMIT_AS, "RLIMIT_AS (ulimit -v)"),
                                       std::pair(RLIMIT_DATA, "RLIMIT_DATA (ulimit -d)")}) {
    const std::uint64_t limit = limit_of(resource);
    if (limit == kUnlimited) continue;
    text += (text.empty() ? "" : ", ") + std::string(name) + " is " + size_text(limit);
  }
  return text;
}

bool has(const std::string& list, const std::string& word) {
  return ("," + list + ",").find("," + word + ",") != std::string::npos;
}

}  // namespace

std::uint64_t file_limit() noexcept { return limit_of(RLIMIT_FSIZE); }

std::uint64_t memory_limit(const std::string& groups, const std::string& mount) {
  std::uint64_t least = kUnlimited;
  std::ifstream file(groups);
  for (std::string line; std::getline(file, line);) {  // NUMBER:CONTROLLERS:GROUP
    const auto first = line.find(':');
    const auto second = line.find(':', first + 1);
    if (first == line.npos || second == line.npos) continue;
    const std::string controllers = line.substr(first + 1, second - first - 1);
    const std::string group = line.substr(second + 1);
    if (controllers.empty()) {
      least = std::min(least, least_above(mount, group, "memory.max"));
    } else if (has(controllers, "memory")) {
      least = std::min(least, least_above(mount + "/memory", group, "memory.limit_in_bytes"));
    }
  }
  return least;
}

std::string size_text(std::uint64_t bytes) {
  constexpr std::uint64_t kMiB = 1 << 20;
  const bool is_small = bytes < 10 * kMiB && bytes % kMiB != 0;
  return is_small ? std::to_string(bytes >> 10) + " KiB" : std::to_string(bytes / kMiB) + " MiB";
}

std::string advice_on_address_space() {
  const std::string limits = memory_limits();
  return (limits.empty() ? "free memory" : limits + ": raise it") +
         ", or have the segment made anew with a smaller LOT_SIZE, when all that use it have ended";
}

std::string advice_on_threads() {
  const std::uint64_t threads = limit_of(RLIMIT_NPROC);
  std::string limits = memory_limits();  // each thread has a stack
  if (threads != kUnlimited) {
    limits +=
        (limits.empty() ? "" : ", ") + ("RLIMIT_NPROC (ulimit -u) is " + std::to_string(threads));
  }
  if (limits.empty()) return "raise the limit of threads (pids.max of the control group)";
  return limits + ": raise it, or pids.max of the control group";
}

}  // namespace lot::segment
