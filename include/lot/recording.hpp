// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "lot/any_message.hpp"
#include "lot/any_pusher.hpp"
#include "lot/value.hpp"

/// Reads recordings: MCAP files of a Recorder, of `lot record`, and of other programs. It needs the
/// library lot::record, as lot/recorder.hpp does.
namespace lot {

/// A time of a recording: nanoseconds since 1970, as a rule (docs/record.md).
using RecordedTime = std::chrono::time_point<std::chrono::system_clock, std::chrono::nanoseconds>;

/// What a recording has of a topic. A topic that has had several types is there several times.
struct RecordedTopic {
  std::string name;             ///< the topic
  std::string type;             ///< of its messages, as its schema is called
  std::string encoding;         ///< of its messages: "cdr"
  std::string schema_encoding;  ///< "ros2msg"
  std::string schema;           ///< its text
  std::uint64_t messages = 0;   ///< in the files
  std::uint64_t missed = 0;     ///< by the recorder, where the file says so: before it looked
  std::uint64_t lost = 0;       ///< could not be written, or encoded; or are damaged in the file
  std::uint64_t left_out = 0;   ///< beyond a rate
  /// Why its messages cannot be decoded; empty: they can be.
  std::string objection;
};

/// Which messages of a recording are read.
struct RecordingQuery {
  std::vector<std::string> topics;           ///< names, and patterns of a shell; none: all
  RecordedTime from = RecordedTime::min();   ///< log times, both included
  RecordedTime until = RecordedTime::max();  ///< the same
};

/// What was skipped in the files, since it cannot be read.
struct RecordingDamage {
  std::uint64_t chunks = 0;   ///< pieces with messages
  std::uint64_t records = 0;  ///< others, and messages without a topic
  std::uint64_t bytes = 0;    ///< of all of it, and of what is cut off
  std::string first;          ///< the first reason; empty: nothing was skipped
  bool is_cut = false;        ///< a file was not closed by its recorder
};

/// A message of a recording. It is valid until its RecordedMessages goes on.
///
/// Threads: one at a time, with its RecordedMessages.
/// Errors:  lot::Error: EINVAL where the topic has an objection(); of what is damaged as the codec
///          says it: EBADMSG, ENOTSUP, ERANGE.
/// Memory:  root() decodes into private memory, which its RecordedMessages uses again.
/// Crash:   nothing of it is shared.
class RecordedMessage {
 public:
  /// Its topic. Valid as long as the Recording. Throws nothing.
  const RecordedTopic& topic() const noexcept { return *topic_; }
  /// When it was recorded. Throws nothing.
  RecordedTime log_time() const noexcept { return log_time_; }
  /// When it was published, where the file says so; else as log_time(). Throws nothing.
  RecordedTime publish_time() const noexcept { return publish_time_; }
  /// Grows by 1 from message to message of a topic, and by what was missed. From 2^32 - 1 it goes
  /// on to 0. Of files of others: what they say, often 0. Throws nothing.
  std::uint32_t sequence() const noexcept { return sequence_; }
  /// Its bytes, as in the file. Throws nothing.
  Bytes payload() const noexcept { return payload_; }

  /// The type that it is decoded as: the one that was recorded, or one that follows from the
  /// schema. Throws lot::Error.
  const AnyType& type() const;
  /// The message, to be read. Throws lot::Error, std::bad_alloc.
  Value root() const;
  /// Makes a loan the message: its one copy. The loan may be of another type whose schema has the
  /// same fields. Throws lot::Error, lot::OutOfMemory; then the loan is half made.
  void copy_to(const AnyLoan& loan) const;
  /// Whether a message has the same bytes. Throws lot::Error of what cannot be encoded,
  /// std::bad_alloc.
  bool is_equal(const AnyMessage& message) const;

 private:
  friend class Recording;
  friend class RecordedMessages;
  struct Reading;

  const RecordedTopic* topic_ = nullptr;
  RecordedTime log_time_;
  RecordedTime publish_time_;
  std::uint32_t sequence_ = 0;
  Bytes payload_;
  Reading* reading_ = nullptr;
  std::size_t number_ = 0;  ///< of its topic
};

/// The messages that were asked for, in the order of their log times.
///
///     auto messages = recording.messages();
///     while (const auto message = messages.next()) std::cout << message->root() << '\n';
///
/// Threads: one at a time.
/// Errors:  lot::Error: the file cannot be read any more; EFBIG when more of it overlaps in time
///          than a reader holds. What is damaged is skipped: Recording::damage().
/// Memory:  the chunks that overlap in time, and a decoded message.
/// Crash:   nothing of it is shared.
class RecordedMessages {
 public:
  ~RecordedMessages();
  RecordedMessages(RecordedMessages&&) noexcept;
  RecordedMessages& operator=(RecordedMessages&&) noexcept;

  /// The next one, valid until the next call; none at the end. Throws lot::Error, std::bad_alloc.
  std::optional<RecordedMessage> next();

 private:
  friend class Recording;
  explicit RecordedMessages(std::unique_ptr<RecordedMessage::Reading> reading) noexcept;

  std::unique_ptr<RecordedMessage::Reading> reading_;
};

/// A recording: one file, or the files of one that was split.
///
///     lot::Recording recording("drive.mcap");
///     lot::RecordingQuery query;
///     query.topics = {"/camera/*"};
///     query.from = recording.begin() + 10s;
///     auto frames = recording.messages(query);
///
/// Threads: one at a time, with its RecordedMessages, which it must outlive.
/// Errors:  lot::Error: a file cannot be read at all, or is no MCAP file (EINVAL).
/// Memory:  an index: about 200 bytes for each chunk.
/// Crash:   nothing of it is shared.
class Recording {
 public:
  /// Opens a file. Throws lot::Error, std::bad_alloc.
  explicit Recording(const std::string& path);
  /// Opens several, which are read as one. Throws lot::Error, std::bad_alloc.
  explicit Recording(const std::vector<std::string>& paths);
  ~Recording();
  Recording(Recording&&) noexcept;
  Recording& operator=(Recording&&) noexcept;

  /// What it has. Throws nothing.
  const std::vector<RecordedTopic>& topics() const noexcept;
  /// The first log time, and the last one; of no messages 0. Throws nothing.
  RecordedTime begin() const noexcept;
  /// The same. Throws nothing.
  RecordedTime end() const noexcept;
  /// The messages that the query asks for. Throws lot::Error, std::bad_alloc.
  RecordedMessages messages(const RecordingQuery& query = RecordingQuery());
  /// The type of a topic's messages, for ShmEngine::advertise_any(). Throws lot::Error: EINVAL
  /// where it has an objection, or is not of this recording.
  AnyType type_of(const RecordedTopic& topic) const;
  /// What was skipped so far. Throws std::bad_alloc.
  RecordingDamage damage() const;

 private:
  friend class RecordedMessage;
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

}  // namespace lot
