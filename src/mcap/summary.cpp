// SPDX-License-Identifier: Apache-2.0
#include "mcap/summary.hpp"

#include <algorithm>
#include <array>
#include <set>
#include <utility>

#include "mcap/crc.hpp"

namespace lot::mcap {
namespace {

Footer read_footer(InFile& file, const Limits& limits, Frame& frame) {
  constexpr std::uint64_t kEnd = kPrefixBytes + kFooterBytes + kMagicBytes;
  if (file.size() < kMagicBytes + kEnd) throw Malformed("it has no footer");
  const auto found = frame_at(file, file.size() - kEnd);
  const View magic = file.peek(file.size() - kMagicBytes, kMagicBytes);
  if (!found || !found->is(Opcode::Footer) || found->bytes != kFooterBytes ||
      !std::ranges::equal(magic, std::as_bytes(std::span(kMagic)))) {
    throw Malformed("it has no footer");
  }
  frame = *found;
  return read_record<Footer>(file, frame, limits);
}

void check_crc(InFile& file, const Footer& footer, const Frame& frame) {
  if (footer.summary_crc == 0) return;
  Crc crc;
  const std::uint64_t end = frame.end() - sizeof(footer.summary_crc);
  for (std::uint64_t at = footer.summary_start; at < end;) {
    const std::uint64_t most = std::min<std::uint64_t>(InFile::kAhead, end - at);
    const View there = file.peek(at, most);
    const View piece = there.first(std::min<std::uint64_t>(there.size(), most));
    if (piece.empty()) throw Malformed("it leads out of the file");
    crc.add(piece);
    at += piece.size();
  }
  if (crc.value() != footer.summary_crc) throw Malformed("its CRC is wrong");
}

/// One record of the summary. False: it belongs somewhere else.
bool take(InFile& file, const Frame& frame, const Limits& limits, Contents& to, bool& has_counts) {
  switch (static_cast<Opcode>(frame.opcode)) {
    case Opcode::Schema: {
      auto schema = read_record<Schema>(file, frame, limits);
      to.schemas.emplace(schema.id, std::move(schema));
      return true;
    }
    case Opcode::Channel: {
      auto channel = read_record<Channel>(file, frame, limits);
      to.channels.emplace(channel.id, std::move(channel));
      return true;
    }
    case Opcode::Statistics:
      to.statistics = read_record<Statistics>(file, frame, limits);
      has_counts = true;
      return true;
    case Opcode::ChunkIndex:
      to.chunks.push_back(read_record<ChunkIndex>(file, frame, limits));
      return true;
    case Opcode::AttachmentIndex:
      to.attachments.push_back(read_record<AttachmentIndex>(file, frame, limits));
      return true;
    case Opcode::MetadataIndex:
      to.metadata.push_back(read_record<MetadataIndex>(file, frame, limits));
      return true;
    case Opcode::SummaryOffset:
      return true;
    default:
      return frame.opcode > static_cast<std::uint8_t>(Opcode::DataEnd);
  }
}

/// How many entries the message indexes of a chunk have.
std::uint64_t indexed_messages(const ChunkIndex& chunk) {
  constexpr std::uint64_t kIndex = kPrefixBytes + sizeof(std::uint16_t) + sizeof(std::uint32_t);
  constexpr std::uint64_t kEntry = 2 * sizeof(std::uint64_t);
  const std::uint64_t heads = kIndex * chunk.message_indexes.size();
  return chunk.message_index_bytes < heads ? 0 : (chunk.message_index_bytes - heads) / kEntry;
}

/// Throws Incomplete if something that the file has cannot be found by its summary.
void check_complete(const Contents& contents) {
  const auto known = [&](const auto& pair) { return contents.channels.contains(pair.first); };
  const Statistics& counts = contents.statistics;
  bool complete = std::ranges::all_of(counts.channel_messages, known) &&
                  counts.chunks == contents.chunks.size() &&
                  counts.attachments == contents.attachments.size() &&
                  counts.metadata == contents.metadata.size();
  std::uint64_t messages = 0;
  for (const ChunkIndex& chunk : contents.chunks) {
    complete = complete && std::ranges::all_of(chunk.message_indexes, known);
    messages += indexed_messages(chunk);
  }
  if (!complete || messages != counts.messages)
    throw Incomplete("it does not lead to all messages");
}

/// The chunks as parts, in the order of the file. Throws Malformed if they overlap there.
std::vector<Part> parts_of(const std::vector<ChunkIndex>& chunks, std::uint64_t data_begin,
                           std::uint64_t data_end) {
  std::vector<Part> parts;
  for (const ChunkIndex& chunk : chunks) {
    Part part{chunk.start, chunk.end, chunk.offset, chunk.bytes, {}};
    for (const auto& [channel, offset] : chunk.message_indexes) part.channels.push_back(channel);
    parts.push_back(std::move(part));
  }
  std::ranges::sort(parts, {}, &Part::at);
  std::uint64_t at = data_begin;
  for (const Part& part : parts) {
    if (part.at < at || part.at > data_end || part.bytes > data_end - part.at) {
      throw Malformed("a chunk is not where it says");
    }
    at = part.at + part.bytes;
  }
  return parts;
}

/// Adds what a record of the data, which could be read, says.
void take(InFile& file, const Frame& frame, Scan& scan, const Limits& limits, Index& to) {
  Contents& contents = to.contents;
  if (frame.is(Opcode::Attachment)) {
    contents.note(read_record<Attachment>(file, frame, limits), frame.at, frame.end() - frame.at);
  } else if (frame.is(Opcode::Metadata)) {
    contents.note(read_record<Metadata>(file, frame, limits), frame.at, frame.end() - frame.at);
  } else if (frame.is(Opcode::MessageIndex) && !contents.chunks.empty()) {
    ChunkIndex& chunk = contents.chunks.back();
    if (chunk.offset + chunk.bytes + chunk.message_index_bytes != frame.at) return;
    const auto index = read_record<MessageIndex>(file, frame, limits);
    if (scan.channels().contains(index.channel)) {
      chunk.message_indexes.emplace_back(index.channel, frame.at);
    }
    chunk.message_index_bytes += frame.end() - frame.at;
  }
  if (scan.records() == nullptr) return;

  std::set<std::uint16_t> channels;
  Part part{0, 0, frame.at, frame.end() - frame.at, {}};
  for (const Message& message : scan.records()->messages()) {
    if (scan.channel_of(message) == nullptr) continue;
    const std::uint64_t time = message.head.log_time;
    part.start = channels.empty() ? time : std::min(part.start, time);
    part.end = channels.empty() ? time : std::max(part.end, time);
    channels.insert(message.head.channel);
    contents.statistics.count(message.head.channel, time);
  }
  part.channels.assign(channels.begin(), channels.end());
  if (!channels.empty()) to.parts.push_back(part);
  if (frame.is(Opcode::Message)) {
    to.has_loose = true;
    return;
  }
  const ChunkHead& head = scan.records()->head();
  contents.chunks.push_back({head.start,
                             head.end,
                             part.at,
                             part.bytes,
                             {},
                             0,
                             head.compression,
                             head.compressed_bytes,
                             head.uncompressed_bytes});
}

}  // namespace

Index index_by_summary(InFile& file, const Limits& limits) {
  Index index;
  std::uint64_t data_begin = 0;
  std::tie(index.header, data_begin) = read_header(file, limits);
  Frame end;
  const Footer footer = read_footer(file, limits, end);
  if (footer.summary_start == 0) throw NoSummary("it has no summary");
  if (footer.summary_start < data_begin || footer.summary_start > end.at) {
    throw Malformed("it is not where the footer says");
  }
  check_crc(file, footer, end);
  bool has_counts = false;
  for (std::uint64_t at = footer.summary_start; at != end.at;) {
    const auto frame = frame_at(file, at);
    if (!frame || frame->end() > end.at ||
        !take(file, *frame, limits, index.contents, has_counts)) {
      throw Malformed("it has a record that may not be there");
    }
    at = frame->end();
  }
  if (!has_counts) throw Incomplete("it has no statistics");
  check_complete(index.contents);
  index.parts = parts_of(index.contents.chunks, data_begin, footer.summary_start);
  index.data_end = footer.summary_start;
  index.has_summary = true;
  return index;
}

Index index_by_reading(InFile& file, const Limits& limits) {
  Index index;
  Scan scan(file, limits);
  bool in_data = true;
  while (const auto frame = scan.next()) {
    if (in_data && (frame->is(Opcode::DataEnd) || frame->is(Opcode::Footer))) {
      in_data = false;
      index.data_end = frame->at;
      index.has_data_end = true;
    }
    if (in_data) take(file, *frame, scan, limits, index);
  }
  if (in_data) index.data_end = scan.at();
  index.header = scan.header();
  index.contents.schemas = scan.schemas();
  index.contents.channels = scan.channels();
  Statistics& counts = index.contents.statistics;
  counts.schemas = static_cast<std::uint16_t>(scan.schemas().size());
  counts.channels = static_cast<std::uint32_t>(scan.channels().size());
  counts.chunks = static_cast<std::uint32_t>(index.contents.chunks.size());
  index.is_whole = scan.is_whole();
  index.damage = scan.damage();
  return index;
}

Index index_of(InFile& file, const Limits& limits) {
  std::string fault;
  try {
    return index_by_summary(file, limits);
  } catch (const Incomplete&) {
    // It is right, and has less than the file.
  } catch (const NoSummary&) {
    // Its writer has left it out.
  } catch (const Malformed& malformed) {
    fault = malformed.what();
  }
  Index index = index_by_reading(file, limits);
  if (index.is_whole) index.summary_fault = fault;
  return index;
}

}  // namespace lot::mcap
