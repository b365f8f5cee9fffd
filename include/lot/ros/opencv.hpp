// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include <boost/endian/conversion.hpp>
#include <boost/make_shared.hpp>
#include <boost/shared_ptr.hpp>
#include <cv_bridge/cv_bridge.h>
#include <opencv2/core/mat.hpp>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>

#include "lot/ros/message.hpp"
#include "lot/ros/publisher.hpp"

/// Images in shared memory for OpenCV. Link cv_bridge and OpenCV.
///
///     void callback(const boost::shared_ptr<Image const>& image) {
///       const cv::Mat seen = lot::ros::view(*image);             // no copy; as long as the image
///       auto shared = cv_bridge::toCvShare(image);               // no copy; keeps the image
///       auto mine = cv_bridge::toCvCopy(image, "mono8");         // one
///       auto out = lot::ros::loan_image(pub, rows, cols, "bgr8");
///       cv::Mat made = lot::ros::view(*out);                      // to be filled where it lies
///       pub.publish(std::move(out));
///       pub.publish(lot::ros::loan_image(pub, picture, "bgr8"));  // a cv::Mat: one copy
///     }
///
/// Errors:  cv_bridge::Exception, where a message's data is too short for the size and the encoding
///          that it states.
namespace lot::ros {
namespace detail {

using Image = Message<sensor_msgs::Image_>;

/// A matrix on an image's pixels.
inline cv::Mat matrix_on(const Image& image) {
  const int type = cv_bridge::getCvType(image.encoding);
  const std::size_t row = std::size_t{image.width} * CV_ELEM_SIZE(type);
  const std::size_t bytes = std::size_t{image.step} * image.height;
  if (image.step < row || image.data.size() < bytes) {
    throw cv_bridge::Exception("an image of " + std::to_string(image.width) + " x " +
                               std::to_string(image.height) + " " + image.encoding +
                               " with steps of " + std::to_string(image.step) + " bytes has only " +
                               std::to_string(image.data.size()) + " bytes");
  }
  return {static_cast<int>(image.height), static_cast<int>(image.width), type,
          const_cast<std::uint8_t*>(image.data.data()), image.step};
}

/// Pixels of several bytes that another kind of machine has written.
inline bool has_foreign_bytes(const Image& image) {
  const bool is_big = boost::endian::order::native == boost::endian::order::big;
  return (image.is_bigendian != 0) != is_big &&
         sensor_msgs::image_encodings::bitDepth(image.encoding) > 8;
}

/// An image of cv_bridge's whose pixels lie in a message, which it keeps.
struct SharedImage : cv_bridge::CvImage {
  boost::shared_ptr<void const> message;
};

inline cv_bridge::CvImageConstPtr share(const Image& image,
                                        const boost::shared_ptr<void const>& keeper) {
  auto shared = boost::make_shared<SharedImage>();
  shared->header = image.header;
  shared->encoding = image.encoding;
  shared->image = matrix_on(image);
  shared->message = keeper;
  return shared;
}

}  // namespace detail

/// The pixels, where they lie. REQUIRES: the message is there as long as the matrix. Of a message
/// that was received they are not to be written. Throws cv_bridge::Exception where the message has
/// too few bytes, or an encoding that OpenCV has no type for.
[[nodiscard]] inline cv::Mat view(detail::Image& image) { return detail::matrix_on(image); }
/// The pixels of a message that cannot be changed: do not write them. Throws the same.
[[nodiscard]] inline const cv::Mat view(const detail::Image& image) {
  return detail::matrix_on(image);
}

/// Makes `image` one of that size, whose pixels are still to be filled. The header stays. Throws
/// cv_bridge::Exception for an encoding that OpenCV has no type for; lot::OutOfMemory.
inline void shape(detail::Image& image, int rows, int cols, const std::string& encoding) {
  const std::size_t row =
      static_cast<std::size_t>(cols) * CV_ELEM_SIZE(cv_bridge::getCvType(encoding));
  image.height = static_cast<std::uint32_t>(rows);
  image.width = static_cast<std::uint32_t>(cols);
  image.encoding = encoding;
  image.is_bigendian = boost::endian::order::native == boost::endian::order::big;
  image.step = static_cast<std::uint32_t>(row);
  image.data.resize(row * static_cast<std::size_t>(rows));
}

/// Copies a matrix into a message, once; CvImage::toImageMsg()'s counterpart. The header stays.
/// Throws cv_bridge::Exception where the matrix has not the type of the encoding; lot::OutOfMemory.
inline void to_image(const cv::Mat& pixels, const std::string& encoding, detail::Image& image) {
  if (pixels.type() != cv_bridge::getCvType(encoding)) {
    throw cv_bridge::Exception("a matrix of type " + cv::typeToString(pixels.type()) +
                               " is no image of encoding " + encoding);
  }
  shape(image, pixels.rows, pixels.cols, encoding);
  cv::Mat there = view(image);
  pixels.copyTo(there);
}
/// The same of an image of cv_bridge's, with its header. Throws the same.
inline void to_image(const cv_bridge::CvImage& from, detail::Image& image) {
  to_image(from.image, from.encoding, image);
  image.header = from.header;
}

/// A loan of that size, whose pixels are still to be filled: view(*loan). Throws as shape() and
/// Publisher::loan(): lot::OutOfMemory where the segment has no room for the pixels.
[[nodiscard]] inline Loan<detail::Image> loan_image(const Publisher<detail::Image>& publisher,
                                                    int rows, int cols,
                                                    const std::string& encoding) {
  auto image = publisher.loan();
  if (image) shape(*image, rows, cols, encoding);
  return image;
}
/// A loan with these pixels. Throws as to_image() and Publisher::loan().
[[nodiscard]] inline Loan<detail::Image> loan_image(const Publisher<detail::Image>& publisher,
                                                    const cv::Mat& pixels,
                                                    const std::string& encoding) {
  auto image = publisher.loan();
  if (image) to_image(pixels, encoding, *image);
  return image;
}

}  // namespace lot::ros

