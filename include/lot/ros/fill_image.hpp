// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

#include <sensor_msgs/Image.h>

#include "lot/ros/message.hpp"

namespace sensor_msgs {

/// sensor_msgs/fill_image.h's fillImage(), for images in shared memory: one copy. Always true.
/// Throws lot::OutOfMemory when the segment has no room, and lot::Error as lot::ShmAllocator.
inline bool fillImage(lot::ros::Message<Image_>& image, const std::string& encoding,
                      std::uint32_t rows, std::uint32_t cols, std::uint32_t step,
                      const void* data) {
  image.encoding = encoding;
  image.height = rows;
  image.width = cols;
  image.step = step;
  image.is_bigendian = 0;
  const std::size_t bytes = std::size_t{step} * rows;
  image.data.resize(bytes);
  if (bytes != 0) std::memcpy(image.data.data(), data, bytes);
  return true;
}
/// sensor_msgs/fill_image.h's clearImage(): no pixels. Throws nothing.
inline void clearImage(lot::ros::Message<Image_>& image) { image.data.clear(); }

}  // namespace sensor_msgs
