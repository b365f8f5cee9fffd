// SPDX-License-Identifier: Apache-2.0

// lot_relay IN OUT: publishes what comes on one topic on another one, in shared memory. What plain
// nodes publish is so brought into LOT once, for all that read it there; plain nodes get OUT, too.
//
// It knows the messages of std_msgs, geometry_msgs and sensor_msgs; for others a node of three
// lines does the same (docs/porting.md).

#include <cstdio>
#include <functional>
#include <map>
#include <string>

#include <geometry_msgs/PointStamped.h>
#include <geometry_msgs/PoseArray.h>
#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>
#include <geometry_msgs/Twist.h>
#include <geometry_msgs/TwistStamped.h>
#include <geometry_msgs/WrenchStamped.h>
#include <ros/ros.h>
#include <sensor_msgs/BatteryState.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/FluidPressure.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/JointState.h>
#include <sensor_msgs/Joy.h>
#include <sensor_msgs/LaserScan.h>
#include <sensor_msgs/MagneticField.h>
#include <sensor_msgs/MultiEchoLaserScan.h>
#include <sensor_msgs/NavSatFix.h>
#include <sensor_msgs/PointCloud.h>
#include <sensor_msgs/PointCloud2.h>
#include <sensor_msgs/Range.h>
#include <sensor_msgs/Temperature.h>
#include <std_msgs/ByteMultiArray.h>
#include <std_msgs/ColorRGBA.h>
#include <std_msgs/Float32.h>
#include <std_msgs/Float32MultiArray.h>
#include <std_msgs/Float64.h>
#include <std_msgs/Float64MultiArray.h>
#include <std_msgs/Header.h>
#include <std_msgs/Int32.h>
#include <std_msgs/Int32MultiArray.h>
#include <std_msgs/Int64.h>
#include <std_msgs/String.h>
#include <std_msgs/UInt8MultiArray.h>

#include "lot/ros.hpp"

namespace {

constexpr std::uint32_t kQueue = 100;

using Run = std::function<void(lot::ros::NodeHandle&, const std::string&, const std::string&)>;

template <template <class> class Generated>
void relay(lot::ros::NodeHandle& node, const std::string& in, const std::string& out) {
  using M = lot::ros::Message<Generated>;
  auto publisher = node.advertise<M>(out, kQueue);
  auto subscriber = node.subscribe<M>(
      in, kQueue,
      [publisher](const boost::shared_ptr<M const>& message) { publisher.publish(message); });
  ros::spin();
}

template <template <class> class Generated>
std::pair<const std::string, Run> entry() {
  return {ros::message_traits::DataType<Generated<std::allocator<void>>>::value(),
          relay<Generated>};
}

const std::map<std::string, Run>& known() {
  static const std::map<std::string, Run> types{entry<geometry_msgs::PointStamped_>(),
                                                entry<geometry_msgs::PoseArray_>(),
                                                entry<geometry_msgs::PoseStamped_>(),
                                                entry<geometry_msgs::PoseWithCovarianceStamped_>(),
                                                entry<geometry_msgs::TransformStamped_>(),
                                                entry<geometry_msgs::Twist_>(),
                                                entry<geometry_msgs::TwistStamped_>(),
                                                entry<geometry_msgs::WrenchStamped_>(),
                                                entry<sensor_msgs::BatteryState_>(),
                                                entry<sensor_msgs::CameraInfo_>(),
                                                entry<sensor_msgs::CompressedImage_>(),
                                                entry<sensor_msgs::FluidPressure_>(),
                                                entry<sensor_msgs::Image_>(),
                                                entry<sensor_msgs::Imu_>(),
                                                entry<sensor_msgs::JointState_>(),
                                                entry<sensor_msgs::Joy_>(),
                                                entry<sensor_msgs::LaserScan_>(),
                                                entry<sensor_msgs::MagneticField_>(),
                                                entry<sensor_msgs::MultiEchoLaserScan_>(),
                                                entry<sensor_msgs::NavSatFix_>(),
                                                entry<sensor_msgs::PointCloud_>(),
                                                entry<sensor_msgs::PointCloud2_>(),
                                                entry<sensor_msgs::Range_>(),
                                                entry<sensor_msgs::Temperature_>(),
                                                entry<std_msgs::ByteMultiArray_>(),
                                                entry<std_msgs::ColorRGBA_>(),
                                                entry<std_msgs::Float32_>(),
                                                entry<std_msgs::Float32MultiArray_>(),
                                                entry<std_msgs::Float64_>(),
                                                entry<std_msgs::Float64MultiArray_>(),
                                                entry<std_msgs::Header_>(),
                                                entry<std_msgs::Int32_>(),
                                                entry<std_msgs::Int32MultiArray_>(),
                                                entry<std_msgs::Int64_>(),
                                                entry<std_msgs::String_>(),
                                                entry<std_msgs::UInt8MultiArray_>()};
  return types;
}

/// The type of a topic that somebody publishes; waits for one.
std::string type_of(const std::string& topic) {
  for (bool said = false; ros::ok(); said = true) {
    ros::master::V_TopicInfo topics;
    ros::master::getTopics(topics);
    for (const auto& info : topics) {
      if (info.name == topic) return info.datatype;
    }
    if (!said) ROS_INFO("waiting for a publisher of %s", topic.c_str());
    ros::WallDuration(0.2).sleep();
  }
  return "";
}

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "lot_relay", ros::init_options::AnonymousName);
  ros::V_string arguments;
  ros::removeROSArgs(argc, argv, arguments);
  if (arguments.size() != 3) {
    std::fprintf(stderr, "usage: lot_relay IN OUT\n");
    return 2;
  }
  lot::ros::NodeHandle node;
  const std::string in = node.resolveName(arguments[1]);
  const std::string type = type_of(in);
  if (type.empty()) return 0;  // it was asked to end
  const auto at = known().find(type);
  if (at == known().end()) {
    std::fprintf(stderr,
                 "lot_relay: %s carries %s, which this relay does not know; docs/porting.md shows "
                 "the node of three lines that relays it\n",
                 in.c_str(), type.c_str());
    return 1;
  }
  at->second(node, in, arguments[2]);
}
