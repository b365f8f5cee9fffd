// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

/// Ends of a ROS topic of sensor_msgs/Image, whose `data` are the bytes. C++17, and without ROS's
/// headers: what it is used by is C++20, which ROS's messages are not.
namespace ab::ros_ends {

enum class Way {
  Tcp,           ///< roscpp's TCPROS
  TcpNoDelay,    ///< without Nagle's algorithm
  Udp,           ///< roscpp's UDPROS
  Intra,         ///< roscpp, by pointer, within one process
  Lot,           ///< lot::ros
  LotImmediate,  ///< and callbacks on LOT's thread
  LotMutex,
  Pace,  ///< TCPROS's nodes, which publish nothing
};
enum class Waiting { Spin, Adaptive, Park };

struct Terms {
  Way way = Way::Tcp;
  Waiting waiting = Waiting::Park;
  std::string master;   ///< its URI
  std::string address;  ///< of this node, as others reach it
  std::string node;     ///< what this process is called; the first end that it opens decides
  std::string topic;
  std::string directory;  ///< for ROS's files and LOT's segment
  std::string segment;
  std::uint64_t segment_bytes = 0;
  std::size_t size = 0;  ///< of a message
  unsigned depth = 1;
  unsigned pool = 0;       ///< messages that are used again; 0: each is made anew. Not for LOT
  bool one_by_one = true;  ///< see Stream
  unsigned prepared = 0;   ///< messages of LOT's that are touched at the start
};

/// Threads: one.
class Publisher {
 public:
  virtual ~Publisher() = default;
  virtual unsigned subscribers() const = 0;
  /// Where the next message is to be written. Throws when there is no memory.
  virtual std::byte* loan() = 0;
  virtual void publish() = 0;
  virtual std::uint64_t serialised() const = 0;  ///< messages
};
/// Threads: one.
class Subscriber {
 public:
  using Handler = std::function<void(const std::byte* bytes, std::size_t size)>;
  virtual ~Subscriber() = default;
  /// Calls handler for the next message, in this thread, from roscpp's callback queue. False: none
  /// came in time (negative: for ever).
  virtual bool receive(const Handler& handler, std::chrono::nanoseconds patience) = 0;
};

std::unique_ptr<Publisher> advertise(const Terms& terms);
std::unique_ptr<Subscriber> subscribe(const Terms& terms);

}  // namespace ab::ros_ends
