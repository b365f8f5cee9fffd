// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "mcap/scan.hpp"
#include "mcap/summary.hpp"

namespace lot::mcap {

/// Reads the messages of a file in its own order. It needs no summary.
///
/// Threads: one at a time.
/// Errors:  lot::Error: the file cannot be read at all, or is no MCAP file. What is damaged is
///          skipped and counted.
/// Memory:  one chunk.
class Stream {
 public:
  explicit Stream(const std::string& path, const Limits& limits = {});

  /// The next message, valid until the next call; none at the end.
  std::optional<Message> next();

  const Header& header() const { return scan_.header(); }
  /// Those that came so far: that of each message that was returned.
  const std::map<std::uint16_t, Schema>& schemas() const { return scan_.schemas(); }
  const std::map<std::uint16_t, Channel>& channels() const { return scan_.channels(); }
  const Damage& damage() const { return scan_.damage(); }
  /// At the end: whether its writer has closed it.
  bool is_whole() const { return scan_.is_whole(); }

 private:
  InFile file_;
  Scan scan_;
  std::size_t next_ = 0;  ///< of the scan's records
};

/// Which messages a Reader gives.
struct Query {
  std::uint64_t from = 0;  ///< log times, both included
  std::uint64_t until = std::numeric_limits<std::uint64_t>::max();
  std::optional<std::set<std::uint16_t>> channels;  ///< none: all
};

class Messages;

/// Reads a file by its index. Where that is missing or wrong it makes one, by reading all.
///
/// Threads: one at a time, with its Messages.
/// Errors:  as Stream.
/// Memory:  the index: about 200 bytes for each chunk.
class Reader {
 public:
  explicit Reader(const std::string& path, const Limits& limits = {});

  const Header& header() const { return index_.header; }
  const std::map<std::uint16_t, Schema>& schemas() const { return index_.contents.schemas; }
  const std::map<std::uint16_t, Channel>& channels() const { return index_.contents.channels; }
  const Statistics& statistics() const { return index_.contents.statistics; }
  const std::vector<ChunkIndex>& chunks() const { return index_.contents.chunks; }
  const std::vector<AttachmentIndex>& attachments() const { return index_.contents.attachments; }
  const std::vector<MetadataIndex>& metadata() const { return index_.contents.metadata; }

  /// What an index leads to. Throw lot::Error when it is not there, or damaged.
  Attachment read(const AttachmentIndex& index);
  Metadata read(const MetadataIndex& index);

  /// In the order of log times; of equal ones, in that of the file. REQUIRES: the reader outlives
  /// it.
  Messages messages(Query query = {});

  /// False: the index was made by reading.
  bool has_summary() const { return index_.has_summary; }
  /// What is wrong with the summary of a file that was closed; empty: nothing, or it has none.
  const std::string& summary_fault() const { return index_.summary_fault; }
  /// What was skipped so far.
  const Damage& damage() const { return index_.damage; }

 private:
  friend class Messages;
  template <class Record>
  Record read(std::uint64_t at, std::uint64_t bytes, Opcode opcode);

  InFile file_;
  Limits limits_;
  Index index_;
};

/// The messages that a query asked for.
///
/// Memory: the chunks that overlap in time at the place where it reads.
class Messages {
 public:
  /// The next one, valid until the next call; none at the end. Errors: lot::Error with EFBIG: more
  /// overlaps than Limits::overlap_bytes.
  std::optional<Message> next();

 private:
  friend class Reader;
  /// A part that has been read: its messages that are asked for, in order.
  struct Open {
    std::uint64_t at = 0;
    std::shared_ptr<const Records> records;
    std::vector<const Message*> left;  ///< the next one at the end
    std::uint64_t time() const { return left.back()->head.log_time; }
    /// For a heap whose top is what comes first.
    friend bool operator<(const Open& a, const Open& b) {
      return a.time() != b.time() ? a.time() > b.time() : a.at > b.at;
    }
  };

  Messages(Reader& reader, Query query);
  bool wants(const Part& part) const;
  bool wants(const Message& message) const;
  void open(const Part& part);

  Reader* reader_;
  Query query_;
  std::vector<const Part*> parts_;  ///< still to be read; the next one at the end
  std::vector<Open> open_;          ///< a heap
  std::uint64_t open_bytes_ = 0;
  std::shared_ptr<const Records> returned_;  ///< of the message that was returned
};

}  // namespace lot::mcap
