// SPDX-License-Identifier: Apache-2.0
#include "record/files.hpp"

#include <algorithm>
#include <cerrno>
#include <exception>
#include <filesystem>
#include <limits>
#include <system_error>
#include <utility>

#include "lot/error.hpp"

namespace lot::record {
namespace {

using Steady = std::chrono::steady_clock;
using Topic = RecorderStatus::Topic;

/// Between two tries to make a file that could not be made.
constexpr std::chrono::seconds kTryAgain{1};
/// Names of files that are there already are passed over, so many.
constexpr unsigned kMostNames = 100'000;
constexpr std::string_view kEnding = ".mcap";

mcap::Compression compression_of(Compression compression) {
  switch (compression) {
    case Compression::Lz4:
      return mcap::Compression::Lz4;
    case Compression::Zstd:
      return mcap::Compression::Zstd;
    case Compression::None:
      break;
  }
  return mcap::Compression::None;
}

mcap::Bytes schema_bytes(const std::string& text) {
  const auto bytes = std::as_bytes(std::span(text));
  return {bytes.begin(), bytes.end()};
}

}  // namespace

Files::Files(const RecorderOptions& options, Ledger& ledger, const Clock& clock)
    : options_(options), ledger_(ledger), clock_(clock) {}

Files::~Files() {
  try {
    close();
  } catch (const std::exception&) {
    // A destructor has no way to say so; close() has.
  }
}

bool Files::numbers_files() const {
  return options_.split_bytes != 0 || options_.split_time > Duration() ||
         options_.keep_last > Duration();
}

std::string Files::next_path() {
  if (!numbers_files()) return options_.path;
  std::string stem = options_.path;
  const bool has_ending = stem.ends_with(kEnding);
  if (has_ending) stem.resize(stem.size() - kEnding.size());
  return stem + "_" + std::to_string(number_) + (has_ending ? std::string(kEnding) : "");
}

void Files::make() {
  mcap::WriterOptions how;
  how.header.library = "lot " LOT_VERSION;
  how.compression = compression_of(options_.compression);
  how.level = options_.level;
  how.chunk_bytes = options_.chunk_bytes;
  how.crcs = options_.crcs;
  const bool is_first = number_ == 0;
  for (unsigned names = 0; !writer_; ++names) {
    path_ = next_path();
    try {
      writer_.emplace(path_, how);
    } catch (const Error& e) {
      const bool may_pass = e.error_number() == EEXIST && numbers_files() && names < kMostNames;
      if (!may_pass || (is_first && options_.keep_last <= Duration())) throw;
    }
    if (writer_ || numbers_files()) ++number_;
  }
}

void Files::try_out() {
  make();
  forget_file();
  number_ = 0;
  std::error_code ignored;
  std::filesystem::remove(path_, ignored);
}

void Files::open() {
  make();
  begin_ = 0;
  ledger_.made(path_);
  note_begin();
}

void Files::note_begin() {
  mcap::Metadata about;
  about.name = "lot.recording";
  about.pairs = {
      {"lot", LOT_VERSION},
      {"clock", "the system's time at the begin of the recording, then the monotonic clock"},
      {"system_clock_ahead_ns", std::to_string(clock_.system_ahead())},
      {"file", std::to_string(number_ == 0 ? 0 : number_ - 1)}};
  try {
    writer_->add(about);
  } catch (const Error& e) {
    ledger_.went_wrong(e.what());  // the disk is full: messages will say so, too
  }
}

bool Files::is_full(std::uint64_t log_time, std::uint64_t bytes) const {
  if (!writer_ || begin_ == 0) return false;
  const auto length = static_cast<std::uint64_t>(options_.split_time.count());
  return (options_.split_bytes != 0 && writer_->bytes() + bytes > options_.split_bytes) ||
         (length != 0 && log_time >= begin_ && log_time - begin_ >= length);
}

std::uint16_t Files::schema_of(const Stream& stream) {
  const std::pair key(stream.schema.name, stream.schema.msg);
  if (const auto found = schemas_.find(key); found != schemas_.end()) return found->second;
  mcap::Schema schema;
  schema.name = stream.schema.name;
  schema.encoding = "ros2msg";
  schema.data = schema_bytes(stream.schema.msg);
  const std::uint16_t id = writer_->add(std::move(schema));
  schemas_.emplace(key, id);
  return id;
}

Files::Given& Files::given(const Stream& stream) {
  if (const auto found = channels_.find(stream.line); found != channels_.end()) {
    return found->second;
  }
  mcap::Channel channel;
  channel.schema = schema_of(stream);
  channel.topic = stream.name;
  channel.message_encoding = "cdr";
  channel.metadata = stream.metadata;
  Given given;
  given.topic = stream.name;
  given.channel = writer_->add(std::move(channel));
  return channels_.emplace(stream.line, std::move(given)).first->second;
}

void Files::write(const Stream& stream, mcap::MessageHead head,
                  std::span<const mcap::View> payload) {
  const std::uint64_t bytes = mcap::size_of(payload);
  bool is_given = false;
  try {
    if (is_full(head.log_time, bytes)) close();
    if (!writer_) {
      const auto now = Steady::now();
      if (now < again_) throw Error(ENOENT, path_, "there is no file to write to", "");
      again_ = now + kTryAgain;
      open();
      again_ = {};
    }
    Given& its = given(stream);
    head.channel = its.channel;
    if (begin_ == 0) begin_ = std::max<std::uint64_t>(head.log_time, 1);
    permit();
    ++its.messages;
    its.bytes += bytes;
    is_given = true;
    writer_->write(head, payload);
    ledger_.add(stream.line, &Topic::messages, 1);
    ledger_.add(stream.line, &Topic::bytes, bytes);
  } catch (const std::exception& e) {
    // What was given counts as recorded, until count_lost() takes it back.
    ledger_.add(stream.line, is_given ? &Topic::messages : &Topic::lost, 1);
    if (is_given) ledger_.add(stream.line, &Topic::bytes, bytes);
    count_lost(e);
    throw;
  }
}

void Files::permit() {
  const mode_t mode = ledger_.mode();
  if (permitted_ == mode) return;
  permitted_ = mode;
  writer_->permit(mode);
}

void Files::count_lost(const std::exception& why) {
  if (!writer_) return;
  const auto* const error = dynamic_cast<const Error*>(&why);
  if (error != nullptr && error->error_number() == ENOENT) {
    settle(true);
    forget_file();
  } else if (writer_->lost() != lost_) {
    settle();  // else the open chunk is still there
  }
}

void Files::settle(bool is_removed) {
  const auto& written = writer_->statistics().channel_messages;
  for (auto& [line, its] : channels_) {
    const auto found = written.find(its.channel);
    const bool has_some = !is_removed && found != written.end();
    const std::uint64_t lost = its.messages - std::min(its.messages, has_some ? found->second : 0);
    const std::uint64_t there = has_some ? writer_->payload_bytes(its.channel) : 0;
    const std::uint64_t lost_bytes = its.bytes - std::min(its.bytes, there);
    its.messages -= lost;
    its.bytes -= lost_bytes;
    ledger_.take(line, &Topic::messages, lost);
    ledger_.take(line, &Topic::bytes, lost_bytes);
    ledger_.add(line, &Topic::lost, lost);
  }
  lost_ = writer_->lost();
}

void Files::forget_file() {
  writer_.reset();
  permitted_.reset();
  lost_ = 0;
  channels_.clear();
  schemas_.clear();
}

void Files::flush() {
  if (!writer_) return;
  try {
    writer_->flush();
    settle();
  } catch (const std::exception& e) {
    count_lost(e);
    throw;
  }
}

void Files::note_end() {
  for (const auto& [line, its] : channels_) {
    const Topic now = ledger_.topic(line);
    const Topic& before = told_[line];
    const auto since = [&](Ledger::Count count) {
      return std::to_string(now.*count - before.*count);
    };
    mcap::Metadata about;
    about.name = "lot.topic";
    about.pairs = {{"topic", its.topic},
                   {"channel", std::to_string(its.channel)},
                   {"missed", since(&Topic::missed)},
                   {"lost", since(&Topic::lost)},
                   {"damaged", since(&Topic::damaged)},
                   {"left_out", since(&Topic::left_out)}};
    writer_->add(about);
    told_[line] = now;
  }
  for (const auto& refused : ledger_.told().refused) {
    mcap::Metadata about;
    about.name = "lot.refused";
    about.pairs = {{"topic", refused.name}, {"why", refused.why}};
    writer_->add(about);
  }
}

void Files::close() {
  if (!writer_) return;
  std::exception_ptr failure;
  const auto carefully = [&](auto&& step) {
    try {
      step();
    } catch (const std::exception&) {
      if (failure == nullptr) failure = std::current_exception();
    }
  };
  carefully([&] { flush(); });
  if (writer_) carefully([&] { note_end(); });
  if (writer_) carefully([&] { writer_->close(); });
  forget_file();
  if (failure != nullptr) std::rethrow_exception(failure);
}

}  // namespace lot::record
