// SPDX-License-Identifier: Apache-2.0

// What people write around messages: OpenCV, PCL, iterators, with messages in shared memory as with
// the standard ones.

#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <unistd.h>
#include <vector>

#include <boost/make_shared.hpp>
#include <doctest/doctest.h>
#include <pcl/point_types.h>
#include <sensor_msgs/fill_image.h>
#include <sensor_msgs/point_cloud2_iterator.h>

#include "lot/engine.hpp"
#include "lot/ros.hpp"
#include "lot/ros/fill_image.hpp"
#include "lot/ros/opencv.hpp"
#include "lot/ros/pcl.hpp"
#include "lot/ros/point_cloud2.hpp"

namespace test {

struct Stereo {
  lot::ros::Message<sensor_msgs::Image_> left, right;
};

}  // namespace test

template <>
struct lot::is_trusted_message<test::Stereo> : std::true_type {};

namespace {

using Image = lot::ros::Message<sensor_msgs::Image_>;
using Cloud = lot::ros::Message<sensor_msgs::PointCloud2_>;

lot::EngineOptions options() {
  lot::EngineOptions options;
  options.segment = "lot_ros_helpers_" + std::to_string(getpid());
  options.size_bytes = 64 << 20;
  return options;
}

/// A message that is being built in shared memory.
template <class M>
struct Made {
  lot::ShmEngine engine{options()};
  lot::ShmPusher<M> pusher = engine.advertise<M>("/made");
  lot::ShmUniquePtr<M> message = pusher.loan();
  M& operator*() { return *message; }
  M* operator->() { return message.get(); }
};

boost::shared_ptr<Image> image_of(const cv::Mat& pixels, const std::string& encoding) {
  auto image = boost::make_shared<Image>();
  lot::ros::to_image(pixels, encoding, *image);
  image->header.frame_id = "camera";
  image->header.seq = 7;
  return image;
}

cv::Mat gradient(int rows, int cols, int type) {
  cv::Mat made(rows, cols, type);
  for (int y = 0; y < rows; ++y) {
    for (std::size_t x = 0; x < static_cast<std::size_t>(cols) * made.elemSize(); ++x) {
      made.ptr(y)[x] = static_cast<std::uint8_t>(static_cast<std::size_t>(y) * 31 + x * 7);
    }
  }
  return made;
}
bool are_equal(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0;
}

template <class Its>
void fill(Its& cloud, std::size_t points) {
  for (std::size_t i = 0; i < cloud.data.size(); ++i) {
    cloud.data[i] = static_cast<std::uint8_t>(i * 13 + points);
  }
}

}  // namespace

TEST_CASE("a matrix on an image has its pixels, without a copy") {
  Made<Image> image;
  lot::ros::shape(*image, 20, 30, "bgr8");
  CHECK(image->step == 90);
  CHECK(image->data.size() == 1800);
  cv::Mat pixels = lot::ros::view(*image);
  CHECK(pixels.data == image->data.data());
  gradient(20, 30, CV_8UC3).copyTo(pixels);
  CHECK(image->data[91] == static_cast<std::uint8_t>(31 + 7));
  CHECK(image->data[29 * 3] == static_cast<std::uint8_t>(29 * 3 * 7));
}

TEST_CASE("toCvShare shares, toCvCopy copies, as for the standard image") {
  const cv::Mat pixels = gradient(16, 24, CV_8UC3);
  boost::shared_ptr<Image const> image = image_of(pixels, "bgr8");
  auto shared = cv_bridge::toCvShare(image);
  CHECK(shared->image.data == image->data.data());
  CHECK(shared->header.frame_id == "camera");
  CHECK(shared->encoding == "bgr8");
  CHECK(cv_bridge::toCvShare(image, "bgr8")->image.data == image->data.data());
  const auto copy = cv_bridge::toCvCopy(image);
  CHECK(copy->image.data != image->data.data());
  CHECK(are_equal(copy->image, pixels));

  auto standard = boost::make_shared<sensor_msgs::Image>();
  lot::ros::assign(*standard, *image);
  for (const char* const encoding : {"rgb8", "mono8", "bgra8"}) {
    const auto want = cv_bridge::toCvCopy(standard, encoding);
    CHECK(are_equal(cv_bridge::toCvCopy(image, encoding)->image, want->image));
    CHECK(are_equal(cv_bridge::toCvShare(image, encoding)->image, want->image));
    CHECK(are_equal(cv_bridge::toCvCopy(*image, encoding)->image, want->image));
  }
  boost::weak_ptr<Image const> there = image;
  image.reset();
  CHECK(!there.expired());  // the shared one keeps it
  CHECK(are_equal(shared->image, pixels));
  shared.reset();
  CHECK(there.expired());
}

