// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "tool/machine.hpp"

namespace lot::testing {

constexpr std::uint64_t kMiB = 1 << 20;

inline tool::SegmentSeen segment_seen() {
  tool::SegmentSeen s;
  s.name = "LOTROS";
  s.path = "/dev/shm/LOTROS";
  s.is_wanted = true;
  s.bytes = 1024 * kMiB;
  s.taken = 64 * kMiB;
  s.living = 3;
  return s;
}

/// A machine that is well in all that LOT looks at.
inline tool::Machine good() {
  tool::Machine m;
  m.directory = "/dev/shm";
  m.segment = "LOTROS";
  m.mount = {"/dev/shm", "tmpfs", "rw,huge=advise"};
  m.total_bytes = 8192 * kMiB;
  m.free_bytes = 4096 * kMiB;
  m.segments = {segment_seen()};
  m.release = "6.1.0";
  m.huge_pages = "never";
  m.available_bytes = 8192 * kMiB;
  m.real_time_priority = 50;
  return m;
}

}  // namespace lot::testing
