// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "transport.hpp"

/// What the nodes of a cell are told before they begin: it lies on the board, as JSON.
namespace ab {

enum class Role { Publish, Subscribe };

struct NodePlan {
  unsigned arm = 0;
  unsigned stream = 0;
  Role role = Role::Publish;
  unsigned index = 0;      ///< among the publishers, or subscribers, of its stream
  std::vector<int> cores;  ///< it may run on these; empty: on all
  double delay_s = 0;      ///< before it opens its end
  bool profiled = false;
};

struct StreamPlan {
  Stream stream;
  double rate_hz = 0;  ///< 0: as fast as it goes
};

struct ArmPlan {
  std::string transport;
  std::vector<StreamPlan> streams;  ///< ping-pong: there, and back
  /// Each group of nodes has one parent process, in namespaces of its own if the place asks for it.
  std::vector<std::vector<unsigned>> groups;
};

/// How many messages of a stream are as long as a block of the first one.
inline std::uint64_t messages_in_block(double first_hz, double rate_hz, std::uint64_t of_first) {
  if (first_hz == 0 || rate_hz == 0) return of_first;
  const double n = static_cast<double>(of_first) * rate_hz / first_hz;
  return std::max<std::uint64_t>(1, static_cast<std::uint64_t>(n + 0.5));
}

struct Plan {
  std::string mode;
  bool fill = true;
  std::uint64_t keep_every = 1;  ///< of so many messages, one is a sample
  std::vector<ArmPlan> arms;
  std::vector<NodePlan> nodes;
};

NLOHMANN_JSON_SERIALIZE_ENUM(Role, {{Role::Publish, "publish"}, {Role::Subscribe, "subscribe"}})
NLOHMANN_JSON_SERIALIZE_ENUM(Wait, {{Wait::Spin, "spin"},
                                    {Wait::Adaptive, "adaptive"},
                                    {Wait::Park, "park"}})
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Stream, name, directory, size, publishers, subscribers, wait,
                                   pool, depth, filled, one_by_one, lossless, isolated, address)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(NodePlan, arm, stream, role, index, cores, delay_s, profiled)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(StreamPlan, stream, rate_hz)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(ArmPlan, transport, streams, groups)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Plan, mode, fill, keep_every, arms, nodes)

}  // namespace ab
