// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <unistd.h>
#include <vector>

#include "segment/segment.hpp"
#include "support/processes.hpp"
#include "transport/participant.hpp"

namespace lot::testing {

/// Options of a segment whose files are removed at the end, whatever the test has come to.
struct Ground : EngineOptions {
  Ground() : EngineOptions(fresh()) {}
  ~Ground() {
    std::error_code ignored;
    for (const char* suffix : {"", ".new", ".lock"}) {
      std::filesystem::remove_all(directory + "/" + segment + suffix, ignored);
    }
  }
  Ground(const Ground&) = delete;
  Ground& operator=(const Ground&) = delete;
};

/// A process that looks for the dead all the time, where a warden sleeps until it is told: what
/// seems dead for a moment is reaped.
class Neighbour {
 public:
  explicit Neighbour(const EngineOptions& options)
      : child_([&, this] {
          const auto participant = transport::Participant::join(options);
          ready_.tell();
          char reaps = 'a';
          while (done_.next(0ms) == '\0') {
            if (participant->reaper().reap_dead() && reaps < 'z') ++reaps;
            usleep(200);
          }
          reaps_.tell(reaps);
        }) {
    must(ready_.next() == '.', "the neighbour has joined");
  }

  /// Leaves; how often its own calls have reaped a process, -1 when it failed. Its warden reaps,
  /// too, and is not counted.
  int leave() {
    done_.tell();
    const char reaps = reaps_.next();
    return child_.wait() == 0 ? reaps - 'a' : -1;
  }

 private:
  Steps ready_, done_, reaps_;
  Child child_;
};

/// The indexes that are taken.
inline std::vector<std::uint32_t> taken(segment::Segment& s) {
  std::vector<std::uint32_t> indexes;
  for (std::uint32_t k = 1; k < s.capacity().participants; ++k) {
    if (s.participants()[k].state.load() != 0) indexes.push_back(k);
  }
  return indexes;
}

/// The index of the participant of that name (EngineOptions::name), or 0.
inline std::uint32_t index_of(segment::Segment& s, std::string_view name) {
  for (const std::uint32_t k : taken(s)) {
    if (name == s.participants()[k].name) return k;
  }
  return 0;
}

inline EngineOptions named(EngineOptions options, const char* name) {
  options.name = name;
  return options;
}

/// A process that is in the segment under that name until it is told the end.
inline Child member(const EngineOptions& options, const char* name, const Steps& joined,
                    const Steps& end) {
  return Child([&options, &joined, &end, name] {
    const ShmEngine engine(named(options, name));
    joined.tell();
    end.next(60s);
  });
}

inline std::string file_of(const EngineOptions& options) {
  return options.directory + "/" + options.segment;
}

/// True when the thread sleeps in the kernel.
inline bool asleep(pid_t process, pid_t thread) {
  const std::string path =
      "/proc/" + std::to_string(process) + "/task/" + std::to_string(thread) + "/stat";
  std::FILE* file = std::fopen(path.c_str(), "r");
  if (file == nullptr) return false;
  char text[512] = {};
  const std::size_t n = std::fread(text, 1, sizeof(text) - 1, file);
  std::fclose(file);
  const std::string_view stat(text, n);
  const auto end_of_name = stat.rfind(')');
  return end_of_name != stat.npos && stat.substr(end_of_name).starts_with(") S");
}

}  // namespace lot::testing
