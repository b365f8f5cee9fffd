// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "mcap/records.hpp"

namespace lot::mcap {

/// What is in a file, as its summary says it.
struct Contents {
  std::map<std::uint16_t, Schema> schemas;
  std::map<std::uint16_t, Channel> channels;
  Statistics statistics;
  std::vector<ChunkIndex> chunks;
  std::vector<AttachmentIndex> attachments;
  std::vector<MetadataIndex> metadata;

  /// Attachments and metadata, each with what is counted of it.
  void note(const Attachment& attachment, std::uint64_t offset, std::uint64_t bytes);
  void note(const Metadata& record, std::uint64_t offset, std::uint64_t bytes);
};

/// The message indexes of a chunk, which come behind it; `chunk` then says where.
Bytes encode_indexes(const std::map<std::uint16_t, MessageIndex>& indexes, ChunkIndex& chunk);

/// What comes behind `data_bytes` of data: DataEnd, the summary and the footer. `data_crc`: 0 for
/// none. `crc`: whether the summary has one.
Bytes encode_end(const Contents& contents, std::uint64_t data_bytes, std::uint32_t data_crc,
                 bool crc);

}  // namespace lot::mcap
