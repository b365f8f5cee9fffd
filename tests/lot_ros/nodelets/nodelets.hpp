// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include "lot/ros.hpp"

/// Nodelets of several libraries for one manager. They say what they saw as private parameters.
namespace lot_test {

using LotImage = lot::ros::Message<sensor_msgs::Image_>;
constexpr double kPeriod = 0.01;  ///< seconds

/// The image's number, and where its bytes lie.
template <class Image>
void mark(Image& image, int number) {
  image.height = static_cast<std::uint32_t>(number);
  image.step = static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(image.data.data()));
  image.data.front() = image.data.back() = static_cast<std::uint8_t>(number);
}
template <class Image>
bool is_in_its_place(const Image& image) {
  return image.step ==
         static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(image.data.data()));
}

/// What a viewer has seen.
class Tally {
 public:
  template <class Image>
  void add(const Image& image) {
    const int number = static_cast<int>(image.height);
    const auto byte = static_cast<std::uint8_t>(number);
    if (received_ == 0) first_ = number;
    if (number != first_ + received_ || image.data.front() != byte || image.data.back() != byte) {
      ++wrong_;
    }
    if (!is_in_its_place(image)) ++elsewhere_;
    ++received_;
  }
  void tell(const ros::NodeHandle& own) const {
    own.setParam("first", first_);
    own.setParam("wrong", wrong_);
    own.setParam("elsewhere", elsewhere_);
    own.setParam("received", received_);
  }

 private:
  int first_ = 0;
  int received_ = 0;
  int wrong_ = 0;
  int elsewhere_ = 0;
};

}  // namespace lot_test
