// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

#include "lot/duration.hpp"

namespace lot {

/// Which segment an engine uses, and how it is made when it is absent. What the environment says
/// (LOT_SEGMENT, LOT_DIR, LOT_SIZE, LOT_PERMISSIONS) comes before what the code says.
struct EngineOptions {
  std::string segment = "LOTROS";      ///< LOT_SEGMENT
  std::string directory = "/dev/shm";  ///< LOT_DIR; share it with the containers that are to meet
  std::uint64_t size_bytes = 0;  ///< LOT_SIZE (512M, 2G); 0: 1 GiB, or 3/4 of what is free if less
  unsigned permissions = 0600;   ///< LOT_PERMISSIONS, octal; 0660 shares with the group
  bool persist = false;          ///< the last one to leave keeps the files
  std::string name;              ///< what tools call this process; default: its program name

  // Capacities of a new segment.
  std::uint32_t processes = 319;
  std::uint32_t blocks = 16384;  ///< messages that exist at once, all topics together
  std::uint32_t topics = 1024;
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
  Ring,  ///< lock-free: a process that is killed or stopped holds nobody up
  Mutex  ///< every step under one lock, as most queues are built: to compare with
};

struct PusherOptions {
  Policy policy = Policy::Overwrite;
  /// Messages that the queue holds at most. Under Overwrite it may hold fewer while the segment is
  /// short of memory.
  std::uint32_t depth = 64;
  Duration block_for = std::chrono::seconds(1);
  /// LOT_QUEUE=ring or LOT_QUEUE=mutex in the environment comes before it, for every topic.
  QueueEngine engine = QueueEngine::Ring;
};

/// How a puller passes the time until a message comes.
enum class Wait {
  Spin,      ///< lowest latency, a whole core
  Adaptive,  ///< spins for some microseconds where that has helped lately, then parks
  Park       ///< sleeps at once
};

struct PullerOptions {
  Wait wait = Wait::Adaptive;
  /// Messages published before this subscription that it gets first (latched: 1).
  std::uint64_t history = 0;
};

}  // namespace lot
