// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "lot/duration.hpp"
#include "lot/options.hpp"

/// Records topics into MCAP files, which Foxglove and ROS 2 read: docs/record.md. It needs the
/// library lot::record, which needs libdeflate, lz4 and zstd.
namespace lot {

namespace transport {
class Participant;
}

/// How the chunks of a recording are compressed.
enum class Compression {
  None,  ///< fastest: large messages are written without a copy
  Lz4,   ///< fast
  Zstd   ///< smallest
};

/// What a Recorder records, and how.
struct RecorderOptions {
  /// The file, such as "drive.mcap". Where it is split, or has only the last seconds: the files
  /// "drive_0.mcap", "drive_1.mcap" and so on. A file that is there is never overwritten.
  std::string path;
  /// Names of topics, or patterns of a shell: "/camera/*". `*` matches `/` as well. A topic of
  /// lot::ros has its ROS name.
  std::vector<std::string> topics;
  std::vector<std::string> except;  ///< names and patterns of those that are left out

  Compression compression = Compression::None;  ///< of chunks
  int level = 0;                                ///< of the compression; 0: its library's default
  bool crcs = true;                             ///< false: no checksums
  std::uint64_t chunk_bytes = 1 << 20;          ///< at most so much is in one chunk

  std::uint64_t split_bytes = 0;     ///< a file has at most so many, but one message; 0: no limit
  Duration split_time = Duration();  ///< a file is at most so long; 0: no limit

  /// Memory of messages that are seen and not written yet, in bytes. 0: an eighth of the segment.
  /// One message is always allowed.
  std::uint64_t max_held_bytes = 0;
  double max_rate = 0;  ///< messages a second of each topic; the others are left out. 0: all

  /// Not zero: nothing is written before trigger(). Then a file gets the messages of so long before
  /// it, which are kept in this process's memory until then.
  Duration keep_last = Duration();
  std::uint64_t keep_last_bytes = std::uint64_t{1} << 30;  ///< at most so much of them
  /// And those of so long after it. Only with keep_last, as `trigger`.
  Duration keep_after = Duration();
  std::string trigger;  ///< a topic, each message of which is a trigger(); empty: none
};

/// What a Recorder has done so far.
struct RecorderStatus {
  /// A topic that it records.
  struct Topic {
    std::string name;            ///< in the file
    std::string in_segment;      ///< its name there: lot::ros puts a run before it
    std::string type;            ///< in the file, as ROS 2 would call it
    std::uint64_t messages = 0;  ///< recorded: written, or in the open chunk
    std::uint64_t bytes = 0;     ///< of these, as in the file before its compression
    std::uint64_t missed = 0;    ///< overwritten before it looked
    std::uint64_t lost = 0;      ///< could not be written, or went with a file that was removed
    std::uint64_t damaged = 0;   ///< could not be encoded
    std::uint64_t left_out = 0;  ///< beyond RecorderOptions::max_rate
  };
  /// A topic that it cannot record.
  struct Refused {
    std::string name;  ///< as in a Topic
    std::string why;   ///< in words
  };
  std::vector<Topic> topics;     ///< in the order of their first look
  std::vector<Refused> refused;  ///< a queue, an opaque type
  /// Names and patterns of RecorderOptions (topics, except, trigger) that no topic has fitted yet.
  std::vector<std::string> unmatched;
  std::vector<std::string> segments;  ///< paths of those that it has joined, in their order
  std::vector<std::string> files;     ///< that were made
  std::uint64_t held_bytes = 0;       ///< seen and not written yet
  std::uint64_t kept_messages = 0;  ///< with RecorderOptions::keep_last: what a trigger would write
  std::uint64_t kept_bytes = 0;     ///< of these
  std::uint64_t cut_messages = 0;   ///< of the kept ones, that keep_last_bytes had no room for
  Duration cut_time = Duration();   ///< how long a time was kept when the last of these went
  std::uint64_t triggers = 0;       ///< that have come
  std::string first_error;          ///< the first thing that went wrong; empty: nothing
  std::string error;                ///< the last one
};

/// Records topics, on two threads of its own, from its construction on until stop().
///
///     lot::RecorderOptions what;
///     what.path = "drive.mcap";
///     what.topics = {"/camera/*", "/pose"};
///     lot::Recorder recorder(what);
///     drive();
///     recorder.stop();
///
/// It is an observer: no publisher waits for it. What it misses is counted in the file.
///
/// Threads: all members may be called at once, but for the destructor.
/// Errors:  lot::Error: the constructor's, and stop()'s. What goes wrong between them is in
///          status(), and the recorder goes on.
/// Memory:  messages in the segment, by pointer, as RecorderOptions::max_held_bytes says; the open
///          chunk; with keep_last what that says.
/// Crash:   files can be read up to their last chunk. Another process frees what it kept.
class Recorder {
 public:
  /// Begins. It joins the segment, and makes it where there is none. Throws lot::Error: EEXIST when
  /// the file is there already, ENOENT when its directory is not, EINVAL for options that cannot
  /// be; what the system says; as ShmEngine. std::bad_alloc.
  explicit Recorder(RecorderOptions what, const EngineOptions& where = EngineOptions());
  /// For programs of the library's own: `join` is called again when the segment was made anew; it
  /// throws ENOENT where there is none. Throws the same, but not what `join` throws.
  Recorder(RecorderOptions what, std::function<std::shared_ptr<transport::Participant>()> join);
  /// As stop(), without a word when that fails.
  ~Recorder();
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  /// Writes what is kept of the last seconds. Does nothing without RecorderOptions::keep_last.
  /// Throws nothing: status() says what went wrong.
  void trigger() noexcept;
  /// Writes what was pushed before, and ends. The second call does nothing. Throws lot::Error when
  /// some messages could not be written: the first reason.
  void stop();
  /// What it has done so far. Throws std::bad_alloc.
  RecorderStatus status() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace lot
