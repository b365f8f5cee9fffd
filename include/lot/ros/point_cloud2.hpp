// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include <sensor_msgs/PointCloud2.h>
#include <sensor_msgs/PointField.h>

#include "lot/ros/message.hpp"

/// Point clouds in shared memory, by their fields: sensor_msgs/point_cloud2_iterator.h's
/// counterparts.
///
///     lot::ros::PointCloud2Modifier modifier(*cloud);
///     modifier.setPointCloud2FieldsByString(2, "xyz", "rgb");
///     modifier.resize(100);
///     for (lot::ros::PointCloud2Iterator<float> x(*cloud, "x"); x != x.end(); ++x) x[0] = 1;
///
/// Errors:  std::runtime_error, where the cloud has no such field.
namespace lot::ros {
namespace detail {

using Cloud = Message<sensor_msgs::PointCloud2_>;

inline std::size_t size_of_point_field(int datatype) {
  switch (datatype) {
    case sensor_msgs::PointField::INT8:
    case sensor_msgs::PointField::UINT8:
      return 1;
    case sensor_msgs::PointField::INT16:
    case sensor_msgs::PointField::UINT16:
      return 2;
    case sensor_msgs::PointField::INT32:
    case sensor_msgs::PointField::UINT32:
    case sensor_msgs::PointField::FLOAT32:
      return 4;
    case sensor_msgs::PointField::FLOAT64:
      return 8;
    default:
      throw std::runtime_error("no point field has the datatype " + std::to_string(datatype));
  }
}

/// Where in a point a field of that name lies. "r", "g", "b" and "a" are bytes of "rgb" or "rgba".
inline std::size_t offset_of_field(const Cloud& cloud, const std::string& name, std::size_t size) {
  for (const auto& field : cloud.fields) {
    const bool is_colour = field.name == "rgb" || field.name == "rgba";
    const std::size_t colour = std::string("bgra").find(name);
    const bool is_byte = is_colour && name.size() == 1 && colour != std::string::npos;
    if (field.name != name && !is_byte) continue;
    const std::size_t offset =
        !is_byte ? field.offset : field.offset + (cloud.is_bigendian ? 3 - colour : colour);
    const std::size_t bytes =
        is_byte ? 1 : size_of_point_field(field.datatype) * std::max<std::size_t>(field.count, 1);
    if (size > bytes || offset + size > cloud.point_step) {
      throw std::runtime_error("the point field " + name + " has " + std::to_string(bytes) +
                               " bytes, and not " + std::to_string(size));
    }
    return offset;
  }
  throw std::runtime_error("the point cloud has no field " + name);
}

/// Goes from point to point through one field, which lies at any address.
template <class T, class Byte, class Its, class Derived>
class PointIterator {
  typedef T Value __attribute__((aligned(1), may_alias));

 public:
  PointIterator() = default;
  PointIterator(Its& cloud, const std::string& field) : step_(cloud.point_step) {
    const std::size_t offset = offset_of_field(cloud, field, sizeof(T));
    const std::size_t points = cloud.data.size() / step_;
    if (points == 0) return;
    at_ = cloud.data.data() + offset;
    end_ = at_ + points * step_;
  }

  Value& operator*() const { return *reinterpret_cast<Value*>(at_); }
  /// The i-th value of the point from here, of a field that has several or of those behind it.
  Value& operator[](std::size_t i) const { return reinterpret_cast<Value*>(at_)[i]; }
  Derived& operator++() { return *this += 1; }
  Derived& operator+=(int points) {
    at_ += points * static_cast<std::ptrdiff_t>(step_);
    return static_cast<Derived&>(*this);
  }
  Derived operator+(int points) const {
    Derived there = static_cast<const Derived&>(*this);
    return there += points;
  }
  Derived end() const {
    Derived there = static_cast<const Derived&>(*this);
    there.at_ = end_;
    return there;
  }
  friend bool operator==(const PointIterator& a, const PointIterator& b) { return a.at_ == b.at_; }
  friend bool operator!=(const PointIterator& a, const PointIterator& b) { return a.at_ != b.at_; }
  friend bool operator<(const PointIterator& a, const PointIterator& b) { return a.at_ < b.at_; }

