// SPDX-License-Identifier: Apache-2.0
/// Cameras of ROS that film for bench/record/ros.py: sensor_msgs/Image on /camera/0, /camera/1 ...
/// by lot::ros. Each frame differs from the one before it. Prints how many it has published.
///
///     ros_cameras CAMERAS BYTES HZ SECONDS SUBSCRIBERS
///     ros_cameras viewer CAMERAS
///
/// It begins when each topic has so many subscribers, and a second has passed. The viewer is a
/// subscriber by LOT of each: an observer sees what a publisher puts into its ring for such a one.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include <lot/ros.hpp>

namespace {

using Image = lot::ros::Message<sensor_msgs::Image_>;

void publish(const lot::ros::Publisher<Image>& camera, std::size_t bytes, unsigned number) {
  auto image = camera.loan();
  image->height = 1;
  image->width = static_cast<std::uint32_t>(bytes);
  image->step = image->width;
  image->encoding = "mono8";
  image->data.resize(bytes);
  std::memset(image->data.data(), static_cast<int>(number & 0xff), 4096);
  image->header.stamp = ros::Time::now();
  camera.publish(std::move(image));
}

void film(int number, std::size_t bytes, double hz, unsigned frames, std::uint32_t wanted) {
  lot::ros::NodeHandle node;
  std::vector<lot::ros::Publisher<Image>> cameras;
  for (int c = 0; c < number; ++c) {
    cameras.push_back(node.advertise<Image>("/camera/" + std::to_string(c), 16));
  }
  ros::AsyncSpinner spinner(1);
  spinner.start();
  for (const auto& camera : cameras) {
    while (ros::ok() && camera.getNumSubscribers() < wanted) ros::WallDuration(0.01).sleep();
  }
  ros::WallDuration(1).sleep();
  unsigned sent = 0;
  ros::WallRate rate(hz);
  for (unsigned n = 0; n < frames && ros::ok(); ++n, rate.sleep()) {
    for (const auto& camera : cameras) {
      publish(camera, bytes, n);
      ++sent;
    }
  }
  ros::WallDuration(2).sleep();  // what is on its way is recorded
  std::printf("%u\n", sent);
}

void view(int number) {
  lot::ros::NodeHandle node;
  std::size_t seen = 0;
  std::vector<lot::ros::Subscriber> viewers;
  for (int c = 0; c < number; ++c) {
    viewers.push_back(node.subscribe<Image>(
        "/camera/" + std::to_string(c), 16,
        [&](const lot::ShmSharedPtr<const Image>& image) { seen += image->data.size(); }));
  }
  ros::spin();
  std::printf("%zu bytes\n", seen);
}

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "cameras", ros::init_options::AnonymousName);
  const bool viewer = argc == 3 && std::string(argv[1]) == "viewer";
  if (!viewer && argc != 6) {
    std::fprintf(
        stderr,
        "usage: ros_cameras CAMERAS BYTES HZ SECONDS SUBSCRIBERS, or ros_cameras viewer CAMERAS\n");
    return 2;
  }
  if (viewer) {
    view(std::atoi(argv[2]));
    return 0;
  }
  const double hz = std::atof(argv[3]);
  film(std::atoi(argv[1]), static_cast<std::size_t>(std::atoll(argv[2])), hz,
       static_cast<unsigned>(std::atof(argv[4]) * hz),
       static_cast<std::uint32_t>(std::atoi(argv[5])));
  return 0;
}
