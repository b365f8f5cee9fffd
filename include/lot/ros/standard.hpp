// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include <boost/shared_ptr.hpp>

#include "lot/ros/core.hpp"
#include "lot/ros/message.hpp"

namespace lot::ros {

/// Makes standard messages of those in shared memory, for functions that take only these:
///
///     lot::ros::ToStandard<Image> standard;                      // one for each topic
///     sensor_msgs::ImageConstPtr copy = standard(image);         // boost::shared_ptr<Image const>
///
/// A message is copied once for all callers of this process, as long as one of them has the copy,
/// into memory that is used again: it is touched for the first time once, and not for each message.
///
/// Shape:   a handle; copies of it share that memory.
/// Threads: all members may be called at once. A caller must not change a copy: others read it.
/// Errors:  std::bad_alloc.
/// Memory:  keeps that of at most four copies that have no pointer left, on the heap.
/// Crash:   nothing of it is in the segment.
template <class M>
class ToStandard {
 public:
  using Pointer = boost::shared_ptr<Standard<M> const>;  ///< to a copy that is shared

  /// The copy of a message, made where there is none; null for null. Throws std::bad_alloc.
  [[nodiscard]] Pointer operator()(const boost::shared_ptr<M const>& message) const {
    if (!message) return nullptr;
    return boost::static_pointer_cast<Standard<M> const>(converter_->shared(message));
  }

 private:
  std::shared_ptr<detail::Converter> converter_ = detail::make_converter(detail::kind_of<M>());
};

}  // namespace lot::ros
