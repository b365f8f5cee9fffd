// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>

#include "tool/sight.hpp"

namespace lot::tool {

struct Settings {
  Where where;
  bool json = false;
};

/// Who is there: segments, processes, topics, publishers, subscribers, memory.
Exit ls(const Settings& settings, std::chrono::milliseconds interval);
/// Who holds which message since when, and who is behind. `all`: queued and spare ones too.
Exit who(const Settings& settings, bool all);
/// Reaps the dead and removes what nobody lives in.
Exit clean(const Settings& settings, bool dry_run);

}  // namespace lot::tool