TEST_CASE("pixels of 16 bits from a machine of the other byte order are read right") {
  boost::shared_ptr<Image> image = image_of(gradient(4, 4, CV_16UC1), "mono16");
  image->is_bigendian = !image->is_bigendian;
  sensor_msgs::Image standard;
  lot::ros::assign(standard, *image);
  CHECK(are_equal(cv_bridge::toCvShare(boost::shared_ptr<Image const>(image))->image,
                  cv_bridge::toCvCopy(standard)->image));
}

TEST_CASE("an image that cannot be what it says is an error") {
  boost::shared_ptr<Image> image = image_of(gradient(4, 4, CV_8UC3), "bgr8");
  SUBCASE("too few bytes") { image->height = 5; }
  SUBCASE("steps that are too short") { image->step = 11; }
  SUBCASE("an encoding that there is not") { image->encoding = "nonsense"; }
  CHECK_THROWS_AS((void)lot::ros::view(*image), cv_bridge::Exception);
  CHECK_THROWS_AS((void)cv_bridge::toCvCopy(*image), cv_bridge::Exception);
}

TEST_CASE("an image of cv_bridge's, or a part of a matrix, becomes a message") {
  const cv::Mat whole = gradient(40, 40, CV_8UC3);
  const cv::Mat part = whole(cv::Rect(3, 5, 11, 13));
  cv_bridge::CvImage bridge(std_msgs::Header(), "bgr8", part);
  bridge.header.frame_id = "lens";
  Made<Image> image;
  lot::ros::to_image(bridge, *image);
  sensor_msgs::Image standard;
  bridge.toImageMsg(standard);
  CHECK(image->header.frame_id == "lens");
  CHECK(image->data == standard.data);
  CHECK(image->step == standard.step);
  CHECK_THROWS_AS(lot::ros::to_image(part, "mono16", *image), cv_bridge::Exception);
}

TEST_CASE("fillImage fills it") {
  Made<Image> image;
  sensor_msgs::Image standard;
  const std::vector<std::uint8_t> pixels(4 * 10 * 3, 9);
  CHECK(sensor_msgs::fillImage(*image, "rgb8", 4, 10, 30, pixels.data()));
  CHECK(sensor_msgs::fillImage(standard, "rgb8", 4, 10, 30, pixels.data()));
  sensor_msgs::Image same;
  lot::ros::assign(same, *image);
  CHECK(same == standard);
  sensor_msgs::clearImage(*image);
  CHECK(image->data.empty());
}

TEST_CASE("fields of a cloud are laid out as by the standard modifier") {
  Made<Cloud> cloud;
  sensor_msgs::PointCloud2 standard;
  lot::ros::PointCloud2Modifier ours(*cloud);
  sensor_msgs::PointCloud2Modifier theirs(standard);
  const auto set = [](auto& modifier, bool by_string) {
    using F = sensor_msgs::PointField;
    if (by_string) {
      modifier.setPointCloud2FieldsByString(2, "xyz", "rgb");
    } else {
      modifier.setPointCloud2Fields(4, "x", 1, F::FLOAT32, "y", 1, F::FLOAT64, "n", 3, F::INT16,
                                    "t", 1, F::UINT8);
    }
    modifier.resize(100);
  };
  bool by_string = false;
  SUBCASE("by name") { by_string = true; }
  SUBCASE("by value") {}
  set(ours, by_string);
  set(theirs, by_string);
  fill(*cloud, 100);
  fill(standard, 100);
  sensor_msgs::PointCloud2 same;
  lot::ros::assign(same, *cloud);
  CHECK(same == standard);
  CHECK(ours.size() == 100);

  std::size_t points = 0;
  const Cloud& read = *cloud;
  for (lot::ros::PointCloud2ConstIterator<float> x(read, "x"); x != x.end(); ++x) {
    const float value = *x;
    CHECK(std::memcmp(&value, &standard.data[points * standard.point_step], sizeof(float)) == 0);
    ++points;
  }
  CHECK(points == 100);
  if (by_string) {
    lot::ros::PointCloud2Iterator<std::uint8_t> r(*cloud, "r"), g(*cloud, "g"), b(*cloud, "b");
    sensor_msgs::PointCloud2Iterator<std::uint8_t> their_r(standard, "r"), their_g(standard, "g");
    CHECK(*(r + 5) == *(their_r + 5));
    CHECK(*(g += 7) == *(their_g += 7));
    *b = 200;
    CHECK(cloud->data[16] == 200);
    CHECK_THROWS_AS(lot::ros::PointCloud2Iterator<double>(*cloud, "x"), std::runtime_error);
  }
  CHECK_THROWS_AS(lot::ros::PointCloud2Iterator<float>(*cloud, "w"), std::runtime_error);
  ours.clear();
  CHECK(ours.size() == 0);
  CHECK(cloud->width == 0);
  lot::ros::PointCloud2Iterator<float> none(*cloud, "x");
  CHECK(none == none.end());
}

