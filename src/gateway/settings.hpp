// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "lot/duration.hpp"

#include "gateway/domain.hpp"

namespace lot::gateway {

/// What other processes of a segment see of a gateway. By it gateways know each other: no gateway
/// carries out what one has brought in.
inline constexpr const char* kProcessName = "lot_gateway";

/// AsWriters: of an incoming topic, what all of its writers offer; of an outgoing one, reliable.
enum class Reliability { AsWriters, Reliable, BestEffort };
/// TransientLocal: readers that come late get the last messages. AsWriters: of an incoming topic,
/// what all of its writers offer; of an outgoing one, volatile.
enum class Durability { AsWriters, Volatile, TransientLocal };

/// How a topic is carried in DDS.
struct Quality {
  Reliability reliability = Reliability::AsWriters;
  Durability durability = Durability::AsWriters;
  std::uint32_t depth = 64;  ///< KEEP_LAST
  Duration deadline;         ///< DEADLINE; 0: none

  bool operator==(const Quality&) const = default;
};

/// What may come in on one topic.
struct Limits {
  double max_rate = 0;          ///< messages a second; 0: no limit
  std::uint64_t max_bytes = 0;  ///< PusherOptions::max_bytes; 0: an eighth of the segment

  bool operator==(const Limits&) const = default;
};

/// The topics that are to be carried in one direction, by a name or a pattern of the shell.
struct RouteSettings {
  std::string topics;
  std::string dds_topic;  ///< for a single name: what it is called in DDS, if not as ROS 2 would
  Quality quality;
  Limits limits;     ///< incoming ones
  std::string type;  ///< of incoming ones, in ROS 2, for topics that no process here uses

  bool operator==(const RouteSettings&) const = default;
};

/// All that a gateway is told. Of several rows that fit a topic the first one counts.
struct Settings {
  DomainSettings domain;
  std::vector<RouteSettings> out;
  std::vector<RouteSettings> in;
  /// Topics that come in at once: a pattern fits as many as the network likes.
  std::size_t most_incoming = 256;
  /// The file of its Ledger. Empty: it has none.
  std::string state;
  /// What ROS 2 calls the gateway.
  std::string node = kProcessName;
  /// Of an identity in ROS 2's messages: 24 up to Humble, 16 from Iron on.
  std::size_t gid_bytes = 24;
};

}  // namespace lot::gateway
