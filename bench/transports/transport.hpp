// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

/// What every way to move messages looks like to the harness (bench/latency).
///
/// A *stream* is a topic with its publishers and subscribers, each a *node*: a process, or a thread
/// where the transport knows threads alone. The harness makes one Sender or Receiver in each node
/// (both, for ping-pong), fills messages, stamps and checks them, and counts; a transport moves
/// bytes, as well as it can.
namespace ab {

enum class Wait { Spin, Adaptive, Park };

/// How a node reaches another one's sockets. Index: publisher, then subscriber.
using Addresses = std::vector<std::vector<std::string>>;

/// What all nodes of a stream agree on before the first of them opens its end.
struct Stream {
  /// Unique on this machine; at most 60 letters, digits, '_' and '-'. Whatever has a name
  /// (segments, queues, sockets, domains) has this one at its beginning, so that the harness can
  /// remove it.
  std::string name;
  /// For files that nodes share: the same directory for all of them, also in containers, in memory
  /// (tmpfs), theirs alone, removed by the harness. In containers /dev/shm is theirs alone, too.
  std::string directory;
  std::size_t size = 128;  ///< bytes of every message; at least 128
  unsigned publishers = 1;
  unsigned subscribers = 1;
  Wait wait = Wait::Park;
  /// Messages that a publisher prepares and uses again and again; 0: makes each anew. Transports
  /// that have no such choice (they copy, or recycle by themselves) ignore it.
  unsigned pool = 0;
  unsigned depth = 30;  ///< messages that wait for a slow subscriber
  bool filled = true;   ///< the whole message is written each time, not its ends alone
  /// receive() returns after each message; false: it may hand over several before it does.
  bool one_by_one = true;
  bool lossless = false;  ///< push() waits for slow subscribers, where Transport::waits
  bool isolated = false;  ///< the nodes have namespaces of their own (PID, IPC, mount, network)
  /// The publisher's network address as the subscriber sees it. Ports are the transport's affair
  /// (publishers listen on a port that the kernel chooses, and say so in a file of `directory`).
  Addresses address;
};

/// A publisher's end. Used by one thread.
class Sender {
 public:
  virtual ~Sender() = default;
  /// Returns when `subscribers` have joined, or false after `patience`. Called once, before the
  /// first loan(); may be called again after false.
  virtual bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) = 0;
  /// Where the next message is to be written: `size` bytes, 64-byte aligned if the transport can.
  /// A second loan() without a push() returns the same place. Throws what says why it cannot.
  virtual std::byte* loan() = 0;
  /// Publishes it. False: nobody had room in time, and it was dropped here.
  virtual bool push() = 0;
  /// Bytes of messages that this end has copied so far, by itself and in system calls.
  virtual std::uint64_t copied() const { return 0; }
};

/// A subscriber's end. Used by one thread.
class Receiver {
 public:
  /// Called with each message when it is there: valid until it returns. What it does is not the
  /// transport's business; it enters at the earliest moment at which a user's callback could.
  using Handler = std::function<void(std::span<const std::byte>)>;

  virtual ~Receiver() = default;
  /// Waits at most `patience` (negative: for ever) for a message, in the way that Stream::wait
  /// says, and calls handler for it; one message at most (but see Stream::one_by_one), and from no
  /// other thread when this has returned. False: none came. An unfinished or
  /// torn message is never handed over: it counts as missed.
  virtual bool receive(const Handler& handler, std::chrono::nanoseconds patience) = 0;
  /// Messages of which this end knows that they went past it.
  virtual std::uint64_t missed() const { return 0; }
  virtual std::uint64_t copied() const { return 0; }
};

/// Something that must run beside the nodes (a broker, a discovery server). Made before the first
/// node, in the harness's process; ends what it has started when it is destroyed.
class Service {
 public:
  virtual ~Service() = default;
  /// Its process, whose processor time is told apart; 0: it has none of its own.
  virtual int pid() const { return 0; }
};

struct Transport {
  std::string name;
  std::string about;        ///< one line, with the version of what it is
  bool threads = false;     ///< its nodes are threads of one process
  bool is_floor = false;    ///< a bound to compare with, not a way to send messages
  bool delivers = true;     ///< false: its subscribers hear nothing (the cost of pacing alone)
  bool waits = true;        ///< push() can wait for slow subscribers: nothing need be lost
  bool is_network = false;  ///< needs Stream::address
  bool may_lose = false;    ///< the last message, too
  /// Bytes of a message that arrives whole, however busy the machine is, when nothing else is on
  /// its way: more than this, and whoever sends can outrun whoever reads.
  std::size_t arrives = SIZE_MAX;
  bool copies = false;  ///< a message's bytes are copied on their way
  /// Why this stream cannot be had: empty, or a sentence that says what can be set instead.
  std::function<std::string(const Stream&)> refuses;
  /// Null where none is needed.
  std::function<std::unique_ptr<Service>(const Stream&)> serve;
  std::function<std::unique_ptr<Sender>(const Stream&, unsigned publisher)> sender;
  std::function<std::unique_ptr<Receiver>(const Stream&, unsigned subscriber)> receiver;
};

/// All that this program was built with, in the order in which tables show them.
const std::vector<Transport>& transports();
/// The one of this name; null: this program was built without it.
const Transport* find_transport(const std::string& name);

/// Transports that were not found when this program was configured: name, and the package to
/// install.
struct Missing {
  std::string name;
  std::string why;
};
const std::vector<Missing>& missing_transports();

// ---- one function for each file beside this one
// ----------------------------------------------------

std::vector<Transport> lot_transports();      ///< ring, mutex
std::vector<Transport> floor_transports();    ///< floor-spin, floor-futex, floor-pace
std::vector<Transport> lot2021_transports();  ///< lot2021
std::vector<Transport> tzc_transports();      ///< tzc
std::vector<Transport> intra_transports();    ///< intra
std::vector<Transport> ros_transports();      ///< ros-tcp, ros-udp, ros-intra, ros-lot, ...
std::vector<Transport> socket_transports();   ///< tcp, tcp-nagle, uds
std::vector<Transport> udp_transports();      ///< udp, udp-65507
std::vector<Transport> iceoryx_transports();  ///< iceoryx
std::vector<Transport> fastdds_transports();  ///< fastdds, fastdds-loan

}  // namespace ab
