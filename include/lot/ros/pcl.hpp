// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include <boost/endian/conversion.hpp>
#include <pcl/PCLPointField.h>
#include <pcl/common/io.h>
#include <pcl/conversions.h>
#include <pcl/point_cloud.h>
#include <pcl_conversions/pcl_conversions.h>
#include <sensor_msgs/PointCloud2.h>

#include "lot/ros/message.hpp"
#include "lot/ros/point_cloud2.hpp"

/// Point clouds in shared memory for PCL. Link pcl_common.
///
///     for (const pcl::PointXYZ& point : lot::ros::points<pcl::PointXYZ>(*cloud)) ...  // no copy
///     pcl::PointCloud<pcl::PointXYZ> mine;
///     pcl::fromROSMsg(*cloud, mine);                                                   // one
///     auto out = pub.loan();
///     pcl::toROSMsg(mine, *out);                                                       // one
namespace lot::ros {

/// Points that lie in a message one behind the other. The message must be there as long as it.
///
/// Threads: a value; of the points as of the message: one thread writes, any number read.
/// Errors:  no member throws.
/// Memory:  two words.
/// Crash:   nothing of it is in the segment.
template <class Point>
class Points {
 public:
  /// For points().
  Points(Point* first, std::size_t count) noexcept : first_(first), count_(count) {}
  /// The first point.
  Point* begin() const noexcept { return first_; }
  /// Behind the last one.
  Point* end() const noexcept { return first_ + count_; }
  /// How many.
  std::size_t size() const noexcept { return count_; }
  /// True when there is none.
  [[nodiscard]] bool empty() const noexcept { return count_ == 0; }
  /// REQUIRES: i < size().
  Point& operator[](std::size_t i) const noexcept { return first_[i]; }

 private:
  Point* first_;
  std::size_t count_;
};

namespace detail {

inline std::vector<pcl::PCLPointField> pcl_fields(const Cloud& cloud) {
  std::vector<pcl::PCLPointField> fields(cloud.fields.size());
  for (std::size_t i = 0; i < fields.size(); ++i) {
    fields[i].name = cloud.fields[i].name;
    fields[i].offset = cloud.fields[i].offset;
    fields[i].datatype = cloud.fields[i].datatype;
    fields[i].count = cloud.fields[i].count;
  }
  return fields;
}

/// Which bytes of a point of the cloud are which of a Point.
template <class Point>
pcl::MsgFieldMap mapping(const Cloud& cloud) {
  pcl::MsgFieldMap map;
  pcl::createMapping<Point>(pcl_fields(cloud), map);
  for (const auto& piece : map) {
    if (std::size_t{piece.serialized_offset} + piece.size > cloud.point_step) {
      throw std::runtime_error("a field of the point cloud lies outside of its points");
    }
  }
  return map;
}

/// How many points the cloud has. Throws std::runtime_error where its bytes are fewer.
inline std::size_t count_points(const Cloud& cloud) {
  const std::size_t row = std::size_t{cloud.width} * cloud.point_step;
  const std::size_t bytes =
      cloud.height == 0 ? 0 : std::size_t{cloud.height - 1} * cloud.row_step + row;
  if (cloud.row_step < row || cloud.data.size() < bytes) {
    throw std::runtime_error("a point cloud of " + std::to_string(cloud.width) + " x " +
                             std::to_string(cloud.height) + " points has only " +
                             std::to_string(cloud.data.size()) + " bytes");
  }
  return std::size_t{cloud.width} * cloud.height;
}

template <class Point, class Byte, class Its>
Points<Point> points_of(Its& cloud, Byte* bytes) {
  const std::size_t count = count_points(cloud);
  for (const auto& field : pcl::getFields<std::remove_const_t<Point>>()) {
    const auto is_it = [&](const auto& there) {
      const bool are_colours = field.name.rfind("rgb", 0) == 0 && there.name.rfind("rgb", 0) == 0;
      return (there.name == field.name && there.datatype == field.datatype) || are_colours;
    };
    const auto there = std::find_if(cloud.fields.begin(), cloud.fields.end(), is_it);
    if (there == cloud.fields.end()) {
      throw std::runtime_error("the point cloud has no field " + field.name + " of that type");
    }
    if (there->offset != field.offset) {
      throw std::runtime_error("the points of the cloud are laid out otherwise: pcl::fromROSMsg()");
    }
  }
  const bool is_dense = cloud.height <= 1 || cloud.row_step == cloud.width * cloud.point_step;
  if (cloud.point_step != sizeof(Point) || !is_dense) {
    throw std::runtime_error("the points of the cloud are " + std::to_string(cloud.point_step) +
                             " bytes apart, and not " + std::to_string(sizeof(Point)) +
                             ": pcl::fromROSMsg()");
  }
  if (reinterpret_cast<std::uintptr_t>(bytes) % alignof(Point) != 0) {
    throw std::runtime_error(
        "the points of the cloud are not aligned (clouds under 64 KiB may not be): "
        "pcl::fromROSMsg()");
  }
  return {reinterpret_cast<Point*>(bytes), count};
}

}  // namespace detail

/// The points, where they lie. Throws std::runtime_error where they are not laid out as Point is,
/// and pcl::fromROSMsg() has to copy them.
template <class Point>
[[nodiscard]] Points<const Point> points(const detail::Cloud& cloud) {
  return detail::points_of<const Point>(cloud, cloud.data.data());
}
/// The same, to be written. Throws the same.
template <class Point>
[[nodiscard]] Points<Point> points(detail::Cloud& cloud) {
  return detail::points_of<Point>(cloud, cloud.data.data());
}

/// Makes `cloud` one of so many points, which are still to be filled: points<Point>(cloud). Throws
/// std::runtime_error for a row of 4 GiB or more; lot::OutOfMemory when the segment has no room.
template <class Point>
void shape(detail::Cloud& cloud, std::uint32_t width, std::uint32_t height = 1) {
  if (std::size_t{width} * sizeof(Point) > UINT32_MAX) {
    throw std::runtime_error("a row of a point cloud has less than 4 GiB");
  }
  const auto fields = pcl::getFields<Point>();
  cloud.fields.resize(fields.size());
  for (std::size_t i = 0; i < fields.size(); ++i) {
    cloud.fields[i].name = fields[i].name;
    cloud.fields[i].offset = fields[i].offset;
    cloud.fields[i].datatype = fields[i].datatype;
    cloud.fields[i].count = fields[i].count;
  }
  cloud.width = width;
  cloud.height = height;
  cloud.is_bigendian = boost::endian::order::native == boost::endian::order::big;
  cloud.is_dense = true;
  cloud.point_step = sizeof(Point);
  cloud.row_step = width * cloud.point_step;
  cloud.data.resize(std::size_t{cloud.row_step} * height);
}

}  // namespace lot::ros

