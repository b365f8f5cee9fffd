// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <dds/dds.h>

#include "gateway/cdr_type.hpp"
#include "gateway/domain.hpp"
#include "gateway/entity.hpp"

namespace lot::gateway {

/// Tells ROS 2 that the gateway is a node, with these readers and writers: on the topic
/// `ros_discovery_info`, as each process of ROS 2 does. So `ros2 node list` has it, and `ros2 topic
/// info` names it.
///
/// Threads: one.
/// Errors:  lot::Error of the constructor; those of tell().
/// Memory:  one sample, which CycloneDDS keeps for programs that come later.
/// Crash:   others forget the node with its participant.
class RosGraph {
 public:
  /// `gid_bytes`: 24 up to ROS 2 Humble, 16 from Iron on. Throws lot::Error.
  RosGraph(const Domain& domain, std::string node, std::size_t gid_bytes);

  /// Throws lot::Error, std::bad_alloc.
  void tell(const std::vector<dds_guid_t>& readers, const std::vector<dds_guid_t>& writers);

 private:
  const std::string node_;
  const std::size_t gid_bytes_;
  dds_guid_t participant_{};
  CdrTopic topic_;
  Entity writer_;
};

}  // namespace lot::gateway
