// SPDX-License-Identifier: Apache-2.0

// Prints which fields the gateway knows of messages of ROS 2.
//
//     gateway_ros_schema NAME...      for each "@ NAME", and its `.msg`: nothing where it knows
//     none

#include <cstdio>
#include <exception>

#include "codec/program.hpp"
#include "codec/schema.hpp"
#include "gateway/names.hpp"
#include "gateway/ros_types.hpp"

int main(int argc, char** argv) try {
  for (int i = 1; i < argc; ++i) {
    std::printf("@ %s\n", argv[i]);
    const lot::AnyType type = lot::gateway::type_of_ros(lot::gateway::dds_type_of(argv[i]));
    if (!type) continue;
    const lot::codec::Program program(type.description());
    std::printf("%s", lot::codec::schema_of(program.description()).msg.c_str());
  }
  return 0;
} catch (const std::exception& e) {
  std::fprintf(stderr, "%s\n", e.what());
  return 1;
}
