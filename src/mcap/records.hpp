// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "mcap/bytes.hpp"

/// The records of MCAP, version 0, as structures, and as bytes. Times are nanoseconds; since when,
/// the file's profile says. Source: https://mcap.dev/spec
namespace lot::mcap {

enum class Opcode : std::uint8_t {
  Header = 1,
  Footer,
  Schema,
  Channel,
  Message,
  Chunk,
  MessageIndex,
  ChunkIndex,
  Attachment,
  AttachmentIndex,
  Statistics,
  Metadata,
  MetadataIndex,
  SummaryOffset,
  DataEnd
};

/// The first and the last bytes of a file.
inline constexpr unsigned char kMagic[8] = {0x89, 'M', 'C', 'A', 'P', '0', '\r', '\n'};
inline constexpr std::uint64_t kMagicBytes = sizeof(kMagic);
/// An opcode and a length: what is in front of each record's body.
inline constexpr std::uint64_t kPrefixBytes = 9;
/// What is in front of a message's payload, without the prefix.
inline constexpr std::uint64_t kMessageBytes = 22;
inline constexpr std::uint64_t kFooterBytes = 20;

using Pairs = std::map<std::string, std::string>;

struct Header {
  std::string profile;
  std::string library;
};

struct Footer {
  std::uint64_t summary_start = 0;         ///< 0: there is no summary
  std::uint64_t summary_offset_start = 0;  ///< 0: there are no SummaryOffsets
  std::uint32_t summary_crc = 0;           ///< from summary_start up to this field; 0: none
};

struct Schema {
  std::uint16_t id = 0;  ///< never 0
  std::string name;
  std::string encoding;
  Bytes data;
  bool operator==(const Schema&) const = default;
};

struct Channel {
  std::uint16_t id = 0;
  std::uint16_t schema = 0;  ///< 0: none
  std::string topic;
  std::string message_encoding;
  Pairs metadata;
  bool operator==(const Channel&) const = default;
};

/// What a message says of itself, without its payload.
struct MessageHead {
  std::uint16_t channel = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time = 0;
  std::uint64_t publish_time = 0;
};

/// A chunk without its records.
struct ChunkHead {
  std::uint64_t start = 0;  ///< the earliest log time in it
  std::uint64_t end = 0;    ///< the latest
  std::uint64_t uncompressed_bytes = 0;
  std::uint32_t uncompressed_crc = 0;  ///< 0: none
  std::string compression;             ///< "", "lz4" or "zstd"
  std::uint64_t compressed_bytes = 0;
};

/// Where the messages of one channel lie in a chunk: log times, and offsets in its records.
struct MessageIndex {
  std::uint16_t channel = 0;
  std::vector<std::pair<std::uint64_t, std::uint64_t>> entries;
};

struct ChunkIndex {
  std::uint64_t start = 0;
  std::uint64_t end = 0;
  std::uint64_t offset = 0;  ///< of the chunk's record in the file
  std::uint64_t bytes = 0;   ///< of that record, with its prefix
  std::vector<std::pair<std::uint16_t, std::uint64_t>> message_indexes;  ///< channel, offset
  std::uint64_t message_index_bytes = 0;
  std::string compression;
  std::uint64_t compressed_bytes = 0;
  std::uint64_t uncompressed_bytes = 0;
};

struct Attachment {
  std::uint64_t log_time = 0;
  std::uint64_t create_time = 0;
  std::string name;
  std::string media_type;
  Bytes data;
};

struct AttachmentIndex {
  std::uint64_t offset = 0;
  std::uint64_t bytes = 0;
  std::uint64_t log_time = 0;
  std::uint64_t create_time = 0;
  std::uint64_t data_bytes = 0;
  std::string name;
  std::string media_type;
};

struct Metadata {
  std::string name;
  Pairs pairs;
};

struct MetadataIndex {
  std::uint64_t offset = 0;
  std::uint64_t bytes = 0;
  std::string name;
};

struct Statistics {
  std::uint64_t messages = 0;
  std::uint16_t schemas = 0;
  std::uint32_t channels = 0;
  std::uint32_t attachments = 0;
  std::uint32_t metadata = 0;
  std::uint32_t chunks = 0;
  std::uint64_t start = 0;  ///< the earliest log time; 0 without messages
  std::uint64_t end = 0;
  std::map<std::uint16_t, std::uint64_t> channel_messages;

  /// One message more.
  void count(std::uint16_t channel, std::uint64_t log_time);
};

struct SummaryOffset {
  Opcode group{};
  std::uint64_t start = 0;
  std::uint64_t bytes = 0;
};

// ---- as bytes: with prefix, appended to a buffer
// --------------------------------------------------

void encode(Bytes& out, const Header& header);
void encode(Bytes& out, const Footer& footer);
void encode(Bytes& out, const Schema& schema);
void encode(Bytes& out, const Channel& channel);
void encode(Bytes& out, const MessageIndex& index);
void encode(Bytes& out, const ChunkIndex& index);
/// Its CRC is 0 unless `crc`.
void encode(Bytes& out, const Attachment& attachment, bool crc);
void encode(Bytes& out, const AttachmentIndex& index);
void encode(Bytes& out, const Metadata& metadata);
void encode(Bytes& out, const MetadataIndex& index);
void encode(Bytes& out, const Statistics& statistics);
void encode(Bytes& out, const SummaryOffset& offset);
void encode_data_end(Bytes& out, std::uint32_t crc);
void encode_magic(Bytes& out);
/// Up to the payload, which has so many bytes.
void encode(Bytes& out, const MessageHead& head, std::uint64_t payload_bytes);
/// Up to the chunk's records.
void encode(Bytes& out, const ChunkHead& head);

// ---- from bytes: a record's body, without prefix. Throw Malformed
// ---------------------------------

template <class Record>
Record decode(View body);

template <>
Header decode<Header>(View body);
template <>
Footer decode<Footer>(View body);
template <>
Schema decode<Schema>(View body);
template <>
Channel decode<Channel>(View body);
template <>
MessageHead decode<MessageHead>(View body);
template <>
MessageIndex decode<MessageIndex>(View body);
template <>
ChunkIndex decode<ChunkIndex>(View body);
template <>
Attachment decode<Attachment>(View body);
template <>
AttachmentIndex decode<AttachmentIndex>(View body);
template <>
Metadata decode<Metadata>(View body);
template <>
MetadataIndex decode<MetadataIndex>(View body);
template <>
Statistics decode<Statistics>(View body);

/// A chunk's head from its first bytes, and how many of them it takes. `body_bytes` is the length
/// of the whole body, which its records must not exceed.
std::pair<ChunkHead, std::uint64_t> decode_chunk_head(View first, std::uint64_t body_bytes);

}  // namespace lot::mcap
