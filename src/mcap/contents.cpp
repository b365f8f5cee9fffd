// SPDX-License-Identifier: Apache-2.0
#include "mcap/contents.hpp"

#include <cstring>
#include <span>

#include "mcap/crc.hpp"

namespace lot::mcap {

void Contents::note(const Attachment& attachment, std::uint64_t offset, std::uint64_t bytes) {
  attachments.push_back({offset, bytes, attachment.log_time, attachment.create_time,
                         attachment.data.size(), attachment.name, attachment.media_type});
  ++statistics.attachments;
}

void Contents::note(const Metadata& record, std::uint64_t offset, std::uint64_t bytes) {
  metadata.push_back({offset, bytes, record.name});
  ++statistics.metadata;
}

Bytes encode_indexes(const std::map<std::uint16_t, MessageIndex>& indexes, ChunkIndex& chunk) {
  Bytes out;
  chunk.message_indexes.clear();
  for (const auto& [channel, index] : indexes) {
    chunk.message_indexes.emplace_back(channel, chunk.offset + chunk.bytes + out.size());
    encode(out, index);
  }
  chunk.message_index_bytes = out.size();
  return out;
}

Bytes encode_end(const Contents& contents, std::uint64_t data_bytes, std::uint32_t data_crc,
                 bool crc) {
  Bytes out;
  encode_data_end(out, data_crc);
  const std::size_t summary = out.size();
  std::vector<SummaryOffset> groups;
  const auto group = [&](Opcode opcode, auto&& fill) {
    const std::size_t begin = out.size();
    fill();
    if (out.size() != begin) groups.push_back({opcode, data_bytes + begin, out.size() - begin});
  };
  group(Opcode::Schema, [&] {
    for (const auto& [id, schema] : contents.schemas) encode(out, schema);
  });
  group(Opcode::Channel, [&] {
    for (const auto& [id, channel] : contents.channels) encode(out, channel);
  });
  group(Opcode::Statistics, [&] { encode(out, contents.statistics); });
  group(Opcode::MetadataIndex, [&] {
    for (const MetadataIndex& index : contents.metadata) encode(out, index);
  });
  group(Opcode::AttachmentIndex, [&] {
    for (const AttachmentIndex& index : contents.attachments) encode(out, index);
  });
  group(Opcode::ChunkIndex, [&] {
    for (const ChunkIndex& index : contents.chunks) encode(out, index);
  });
  const std::size_t offsets = out.size();
  for (const SummaryOffset& offset : groups) encode(out, offset);

  encode(out, Footer{data_bytes + summary, data_bytes + offsets, 0});
  Footer footer{};
  const std::size_t covered = out.size() - sizeof(footer.summary_crc);
  if (crc) footer.summary_crc = Crc(View(out).subspan(summary, covered - summary)).value();
  std::memcpy(out.data() + covered, &footer.summary_crc, sizeof(footer.summary_crc));
  encode_magic(out);
  return out;
}

}  // namespace lot::mcap
