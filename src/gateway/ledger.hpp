// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <string>
#include <string_view>

#include "gateway/counts.hpp"
#include "mcap/files.hpp"

namespace lot::gateway {

/// How far a gateway has come with a topic, in one direction.
struct Progress {
  /// What came from one publisher, or from one other gateway.
  struct Line {
    std::uint64_t id = 0;    ///< 0: none
    std::uint64_t next = 0;  ///< the number of its next message
  };
  static constexpr std::size_t kMostLines = 16;

  std::array<std::uint64_t, kNumbers.size()> counts{};  ///< as kNumbers
  std::uint64_t written = 0;                            ///< out: samples that DDS has got
  std::array<Line, kMostLines> lines{};                 ///< the one that was used last comes first

  /// 0: it is not known.
  std::uint64_t next_of(std::uint64_t id) const noexcept;
  /// Of more than kMostLines it forgets the one that was not used for longest.
  void set_next(std::uint64_t id, std::uint64_t next) noexcept;
};

/// A gateway's progress with its topics, in a file that outlives it: so a gateway that was killed
/// and started again counts what was lost meanwhile.
///
///     Ledger ledger("/run/gateway.state", place);
///     Ledger::Entry* entry = ledger.entry(Ledger::Way::Out, "/pose");
///     Progress progress = entry->told();
///     progress.set_next(publisher, 7);
///     entry->write(progress);
///
/// Threads: each entry one; entry() and for_each() one.
/// Errors:  lot::Error of the constructor: EBUSY, another gateway has the file; EEXIST, it is a
/// file
///          of something else; what the system says, as ENOSPC
/// Memory:  half a MiB of the disk, which it maps
/// Crash:   an entry has what was written last. A kill in write() leaves what was there before
class Ledger {
 public:
  class Entry;
  enum class Way : char { Out = 'o', In = 'i' };

  /// `place`: place_of() the segment. What the file says of another one is forgotten.
  Ledger(const std::string& file, std::string_view place);
  ~Ledger();
  Ledger(const Ledger&) = delete;
  Ledger& operator=(const Ledger&) = delete;

  /// Tells this file apart from all others. Not 0.
  std::uint64_t id() const noexcept;
  /// Null: the topic's name is too long, or there are too many.
  Entry* entry(Way way, std::string_view topic) noexcept;
  void for_each(const std::function<void(Way, std::string_view topic, const Progress&)>& see) const;

 private:
  struct File;

  mcap::Descriptor lock_;  ///< held as long as the file is this gateway's
  File* file_ = nullptr;
};

/// The progress with one topic.
class Ledger::Entry {
 public:
  Progress told() const noexcept;
  void write(const Progress& progress) noexcept;

 private:
  friend class Ledger;
  static constexpr std::size_t kMostTopic = 256;

  /// The file may have any bytes in it.
  std::string_view topic() const noexcept {
    return {topic_.data(), strnlen(topic_.data(), topic_.size())};
  }

  char way_;                            ///< of Way; 0: the entry is free
  std::array<char, kMostTopic> topic_;  ///< ends with a zero byte
  std::uint64_t current_;               ///< which of the two counts
  std::array<Progress, 2> both_;
};

}  // namespace lot::gateway