namespace cv_bridge {

/// As for the standard image: no copy unless the encoding is another one. The pixels are not to be
/// written. Throws cv_bridge::Exception, cv::Exception and std::bad_alloc.
[[nodiscard]] inline CvImageConstPtr toCvShare(const lot::ros::Message<sensor_msgs::Image_>& source,
                                               const boost::shared_ptr<void const>& tracked_object,
                                               const std::string& encoding = std::string()) {
  if (lot::ros::detail::has_foreign_bytes(source)) {
    sensor_msgs::Image standard;
    lot::ros::assign(standard, source);
    return toCvCopy(standard, encoding);
  }
  const CvImageConstPtr shared = lot::ros::detail::share(source, tracked_object);
  return encoding.empty() || source.encoding == encoding ? shared : cvtColor(shared, encoding);
}
/// The same of a pointer, which is kept. REQUIRES: it is not null. Throws the same.
[[nodiscard]] inline CvImageConstPtr toCvShare(
    const boost::shared_ptr<lot::ros::Message<sensor_msgs::Image_> const>& source,
    const std::string& encoding = std::string()) {
  return toCvShare(*source, source, encoding);
}

/// As for the standard image: one copy. Throws cv_bridge::Exception, cv::Exception and
/// std::bad_alloc.
[[nodiscard]] inline CvImagePtr toCvCopy(const lot::ros::Message<sensor_msgs::Image_>& source,
                                         const std::string& encoding = std::string()) {
  const CvImageConstPtr shared = toCvShare(source, nullptr, encoding);
  const bool is_copy = shared->image.data != source.data.data();
  return boost::make_shared<CvImage>(shared->header, shared->encoding,
                                     is_copy ? shared->image : shared->image.clone());
}
/// The same of a pointer. REQUIRES: it is not null. Throws the same.
[[nodiscard]] inline CvImagePtr toCvCopy(
    const boost::shared_ptr<lot::ros::Message<sensor_msgs::Image_> const>& source,
    const std::string& encoding = std::string()) {
  return toCvCopy(*source, encoding);
}

}  // namespace cv_bridge
