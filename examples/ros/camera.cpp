// SPDX-License-Identifier: Apache-2.0

// A camera and a viewer of stock ROS, in shared memory: examples/ros/launch/camera.launch.
//
//     ros_camera camera    publishes /camera/image, 16 MiB at 30 Hz
//     ros_camera viewer    prints how old the images are

#include <cstdio>
#include <cstring>
#include <string>

#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include <lot/ros.hpp>
#include <lot/signals.hpp>

using Image = lot::ros::Message<sensor_msgs::Image_>;

int main(int argc, char** argv) {
  lot::end_cleanly_on_signals();  // SIGTERM; SIGINT is roscpp's
  ros::init(argc, argv, "ros_camera", ros::init_options::AnonymousName);
  lot::ros::NodeHandle node;
  const std::string role = argc > 1 ? argv[1] : "";
  if (role == "camera") {
    auto publisher = node.advertise<Image>("camera/image", 10);
    int shade = 0;
    for (ros::Rate rate(30); ros::ok(); rate.sleep()) {
      auto image = publisher.loan();
      image->height = 2048;
      image->width = 2048;
      image->step = 4 * image->width;
      image->encoding = "rgba8";
      image->data.resize(16 << 20);
      std::memset(image->data.data(), shade++, image->data.size());
      image->header.stamp = ros::Time::now();
      publisher.publish(std::move(image));
    }
  } else if (role == "viewer") {
    auto subscriber =
        node.subscribe<Image>("camera/image", 10, [](const lot::ShmSharedPtr<const Image>& image) {
          const double age = (ros::Time::now() - image->header.stamp).toSec();
          std::printf("image %u, %zu bytes, %.0f us old\n", image->header.seq, image->data.size(),
                      1e6 * age);
        });
    ros::spin();
  } else {
    std::fprintf(stderr, "usage: ros_camera camera|viewer\n");
    return 2;
  }
}
