// SPDX-License-Identifier: Apache-2.0
#include "mcap/reader.hpp"

#include <algorithm>
#include <cerrno>
#include <tuple>
#include <utility>

#include "lot/error.hpp"

namespace lot::mcap {
namespace {

/// The record that an index leads to.
Frame indexed(InFile& file, std::uint64_t at, std::uint64_t bytes, Opcode opcode) {
  const auto frame = frame_at(file, at);
  if (!frame || !frame->is(opcode) || frame->end() - at != bytes) {
    throw Malformed("it is not where the index says");
  }
  return *frame;
}

}  // namespace

// ---- Stream
// ---------------------------------------------------------------------------------------

Stream::Stream(const std::string& path, const Limits& limits) : file_(path), scan_(file_, limits) {}

std::optional<Message> Stream::next() {
  for (;;) {
    while (scan_.records() != nullptr && next_ != scan_.records()->messages().size()) {
      const Message& message = scan_.records()->messages()[next_++];
      if (scan_.channel_of(message) != nullptr) return message;
    }
    next_ = 0;
    if (!scan_.next()) return {};
  }
}

// ---- Reader
// ---------------------------------------------------------------------------------------

Reader::Reader(const std::string& path, const Limits& limits)
    : file_(path), limits_(limits), index_(index_of(file_, limits)) {}

template <class Record>
Record Reader::read(std::uint64_t at, std::uint64_t bytes, Opcode opcode) try {
  return read_record<Record>(file_, indexed(file_, at, bytes, opcode), limits_);
} catch (const Malformed& malformed) {
  throw Error(EINVAL, file_.path(),
              "the record at byte " + std::to_string(at) + ": " + malformed.what(), "");
}

Attachment Reader::read(const AttachmentIndex& index) {
  return read<Attachment>(index.offset, index.bytes, Opcode::Attachment);
}

Metadata Reader::read(const MetadataIndex& index) {
  return read<Metadata>(index.offset, index.bytes, Opcode::Metadata);
}

Messages Reader::messages(Query query) { return {*this, std::move(query)}; }

// ---- Messages
// -------------------------------------------------------------------------------------

Messages::Messages(Reader& reader, Query query) : reader_(&reader), query_(std::move(query)) {
  for (const Part& part : reader.index_.parts) {
    if (wants(part)) parts_.push_back(&part);
  }
  const auto later = [](const Part* a, const Part* b) {
    return a->start != b->start ? a->start > b->start : a->at > b->at;
  };
  std::ranges::sort(parts_, later);
}

bool Messages::wants(const Part& part) const {
  if (part.end < query_.from || part.start > query_.until) return false;
  if (!query_.channels) return true;
  return std::ranges::any_of(part.channels,
                             [&](std::uint16_t c) { return query_.channels->contains(c); });
}

bool Messages::wants(const Message& message) const {
  const MessageHead& head = message.head;
  if (head.log_time < query_.from || head.log_time > query_.until) return false;
  return !query_.channels || query_.channels->contains(head.channel);
}

std::optional<Message> Messages::next() {
  while (!parts_.empty() && (open_.empty() || parts_.back()->start <= open_.front().time())) {
    const Part& part = *parts_.back();
    parts_.pop_back();
    open(part);
  }
  if (open_.empty()) return {};
  std::pop_heap(open_.begin(), open_.end());
  Open& first = open_.back();
  const Message message = *first.left.back();
  first.left.pop_back();
  returned_ = first.records;
  if (first.left.empty()) {
    open_bytes_ -= first.records->bytes();
    open_.pop_back();
  } else {
    std::push_heap(open_.begin(), open_.end());
  }
  return message;
}

void Messages::open(const Part& part) try {
  const auto frame = frame_at(reader_->file_, part.at);
  if (!frame || frame->end() - part.at != part.bytes ||
      !(frame->is(Opcode::Chunk) || frame->is(Opcode::Message))) {
    throw Malformed("it is not where the index says");
  }
  Open opened{
      part.at, std::make_shared<const Records>(reader_->file_, *frame, reader_->limits_), {}};
  for (const Message& message : opened.records->messages()) {
    if (!reader_->channels().contains(message.head.channel)) {
      Damage& damage = reader_->index_.damage;
      ++damage.records;
      damage.note(part.at, "a message of a channel that is not there");
    } else if (wants(message)) {
      opened.left.push_back(&message);
    }
  }
  if (opened.left.empty()) return;
  // The last one first. Of equal times, the place in the chunk decides: they lie in one array.
  std::ranges::sort(opened.left, [](const Message* a, const Message* b) {
    return std::tie(a->head.log_time, a) > std::tie(b->head.log_time, b);
  });
  open_bytes_ += opened.records->bytes();
  if (open_bytes_ > reader_->limits_.overlap_bytes) {
    throw Error(EFBIG, reader_->file_.path(), "too many chunks overlap in time",
                "read it in its own order");
  }
  open_.push_back(std::move(opened));
  std::push_heap(open_.begin(), open_.end());
} catch (const Malformed& malformed) {
  Damage& damage = reader_->index_.damage;
  ++damage.chunks;
  damage.bytes += part.bytes;
  damage.note(part.at, std::string("a chunk: ") + malformed.what());
}

}  // namespace lot::mcap
