// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "lot/options.hpp"

#include "tool/window.hpp"

/// What can be seen of a segment from outside, in plain values: the observer reads each word once,
/// checks it, and never trusts it. While processes work, the words that it read first are older
/// than those that it read last.
namespace lot::tool {

struct Process {
  std::uint32_t index;
  std::string name;
  std::int32_t pid;        ///< as the process says it, in its own namespace
  std::uint64_t since_ns;  ///< wall clock
  bool alive;
  std::uint64_t bytes = 0;  ///< memory of the messages that it has made
};

struct Reader {
  std::uint32_t process;
  bool joining = false;     ///< the reader is joining: lag and lost are not known yet
  bool observes = false;    ///< it only looks on: nothing waits for it
  bool awaited = false;     ///< the reader has not looked since the publisher came
  std::uint64_t lag = 0;    ///< published and not read yet; the message in hand counts
  std::uint64_t lost = 0;   ///< how many of the lag are overwritten already
  bool holds_back = false;  ///< the publisher has no room because of this reader
  /// How long ago the oldest message of the lag was pushed that is still in the queue. Nothing: no
  /// such message, or the publisher does not stamp.
  std::optional<double> delay = std::nullopt;
};

struct Queued {
  std::uint64_t sequence;
  std::uint32_t block;  ///< ring::kInSlot: it lies in the queue itself
  std::uint32_t slot = 0;
};

/// One publisher's queue.
struct Channel {
  std::uint32_t channel = 0;
  std::uint32_t generation = 0;
  bool orphan = false;  ///< its publisher has gone, its readers have not
  std::uint32_t publisher = 0;
  std::uint32_t topic = 0;
  std::uint32_t depth = 0;
  Policy policy = Policy::Overwrite;
  QueueEngine engine = QueueEngine::Ring;
  bool stamps = false;         ///< each message has the time of its push
  bool taken = false;          ///< each message is for one reader, which takes it
  std::size_t unfinished = 0;  ///< messages that a worker works on
  bool waits = false;          ///< the publisher has found no room, and no reader has made any
  std::uint64_t next = 0;      ///< sequence of the next message
  std::uint64_t published = 0;
  std::vector<Queued> queue;  ///< oldest first
  std::vector<Reader> readers;
};

struct Topic {
  std::uint32_t index;
  std::string name;
  std::string type;
  std::uint64_t type_size;
  std::vector<std::uint32_t> subscribers;
  bool used;
  std::vector<std::uint32_t> observers;  ///< only look on; a topic without a user may have some
};

/// Since when a process holds a message, as far as its warden has noted it.
struct Age {
  std::optional<double> seconds;
  std::optional<double> at_most;  ///< where the warden has not noted it
};

struct Holder {
  enum class How {
    Keeps,  ///< by pointers
    Borrows,
    Queues,  ///< in the queue of one of its publishers
    Refers,  ///< another message that it made refers to the message
    Spare    ///< loaned and not published, or waiting for a loan
  };
  std::uint32_t process;  ///< 0: the orphanage
  How how;
  Age age;                                ///< of Keeps and Borrows
  std::optional<std::uint64_t> sequence;  ///< of Queues
  std::optional<std::uint32_t> topic;     ///< of Queues and Borrows: where
};
const char* to_string(Holder::How how);

struct Message {
  std::uint32_t block;
  std::uint32_t generation;
  std::uint32_t home;  ///< the process that made it; 0: that process has gone
  std::string topic;   ///< the topic that it was made for; empty: none, or one that has gone
  std::uint64_t bytes;
  std::vector<Holder> holders;
};

struct Fill {
  std::uint64_t used = 0;
  std::uint64_t total = 0;
};

struct Observation {
  std::uint64_t instance = 0;
  bool persists = false;  ///< its files stay when the last process leaves
  Fill memory;            ///< bytes
  /// How many bytes of `memory.used` no other process can see as a message. They wait for a loan,
  /// or are loaned.
  std::uint64_t held_back = 0;
  Fill blocks;
  std::vector<Process> processes;
  std::vector<Topic> topics;
  std::vector<Channel> channels;
  std::vector<Message> messages;
  std::vector<std::string> damage;  ///< words that can not be right

  const Process* process(std::uint32_t index) const;
  const Topic* topic(std::uint32_t index) const;
  /// "3 camera", for people.
  std::string who(std::uint32_t index) const;
};

/// Observes a segment. Throws nothing but bad_alloc, whatever the bytes of the segment are.
Observation observe(Window& window);

/// The participants (1 and up) that are alive, or dead: taken, and dead only if both witnesses of
/// the library say so.
std::vector<std::uint32_t> living(Window& window);
std::vector<std::uint32_t> dead(Window& window);

/// Items that wait to be taken, by the names of their queues. A queue without items is left out.
using Waiting = std::map<std::string, std::uint64_t>;
Waiting waiting(Window& window);

}  // namespace lot::tool
