// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <sys/types.h>
#include <utility>

#include "lot/recorder.hpp"

#include "mcap/writer.hpp"
#include "record/clock.hpp"
#include "record/ledger.hpp"
#include "record/stream.hpp"

namespace lot::record {

/// The files of a recording, one after the other.
///
/// Threads: one at a time.
/// Errors:  what mcap::Writer throws. It is noted in the ledger what that has cost, and the next
///          call may go well again.
/// Crash:   as mcap::Writer; a file that has just been made may be empty.
class Files {
 public:
  Files(const RecorderOptions& options, Ledger& ledger, const Clock& clock);
  /// As close(), without a word when that fails.
  ~Files();
  Files(const Files&) = delete;
  Files& operator=(const Files&) = delete;

  bool is_open() const { return writer_.has_value(); }
  /// Makes the next file.
  void open();
  /// Throws what keeps open() from making the first file, and leaves none.
  void try_out();
  /// Where there is no file, it makes one, or else the message is lost.
  void write(const Stream& stream, mcap::MessageHead head, std::span<const mcap::View> payload);
  /// Writes the open chunk.
  void flush();
  void close();

 private:
  /// A channel of the open file.
  struct Given {
    std::string topic;
    std::uint16_t channel = 0;
    std::uint64_t messages = 0;  ///< that the writer was given
    std::uint64_t bytes = 0;     ///< of these
  };
  std::string next_path();
  void make();
  bool numbers_files() const;
  bool is_full(std::uint64_t log_time, std::uint64_t bytes) const;
  Given& given(const Stream& stream);
  std::uint16_t schema_of(const Stream& stream);
  void note_begin();
  void note_end();
  /// A message is to be written: the file is to be as open as the segments that it is from.
  void permit();
  /// A write has failed: notes which messages that has cost. A file that was removed is no more.
  void count_lost(const std::exception& why);
  /// There is no open chunk: what the writer was given and has not written is lost. `is_removed`:
  /// so is what it has written.
  void settle(bool is_removed = false);
  void forget_file();

  const RecorderOptions& options_;
  Ledger& ledger_;
  const Clock& clock_;
  std::optional<mcap::Writer> writer_;
  std::optional<mode_t> permitted_;  ///< of the open file
  std::uint64_t lost_ = 0;           ///< of what the writer has lost, what the ledger says
  std::string path_;
  unsigned number_ = 0;                    ///< of the next file
  std::uint64_t begin_ = 0;                ///< the log time of the file's first message
  std::map<std::size_t, Given> channels_;  ///< of lines of the ledger
  std::map<std::pair<std::string, std::string>, std::uint16_t> schemas_;
  std::map<std::size_t, Ledger::Topic> told_;    ///< what ends of files have said of a line so far
  std::chrono::steady_clock::time_point again_;  ///< not before this time it makes a file anew
};

}  // namespace lot::record