TEST_CASE("clouds go to PCL and back with every point") {
  pcl::PointCloud<pcl::PointXYZRGB> points(70, 100);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto f = static_cast<float>(i);
    points[i].x = f, points[i].y = -f, points[i].z = f / 2;
    points[i].rgba = static_cast<std::uint32_t>(i * 977);
  }
  points.header.frame_id = "lidar";
  points.header.stamp = 1'234'567;
  points.is_dense = false;
  Made<Cloud> cloud;
  sensor_msgs::PointCloud2 standard;
  pcl::toROSMsg(points, *cloud);
  pcl::toROSMsg(points, standard);
  sensor_msgs::PointCloud2 same;
  lot::ros::assign(same, *cloud);
  CHECK(same == standard);

  SUBCASE("of the same type") {
    pcl::PointCloud<pcl::PointXYZRGB> back;
    pcl::fromROSMsg(*cloud, back);
    CHECK(back.size() == points.size());
    CHECK(back.height == 100);
    CHECK(back.header.stamp == 1'234'567);
    CHECK(back.header.frame_id == "lidar");
    CHECK(back[6999].rgba == points[6999].rgba);
    CHECK(back[6999].z == points[6999].z);
  }
  SUBCASE("with fewer fields") {
    pcl::PointCloud<pcl::PointXYZ> ours, theirs;
    pcl::fromROSMsg(*cloud, ours);
    pcl::fromROSMsg(standard, theirs);
    REQUIRE(ours.size() == theirs.size());
    for (std::size_t i = 0; i < ours.size(); ++i)
      CHECK(ours[i].getVector3fMap() == theirs[i].getVector3fMap());
  }
  SUBCASE("with rows that end in a gap") {
    Cloud gaps = *cloud;
    gaps.row_step = cloud->row_step + 40;
    gaps.data.resize(std::size_t{gaps.row_step} * gaps.height);
    for (std::uint32_t y = 0; y < gaps.height; ++y) {
      std::memcpy(gaps.data.data() + std::size_t{y} * gaps.row_step,
                  cloud->data.data() + std::size_t{y} * cloud->row_step, cloud->row_step);
    }
    pcl::PointCloud<pcl::PointXYZRGB> back;
    pcl::fromROSMsg(gaps, back);
    CHECK(back[6999].rgba == points[6999].rgba);
    CHECK_THROWS_AS((void)lot::ros::points<pcl::PointXYZRGB>(gaps), std::runtime_error);
  }
  SUBCASE("where they lie") {
    const Cloud& read = *cloud;
    const auto there = lot::ros::points<pcl::PointXYZRGB>(read);
    CHECK(there.size() == 7000);
    CHECK(static_cast<const void*>(&there[0]) == read.data.data());
    CHECK(there[123].x == 123);
    CHECK_THROWS_AS((void)lot::ros::points<pcl::PointXYZ>(read), std::runtime_error);
    CHECK_THROWS_AS((void)lot::ros::points<pcl::PointXYZI>(read),
                    std::runtime_error);  // no intensity
  }
  SUBCASE("of fewer bytes than it says") {
    cloud->data.resize(100);
    pcl::PointCloud<pcl::PointXYZRGB> back;
    CHECK_THROWS_AS(pcl::fromROSMsg(*cloud, back), std::runtime_error);
  }
}

