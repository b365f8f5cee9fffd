// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>

#include "tool/sight.hpp"

namespace lot::tool {

struct Settings {
  Where where;
  bool json = false;
};

/// Lists what is there: segments, processes, topics, publishers, subscribers, memory.
/// `each`: a row for each end, also where many are alike.
Exit ls(const Settings& settings, std::chrono::milliseconds interval, bool each);
/// Lists which process holds which message since when, and which reader is behind. `all`: queued
/// and spare messages too, and a row for each reader and publisher.
Exit who(const Settings& settings, bool all);
struct CleanOptions {
  bool dry_run = false;     ///< only say what would be done
  bool with_items = false;  ///< also remove segments in whose queues items wait
};
/// Reaps the dead and removes segments in which no process lives.
Exit clean(const Settings& settings, const CleanOptions& options);

/// Looks at the machine, and says what to change. It reads only.
Exit doctor(const Settings& settings);

}  // namespace lot::tool
