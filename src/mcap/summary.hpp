// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "mcap/contents.hpp"
#include "mcap/scan.hpp"

namespace lot::mcap {

/// A piece of the file that has messages: a chunk, or one message outside of chunks.
struct Part {
  std::uint64_t start = 0;
  std::uint64_t end = 0;
  std::uint64_t at = 0;                 ///< of its record
  std::uint64_t bytes = 0;              ///< of that record, with its prefix
  std::vector<std::uint16_t> channels;  ///< of its messages
};

/// What is where in a file.
struct Index {
  Header header;
  Contents contents;
  std::vector<Part> parts;     ///< in the order of the file
  std::uint64_t data_end = 0;  ///< behind the last whole record of the data
  bool has_summary = false;    ///< it comes from the summary
  bool has_loose = false;      ///< there are messages outside of chunks
  bool is_whole = false;       ///< the file ends with a footer
  bool has_data_end = false;   ///< at `data_end` there is a DataEnd or a Footer
  /// What is wrong with the summary of a file that was closed; empty: nothing, or it has none.
  std::string summary_fault;
  Damage damage;
};

/// A summary that is right, and does not lead to all that the file has.
struct Incomplete : Malformed {
  using Malformed::Malformed;
};

/// A file that was closed, whose writer has left the summary out.
struct NoSummary : Malformed {
  using Malformed::Malformed;
};

/// From the summary; throws Malformed if it is missing or wrong, or Incomplete: then the file must
/// be read. Errors: lot::Error.
Index index_by_summary(InFile& file, const Limits& limits);
/// By reading the whole file. Errors: lot::Error.
Index index_by_reading(InFile& file, const Limits& limits);
/// By the summary, or else by reading. Errors: lot::Error.
Index index_of(InFile& file, const Limits& limits);

}  // namespace lot::mcap
