// SPDX-License-Identifier: Apache-2.0
#include "mcap/writer.hpp"

#include <algorithm>
#include <cerrno>
#include <exception>
#include <limits>
#include <map>
#include <new>
#include <unistd.h>
#include <utility>

#include "lot/error.hpp"

namespace lot::mcap {
namespace {

Crc crc_of(std::span<const View> pieces) {
  Crc crc;
  for (const View piece : pieces) crc.add(piece);
  return crc;
}

iovec vector_of(View bytes) {
  return {const_cast<std::byte*>(bytes.data()), bytes.size()};  // writing only reads it
}

}  // namespace

Writer::Writer(const std::string& path, WriterOptions options)
    : options_(std::move(options)), path_(path), file_(OutFile::make(path)) {
  if (options_.compression != Compression::None) {
    compressor_.emplace(options_.compression, options_.level);
  }
  Bytes head;
  encode_magic(head);
  encode(head, options_.header);
  try {
    append(head);
  } catch (const Error&) {
    ::unlink(path.c_str());  // there is nothing in it
    throw;
  }
}

Writer::~Writer() {
  try {
    close();
  } catch (const std::exception&) {
    // A destructor has no way to say so; close() has.
  }
}

void Writer::require_open() const {
  if (!file_) throw Error(EBADF, path_, "the recording is closed", "");
}

void Writer::append(std::span<const View> pieces, const Crc& crc) {
  std::vector<iovec> vectors(pieces.size());
  std::transform(pieces.begin(), pieces.end(), vectors.begin(), vector_of);
  file_->append(vectors);
  written_ = file_->size();
  crc_.add(crc);
}

std::uint64_t Writer::append(const Bytes& record) {
  const std::uint64_t at = written_;
  const View piece = record;
  append(std::span(&piece, 1), options_.crcs ? Crc(piece) : Crc());
  return at;
}

template <class Record, class Count>
std::uint16_t Writer::define(std::map<std::uint16_t, Record>& known, Record& record, Count& count) {
  if (known.size() == std::numeric_limits<std::uint16_t>::max()) {
    throw Error(EOVERFLOW, path_, "65535 schemas, or channels, are there",
                "a recording has no more");
  }
  record.id = static_cast<std::uint16_t>(known.size() + 1);
  Bytes bytes;
  encode(bytes, record);
  append(bytes);
  ++count;
  return known.emplace(record.id, std::move(record)).first->first;
}

std::uint16_t Writer::add(Schema schema) {
  require_open();
  return define(contents_.schemas, schema, contents_.statistics.schemas);
}

std::uint16_t Writer::add(Channel channel) {
  require_open();
  if (channel.schema != 0 && !contents_.schemas.contains(channel.schema)) {
    throw Error(EINVAL, path_, channel.topic + ": its schema is not there", "add that one first");
  }
  return define(contents_.channels, channel, contents_.statistics.channels);
}

void Writer::add(const Attachment& attachment) {
  flush();
  Bytes record;
  encode(record, attachment, options_.crcs);
  const std::uint64_t at = append(record);
  contents_.note(attachment, at, record.size());
}

void Writer::add(const Metadata& metadata) {
  flush();
  Bytes record;
  encode(record, metadata);
  const std::uint64_t at = append(record);
  contents_.note(metadata, at, record.size());
}

void Writer::make_room(std::uint64_t record_bytes) try {
  if (chunk_.size() + record_bytes > options_.chunk_bytes) flush();
} catch (const std::exception&) {
  ++lost_;  // the message that it was for
  throw;
}

void Writer::write(const MessageHead& head, std::span<const View> payload) {
  require_open();
  if (!contents_.channels.contains(head.channel)) {
    throw Error(EINVAL, path_, "no channel " + std::to_string(head.channel), "add it first");
  }
  const std::uint64_t payload_bytes = size_of(payload);
  const std::uint64_t record_bytes = kPrefixBytes + kMessageBytes + payload_bytes;
  make_room(record_bytes);
  if (record_bytes < options_.chunk_bytes) {
    chunk_.reserve(options_.chunk_bytes);  // so that nothing below runs out of memory half way
    noted_.push_back({head, chunk_.size(), payload_bytes});
    encode(chunk_, head, payload_bytes);
    for (const View piece : payload) Encoder(chunk_).raw(piece);
    return;
  }
  message_head_.clear();
  encode(message_head_, head, payload_bytes);
  std::vector<View> records{message_head_};
  records.insert(records.end(), payload.begin(), payload.end());
  noted_.push_back({head, 0, payload_bytes});
  write_chunk(records);
}

void Writer::permit(mode_t mode) noexcept {
  if (file_) file_->permit(mode);
}

void Writer::flush() {
  require_open();
  if (noted_.empty()) return;
  const View records = chunk_;
  write_chunk(std::span(&records, 1));
}

ChunkHead Writer::head_of_noted() const {
  ChunkHead head;
  head.start = head.end = noted_.front().head.log_time;
  for (const Noted& message : noted_) {
    head.start = std::min(head.start, message.head.log_time);
    head.end = std::max(head.end, message.head.log_time);
  }
  head.compression = name_of(options_.compression);
  return head;
}

Bytes Writer::index_noted(ChunkIndex& chunk) const {
  std::map<std::uint16_t, MessageIndex> indexes;
  for (const Noted& message : noted_) {
    MessageIndex& index = indexes[message.head.channel];
    index.channel = message.head.channel;
    index.entries.emplace_back(message.head.log_time, message.offset);
  }
  return encode_indexes(indexes, chunk);
}

void Writer::write_chunk(std::span<const View> records) try {
  const Crc records_crc = options_.crcs ? crc_of(records) : Crc();
  View compressed;
  if (compressor_) compressed = compressor_->compress(records);

  ChunkHead head = head_of_noted();
  head.uncompressed_bytes = size_of(records);
  head.uncompressed_crc = records_crc.value();
  head.compressed_bytes = compressor_ ? compressed.size() : head.uncompressed_bytes;
  Bytes front;
  encode(front, head);
  const std::uint64_t bytes = front.size() + head.compressed_bytes;
  ChunkIndex index{head.start,
                   head.end,
                   written_,
                   bytes,
                   {},
                   0,
                   head.compression,
                   head.compressed_bytes,
                   head.uncompressed_bytes};
  const Bytes back = index_noted(index);

  std::vector<View> pieces{front};
  if (compressor_) {
    pieces.push_back(compressed);
  } else {
    pieces.insert(pieces.end(), records.begin(), records.end());
  }
  pieces.push_back(back);
  Crc crc;
  if (options_.crcs) {
    crc.add(front);
    crc.add(compressor_ ? Crc(compressed) : records_crc);
    crc.add(back);
  }
  append(pieces, crc);

  for (const Noted& message : noted_) {
    contents_.statistics.count(message.head.channel, message.head.log_time);
    payload_bytes_[message.head.channel] += message.payload_bytes;
  }
  ++contents_.statistics.chunks;
  noted_.clear();
  chunk_.clear();
  contents_.chunks.push_back(std::move(index));
} catch (const std::exception&) {
  lost_ += noted_.size();
  noted_.clear();
  chunk_.clear();
  throw;
}

void Writer::close() {
  if (!file_) return;
  std::exception_ptr failure;
  try {
    flush();
  } catch (const std::exception&) {
    failure = std::current_exception();  // there may be room for the summary all the same
  }
  OutFile file = std::move(*file_);
  file_.reset();
  const std::uint32_t crc = options_.crcs ? crc_.value() : 0;
  const Bytes end = encode_end(contents_, file.size(), crc, options_.crcs);
  const iovec piece = vector_of(end);
  file.append(std::span(&piece, 1));
  written_ = file.size();
  if (failure) std::rethrow_exception(failure);
}

}  // namespace lot::mcap
