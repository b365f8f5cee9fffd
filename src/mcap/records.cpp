// SPDX-License-Identifier: Apache-2.0
#include "mcap/records.hpp"

#include <algorithm>

#include "mcap/crc.hpp"

namespace lot::mcap {
namespace {

using u16 = std::uint16_t;
using u32 = std::uint32_t;
using u64 = std::uint64_t;

template <class... Numbers>
void numbers(Encoder& to, Numbers... values) {
  (to.number(values), ...);
}

template <class Fill>
void record(Bytes& out, Opcode opcode, Fill&& fill) {
  Encoder to(out);
  to.record(static_cast<std::uint8_t>(opcode), [&] { fill(to); });
}

void pairs(Encoder& to, const Pairs& pairs) {
  to.list([&] {
    for (const auto& [key, value] : pairs) {
      to.text(key);
      to.text(value);
    }
  });
}

Pairs pairs(Decoder& from) {
  Pairs result;
  for (Decoder entries(from.list()); entries.left() != 0;) {
    std::string key = entries.text();
    result.insert_or_assign(std::move(key), entries.text());
  }
  return result;
}

/// Channels, and a number for each.
template <class List>
void by_channel(Encoder& to, const List& list) {
  to.list([&] {
    for (const auto& [channel, number] : list) numbers(to, channel, number);
  });
}

template <class List>
List by_channel(Decoder& from) {
  List result;
  for (Decoder entries(from.list()); entries.left() != 0;) {
    const auto channel = entries.number<u16>();
    result.insert(result.end(), {channel, entries.number<u64>()});
  }
  return result;
}

Bytes copy(View bytes) { return {bytes.begin(), bytes.end()}; }

}  // namespace

void Statistics::count(std::uint16_t channel, std::uint64_t log_time) {
  start = messages == 0 ? log_time : std::min(start, log_time);
  end = messages == 0 ? log_time : std::max(end, log_time);
  ++messages;
  ++channel_messages[channel];
}

void encode_magic(Bytes& out) { Encoder(out).raw(std::as_bytes(std::span(kMagic))); }

void encode(Bytes& out, const Header& header) {
  record(out, Opcode::Header, [&](Encoder& to) {
    to.text(header.profile);
    to.text(header.library);
  });
}

void encode(Bytes& out, const Footer& footer) {
  record(out, Opcode::Footer, [&](Encoder& to) {
    numbers(to, footer.summary_start, footer.summary_offset_start, footer.summary_crc);
  });
}

void encode(Bytes& out, const Schema& schema) {
  record(out, Opcode::Schema, [&](Encoder& to) {
    to.number(schema.id);
    to.text(schema.name);
    to.text(schema.encoding);
    to.list([&] { to.raw(schema.data); });
  });
}

void encode(Bytes& out, const Channel& channel) {
  record(out, Opcode::Channel, [&](Encoder& to) {
    numbers(to, channel.id, channel.schema);
    to.text(channel.topic);
    to.text(channel.message_encoding);
    pairs(to, channel.metadata);
  });
}

void encode(Bytes& out, const MessageHead& head, std::uint64_t payload_bytes) {
  Encoder to(out);
  numbers(to, Opcode::Message, kMessageBytes + payload_bytes);
  numbers(to, head.channel, head.sequence, head.log_time, head.publish_time);
}

void encode(Bytes& out, const ChunkHead& head) {
  Encoder to(out);
  const u64 body = 3 * sizeof(u64) + sizeof(u32) + sizeof(u32) + head.compression.size() +
                   sizeof(u64) + head.compressed_bytes;
  numbers(to, Opcode::Chunk, body);
  numbers(to, head.start, head.end, head.uncompressed_bytes, head.uncompressed_crc);
  to.text(head.compression);
  to.number(head.compressed_bytes);
}

void encode(Bytes& out, const MessageIndex& index) {
  record(out, Opcode::MessageIndex, [&](Encoder& to) {
    to.number(index.channel);
    to.list([&] {
      for (const auto& [log_time, offset] : index.entries) numbers(to, log_time, offset);
    });
  });
}

void encode(Bytes& out, const ChunkIndex& index) {
  record(out, Opcode::ChunkIndex, [&](Encoder& to) {
    numbers(to, index.start, index.end, index.offset, index.bytes);
    by_channel(to, index.message_indexes);
    to.number(index.message_index_bytes);
    to.text(index.compression);
    numbers(to, index.compressed_bytes, index.uncompressed_bytes);
  });
}

void encode(Bytes& out, const Attachment& attachment, bool crc) {
  record(out, Opcode::Attachment, [&](Encoder& to) {
    const std::size_t begin = out.size();
    numbers(to, attachment.log_time, attachment.create_time);
    to.text(attachment.name);
    to.text(attachment.media_type);
    to.number(u64{attachment.data.size()});
    to.raw(attachment.data);
    to.number(crc ? Crc(View(out).subspan(begin)).value() : u32{0});
  });
}

void encode(Bytes& out, const AttachmentIndex& index) {
  record(out, Opcode::AttachmentIndex, [&](Encoder& to) {
    numbers(to, index.offset, index.bytes, index.log_time, index.create_time, index.data_bytes);
    to.text(index.name);
    to.text(index.media_type);
  });
}

void encode(Bytes& out, const Metadata& metadata) {
  record(out, Opcode::Metadata, [&](Encoder& to) {
    to.text(metadata.name);
    pairs(to, metadata.pairs);
  });
}

void encode(Bytes& out, const MetadataIndex& index) {
  record(out, Opcode::MetadataIndex, [&](Encoder& to) {
    numbers(to, index.offset, index.bytes);
    to.text(index.name);
  });
}

void encode(Bytes& out, const Statistics& statistics) {
  record(out, Opcode::Statistics, [&](Encoder& to) {
    const Statistics& s = statistics;
    numbers(to, s.messages, s.schemas, s.channels, s.attachments, s.metadata, s.chunks, s.start,
            s.end);
    by_channel(to, s.channel_messages);
  });
}

void encode(Bytes& out, const SummaryOffset& offset) {
  record(out, Opcode::SummaryOffset,
         [&](Encoder& to) { numbers(to, offset.group, offset.start, offset.bytes); });
}

void encode_data_end(Bytes& out, std::uint32_t crc) {
  record(out, Opcode::DataEnd, [&](Encoder& to) { to.number(crc); });
}

template <>
Header decode<Header>(View body) {
  Decoder from(body);
  Header header;
  header.profile = from.text();
  header.library = from.text();
  return header;
}

template <>
Footer decode<Footer>(View body) {
  Decoder from(body);
  Footer footer;
  footer.summary_start = from.number<u64>();
  footer.summary_offset_start = from.number<u64>();
  footer.summary_crc = from.number<u32>();
  return footer;
}

template <>
Schema decode<Schema>(View body) {
  Decoder from(body);
  Schema schema;
  schema.id = from.number<u16>();
  if (schema.id == 0) throw Malformed("it has the number 0, which means none");
  schema.name = from.text();
  schema.encoding = from.text();
  schema.data = copy(from.list());
  return schema;
}

template <>
Channel decode<Channel>(View body) {
  Decoder from(body);
  Channel channel;
  channel.id = from.number<u16>();
  channel.schema = from.number<u16>();
  channel.topic = from.text();
  channel.message_encoding = from.text();
  channel.metadata = pairs(from);
  return channel;
}

template <>
MessageHead decode<MessageHead>(View body) {
  Decoder from(body);
  MessageHead head;
  head.channel = from.number<u16>();
  head.sequence = from.number<u32>();
  head.log_time = from.number<u64>();
  head.publish_time = from.number<u64>();
  return head;
}

template <>
MessageIndex decode<MessageIndex>(View body) {
  Decoder from(body);
  MessageIndex index;
  index.channel = from.number<u16>();
  for (Decoder entries(from.list()); entries.left() != 0;) {
    const auto log_time = entries.number<u64>();
    index.entries.emplace_back(log_time, entries.number<u64>());
  }
  return index;
}

template <>
ChunkIndex decode<ChunkIndex>(View body) {
  Decoder from(body);
  ChunkIndex index;
  index.start = from.number<u64>();
  index.end = from.number<u64>();
  index.offset = from.number<u64>();
  index.bytes = from.number<u64>();
  index.message_indexes = by_channel<decltype(index.message_indexes)>(from);
  index.message_index_bytes = from.number<u64>();
  index.compression = from.text();
  index.compressed_bytes = from.number<u64>();
  index.uncompressed_bytes = from.number<u64>();
  return index;
}

template <>
Attachment decode<Attachment>(View body) {
  Decoder from(body);
  Attachment attachment;
  attachment.log_time = from.number<u64>();
  attachment.create_time = from.number<u64>();
  attachment.name = from.text();
  attachment.media_type = from.text();
  attachment.data = copy(from.raw(from.number<u64>()));
  const View covered = body.first(body.size() - from.left());
  const auto crc = from.number<u32>();
  if (crc != 0 && crc != Crc(covered).value()) throw Malformed("its CRC is wrong");
  return attachment;
}

template <>
AttachmentIndex decode<AttachmentIndex>(View body) {
  Decoder from(body);
  AttachmentIndex index;
  index.offset = from.number<u64>();
  index.bytes = from.number<u64>();
  index.log_time = from.number<u64>();
  index.create_time = from.number<u64>();
  index.data_bytes = from.number<u64>();
  index.name = from.text();
  index.media_type = from.text();
  return index;
}

template <>
Metadata decode<Metadata>(View body) {
  Decoder from(body);
  Metadata metadata;
  metadata.name = from.text();
  metadata.pairs = pairs(from);
  return metadata;
}

template <>
MetadataIndex decode<MetadataIndex>(View body) {
  Decoder from(body);
  MetadataIndex index;
  index.offset = from.number<u64>();
  index.bytes = from.number<u64>();
  index.name = from.text();
  return index;
}

template <>
Statistics decode<Statistics>(View body) {
  Decoder from(body);
  Statistics s;
  s.messages = from.number<u64>();
  s.schemas = from.number<u16>();
  s.channels = from.number<u32>();
  s.attachments = from.number<u32>();
  s.metadata = from.number<u32>();
  s.chunks = from.number<u32>();
  s.start = from.number<u64>();
  s.end = from.number<u64>();
  s.channel_messages = by_channel<decltype(s.channel_messages)>(from);
  return s;
}

std::pair<ChunkHead, std::uint64_t> decode_chunk_head(View first, std::uint64_t body_bytes) {
  Decoder from(first);
  ChunkHead head;
  head.start = from.number<u64>();
  head.end = from.number<u64>();
  head.uncompressed_bytes = from.number<u64>();
  head.uncompressed_crc = from.number<u32>();
  head.compression = from.text();
  head.compressed_bytes = from.number<u64>();
  const u64 taken = first.size() - from.left();
  if (head.compressed_bytes > body_bytes - taken) throw Malformed("its records are longer than it");
  return {head, taken};
}

}  // namespace lot::mcap
