// SPDX-License-Identifier: Apache-2.0
#include "gateway/ros_types.hpp"

#include <algorithm>
#include <cctype>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <memory>
#include <regex>
#include <utility>

#include "lot/description.hpp"
#include "lot/error.hpp"

#include "gateway/names.hpp"
#include "record/schema_text.hpp"
#include "registry/known_type.hpp"

namespace lot::gateway {
namespace {

/// A message as its `.msg` says it, without constants, and with `;` between the fields.
struct Definition {
  const char* name;
  const char* fields;
};

/// Not among them: sensor_msgs/Range, which has another field from Jazzy on.
constexpr Definition kDefinitions[] = {
    {"builtin_interfaces/Duration", "int32 sec; uint32 nanosec"},
    {"builtin_interfaces/Time", "int32 sec; uint32 nanosec"},
    {"geometry_msgs/Accel", "Vector3 linear; Vector3 angular"},
    {"geometry_msgs/AccelStamped", "std_msgs/Header header; Accel accel"},
    {"geometry_msgs/AccelWithCovariance", "Accel accel; float64[36] covariance"},
    {"geometry_msgs/AccelWithCovarianceStamped",
     "std_msgs/Header header; AccelWithCovariance accel"},
    {"geometry_msgs/Inertia",
     "float64 m; Vector3 com; float64 ixx; float64 ixy; float64 ixz; float64 iyy; float64 iyz; "
     "float64 izz"},
    {"geometry_msgs/InertiaStamped", "std_msgs/Header header; Inertia inertia"},
    {"geometry_msgs/Point", "float64 x; float64 y; float64 z"},
    {"geometry_msgs/Point32", "float32 x; float32 y; float32 z"},
    {"geometry_msgs/PointStamped", "std_msgs/Header header; Point point"},
    {"geometry_msgs/Polygon", "Point32[] points"},
    {"geometry_msgs/PolygonInstance", "Polygon polygon; int64 id"},
    {"geometry_msgs/PolygonInstanceStamped", "std_msgs/Header header; PolygonInstance polygon"},
    {"geometry_msgs/PolygonStamped", "std_msgs/Header header; Polygon polygon"},
    {"geometry_msgs/Pose", "Point position; Quaternion orientation"},
    {"geometry_msgs/Pose2D", "float64 x; float64 y; float64 theta"},
    {"geometry_msgs/PoseArray", "std_msgs/Header header; Pose[] poses"},
    {"geometry_msgs/PoseStamped", "std_msgs/Header header; Pose pose"},
    {"geometry_msgs/PoseWithCovariance", "Pose pose; float64[36] covariance"},
    {"geometry_msgs/PoseWithCovarianceStamped", "std_msgs/Header header; PoseWithCovariance pose"},
    {"geometry_msgs/Quaternion", "float64 x; float64 y; float64 z; float64 w"},
    {"geometry_msgs/QuaternionStamped", "std_msgs/Header header; Quaternion quaternion"},
    {"geometry_msgs/Transform", "Vector3 translation; Quaternion rotation"},
    {"geometry_msgs/TransformStamped",
     "std_msgs/Header header; string child_frame_id; Transform transform"},
    {"geometry_msgs/Twist", "Vector3 linear; Vector3 angular"},
    {"geometry_msgs/TwistStamped", "std_msgs/Header header; Twist twist"},
    {"geometry_msgs/TwistWithCovariance", "Twist twist; float64[36] covariance"},
    {"geometry_msgs/TwistWithCovarianceStamped",
     "std_msgs/Header header; TwistWithCovariance twist"},
    {"geometry_msgs/Vector3", "float64 x; float64 y; float64 z"},
    {"geometry_msgs/Vector3Stamped", "std_msgs/Header header; Vector3 vector"},
    {"geometry_msgs/VelocityStamped",
     "std_msgs/Header header; string body_frame_id; string reference_frame_id; Twist velocity"},
    {"geometry_msgs/Wrench", "Vector3 force; Vector3 torque"},
    {"geometry_msgs/WrenchStamped", "std_msgs/Header header; Wrench wrench"},
    {"nav_msgs/GridCells",
     "std_msgs/Header header; float32 cell_width; float32 cell_height; geometry_msgs/Point[] "
     "cells"},
    {"nav_msgs/MapMetaData",
     "builtin_interfaces/Time map_load_time; float32 resolution; uint32 width; uint32 height; "
     "geometry_msgs/Pose origin"},
    {"nav_msgs/OccupancyGrid", "std_msgs/Header header; MapMetaData info; int8[] data"},
    {"nav_msgs/Odometry",
     "std_msgs/Header header; string child_frame_id; geometry_msgs/PoseWithCovariance pose; "
     "geometry_msgs/TwistWithCovariance twist"},
    {"nav_msgs/Path", "std_msgs/Header header; geometry_msgs/PoseStamped[] poses"},
    {"sensor_msgs/BatteryState",
     "std_msgs/Header header; float32 voltage; float32 temperature; float32 current; float32 "
     "charge; float32 capacity; float32 design_capacity; float32 percentage; uint8 "
     "power_supply_status; uint8 power_supply_health; uint8 power_supply_technology; bool present; "
     "float32[] cell_voltage; float32[] cell_temperature; string location; string serial_number"},
    {"sensor_msgs/CameraInfo",
     "std_msgs/Header header; uint32 height; uint32 width; string distortion_model; float64[] d; "
     "float64[9] k; float64[9] r; float64[12] p; uint32 binning_x; uint32 binning_y; "
     "RegionOfInterest roi"},
    {"sensor_msgs/ChannelFloat32", "string name; float32[] values"},
    {"sensor_msgs/CompressedImage", "std_msgs/Header header; string format; uint8[] data"},
    {"sensor_msgs/FluidPressure",
     "std_msgs/Header header; float64 fluid_pressure; float64 variance"},
    {"sensor_msgs/Illuminance", "std_msgs/Header header; float64 illuminance; float64 variance"},
    {"sensor_msgs/Image",
     "std_msgs/Header header; uint32 height; uint32 width; string encoding; uint8 is_bigendian; "
     "uint32 step; uint8[] data"},
    {"sensor_msgs/Imu",
     "std_msgs/Header header; geometry_msgs/Quaternion orientation; float64[9] "
     "orientation_covariance; geometry_msgs/Vector3 angular_velocity; float64[9] "
     "angular_velocity_covariance; geometry_msgs/Vector3 linear_acceleration; float64[9] "
     "linear_acceleration_covariance"},
    {"sensor_msgs/JointState",
     "std_msgs/Header header; string[] name; float64[] position; float64[] velocity; float64[] "
     "effort"},
    {"sensor_msgs/Joy", "std_msgs/Header header; float32[] axes; int32[] buttons"},
    {"sensor_msgs/JoyFeedback", "uint8 type; uint8 id; float32 intensity"},
    {"sensor_msgs/JoyFeedbackArray", "JoyFeedback[] array"},
    {"sensor_msgs/LaserEcho", "float32[] echoes"},
    {"sensor_msgs/LaserScan",
     "std_msgs/Header header; float32 angle_min; float32 angle_max; float32 angle_increment; "
     "float32 time_increment; float32 scan_time; float32 range_min; float32 range_max; float32[] "
     "ranges; float32[] intensities"},
    {"sensor_msgs/MagneticField",
     "std_msgs/Header header; geometry_msgs/Vector3 magnetic_field; float64[9] "
     "magnetic_field_covariance"},
    {"sensor_msgs/MultiDOFJointState",
     "std_msgs/Header header; string[] joint_names; geometry_msgs/Transform[] transforms; "
     "geometry_msgs/Twist[] twist; geometry_msgs/Wrench[] wrench"},
    {"sensor_msgs/MultiEchoLaserScan",
     "std_msgs/Header header; float32 angle_min; float32 angle_max; float32 angle_increment; "
     "float32 time_increment; float32 scan_time; float32 range_min; float32 range_max; LaserEcho[] "
     "ranges; LaserEcho[] intensities"},
    {"sensor_msgs/NavSatFix",
     "std_msgs/Header header; NavSatStatus status; float64 latitude; float64 longitude; float64 "
     "altitude; float64[9] position_covariance; uint8 position_covariance_type"},
    {"sensor_msgs/NavSatStatus", "int8 status; uint16 service"},
    {"sensor_msgs/PointCloud",
     "std_msgs/Header header; geometry_msgs/Point32[] points; ChannelFloat32[] channels"},
    {"sensor_msgs/PointCloud2",
     "std_msgs/Header header; uint32 height; uint32 width; PointField[] fields; bool is_bigendian; "
     "uint32 point_step; uint32 row_step; uint8[] data; bool is_dense"},
    {"sensor_msgs/PointField", "string name; uint32 offset; uint8 datatype; uint32 count"},
    {"sensor_msgs/RegionOfInterest",
     "uint32 x_offset; uint32 y_offset; uint32 height; uint32 width; bool do_rectify"},
    {"sensor_msgs/RelativeHumidity",
     "std_msgs/Header header; float64 relative_humidity; float64 variance"},
    {"sensor_msgs/Temperature", "std_msgs/Header header; float64 temperature; float64 variance"},
    {"sensor_msgs/TimeReference",
     "std_msgs/Header header; builtin_interfaces/Time time_ref; string source"},
    {"std_msgs/Bool", "bool data"},
    {"std_msgs/Byte", "uint8 data"},
    {"std_msgs/ByteMultiArray", "MultiArrayLayout layout; uint8[] data"},
    {"std_msgs/Char", "uint8 data"},
    {"std_msgs/ColorRGBA", "float32 r; float32 g; float32 b; float32 a"},
    {"std_msgs/Empty", ""},
    {"std_msgs/Float32", "float32 data"},
    {"std_msgs/Float32MultiArray", "MultiArrayLayout layout; float32[] data"},
    {"std_msgs/Float64", "float64 data"},
    {"std_msgs/Float64MultiArray", "MultiArrayLayout layout; float64[] data"},
    {"std_msgs/Header", "builtin_interfaces/Time stamp; string frame_id"},
    {"std_msgs/Int16", "int16 data"},
    {"std_msgs/Int16MultiArray", "MultiArrayLayout layout; int16[] data"},
    {"std_msgs/Int32", "int32 data"},
    {"std_msgs/Int32MultiArray", "MultiArrayLayout layout; int32[] data"},
    {"std_msgs/Int64", "int64 data"},
    {"std_msgs/Int64MultiArray", "MultiArrayLayout layout; int64[] data"},
    {"std_msgs/Int8", "int8 data"},
    {"std_msgs/Int8MultiArray", "MultiArrayLayout layout; int8[] data"},
    {"std_msgs/MultiArrayDimension", "string label; uint32 size; uint32 stride"},
    {"std_msgs/MultiArrayLayout", "MultiArrayDimension[] dim; uint32 data_offset"},
    {"std_msgs/String", "string data"},
    {"std_msgs/UInt16", "uint16 data"},
    {"std_msgs/UInt16MultiArray", "MultiArrayLayout layout; uint16[] data"},
    {"std_msgs/UInt32", "uint32 data"},
    {"std_msgs/UInt32MultiArray", "MultiArrayLayout layout; uint32[] data"},
    {"std_msgs/UInt64", "uint64 data"},
    {"std_msgs/UInt64MultiArray", "MultiArrayLayout layout; uint64[] data"},
    {"std_msgs/UInt8", "uint8 data"},
    {"std_msgs/UInt8MultiArray", "MultiArrayLayout layout; uint8[] data"},
    {"tf2_msgs/TF2Error", "uint8 error; string error_string"},
    {"tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms"},
};

/// "geometry_msgs::msg::dds_::Twist_" for "geometry_msgs/Twist".
std::string dds_type_of_definition(std::string name) {
  return dds_type_of(name.insert(name.find('/'), "/msg"));
}

const Definition* find(const std::string& dds_type) {
  const auto* const found = std::ranges::find_if(kDefinitions, [&](const Definition& d) {
    return dds_type_of_definition(d.name) == dds_type;
  });
  return found == std::end(kDefinitions) ? nullptr : found;
}

std::string lines_of(const Definition& definition) {
  std::string lines = definition.fields;
  std::ranges::replace(lines, ';', '\n');
  return lines + "\n";
}

/// All of them, behind the fields of one: a reader of schemas takes those that it needs.
std::string schema_with_all(const Definition& root) {
  std::string text = lines_of(root);
  for (const Definition& each : kDefinitions) {
    if (&each != &root) text += "===\nMSG: " + std::string(each.name) + "\n" + lines_of(each);
  }
  return text;
}

/// "geometry_msgs::Twist" for "geometry_msgs/Twist".
std::string name_in_cpp(const std::string& name) {
  const std::size_t slash = name.find('/');
  return slash == name.npos ? name : std::string(name).replace(slash, 1, "::");
}

/// The fields of a `.msg` as far as its bytes say them. ROS 1 writes "K" where ROS 2 writes "k",
/// and has a number of one byte where ROS 2 has a bool or a byte.
std::string bytes_of(const std::string& name, const std::string& msg) {
  std::string fields = record::read_schema(name, msg).fields;
  std::ranges::transform(fields, fields.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  static const std::regex kOneByte("([:\\]])(bool|int8)(?=[,}])");
  return std::regex_replace(fields, kOneByte, "$1uint8");
}

}  // namespace

bool is_ros_type(const std::string& dds_type) { return find(dds_type) != nullptr; }

AnyType type_of_ros(const std::string& dds_type) {
  const Definition* const found = find(dds_type);
  if (found == nullptr) return {};
  record::SchemaType made = record::read_schema(found->name, schema_with_all(*found));
  for (Description::Type& type : made.description.types) type.name = name_in_cpp(type.name);
  constexpr std::uint64_t kNoIdentity = 0;
  return AnyType(std::make_shared<const registry::KnownType>(
      name_in_cpp(found->name), made.align, kNoIdentity, std::move(made.description)));
}

bool is_as_in_ros(const std::string& dds_type, const std::string& msg) try {
  const Definition* const found = find(dds_type);
  return found == nullptr ||
         bytes_of(found->name, msg) == bytes_of(found->name, schema_with_all(*found));
} catch (const Error&) {
  return false;  // the text is no `.msg`
}

}  // namespace lot::gateway