 private:
  Byte* at_ = nullptr;
  Byte* end_ = nullptr;
  std::size_t step_ = 1;
};

}  // namespace detail

/// Goes from point to point of a cloud that is being built, through one field.
///
/// Threads: one at a time; several may go through one cloud that is not written.
/// Errors:  its constructor throws std::runtime_error where the cloud has no such field; no other
///          member throws.
/// Memory:  three words; the cloud must be there as long as it, and keep its size.
/// Crash:   nothing of it is in the segment.
template <class T>
class PointCloud2Iterator
    : public detail::PointIterator<T, std::uint8_t, detail::Cloud, PointCloud2Iterator<T>> {
 public:
  using PointCloud2Iterator::PointIterator::PointIterator;
};
/// Goes from point to point of any cloud, through one field.
///
/// Threads: one at a time; several may go through one cloud that is not written.
/// Errors:  its constructor throws std::runtime_error where the cloud has no such field; no other
///          member throws.
/// Memory:  three words; the cloud must be there as long as it, and keep its size.
/// Crash:   nothing of it is in the segment.
template <class T>
class PointCloud2ConstIterator
    : public detail::PointIterator<const T, const std::uint8_t, const detail::Cloud,
                                   PointCloud2ConstIterator<T>> {
 public:
  using PointCloud2ConstIterator::PointIterator::PointIterator;
};

/// Says what the points of a cloud that is being built are, and how many.
///
/// Threads: one at a time, that which builds the cloud.
/// Errors:  lot::OutOfMemory when the segment has no room; std::runtime_error for a field that
///          cannot be.
/// Memory:  one word; the cloud must be there as long as it.
/// Crash:   as the cloud's message.
class PointCloud2Modifier {
 public:
  /// Of that cloud. Throws nothing.
  explicit PointCloud2Modifier(detail::Cloud& cloud) : cloud_(cloud) {}

  /// How many points the cloud has bytes for. Throws nothing.
  std::size_t size() const {
    return cloud_.point_step == 0 ? 0 : cloud_.data.size() / cloud_.point_step;
  }
  /// Memory for so many points. REQUIRES: the fields are said. Throws lot::OutOfMemory.
  void reserve(std::size_t points) { cloud_.data.reserve(points * cloud_.point_step); }
  /// So many points. A cloud of one row, or of one column, stays one. REQUIRES: the fields are
  /// said. Throws lot::OutOfMemory.
  void resize(std::size_t points) {
    cloud_.data.resize(points * cloud_.point_step);
    const auto n = static_cast<std::uint32_t>(points);
    if (cloud_.height != 1 && cloud_.width == 1) {
      cloud_.height = n;
      return;
    }
    cloud_.height = 1;
    cloud_.width = n;
    cloud_.row_step = n * cloud_.point_step;
  }
  /// No points; the fields stay. Throws nothing.
  void clear() {
    cloud_.data.clear();
    if (cloud_.height == 1) {
      cloud_.row_step = cloud_.width = 0;
    } else if (cloud_.width == 1) {
      cloud_.height = 0;
    } else {
      cloud_.row_step = cloud_.width = cloud_.height = 0;
    }
  }

  /// So many fields, each a name, how many values it has, and their datatype; without gaps. Throws
  /// std::runtime_error for a datatype that does not exist, lot::OutOfMemory.
  template <class... Fields>
  void setPointCloud2Fields([[maybe_unused]] int count, const Fields&... fields) {
    static_assert(sizeof...(Fields) % 3 == 0, "each field is a name, a count and a datatype");
    cloud_.fields.clear();
    cloud_.fields.reserve(sizeof...(Fields) / 3);
    lay_out(add(0, fields...));
  }
  /// By their usual names: "xyz", "rgb", "rgba", each of 16 bytes. Throws std::runtime_error for
  /// another name, lot::OutOfMemory.
  template <class... Names>
  void setPointCloud2FieldsByString([[maybe_unused]] int count, const Names&... names) {
    cloud_.fields.clear();
    std::uint32_t offset = 0;
    ((offset = add_by_string(names, offset)), ...);
    lay_out(offset);
  }

 private:
  std::uint32_t add(std::uint32_t offset) const { return offset; }
  template <class... Others>
  std::uint32_t add(std::uint32_t offset, const std::string& name, int count, int datatype,
                    const Others&... others) {
    cloud_.fields.emplace_back();
    auto& field = cloud_.fields.back();
    field.name = name;
    field.offset = offset;
    field.datatype = static_cast<std::uint8_t>(datatype);
    field.count = static_cast<std::uint32_t>(count);
    const std::size_t bytes = field.count * detail::size_of_point_field(datatype);
    return add(offset + static_cast<std::uint32_t>(bytes), others...);
  }
  std::uint32_t add_by_string(const std::string& name, std::uint32_t offset) {
    constexpr int kFloat = sensor_msgs::PointField::FLOAT32;
    if (name == "xyz") {
      add(offset, "x", 1, kFloat, "y", 1, kFloat, "z", 1, kFloat);
    } else if (name == "rgb" || name == "rgba") {
      add(offset, name, 1, kFloat);
    } else {
      throw std::runtime_error("no point fields are called " + name + ": xyz, rgb or rgba");
    }
    return offset + 4 * sizeof(float);
  }
  void lay_out(std::uint32_t point_step) {
    cloud_.point_step = point_step;
    cloud_.row_step = cloud_.width * point_step;
    cloud_.data.resize(std::size_t{cloud_.height} * cloud_.row_step);
  }

  detail::Cloud& cloud_;
};

}  // namespace lot::ros
