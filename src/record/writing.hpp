// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <exception>
#include <optional>
#include <span>
#include <vector>

#include "lot/error.hpp"
#include "lot/recorder.hpp"

#include "codec/encode.hpp"
#include "record/backlog.hpp"
#include "record/clock.hpp"
#include "record/files.hpp"
#include "record/ledger.hpp"
#include "record/past.hpp"

namespace lot::record {

/// Takes messages out of the backlog, encodes them, and writes them; or keeps the last seconds of
/// them until a trigger comes.
///
/// Threads: one.
/// Errors:  they are noted in the ledger, and it goes on.
/// Crash:   as Files.
class Writing {
 public:
  Writing(const RecorderOptions& options, Ledger& ledger, const Clock& clock, Backlog& backlog);

  /// Makes the first file, where there is to be one from the begin; else looks whether one can be
  /// made. Throws as mcap::Writer.
  void begin();
  /// Until the backlog is over; then it closes the file.
  void run() noexcept;
  /// What went wrong first with a file.
  const std::optional<Error>& failure() const { return failure_; }

 private:
  void take(Entry& entry);
  void write_or_keep(const std::shared_ptr<const Stream>& stream, const mcap::MessageHead& head,
                     std::span<const mcap::View> payload);
  void write(const std::shared_ptr<const Stream>& stream, const mcap::MessageHead& head,
             std::span<const mcap::View> payload);
  void pull_trigger();
  /// Ends what a trigger has begun, when its time is over.
  void look(std::uint64_t now);
  void flush_now_and_then();
  /// Does something with files, and notes what goes wrong.
  template <class Step>
  bool carefully(Step&& step) noexcept;
  bool keeps_past() const { return options_.keep_last > Duration(); }

  const RecorderOptions& options_;
  Ledger& ledger_;
  const Clock& clock_;
  Backlog& backlog_;
  Files files_;
  Past past_;
  std::uint64_t writes_until_ = 0;  ///< behind a trigger, by log time
  std::chrono::steady_clock::time_point flushed_ = std::chrono::steady_clock::now();
  codec::Encoded encoded_;
  std::optional<Error> failure_;
};

}  // namespace lot::record
