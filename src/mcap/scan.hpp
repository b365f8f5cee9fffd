// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "mcap/compression.hpp"
#include "mcap/files.hpp"
#include "mcap/records.hpp"

/// What readers share: the records of a file, one after the other, and what is wrong with them.
namespace lot::mcap {

/// What a reader accepts.
struct Limits {
  /// The largest record that it reads, and the largest chunk, uncompressed.
  std::uint64_t chunk_bytes = 1 << 30;
  /// How much of chunks that overlap in time it holds at once.
  std::uint64_t overlap_bytes = std::uint64_t{4} << 30;
};

/// What a reader has skipped.
struct Damage {
  std::uint64_t chunks = 0;
  std::uint64_t records = 0;  ///< outside of chunks, and messages without a channel
  std::uint64_t bytes = 0;    ///< of both, and of what is behind the last whole record
  std::string first;          ///< the first reason, with its place

  bool any() const { return !first.empty(); }
  void note(std::uint64_t at, const std::string& what);
};

/// A record of the file, outside of chunks.
struct Frame {
  std::uint8_t opcode = 0;
  std::uint64_t at = 0;     ///< of its opcode
  std::uint64_t bytes = 0;  ///< of its body

  bool is(Opcode other) const { return opcode == static_cast<std::uint8_t>(other); }
  std::uint64_t body() const { return at + kPrefixBytes; }
  std::uint64_t end() const { return body() + bytes; }
};

/// The record that begins there; none where no whole one does.
std::optional<Frame> frame_at(InFile& file, std::uint64_t at);
/// The body of a record. Throws Malformed if it is larger than the limit.
Buffer body_of(InFile& file, const Frame& frame, const Limits& limits);

template <class Record>
Record read_record(InFile& file, const Frame& frame, const Limits& limits) {
  return decode<Record>(body_of(file, frame, limits).bytes());
}

/// Where the first record behind the header begins, and the header. Throws lot::Error when the file
/// has none: it is no MCAP file.
std::pair<Header, std::uint64_t> read_header(InFile& file, const Limits& limits);

/// A message. Its payload is valid as long as its reader says.
struct Message {
  MessageHead head;
  View payload;
};

/// What is in a chunk, or in a message outside of chunks.
class Records {
 public:
  /// All that is in it is right, or it throws Malformed. REQUIRES: a Chunk or a Message.
  Records(InFile& file, const Frame& frame, const Limits& limits);

  const std::vector<Message>& messages() const { return messages_; }
  const std::vector<Schema>& schemas() const { return schemas_; }
  const std::vector<Channel>& channels() const { return channels_; }
  /// Of a chunk.
  const ChunkHead& head() const { return head_; }
  std::uint64_t bytes() const { return bytes_.bytes().size(); }
  /// Where the record of one of the messages of a chunk begins, in the chunk's records.
  std::uint64_t offset_of(const Message& message) const {
    const auto payload = message.payload.data() - bytes_.bytes().data();
    return static_cast<std::uint64_t>(payload) - kMessageBytes - kPrefixBytes;
  }

 private:
  void read_chunk(InFile& file, const Frame& frame, const Limits& limits);
  void parse();
  void take(std::uint8_t opcode, View body);

  ChunkHead head_;
  Buffer bytes_;
  std::vector<Message> messages_;
  std::vector<Schema> schemas_;
  std::vector<Channel> channels_;
};

/// Reads a file from the front, a record at a time. What cannot be read is skipped and counted.
///
/// Threads: one at a time.
/// Errors:  lot::Error: the file cannot be read at all, or is no MCAP file.
/// Memory:  one record, or one chunk.
class Scan {
 public:
  Scan(InFile& file, const Limits& limits);

  /// The next record that could be read; none at the end.
  std::optional<Frame> next();
  /// The records of a Chunk or a Message that next() has returned, until the next call; else null.
  const std::shared_ptr<const Records>& records() const { return records_; }
  /// The channel of a message. Null, and counted, if it is not known.
  const Channel* channel_of(const Message& message);

  const Header& header() const { return header_; }
  /// Those that have been read so far.
  const std::map<std::uint16_t, Schema>& schemas() const { return schemas_; }
  const std::map<std::uint16_t, Channel>& channels() const { return channels_; }
  const Damage& damage() const { return damage_; }
  /// Where the next record would begin.
  std::uint64_t at() const { return at_; }
  /// Whether footer and magic have been read.
  bool is_whole() const { return is_whole_; }

 private:
  void read(const Frame& frame);
  void end(const Frame& footer);
  template <class Record>
  void define(std::map<std::uint16_t, Record>& known, const Record& record, std::uint64_t at);

  InFile& file_;
  Limits limits_;
  Header header_;
  std::uint64_t at_ = 0;
  bool is_whole_ = false;
  bool has_ended_ = false;
  std::shared_ptr<const Records> records_;
  std::map<std::uint16_t, Schema> schemas_;
  std::map<std::uint16_t, Channel> channels_;
  Damage damage_;
};

}  // namespace lot::mcap
