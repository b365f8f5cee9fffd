// SPDX-License-Identifier: Apache-2.0
#include "mcap/scan.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "lot/error.hpp"

#include "mcap/crc.hpp"

namespace lot::mcap {
namespace {

/// Throws Malformed for a body that cannot be what its opcode says.
void check(InFile& file, const Frame& frame, const Limits& limits) {
  switch (static_cast<Opcode>(frame.opcode)) {
    case Opcode::Attachment:
      (void)read_record<Attachment>(file, frame, limits);
      return;
    case Opcode::MessageIndex:
      (void)read_record<MessageIndex>(file, frame, limits);
      return;
    case Opcode::Metadata:
      (void)read_record<Metadata>(file, frame, limits);
      return;
    default:
      return;
  }
}

bool is_magic(View bytes) {
  return bytes.size() >= kMagicBytes && std::memcmp(bytes.data(), kMagic, kMagicBytes) == 0;
}

}  // namespace

void Damage::note(std::uint64_t at, const std::string& what) {
  if (first.empty()) first = "at byte " + std::to_string(at) + ": " + what;
}

std::optional<Frame> frame_at(InFile& file, std::uint64_t at) {
  const View there = file.peek(at, kPrefixBytes);
  if (there.size() < kPrefixBytes) return {};
  Decoder prefix(there);
  Frame frame;
  frame.opcode = prefix.number<std::uint8_t>();
  frame.at = at;
  frame.bytes = prefix.number<std::uint64_t>();
  // No record has the opcode 0: this is what a file system may leave where data was to be.
  if (frame.opcode == 0 || frame.bytes > file.size() - frame.body()) return {};
  return frame;
}

Buffer body_of(InFile& file, const Frame& frame, const Limits& limits) {
  if (frame.bytes > limits.chunk_bytes) throw Malformed("it is larger than the reader's limit");
  Buffer buffer(static_cast<std::size_t>(frame.bytes));
  if (frame.bytes <= InFile::kAhead) {
    const View there = file.peek(frame.body(), static_cast<std::size_t>(frame.bytes));
    if (there.size() < frame.bytes) throw Malformed("it leads out of the file");
    std::copy_n(there.begin(), frame.bytes, buffer.bytes().begin());
  } else {
    file.read(frame.body(), buffer.bytes());
  }
  return buffer;
}

std::pair<Header, std::uint64_t> read_header(InFile& file, const Limits& limits) {
  const auto no = [&](const char* what) { return Error(EINVAL, file.path(), what, ""); };
  if (file.size() == 0) throw no("the file is empty");
  if (!is_magic(file.peek(0, kMagicBytes))) throw no("not an MCAP file of version 0");
  const auto frame = frame_at(file, kMagicBytes);
  if (!frame || !frame->is(Opcode::Header)) throw no("the MCAP file has no header");
  try {
    return {read_record<Header>(file, *frame, limits), frame->end()};
  } catch (const Malformed&) {
    throw no("the header of the MCAP file is damaged");
  }
}

// ---- Records
// --------------------------------------------------------------------------------------

Records::Records(InFile& file, const Frame& frame, const Limits& limits) {
  if (frame.is(Opcode::Message)) {
    bytes_ = body_of(file, frame, limits);
    take(frame.opcode, std::as_const(bytes_).bytes());
  } else {
    read_chunk(file, frame, limits);
    parse();
  }
}

void Records::read_chunk(InFile& file, const Frame& frame, const Limits& limits) {
  const View ahead = file.peek(frame.body(), std::min<std::uint64_t>(frame.bytes, 256));
  std::uint64_t head_bytes = 0;
  std::tie(head_, head_bytes) = decode_chunk_head(
      ahead.first(std::min<std::uint64_t>(ahead.size(), frame.bytes)), frame.bytes);
  const Compression compression = compression_of(head_.compression);
  const std::uint64_t size = head_.uncompressed_bytes;
  if (std::max(size, head_.compressed_bytes) > limits.chunk_bytes) {
    throw Malformed("it is larger than the reader's limit");
  }
  if (size > most_uncompressed(compression, head_.compressed_bytes)) {
    throw Malformed("it says that it is larger than its data can be");
  }
  bytes_ = Buffer(static_cast<std::size_t>(size));
  const std::uint64_t at = frame.body() + head_bytes;
  if (compression == Compression::None) {
    if (size != head_.compressed_bytes) throw Malformed("it has two sizes");
    file.read(at, bytes_.bytes());
  } else {
    Buffer compressed(static_cast<std::size_t>(head_.compressed_bytes));
    file.read(at, compressed.bytes());
    uncompress(compression, std::as_const(compressed).bytes(), bytes_.bytes());
  }
  if (head_.uncompressed_crc == 0) return;
  if (Crc(std::as_const(bytes_).bytes()).value() != head_.uncompressed_crc) {
    throw Malformed("its CRC is wrong");
  }
}

void Records::parse() {
  for (Decoder from(std::as_const(bytes_).bytes()); from.left() != 0;) {
    const auto opcode = from.number<std::uint8_t>();
    const auto bytes = from.number<std::uint64_t>();
    take(opcode, from.raw(bytes));
  }
}

void Records::take(std::uint8_t opcode, View body) {
  switch (static_cast<Opcode>(opcode)) {
    case Opcode::Schema:
      schemas_.push_back(decode<Schema>(body));
      return;
    case Opcode::Channel:
      channels_.push_back(decode<Channel>(body));
      return;
    case Opcode::Message:
      messages_.push_back({decode<MessageHead>(body), body.subspan(kMessageBytes)});
      return;
    default:
      if (opcode == 0 || opcode <= static_cast<std::uint8_t>(Opcode::DataEnd)) {
        throw Malformed("it has a record that may not be in a chunk");
      }
  }
}

// ---- Scan
// -----------------------------------------------------------------------------------------

Scan::Scan(InFile& file, const Limits& limits) : file_(file), limits_(limits) {
  std::tie(header_, at_) = read_header(file, limits);
}

std::optional<Frame> Scan::next() {
  records_.reset();
  while (!has_ended_) {
    const auto frame = frame_at(file_, at_);
    if (!frame) {
      has_ended_ = true;
      if (at_ == file_.size()) return {};
      damage_.note(at_, "the file ends, or is damaged, within a record");
      damage_.bytes += file_.size() - at_;
      return {};
    }
    try {
      read(*frame);
      at_ = frame->end();
      return frame;
    } catch (const Malformed& malformed) {
      const bool is_chunk = frame->is(Opcode::Chunk);
      damage_.note(frame->at,
                   (is_chunk ? "a chunk: " : "a record: ") + std::string(malformed.what()));
      ++(is_chunk ? damage_.chunks : damage_.records);
      damage_.bytes += frame->end() - frame->at;
      at_ = frame->end();
    }
  }
  return {};
}

void Scan::read(const Frame& frame) {
  if (frame.is(Opcode::Schema)) {
    define(schemas_, read_record<Schema>(file_, frame, limits_), frame.at);
  } else if (frame.is(Opcode::Channel)) {
    define(channels_, read_record<Channel>(file_, frame, limits_), frame.at);
  } else if (frame.is(Opcode::Chunk) || frame.is(Opcode::Message)) {
    records_ = std::make_shared<const Records>(file_, frame, limits_);
    for (const Schema& schema : records_->schemas()) define(schemas_, schema, frame.at);
    for (const Channel& channel : records_->channels()) define(channels_, channel, frame.at);
  } else if (frame.is(Opcode::Footer)) {
    end(frame);
  } else {
    check(file_, frame, limits_);
  }
}

void Scan::end(const Frame& footer) {
  has_ended_ = true;
  is_whole_ = footer.bytes == kFooterBytes && is_magic(file_.peek(footer.end(), kMagicBytes)) &&
              file_.size() == footer.end() + kMagicBytes;
  if (is_whole_) return;
  damage_.note(footer.end(), "the file does not end behind its footer");
  damage_.bytes += file_.size() - footer.end();
}

/// The first one that a file says stays: messages that came before the second one belong to it.
template <class Record>
void Scan::define(std::map<std::uint16_t, Record>& known, const Record& record, std::uint64_t at) {
  const auto [place, is_new] = known.emplace(record.id, record);
  if (is_new || place->second == record) return;
  ++damage_.records;
  damage_.note(at, "number " + std::to_string(record.id) + " has two meanings");
}

const Channel* Scan::channel_of(const Message& message) {
  const auto found = channels_.find(message.head.channel);
  if (found != channels_.end()) return &found->second;
  ++damage_.records;
  damage_.bytes += kPrefixBytes + kMessageBytes + message.payload.size();
  damage_.note(at_, "a message of a channel that is not there");
  return nullptr;
}

}  // namespace lot::mcap
