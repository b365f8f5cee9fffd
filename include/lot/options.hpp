// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

#include "lot/duration.hpp"

namespace lot {

/// Which segment an engine uses, and how it is made when it is absent. What the environment says
/// (LOT_SEGMENT, LOT_DIR, LOT_SIZE, LOT_PERMISSIONS, LOT_GROUP, LOT_USER, LOT_PERSIST, LOT_MLOCK)
/// comes before what the code says.
struct EngineOptions {
  std::string segment = "LOTROS";      ///< LOT_SEGMENT
  std::string directory = "/dev/shm";  ///< LOT_DIR; share it with the containers that are to meet
  std::uint64_t size_bytes = 0;        ///< LOT_SIZE (512M, 2G); 0: 1 GiB, or less: docs/limits.md
  /// LOT_PERMISSIONS, octal: 0600, 0660, 0606 or 0666, since joining reads and writes. Of new
  /// files; a segment whose files give others more is not joined, nor one's own that gives less. 0:
  /// 0600, or 0660 with a group.
  unsigned permissions = 0;
  /// LOT_GROUP, a name or a number. Its members share the segment: new files belong to it, and
  /// theirs are joined.
  std::string group;
  /// LOT_USER, a name or a number. This user's segment is joined, as are one's own and root's.
  std::string user;
  /// LOT_PERSIST, 1 or 0. The files stay when the last process leaves, and so does what waits in
  /// queues. It holds for the life of the segment once one process has asked for it, whichever
  /// leaves last, and however. `lot clean` removes them.
  bool persist = false;
  /// LOT_MLOCK, 1 or 0. What this process has touched of the segment is never swapped out, and its
  /// publishers' memory is never given back and faulted again. RLIMIT_MEMLOCK must allow the
  /// segment's size, or opening throws.
  bool lock_memory = false;
  std::string name;  ///< what tools call this process; default: its program name

  // Capacities of a new segment.
  std::uint32_t processes = 319;  ///< that are in it at once
  std::uint32_t blocks = 16384;   ///< messages that exist at once, all topics together
  std::uint32_t topics = 1024;    ///< and queues, that have users or items
  std::uint32_t channels = 2048;  ///< publishers, all topics together
  std::uint32_t readers = 256;    ///< of one publisher
};

/// What a publisher does when the slowest reader has not read the oldest message yet.
enum class Policy : std::uint32_t {
  Overwrite,  ///< the oldest is overwritten; each reader is told how many it missed
  Block,      ///< push waits up to PusherOptions::block_for, then says Status::Full
  Refuse      ///< push says Status::Full at once
};

/// How a queue works inside. Both do the same; readers follow the publisher.
enum class QueueEngine : std::uint32_t {
  Ring,  ///< lock-free: a process that is killed or stopped holds no other up
  Mutex  ///< every step under one lock, as most queues are built: to compare with
};

/// How a publisher keeps its messages, and how long it waits for readers.
struct PusherOptions {
  Policy policy = Policy::Overwrite;  ///< where the slowest reader is a whole queue behind
  /// Messages that the queue holds at most. It may hold fewer while the segment, or max_bytes, is
  /// short of memory. Under Block and Refuse only what all readers have read goes: there must be
  /// room for what the slowest one has yet to read.
  std::uint32_t depth = 64;
  /// Under Block: so long a push waits for room; so long a loan, and a message that grows, waits
  /// for memory that goes when readers have read.
  Duration block_for = std::chrono::seconds(1);
  /// LOT_QUEUE=ring or LOT_QUEUE=mutex in the environment comes before it, for every topic.
  QueueEngine engine = QueueEngine::Ring;
  /// The most memory that the messages which this publisher loans take together: in its queue,
  /// loaned, idle, reserved, or kept by readers. Messages of up to 256 bytes, the queue itself and
  /// messages of others do not count. Beyond it the publisher gives its own oldest up, under Block
  /// and Refuse what was read; where none can go, no message grows (lot::OutOfMemory). 0: as much
  /// as the segment has.
  std::uint64_t max_bytes = 0;
  /// So many of the newest messages stay in the queue for readers that subscribe later, though all
  /// readers have read them; the rest of depth is for readers that lag behind. With less than
  /// depth, a loan takes what was read last, whose memory is still in the caches, and a publisher
  /// has no more messages than its readers need. For that a loan looks at the place of each reader:
  /// it is for large messages. 0: none stays; 1: what readers with PullerOptions::history = 1 want.
  /// A message goes with the next loan, or some seconds later: until then there may be one more.
  /// Where there is no subscriber, all readers have read all.
  std::uint32_t history = kAll;
  /// Of history: all that the queue has room for.
  static constexpr std::uint32_t kAll = ~std::uint32_t{0};
  /// Each push notes when it was done, for Envelope::pushed: a look at the clock, and a write to
  /// the line of the message's memory. LOT_STAMP, 1 or 0, in the environment comes before it, for
  /// every publisher.
  bool stamp = false;
  /// Plain messages (trivially copyable and destructible) of up to 240 bytes (232 with `stamp`) and
  /// an alignment of up to 16 travel in the queue itself and not in a block. A reader that borrows
  /// finds them in the cache line that tells it of them. A reader that keeps one copies it into a
  /// block of its own: two that keep it have two messages, and a weak pointer of the publisher does
  /// not see them. False: all messages travel in blocks. LOT_FAST_LANE, 1 or 0, in the environment
  /// comes before it, for every publisher.
  bool fast_lane = true;
};

/// How a puller passes the time until a message comes.
enum class Wait {
  Spin,      ///< lowest latency, a whole core
  Adaptive,  ///< spins for some microseconds where that has helped lately, then parks
  Park       ///< sleeps at once
};

/// What a subscription gets first, how much it keeps, and how it waits.
struct PullerOptions {
  Wait wait = Wait::Adaptive;  ///< how pull() and borrow() pass the time
  /// Messages of each publisher from before this subscription that it gets first (latched: 1),
  /// those of several publishers in no common order. At most what the queue has: depth, under Block
  /// and Refuse one less.
  std::uint64_t history = 0;
  /// What is kept of this subscription's messages at once: memory, in bytes. Beyond it pulls say
  /// Status::HoldsTooMuch, and messages wait in the queue, or are overwritten, until some are let
  /// go. 0: a quarter of the segment. At most 7/16 of it; less while other subscriptions hold much,
  /// since all together leave the half. The limit counts what a message takes, a little more than
  /// its bytes; plain messages of up to 256 bytes do not count. One message is always allowed.
  /// Besides, a subscription keeps at most a quarter of EngineOptions::blocks messages.
  std::uint64_t max_held_bytes = 0;
  /// It only looks on: no publisher waits for it, it does not count in readers(), and `lot ls` says
  /// so. It misses what is overwritten before it looks, also of a lossless publisher, and counts
  /// it; not what a publisher sends that comes and goes between two looks. The topic is not kept
  /// for it: where others make it anew with another type, pulls throw lot::Error (ESTALE).
  bool observer = false;
  /// Of max_held_bytes: neither limit. Such a subscription can leave publishers without memory.
  static constexpr std::uint64_t kNoQuota = ~std::uint64_t{0};
};

}  // namespace lot
