// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <new>
#include <string>
#include <sys/mman.h>

namespace lot::replay {

/// What came of a run. It lies in memory that the conductor, which is a process of its own in each
/// run, shares with the program that has started it.
struct Record {
  enum class End : std::uint32_t {
    Unfinished,  ///< the conductor itself has failed: `text`
    Passed,
    Violation,  ///< `text`
    Skipped,    ///< `text`: what the system refuses, and a line for tests/skips.txt
  };
  /// A turn: one thread has run without another one between.
  struct Turn {
    std::uint64_t steps;  ///< instructions and calls of the run, at the end of the turn
    std::uint64_t fingerprint;
    std::uint64_t place;  ///< where the thread stands then
    std::uint32_t thread;
    std::uint32_t call;  ///< the last system call of the turn, + 1; 0: none
  };
  static constexpr std::size_t kMostTurns = 1 << 20;

  End end;
  char text[1024];
  std::uint64_t fingerprint, steps, calls, kills, operations, messages, virtual_ns;
  std::size_t count;  ///< turns
  Turn turns[kMostTurns];

  static Record& make() {
    void* const at = mmap(nullptr, sizeof(Record), PROT_READ | PROT_WRITE,
                          MAP_SHARED | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (at == MAP_FAILED) throw std::bad_alloc();
    return *static_cast<Record*>(at);
  }
  static void let_go(Record& record) { munmap(&record, sizeof(Record)); }
  void finish(End how, const std::string& why) {
    end = how;
    std::strncpy(text, why.c_str(), sizeof(text) - 1);
  }
};

}  // namespace lot::replay
