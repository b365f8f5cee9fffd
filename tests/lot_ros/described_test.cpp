// SPDX-License-Identifier: Apache-2.0

// What generated messages say of themselves: each field's name, kind, place and size.

#include "lot/detail/described.hpp"

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>
#include <lot_test_msgs/Tracks.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_msgs/Empty.h>
#include <std_msgs/Header.h>
#include <tf2_msgs/TFMessage.h>

#include "lot/describe.hpp"
#include "lot/ros/message.hpp"

namespace {

using lot::Description;
using lot::Kind;
using lot::ros::Message;
using Type = Description::Type;

/// What a field must be.
struct Expected {
  std::string name;
  std::size_t offset;
  std::size_t size;
  Kind kind;
  Kind element = Kind::Opaque;
  std::uint64_t count = 0;
};

void check(const Description& all, const Type& type, const char* name, std::size_t size,
           const std::vector<Expected>& fields) {
  CAPTURE(name);
  CHECK(type.kind == Kind::Struct);
  CHECK(type.name == name);
  CHECK(type.size == size);
  REQUIRE(type.fields.size() == fields.size());
  for (std::size_t i = 0; i < fields.size(); ++i) {
    const Type& field = all.types.at(type.fields[i].type);
    CAPTURE(fields[i].name);
    CHECK(type.fields[i].name == fields[i].name);
    CHECK(type.fields[i].offset == fields[i].offset);
    CHECK(type.fields[i].bits == 0);
    CHECK(field.size == fields[i].size);
    CHECK(field.kind == fields[i].kind);
    CHECK(field.count == fields[i].count);
    if (fields[i].element != Kind::Opaque) {
      REQUIRE(field.element != Description::kNone);
      CHECK(all.types.at(field.element).kind == fields[i].element);
    }
  }
}

/// The type of a field, or of what it holds.
const Type& inside(const Description& all, const Type& type, std::size_t i) {
  const Type& field = all.types.at(type.fields.at(i).type);
  return field.element == Description::kNone ? field : all.types.at(field.element);
}

}  // namespace

