// SPDX-License-Identifier: Apache-2.0
#include "mcap/recover.hpp"

#include <algorithm>
#include <map>
#include <sys/uio.h>

#include "mcap/contents.hpp"
#include "mcap/files.hpp"
#include "mcap/summary.hpp"

namespace lot::mcap {
namespace {

/// Whether the file was closed. Its summary need not lead to all that it has: where its writer has
/// left that out, another summary could not do better.
bool has_summary(InFile& file, const Limits& limits) {
  try {
    index_by_summary(file, limits);
    return true;
  } catch (const Incomplete&) {
    return true;
  } catch (const Malformed&) {
    return false;
  }
}

/// The message indexes of the last chunk, where the file ends between them: they are to be written
/// anew behind the chunk, where the data then ends. Else nothing.
Bytes missing_indexes(InFile& file, const Limits& limits, Index& index) {
  if (index.contents.chunks.empty() || index.parts.empty()) return {};
  ChunkIndex& chunk = index.contents.chunks.back();
  const std::uint64_t chunk_end = chunk.offset + chunk.bytes;
  const Part& part = index.parts.back();
  if (part.at != chunk.offset || chunk_end + chunk.message_index_bytes != index.data_end ||
      chunk.message_indexes.size() >= part.channels.size()) {
    return {};
  }
  const Records records(file, *frame_at(file, chunk.offset), limits);
  std::map<std::uint16_t, MessageIndex> indexes;
  for (const Message& message : records.messages()) {
    const MessageHead& head = message.head;
    if (!index.contents.channels.contains(head.channel)) continue;
    indexes[head.channel].channel = head.channel;
    indexes[head.channel].entries.emplace_back(head.log_time, records.offset_of(message));
  }
  index.data_end = chunk_end;
  return encode_indexes(indexes, chunk);
}

/// What comes behind `data_bytes` of data. No index can lead to messages outside of chunks: then
/// there is no summary, so that readers read the file.
Bytes end_of(const Index& index, std::uint64_t data_bytes) {
  if (!index.has_loose) return encode_end(index.contents, data_bytes, 0, true);
  Bytes end;
  encode_data_end(end, 0);
  encode(end, Footer{});
  encode_magic(end);
  return end;
}

}  // namespace

Recovered recover(const std::string& path, const Limits& limits) {
  OutFile to = OutFile::open(path);  // and with it the lock
  InFile file(path);
  Recovered result;
  const bool closed = has_summary(file, limits);
  Index index = closed ? index_of(file, limits) : index_by_reading(file, limits);
  result.statistics = index.contents.statistics;
  result.damage = index.damage;
  result.was_whole = closed || (index.has_loose && index.is_whole);
  if (result.was_whole) return result;
  result.cut_bytes = file.size() - index.data_end;
  result.cut_old_end = index.has_data_end;
  Bytes end = missing_indexes(file, limits, index);
  const Bytes footer = end_of(index, index.data_end + end.size());
  end.insert(end.end(), footer.begin(), footer.end());
  to.cut(index.data_end);
  const iovec piece{end.data(), end.size()};
  to.append(std::span(&piece, 1));
  return result;
}

}  // namespace lot::mcap
