// SPDX-License-Identifier: Apache-2.0

// The messages of ROS 2 that the gateway knows, beside structs of a program.

#include "gateway/ros_types.hpp"

#include <cstdint>
#include <string>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "codec/program.hpp"
#include "codec/schema.hpp"
#include "gateway/names.hpp"

namespace builtin_interfaces {
struct Time {
  std::int32_t sec;
  std::uint32_t nanosec;
};
}  // namespace builtin_interfaces
namespace std_msgs {
struct Empty {};
struct Header {
  builtin_interfaces::Time stamp;
  lot::ShmString frame_id;
};
}  // namespace std_msgs
namespace geometry_msgs {
struct Point {
  double x, y, z;
};
struct Vector3 {
  double x, y, z;
};
struct Quaternion {
  double x, y, z, w;
};
struct Pose {
  Point position;
  Quaternion orientation;
};
struct PoseWithCovariance {
  Pose pose;
  double covariance[36];
};
struct Twist {
  Vector3 linear, angular;
};
struct TwistWithCovariance {
  Twist twist;
  double covariance[36];
};
struct Transform {
  Vector3 translation;
  Quaternion rotation;
};
struct TransformStamped {
  std_msgs::Header header;
  lot::ShmString child_frame_id;
  Transform transform;
};
}  // namespace geometry_msgs
namespace nav_msgs {
struct Odometry {
  std_msgs::Header header;
  lot::ShmString child_frame_id;
  geometry_msgs::PoseWithCovariance pose;
  geometry_msgs::TwistWithCovariance twist;
};
}  // namespace nav_msgs
namespace sensor_msgs {
struct Image {
  std_msgs::Header header;
  std::uint32_t height, width;
  lot::ShmString encoding;
  std::uint8_t is_bigendian;
  std::uint32_t step;
  lot::ShmVector<std::uint8_t> data;
};
struct JointState {
  std_msgs::Header header;
  lot::ShmVector<lot::ShmString> name;
  lot::ShmVector<double> position, velocity, effort;
};
struct PointField {
  lot::ShmString name;
  std::uint32_t offset;
  std::uint8_t datatype;
  std::uint32_t count;
};
struct PointCloud2 {
  std_msgs::Header header;
  std::uint32_t height, width;
  lot::ShmVector<PointField> fields;
  bool is_bigendian;
  std::uint32_t point_step, row_step;
  lot::ShmVector<std::uint8_t> data;
  bool is_dense;
};
}  // namespace sensor_msgs
namespace tf2_msgs {
struct TFMessage {
  lot::ShmVector<geometry_msgs::TransformStamped> transforms;
};
}  // namespace tf2_msgs

namespace lot::testing {
namespace {

using namespace gateway;

template <class T>
void check(const std::string& name) {
  CAPTURE(name);
  const std::string dds_type = dds_type_of(name);
  const AnyType own = AnyType::of<T>();
  const AnyType made = type_of_ros(dds_type);
  REQUIRE(made);
  CHECK(is_ros_type(dds_type));
  CHECK(made.name() == own.name());
  CHECK(made.is_same(own));
  const codec::Program program(made.description());
  CHECK(codec::schema_of(program.description()).name == name);
  CHECK(codec::schema_of(program.description()).msg == codec::schema_of(own.description()).msg);
}

TEST_SUITE_BEGIN("gateway");

TEST_CASE("a message of ROS 2 is the struct with its name and fields") {
  check<std_msgs::Empty>("std_msgs/msg/Empty");
  check<std_msgs::Header>("std_msgs/msg/Header");
  check<geometry_msgs::Twist>("geometry_msgs/msg/Twist");
  check<geometry_msgs::TransformStamped>("geometry_msgs/msg/TransformStamped");
  check<nav_msgs::Odometry>("nav_msgs/msg/Odometry");
  check<sensor_msgs::Image>("sensor_msgs/msg/Image");
  check<sensor_msgs::JointState>("sensor_msgs/msg/JointState");
  check<sensor_msgs::PointCloud2>("sensor_msgs/msg/PointCloud2");
  check<tf2_msgs::TFMessage>("tf2_msgs/msg/TFMessage");
}

TEST_CASE("what is no common message of ROS 2 has no type") {
  for (const char* name : {"", "/", "geometry_msgs/Twist", "robot/msg/Twist", "Twist",
                           "geometry_msgs/msg/twist", "sensor_msgs/msg/Range"}) {
    CAPTURE(name);
    CHECK(!is_ros_type(dds_type_of(name)));
    CHECK(!type_of_ros(dds_type_of(name)));
  }
}

TEST_CASE("a message that is called as one of ROS 2 and has other fields is found") {
  const auto is_twist = [](const std::string& msg) {
    return is_as_in_ros(dds_type_of("geometry_msgs/msg/Twist"), msg);
  };
  const std::string vector = "===\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";
  CHECK(is_twist("Vector3 linear\nVector3 angular\n" + vector));
  CHECK(is_twist("Vector3 LINEAR\nVector3 angular\n" + vector));
  CHECK_FALSE(is_twist("Vector3 angular\nVector3 linear\n" + vector));
  CHECK_FALSE(is_twist("Vector3 linear\n" + vector));
  CHECK_FALSE(is_twist("Vector3 linear\nVector3 angular\nbool valid\n" + vector));
  CHECK_FALSE(is_twist("float64 linear\nfloat64 angular\n"));
  CHECK_FALSE(is_twist("Vector4 linear\n"));  // whose type is not in the text
  CHECK_FALSE(
      is_twist("Vector3 linear\nVector3 angular\n===\nMSG: geometry_msgs/Vector3\n"
               "float32 x\nfloat64 y\nfloat64 z\n"));

  // ROS 1 says so of a bool and of bytes.
  CHECK(is_as_in_ros(dds_type_of("std_msgs/msg/Bool"), "uint8 data\n"));
  CHECK(is_as_in_ros(dds_type_of("std_msgs/msg/Byte"), "int8 data\n"));
  CHECK_FALSE(is_as_in_ros(dds_type_of("std_msgs/msg/Bool"), "int16 data\n"));
  CHECK_FALSE(is_as_in_ros(dds_type_of("std_msgs/msg/UInt16"), "int16 data\n"));
  // The gateway knows no fields of these.
  CHECK(is_as_in_ros(dds_type_of("robot/msg/Twist"), "float64 data\n"));
  CHECK(is_as_in_ros(dds_type_of("sensor_msgs/msg/Range"), "float64 data\n"));
}

TEST_SUITE_END();

}  // namespace
}  // namespace lot::testing
