// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <fstream>
#include <sstream>
#include <string>
#include <string_view>
#include <sys/mman.h>
#include <vector>

/// Shared memory that a library has mapped for itself, out of our reach but in /proc.
namespace ab {

struct Mapped {
  std::uintptr_t begin = 0;
  std::uintptr_t end = 0;
  bool writable = false;
  std::string path;
};

/// This process's mappings of files whose path begins so.
inline std::vector<Mapped> mappings_of(std::string_view prefix) {
  std::vector<Mapped> found;
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    const std::size_t slash = line.find('/');
    if (slash == std::string::npos || line.compare(slash, prefix.size(), prefix) != 0) continue;
    Mapped mapped;
    char dash = 0;
    std::string rights;
    std::istringstream(line) >> std::hex >> mapped.begin >> dash >> mapped.end >> rights;
    mapped.writable = rights.find('w') != std::string::npos;
    mapped.path = line.substr(slash);
    found.push_back(std::move(mapped));
  }
  return found;
}

/// Fills in the page tables of all of them, so that no message meets a page fault.
inline void warm(std::string_view prefix) {
  constexpr int kPopulateRead = 22;  // Linux 5.14; older ones refuse, and fault later
  constexpr int kPopulateWrite = 23;
  for (const Mapped& mapped : mappings_of(prefix)) {
    (void)madvise(reinterpret_cast<void*>(mapped.begin), mapped.end - mapped.begin,
                  mapped.writable ? kPopulateWrite : kPopulateRead);
  }
}

}  // namespace ab
