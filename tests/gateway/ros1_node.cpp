// SPDX-License-Identifier: Apache-2.0

// A node of ROS 1 for the tests of the gateway: common messages through lot::ros.
//
//     gateway_ros1_node publish       until SIGINT; of each topic the same message again and again
//     gateway_ros1_node subscribe     to all of them, until SIGINT

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include <geometry_msgs/Twist.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/PointCloud2.h>
#include <tf2_msgs/TFMessage.h>

#include "lot/ros.hpp"

namespace {

using Cloud = lot::ros::Message<sensor_msgs::PointCloud2_>;
using Image = lot::ros::Message<sensor_msgs::Image_>;
using Odometry = lot::ros::Message<nav_msgs::Odometry_>;
using Tf = lot::ros::Message<tf2_msgs::TFMessage_>;
using Twist = lot::ros::Message<geometry_msgs::Twist_>;

constexpr std::size_t kBytes = 3000;

template <class Header>
void fill_header(Header& header, const char* frame) {
  header.seq = 77;  // which ROS 2 does not have
  header.stamp = ros::Time(1'700'000'000, 123'456'789);
  header.frame_id = frame;
}

template <class Data>
void fill_data(Data& data) {
  data.resize(kBytes);
  for (std::size_t i = 0; i < kBytes; ++i) data[i] = static_cast<std::uint8_t>(7 * i);
}

void fill(Image& image) {
  fill_header(image.header, "camera");
  image.height = 10;
  image.width = 100;
  image.encoding = "rgb8";
  image.is_bigendian = 0;
  image.step = 300;
  fill_data(image.data);
}

void fill(Cloud& cloud) {
  fill_header(cloud.header, "lidar");
  cloud.height = 1;
  cloud.width = 250;
  cloud.fields.resize(3);
  for (std::uint32_t i = 0; i < 3; ++i) {
    cloud.fields[i].name = std::string(1, static_cast<char>('x' + i));
    cloud.fields[i].offset = 4 * i;
    cloud.fields[i].datatype = sensor_msgs::PointField::FLOAT32;
    cloud.fields[i].count = 1;
  }
  cloud.is_bigendian = false;
  cloud.point_step = 12;
  cloud.row_step = kBytes;
  fill_data(cloud.data);
  cloud.is_dense = true;
}

void fill(Twist& twist) {
  twist.linear.x = 0.5;
  twist.angular.z = -0.25;
}

void fill(Odometry& odometry) {
  fill_header(odometry.header, "odom");
  odometry.child_frame_id = "base";
  odometry.pose.pose.position.x = 1;
  odometry.pose.pose.orientation.w = 1;
  odometry.twist.twist.angular.z = 2;
  for (std::size_t i = 0; i < odometry.pose.covariance.size(); ++i) {
    odometry.pose.covariance[i] = static_cast<double>(i);
    odometry.twist.covariance[i] = -static_cast<double>(i);
  }
}

void fill(Tf& tf) {
  tf.transforms.resize(2);
  for (std::size_t i = 0; i < 2; ++i) {
    fill_header(tf.transforms[i].header, "map");
    tf.transforms[i].child_frame_id = i == 0 ? "odom" : "a longer name of a frame";
    tf.transforms[i].transform.translation.y = static_cast<double>(i);
    tf.transforms[i].transform.rotation.w = 1;
  }
}

template <class M>
void publish(lot::ros::Publisher<M>& publisher) {
  auto message = publisher.loan();
  fill(*message);
  publisher.publish(std::move(message));
}

void publish_all(lot::ros::NodeHandle& nh) {
  constexpr std::uint32_t kQueue = 10;
  constexpr double kPerSecond = 10;
  auto image = nh.advertise<Image>("/camera/image", kQueue);
  auto cloud = nh.advertise<Cloud>("/lidar/points", kQueue);
  auto twist = nh.advertise<Twist>("/cmd_vel", kQueue);
  auto odometry = nh.advertise<Odometry>("/odom", kQueue);
  auto tf = nh.advertise<Tf>("/tf", kQueue);
  for (ros::WallRate rate(kPerSecond); ros::ok(); rate.sleep()) {
    publish(image);
    publish(cloud);
    publish(twist);
    publish(odometry);
    publish(tf);
  }
}

void subscribe_all(lot::ros::NodeHandle& nh) {
  constexpr std::uint32_t kQueue = 10;
  const auto image = nh.subscribe<Image>("/camera/image", kQueue, [](const auto&) {});
  const auto cloud = nh.subscribe<Cloud>("/lidar/points", kQueue, [](const auto&) {});
  const auto twist = nh.subscribe<Twist>("/cmd_vel", kQueue, [](const auto&) {});
  const auto odometry = nh.subscribe<Odometry>("/odom", kQueue, [](const auto&) {});
  const auto tf = nh.subscribe<Tf>("/tf", kQueue, [](const auto&) {});
  ros::spin();
}

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "gateway_ros1_node", ros::init_options::AnonymousName);
  if (argc != 2) return 2;
  lot::ros::NodeHandle nh;
  if (std::strcmp(argv[1], "publish") == 0) {
    publish_all(nh);
  } else {
    subscribe_all(nh);
  }
  return 0;
}
