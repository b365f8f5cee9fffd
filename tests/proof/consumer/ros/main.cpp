// SPDX-License-Identifier: Apache-2.0
#include <cstdio>

#include <ros/ros.h>
#include <std_msgs/String.h>

#include <lot/ros.hpp>

using String = lot::ros::Message<std_msgs::String_>;

/// With an argument it is a node; without one it shows that it was built and starts.
int main(int argc, char** argv) {
  std_msgs::String mine;
  mine.data = "made by another project";
  String shared;
  lot::ros::assign(shared, mine);
  std::printf("%s\n", shared.data.c_str());
  if (argc < 2) return 0;
  ros::init(argc, argv, "consumer");
  lot::ros::NodeHandle node;
  auto publisher = node.advertise<String>("strings", 10);
  publisher.publish(shared);
  auto subscriber = node.subscribe<String>(
      "strings", 10, [](const String& s) { std::printf("%s\n", s.data.c_str()); });
  ros::spin();
}