// A generated message is standard layout, but offsetof() warns of it.
#pragma GCC diagnostic ignored "-Winvalid-offsetof"
#define FIELD(M, name, ...) \
  Expected { #name, offsetof(M, name), sizeof(M::name), __VA_ARGS__ }

TEST_CASE("a header says where its stamp lies, and a stamp that it is sec and nsec") {
  using Header = Message<std_msgs::Header_>;
  const Description& all = lot::describe<Header>();
  check(all, all.root(), "std_msgs/Header", sizeof(Header),
        {FIELD(Header, seq, Kind::UInt), FIELD(Header, stamp, Kind::Struct),
         FIELD(Header, frame_id, Kind::String, Kind::Char)});
  check(all, inside(all, all.root(), 1), "time", 8,
        {{"sec", 0, 4, Kind::UInt}, {"nsec", 4, 4, Kind::UInt}});
  CHECK(inside(all, all.root(), 2).size == 1);
  CHECK(all.types.at(all.root().fields[2].type).name ==
        lot::describe<lot::ShmString>().root().name);
}

TEST_CASE("an image has its fields, of which the header is a struct") {
  using Image = Message<sensor_msgs::Image_>;
  const Description& all = lot::describe<Image>();
  check(all, all.root(), "sensor_msgs/Image", sizeof(Image),
        {FIELD(Image, header, Kind::Struct), FIELD(Image, height, Kind::UInt),
         FIELD(Image, width, Kind::UInt), FIELD(Image, encoding, Kind::String, Kind::Char),
         FIELD(Image, is_bigendian, Kind::UInt), FIELD(Image, step, Kind::UInt),
         FIELD(Image, data, Kind::Vector, Kind::UInt)});
  CHECK(inside(all, all.root(), 0).name == "std_msgs/Header");
  CHECK(inside(all, all.root(), 6).size == 1);
  CHECK(all.names_hash() != 0);
}

TEST_CASE("a point cloud's fields are a vector of messages, whose constants are no fields") {
  using Cloud = Message<sensor_msgs::PointCloud2_>;
  using Field = Message<sensor_msgs::PointField_>;
  const Description& all = lot::describe<Cloud>();
  check(all, all.root(), "sensor_msgs/PointCloud2", sizeof(Cloud),
        {FIELD(Cloud, header, Kind::Struct), FIELD(Cloud, height, Kind::UInt),
         FIELD(Cloud, width, Kind::UInt), FIELD(Cloud, fields, Kind::Vector, Kind::Struct),
         FIELD(Cloud, is_bigendian, Kind::UInt), FIELD(Cloud, point_step, Kind::UInt),
         FIELD(Cloud, row_step, Kind::UInt), FIELD(Cloud, data, Kind::Vector, Kind::UInt),
         FIELD(Cloud, is_dense, Kind::UInt)});
  check(all, inside(all, all.root(), 3), "sensor_msgs/PointField", sizeof(Field),
        {FIELD(Field, name, Kind::String, Kind::Char), FIELD(Field, offset, Kind::UInt),
         FIELD(Field, datatype, Kind::UInt), FIELD(Field, count, Kind::UInt)});
}

TEST_CASE("arrays of fixed length lie in the message") {
  using Info = Message<sensor_msgs::CameraInfo_>;
  const Description& all = lot::describe<Info>();
  check(all, all.root(), "sensor_msgs/CameraInfo", sizeof(Info),
        {FIELD(Info, header, Kind::Struct), FIELD(Info, height, Kind::UInt),
         FIELD(Info, width, Kind::UInt), FIELD(Info, distortion_model, Kind::String, Kind::Char),
         FIELD(Info, D, Kind::Vector, Kind::Float), FIELD(Info, K, Kind::Array, Kind::Float, 9),
         FIELD(Info, R, Kind::Array, Kind::Float, 9), FIELD(Info, P, Kind::Array, Kind::Float, 12),
         FIELD(Info, binning_x, Kind::UInt), FIELD(Info, binning_y, Kind::UInt),
         FIELD(Info, roi, Kind::Struct)});
  using Imu = Message<sensor_msgs::Imu_>;
  const Description& imu = lot::describe<Imu>();
  check(imu, imu.root(), "sensor_msgs/Imu", sizeof(Imu),
        {FIELD(Imu, header, Kind::Struct), FIELD(Imu, orientation, Kind::Struct),
         FIELD(Imu, orientation_covariance, Kind::Array, Kind::Float, 9),
         FIELD(Imu, angular_velocity, Kind::Struct),
         FIELD(Imu, angular_velocity_covariance, Kind::Array, Kind::Float, 9),
         FIELD(Imu, linear_acceleration, Kind::Struct),
         FIELD(Imu, linear_acceleration_covariance, Kind::Array, Kind::Float, 9)});
  check(imu, inside(imu, imu.root(), 1), "geometry_msgs/Quaternion", 32,
        {{"x", 0, 8, Kind::Float},
         {"y", 8, 8, Kind::Float},
         {"z", 16, 8, Kind::Float},
         {"w", 24, 8, Kind::Float}});
}

TEST_CASE("messages of messages of messages say all that lies in them") {
  using Tree = Message<tf2_msgs::TFMessage_>;
  using Stamped = Message<geometry_msgs::TransformStamped_>;
  const Description& all = lot::describe<Tree>();
  check(all, all.root(), "tf2_msgs/TFMessage", sizeof(Tree),
        {FIELD(Tree, transforms, Kind::Vector, Kind::Struct)});
  const Type& stamped = inside(all, all.root(), 0);
  check(all, stamped, "geometry_msgs/TransformStamped", sizeof(Stamped),
        {FIELD(Stamped, header, Kind::Struct),
         FIELD(Stamped, child_frame_id, Kind::String, Kind::Char),
         FIELD(Stamped, transform, Kind::Struct)});
  check(all, inside(all, stamped, 2), "geometry_msgs/Transform", 56,
        {{"translation", 0, 24, Kind::Struct}, {"rotation", 24, 32, Kind::Struct}});
}

TEST_CASE("everything that a message may be made of has its kind") {
  using Tracks = Message<lot_test_msgs::Tracks_>;
  const Description& all = lot::describe<Tracks>();
  check(all, all.root(), "lot_test_msgs/Tracks", sizeof(Tracks),
        {FIELD(Tracks, header, Kind::Struct), FIELD(Tracks, name, Kind::String, Kind::Char),
         FIELD(Tracks, tracks, Kind::Vector, Kind::Struct),
         FIELD(Tracks, pair, Kind::Array, Kind::Struct, 2),
         FIELD(Tracks, matrix, Kind::Array, Kind::Float, 9),
         FIELD(Tracks, raw, Kind::Vector, Kind::UInt), FIELD(Tracks, valid, Kind::UInt),
         FIELD(Tracks, flags, Kind::Vector, Kind::UInt), FIELD(Tracks, big, Kind::Int),
         FIELD(Tracks, bigger, Kind::Vector, Kind::UInt), FIELD(Tracks, exact, Kind::Float),
         FIELD(Tracks, seen, Kind::Struct), FIELD(Tracks, took, Kind::Vector, Kind::Struct),
         FIELD(Tracks, words, Kind::Vector, Kind::String),
         FIELD(Tracks, three, Kind::Array, Kind::String, 3), FIELD(Tracks, c, Kind::UInt),
         FIELD(Tracks, b, Kind::Int), FIELD(Tracks, kind, Kind::UInt)});
  check(all, inside(all, all.root(), 12), "duration", 8,
        {{"sec", 0, 4, Kind::Int}, {"nsec", 4, 4, Kind::Int}});
  CHECK(all.names_hash() != 0);
}

TEST_CASE("a message without fields is a struct without fields") {
  const Description& all = lot::describe<Message<std_msgs::Empty_>>();
  check(all, all.root(), "std_msgs/Empty", 1, {});
}

TEST_CASE("names are those of a definition's own fields") {
  const auto names = [](const char* text) { return lot::ros::detail::field_names(text); };
  using Names = std::vector<std::string>;
  CHECK(names("").empty());
  CHECK(
      names(
          "# uint8 no\n\n  uint8   a  # = 3\nint8[4] b\nstring S = # x\nint32 K=1\nfoo/Bar[] c") ==
      Names{"a", "b", "c"});
  CHECK(names("uint8 a\r\n=====\nMSG: foo/Bar\nuint8 b") == Names{"a"});
  CHECK(names("uint8").empty());
}

TEST_CASE("what describes a message is small enough for a segment") {
  for (const Description* all : {&lot::describe<Message<lot_test_msgs::Tracks_>>(),
                                 &lot::describe<Message<std_msgs::Empty_>>(),
                                 &lot::describe<Message<tf2_msgs::TFMessage_>>()}) {
    CHECK(!lot::detail::make_described(*all).bytes.empty());
  }
}
