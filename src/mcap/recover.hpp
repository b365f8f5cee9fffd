// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include "mcap/scan.hpp"

namespace lot::mcap {

/// What recover() has done.
struct Recovered {
  bool was_whole = false;       ///< it had all, and was not touched
  std::uint64_t cut_bytes = 0;  ///< what was behind the last whole record of the data
  bool cut_old_end = false;     ///< these were the old summary and footer, which have no messages
  Statistics statistics;        ///< what is in the file
  Damage damage;                ///< what the summary leaves out
};

/// Gives a file whose writer was killed what its close() would have written.
///
/// Errors: lot::Error. EWOULDBLOCK: it is still being written. EINVAL: it is no MCAP file.
/// Crash:  may be run again, at any time.
Recovered recover(const std::string& path, const Limits& limits = {});

}  // namespace lot::mcap
