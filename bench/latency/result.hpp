// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

/// What a run of lot_ab came to. The harness fills it; report.cpp counts and prints, json.cpp saves
/// and reads it, figures.cpp draws it, compare.cpp compares two.
///
///     Run -> Cell (one set of conditions) -> Arm (one transport in it) -> StreamResult ->
///     Subscriber
///
/// Times are nanoseconds of CLOCK_MONOTONIC here, and microseconds in tables and files.
namespace ab {

/// A message as its subscriber got it. A stamp of 0 was not set.
struct Sample {
  std::uint64_t number;  ///< the publisher's count, from 0, over all blocks
  std::uint32_t publisher;
  std::uint32_t block;      ///< of the cell: rises; arms take turns
  std::int64_t loaned_at;   ///< before its memory was asked for
  std::int64_t filled_at;   ///< after it was filled (the paper's stamp)
  std::int64_t pushed_at;   ///< just before push()
  std::int64_t entered_at;  ///< when the callback was entered
  bool operator==(const Sample&) const = default;
};

/// What a node did in its blocks, all its threads together.
struct Usage {
  double cpu_us = 0;  ///< user and system time
  std::uint64_t voluntary_switches = 0;
  std::uint64_t involuntary_switches = 0;
  std::uint64_t minor_faults = 0;
  std::uint64_t major_faults = 0;
  std::uint64_t copied_bytes = 0;
  bool operator==(const Usage&) const = default;
};

struct Subscriber {
  unsigned index = 0;
  std::uint64_t received = 0;
  std::uint64_t missed = 0;  ///< the transport said so
  std::uint64_t lost = 0;    ///< sent and neither received nor said to be missed
  std::uint64_t spoilt = 0;  ///< payloads that were not what was sent: none, or the run fails
  Usage usage;
  std::vector<Sample> samples;  ///< in the order of arrival; all, or every n-th of very many
  bool operator==(const Subscriber&) const = default;
};

struct Publisher {
  unsigned index = 0;
  std::uint64_t sent = 0;
  std::uint64_t refused = 0;  ///< push() said that nobody had room
  Usage usage;
  bool operator==(const Publisher&) const = default;
};

/// One block of ping-pong or throughput: how long it took as a whole.
struct BlockTime {
  std::uint32_t block = 0;
  std::uint64_t messages = 0;
  std::int64_t took = 0;
  bool operator==(const BlockTime&) const = default;
};

/// What one block cost: processor time of all its publishers, and of all its subscribers.
struct BlockCost {
  std::uint32_t block = 0;
  std::uint64_t sent = 0;
  double publishers_us = 0;
  double subscribers_us = 0;
  bool operator==(const BlockCost&) const = default;
};

/// One reading of the scheduler's statistics of a node.
struct Utilisation {
  std::string node;  ///< "publisher 0", "subscriber 3"
  std::int64_t at = 0;
  double cores = 0;  ///< since the reading before: 1.0 is one whole core
  bool operator==(const Utilisation&) const = default;
};

/// A place in the program where a SIGPROF sample found it, symbolised.
struct HotSpot {
  std::string symbol;
  double seconds = 0;
  bool operator==(const HotSpot&) const = default;
};
struct Profile {
  double cpu_s = 0;   ///< of all nodes
  double spin_s = 0;  ///< of that in wait loops
  std::uint64_t samples = 0;
  std::vector<HotSpot> hottest;
  bool operator==(const Profile&) const = default;
};

struct StreamResult {
  std::string name;  ///< "", or of a scenario: "camera0", "imu"
  std::size_t size = 0;
  double rate_hz = 0;  ///< of each publisher; 0: as fast as it goes
  std::vector<Publisher> publishers;
  std::vector<Subscriber> subscribers;
  std::vector<BlockTime> blocks;  ///< ping-pong: a message is one way; throughput: one delivered
  std::vector<BlockCost> block_costs;
  bool operator==(const StreamResult&) const = default;
};

struct Arm {
  std::string transport;  ///< its name; of a scenario's quiet twin "ring quiet"
  bool is_floor = false;
  bool copies = false;
  std::string refused;  ///< why it did not run here; empty: it did
  std::vector<StreamResult> streams;
  double daemon_cpu_us = 0;  ///< of a process that serves the nodes, while they had their turns
  std::vector<Utilisation> utilisation;
  Profile profile;  ///< empty unless asked for
  bool operator==(const Arm&) const = default;
};

/// The conditions of a cell, as they were asked for and as files say them.
struct Conditions {
  std::string mode = "paced";  ///< paced, ping-pong, throughput
  std::string graph = "1p1s";  ///< NpMs, or the name of a scenario: av
  std::size_t size = 128;      ///< of a scenario: 0
  double rate_hz = 30;
  std::uint64_t messages = 2000;  ///< of each publisher
  std::uint64_t block = 100;      ///< messages of one turn
  std::string wait = "park";      ///< spin, adaptive, park
  std::string pin = "none";       ///< none, same-core, other-core, socket, other-socket
  std::string place = "host";     ///< host, container, containers
  unsigned pool = 0;
  unsigned depth = 30;
  bool lossless = false;
  bool ordered = false;  ///< nodes come one by one, 2 s apart, publishers first
  bool fill = true;      ///< the whole message is written before it is pushed
  bool operator==(const Conditions&) const = default;
};

struct Cell {
  Conditions conditions;
  std::vector<Arm> arms;
  std::string command{};  ///< that measured it: a run is added to by several
  std::string revision{};
  bool operator==(const Cell&) const = default;
};

struct Machine {
  std::string cpu;
  unsigned cores = 0;
  unsigned sockets = 0;
  double memory_gib = 0;
  std::string kernel;
  std::string distribution;
  std::string compiler;
  std::string governor;     ///< of the cores' frequency; "unknown" where the system does not say
  std::string virtualised;  ///< "none", or by what
  std::string load_before;  ///< load averages when the run began
  bool operator==(const Machine&) const = default;
};

struct Run {
  Machine machine;
  std::string command;
  std::string started;  ///< ISO 8601, UTC
  std::string revision;
  std::uint64_t seed = 0;
  bool complete = true;  ///< false: ended by a signal or an error; what it holds is whole cells
  std::vector<Cell> cells;
  bool operator==(const Run&) const = default;
};

}  // namespace ab
