// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "lot/any_puller.hpp"
#include "lot/engine.hpp"
#include "lot/error.hpp"
#include "lot/options.hpp"
#include "lot/stop_token.hpp"

#include "tool/places.hpp"
#include "tool/sight.hpp"

namespace lot::transport {
class Participant;
class RingPuller;
}  // namespace lot::transport

namespace lot::tool {

/// Joins a segment for the tool. It is not made where there is none. `as`: what other processes see
/// of the tool. Throws lot::Error, ENOENT where there is none.
std::shared_ptr<transport::Participant> visit(const Where& where, const std::string& segment,
                                              const std::string& as);

/// Looks for topics, as often as it is asked.
///
/// Threads: one.
class Search {
 public:
  explicit Search(Where where) : where_(std::move(where)) {}

  /// The segment that has the topic, of those that `where` names; nothing: none has it now. A queue
  /// has it, too. Where it has users counts before where it only has observers. Where none has it,
  /// standard error says once of each file what keeps the tool from looking into it. Throws
  /// lot::Error: EINVAL where several have the topic; of a segment that the user named, what keeps
  /// the tool from looking there.
  std::optional<std::string> segment_with(const std::string& topic);
  /// "there is /same", where no segment has `same`: the name with its first slash, or without.
  /// Empty: there is none either. Throws nothing but std::bad_alloc.
  std::string other_name(const std::string& topic) const;

 private:
  void say_once(const std::string& path, const std::string& reason);

  Where where_;
  std::set<std::string> said_;
};

/// Where a message comes from, as an Envelope says it, but without a text: it costs a few loads.
struct Postmark {
  std::uint64_t publisher;  ///< tells apart the publishers of the topic, while it has this type
  std::uint64_t sequence;   ///< grows by one; from ring::kSequenceMask it goes on to 0
  std::optional<std::chrono::steady_clock::time_point> pushed;  ///< Envelope::pushed
};

/// What a tool sees of a topic: an observer, which waits for segment, topic and publisher as long
/// as they are not there, and goes on with another type when the topic gets one, and in another
/// segment when the files of this one were removed. It says all of it on standard error.
///
/// Threads: one.
class Onlooker {
 public:
  /// `as`: what other processes see of the tool. `history`: PullerOptions::history.
  Onlooker(Where where, std::string topic, std::string as, std::uint64_t history = 0)
      : where_(std::move(where)),
        search_(where_),
        topic_(std::move(topic)),
        as_(std::move(as)),
        history_(history) {}

  /// The next message in place; empty: the token was told to stop, or the time is up. One at a
  /// time. Throws lot::Error for a topic that can not be read, and for a segment that is damaged.
  /// Where it has_topic() all the same, the next call goes on behind what was wrong.
  AnyBorrow next(Deadline deadline, const StopToken& stop);

  /// Of the message that next() gave last. REQUIRES: its borrow has not ended.
  Postmark postmark() const noexcept;
  /// The name of its publisher's process. REQUIRES: the same.
  const std::string& publisher() const noexcept;
  /// Bytes of its memory: those of its block, or whole granules. REQUIRES: the same.
  std::uint64_t memory() const noexcept;

  /// Postmark::publisher of all whose messages it reads.
  std::vector<std::uint64_t> publishers_read() const;

  /// Counts the types that it has met: another number, another type, or another time of the topic.
  unsigned times() const noexcept { return times_; }
  /// True from when it has found the topic, until the topic gets another type.
  bool has_topic() const noexcept { return puller_.has_value(); }
  /// Says something about the topic on standard error.
  void say(const std::string& text) const;

 private:
  bool find(Deadline deadline, const StopToken& stop);
  bool try_to_find();
  bool leaves_what_was_removed();
  void leave() noexcept;
  void say_that_it_waits(const char* reason);

  Where where_;
  Search search_;
  std::string topic_;
  std::string as_;
  std::uint64_t history_;
  std::shared_ptr<transport::Participant> participant_;
  std::optional<ShmEngine> engine_;
  std::optional<AnyPuller> puller_;
  transport::RingPuller* core_ = nullptr;  ///< of puller_
  std::string type_;                       ///< name of the last one
  unsigned times_ = 0;
  bool waits_ = false;  ///< and has said so, since the last message
  bool has_said_other_ = false;
  unsigned looks_ = 0;  ///< for a topic that is not there
};

/// Says what is wrong with messages of a topic that goes on: once as long as the same place is. It
/// knows which exit status that makes.
///
/// Threads: one.
class Complaints {
 public:
  explicit Complaints(const Onlooker& onlooker) : onlooker_(onlooker) {}

  void note(const Error& error);
  /// A message was well.
  void forget() { about_.clear(); }
  Exit exit() const { return exit_; }

 private:
  const Onlooker& onlooker_;
  std::string about_;  ///< the last one
  Exit exit_ = kWell;
};

/// Why a topic's type is one opaque value.
inline constexpr const char* kOpaque =
    "only its own programs know what is in a message of this type: it is opaque to LOT, or its "
    "description is larger than 16 KiB, or its types lie more than 16 levels deep in each other";

/// What the error says behind the name of the library.
std::string reason_of(const Error& error);

}  // namespace lot::tool
