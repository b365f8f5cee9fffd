// SPDX-License-Identifier: Apache-2.0

// What cannot work with messages in shared memory: each case is refused by one line that says what
// to write. tests/lot_ros/CMakeLists.txt has the lines.

#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include "lot/ros.hpp"

using Image = lot::ros::Message<sensor_msgs::Image_>;

void see(const Image&) {}
/// As diagnostic_updater::DiagnosedPublisher takes one.
struct TakesPublisher {
  explicit TakesPublisher(const ros::Publisher&) {}
};

void refused(lot::ros::NodeHandle& node) {
#if defined(LOT_TEST_publisher)
  ros::Publisher out = node.advertise<Image>("image", 1);
#elif defined(LOT_TEST_argument)
  const TakesPublisher out(node.advertise<Image>("image", 1));
#elif defined(LOT_TEST_subscriber)
  ros::Subscriber in = node.subscribe<Image>("image", 1, &see);
#else  // what is to be written compiles
  lot::ros::Publisher<Image> out = node.advertise<Image>("image", 1);
  lot::ros::Subscriber in = node.subscribe<Image>("image", 1, &see);
#endif
}