namespace pcl {

/// As for the standard message, with one copy where it has two. Fields that the cloud has not are
/// zero. Throws std::runtime_error where the cloud has fewer bytes than points, or a field lies
/// outside of its points; std::bad_alloc.
template <class Point>
void fromROSMsg(const lot::ros::Message<sensor_msgs::PointCloud2_>& cloud,
                PointCloud<Point>& points) {
  const auto map = lot::ros::detail::mapping<Point>(cloud);
  const std::size_t count = lot::ros::detail::count_points(cloud);
  points.header.frame_id = cloud.header.frame_id;
  points.header.seq = cloud.header.seq;
  pcl_conversions::toPCL(cloud.header.stamp, points.header.stamp);
  points.width = cloud.width;
  points.height = cloud.height;
  points.is_dense = cloud.is_dense != 0;
  const bool is_whole = map.size() == 1 && map[0].serialized_offset == 0 &&
                        map[0].struct_offset == 0 && map[0].size == cloud.point_step &&
                        cloud.point_step == sizeof(Point);
  if (!is_whole) points.points.clear();
  points.points.resize(count);
  auto* to = reinterpret_cast<std::uint8_t*>(points.points.data());
  for (std::uint32_t y = 0; y < cloud.height; ++y) {
    const std::uint8_t* from = cloud.data.data() + std::size_t{y} * cloud.row_step;
    if (is_whole) {
      if (cloud.width != 0) std::memcpy(to, from, cloud.width * sizeof(Point));
      to += cloud.width * sizeof(Point);
      continue;
    }
    for (std::uint32_t x = 0; x < cloud.width; ++x) {
      for (const auto& piece : map) {
        std::memcpy(to + piece.struct_offset, from + piece.serialized_offset, piece.size);
      }
      from += cloud.point_step;
      to += sizeof(Point);
    }
  }
}

/// As for the standard message. Throws std::runtime_error where there are not width x height
/// points, or a row has 4 GiB or more; lot::OutOfMemory when the segment has no room.
template <class Point>
void toROSMsg(const PointCloud<Point>& points,
              lot::ros::Message<sensor_msgs::PointCloud2_>& cloud) {
  // As PCL does: a cloud without a width and a height is one row.
  const bool is_said = points.width != 0 || points.height != 0;
  lot::ros::shape<Point>(cloud,
                         is_said ? points.width : static_cast<std::uint32_t>(points.points.size()),
                         is_said ? points.height : 1);
  if (std::size_t{cloud.width} * cloud.height != points.points.size()) {
    throw std::runtime_error("the point cloud has not width x height points");
  }
  cloud.header.frame_id = points.header.frame_id;
  cloud.header.seq = points.header.seq;
  pcl_conversions::fromPCL(points.header.stamp, cloud.header.stamp);
  cloud.is_dense = points.is_dense;
  if (!points.points.empty()) {
    std::memcpy(cloud.data.data(), static_cast<const void*>(points.points.data()),
                cloud.data.size());
  }
}

}  // namespace pcl