TEST_CASE("points of three floats, or none, go to PCL's points, which are larger") {
  using F = sensor_msgs::PointField;
  Made<Cloud> cloud;
  lot::ros::PointCloud2Modifier modifier(*cloud);
  modifier.setPointCloud2Fields(3, "x", 1, F::FLOAT32, "y", 1, F::FLOAT32, "z", 1, F::FLOAT32);
  modifier.resize(100);
  REQUIRE(cloud->point_step == 12);
  float next = 0;
  for (lot::ros::PointCloud2Iterator<float> x(*cloud, "x"); x != x.end(); ++x) {
    for (int i = 0; i < 3; ++i) x[static_cast<std::size_t>(i)] = next++;
  }
  pcl::PointCloud<pcl::PointXYZ> points;
  pcl::fromROSMsg(*cloud, points);
  REQUIRE(points.size() == 100);
  CHECK(points[1].x == 3);
  CHECK(points[99].z == 299);
  cloud->width = cloud->height = cloud->row_step = 0;
  cloud->data.clear();
  pcl::fromROSMsg(*cloud, points);
  CHECK(points.empty());
}

TEST_CASE("a cloud of several rows that is cleared has none") {
  Made<Cloud> cloud;
  lot::ros::PointCloud2Modifier modifier(*cloud);
  modifier.setPointCloud2FieldsByString(1, "xyz");
  modifier.resize(100);
  cloud->width = cloud->height = 10;
  cloud->row_step = 10 * cloud->point_step;
  modifier.clear();
  CHECK(cloud->width == 0);
  CHECK(cloud->height == 0);
  CHECK(cloud->row_step == 0);
  CHECK(cloud->data.empty());
}

TEST_CASE("of the standard messages that have gone a converter keeps some, and no more") {
  static int in_use = 0;
  lot::ros::detail::Kind kind = lot::ros::detail::kind_of<Image>();
  kind.standard.make = []() -> void* {
    ++in_use;
    return new sensor_msgs::Image;
  };
  kind.standard.destroy = [](void* image) noexcept {
    --in_use;
    delete static_cast<sensor_msgs::Image*>(image);
  };
  const auto message = boost::make_shared<Image>();
  constexpr int kKept = lot::ros::detail::Converter::kIdle;
  {
    const auto converter = lot::ros::detail::make_converter(kind);
    for (const int count : {kKept + 5, 1, kKept + 1}) {
      std::vector<boost::shared_ptr<void const>> all;
      for (int i = 0; i < count; ++i) all.push_back(converter->make(message));
      all.clear();
      CHECK(in_use == kKept);
    }
  }
  CHECK(in_use == 0);
}

TEST_CASE("a standard message is made once for all that ask, in memory that is used again") {
  lot::ShmEngine engine(options());
  auto out = engine.advertise<Image>("/made");
  const auto received = [&](std::uint8_t value) {
    auto loan = out.loan();
    loan->data.assign(100'000, value);
    return lot::ros::detail::parcel_of(lot::ShmSharedPtr<const Image>(std::move(loan))).message;
  };
  const auto as_image = [](const boost::shared_ptr<void const>& message) {
    return boost::static_pointer_cast<Image const>(message);
  };
  const lot::ros::ToStandard<Image> one, other;
  const auto first = as_image(received(1)), second = as_image(received(2));
  auto a = one(first);
  CHECK(a == other(first));
  CHECK(a == lot::ros::ToStandard<Image>(one)(first));
  CHECK(a->data == first->data);
  const auto b = one(second);
  CHECK(b != a);
  CHECK(b->data.front() == 2);
  const auto* const place = a->data.data();
  a.reset();
  const auto c = one(as_image(received(3)));
  CHECK(c->data.data() == place);  // of the one that has gone
  CHECK(c->data.back() == 3);
  CHECK(one(nullptr) == nullptr);
}

TEST_CASE("standard messages of two parts of one message are two") {
  using test::Stereo;
  lot::ShmEngine engine(options());
  auto out = engine.advertise<Stereo>("/stereo");
  auto loan = out.loan();
  loan->left.data.assign(10, 1);
  loan->right.data.assign(10, 2);
  loan->left.header.frame_id = "left";
  const lot::ShmSharedPtr<const Stereo> stereo(std::move(loan));
  const auto part = [&stereo](const Image& image) {
    return lot::ros::detail::parcel_of(lot::ShmSharedPtr<const Image>(stereo, &image)).message;
  };
  const lot::ros::ToStandard<Image> standard;
  const auto left = standard(boost::static_pointer_cast<Image const>(part(stereo->left)));
  const auto right = standard(boost::static_pointer_cast<Image const>(part(stereo->right)));
  CHECK(left->data.front() == 1);
  CHECK(right->data.front() == 2);
}
