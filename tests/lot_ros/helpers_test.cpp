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

TEST_CASE("fields of a cloud that are set anew replace the former ones, for all its points") {
  using F = sensor_msgs::PointField;
  Made<Cloud> cloud;
  lot::ros::PointCloud2Modifier modifier(*cloud);
  modifier.setPointCloud2Fields(1, "intensity", 1, F::FLOAT64);
  cloud->width = 3;
  cloud->height = 2;
  modifier.setPointCloud2Fields(2, "range", 1, F::FLOAT32, "ring", 1, F::INT16);
  CHECK(cloud->fields.size() == 2);
  CHECK(cloud->row_step == 3 * 6);
  CHECK(cloud->data.size() == 2 * 3 * 6);
  modifier.setPointCloud2FieldsByString(1, "xyz");
  CHECK(cloud->fields.size() == 3);
  CHECK(cloud->row_step == 3 * 16);
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

TEST_CASE("a cloud of a column stays one, any other one becomes a row") {
  Made<Cloud> cloud;
  lot::ros::PointCloud2Modifier modifier(*cloud);
  CHECK(modifier.size() == 0);  // no fields yet
  modifier.setPointCloud2FieldsByString(1, "xyz");
  const auto shape = [&] {
    return std::vector<std::uint32_t>{cloud->width, cloud->height, cloud->row_step};
  };
  using Shape = std::vector<std::uint32_t>;
  modifier.reserve(9);
  CHECK(cloud->data.capacity() >= 9 * 16);
  modifier.resize(9);
  CHECK(shape() == Shape{9, 1, 144});
  CHECK(modifier.size() == 9);
  cloud->width = 1, cloud->height = 9, cloud->row_step = 16;
  modifier.resize(4);
  CHECK(shape() == Shape{1, 4, 16});
  CHECK(cloud->data.size() == 64);
  modifier.clear();
  CHECK(shape() == Shape{1, 0, 16});
  cloud->width = 3, cloud->height = 2, cloud->row_step = 48;
  modifier.resize(6);
  CHECK(shape() == Shape{6, 1, 96});
  modifier.clear();
  CHECK(shape() == Shape{0, 1, 0});
  cloud->width = 1;
  modifier.resize(2);  // one point in one row
  CHECK(shape() == Shape{2, 1, 32});
}

TEST_CASE("fields of a cloud: each size, colours in both byte orders, and what there is not") {
  using F = sensor_msgs::PointField;
  Made<Cloud> cloud;
  lot::ros::PointCloud2Modifier modifier(*cloud);
  modifier.setPointCloud2Fields(9, "a", 1, F::INT8, "b", 1, F::UINT8, "c", 1, F::INT16, "d", 1,
                                F::UINT16, "e", 1, F::INT32, "f", 1, F::UINT32, "g", 1, F::FLOAT32,
                                "h", 1, F::FLOAT64, "i", 2, F::UINT16);
  std::vector<std::uint32_t> offsets;
  for (const auto& field : cloud->fields) offsets.push_back(field.offset);
  CHECK(offsets == std::vector<std::uint32_t>{0, 1, 2, 4, 6, 10, 14, 18, 26});
  CHECK(cloud->point_step == 30);
  CHECK_THROWS_AS(modifier.setPointCloud2Fields(1, "x", 1, 0), std::runtime_error);
  CHECK_THROWS_AS(modifier.setPointCloud2Fields(1, "x", 1, 9), std::runtime_error);
  CHECK_THROWS_AS(modifier.setPointCloud2FieldsByString(1, "hsv"), std::runtime_error);

  modifier.setPointCloud2FieldsByString(1, "rgba");
  modifier.resize(2);
  fill(*cloud, 2);
  const auto byte = [&](const char* name) {
    return *(lot::ros::PointCloud2Iterator<std::uint8_t>(*cloud, name) + 1) - cloud->data[16];
  };
  for (const bool is_bigendian : {false, true}) {
    cloud->is_bigendian = is_bigendian;
    CHECK(byte("b") == (is_bigendian ? 39 : 0));  // bytes differ by 13 each
    CHECK(byte("g") == (is_bigendian ? 26 : 13));
    CHECK(byte("r") == (is_bigendian ? 13 : 26));
    CHECK(byte("a") == (is_bigendian ? 0 : 39));
  }
  CHECK_THROWS_AS(lot::ros::PointCloud2Iterator<std::uint8_t>(*cloud, "gb"), std::runtime_error);
  CHECK_THROWS_AS(lot::ros::PointCloud2Iterator<std::uint16_t>(*cloud, "r"), std::runtime_error);
  CHECK_THROWS_AS(lot::ros::PointCloud2Iterator<double>(*cloud, "rgba"), std::runtime_error);
  cloud->fields[0].count = 0;  // as old drivers say it
  lot::ros::PointCloud2Iterator<float> all(*cloud, "rgba");
  const auto first = all;
  CHECK(all == first);
  CHECK(!(all != first));
  CHECK(!(all < first));
  CHECK(first < ++all);
  CHECK(all != first);
  CHECK(++all == first.end());
  CHECK(first + 2 == first.end());
  cloud->point_step = 3;  // the field does not fit into a point
  CHECK_THROWS_AS(lot::ros::PointCloud2Iterator<float>(*cloud, "rgba"), std::runtime_error);
}

TEST_CASE("PCL's cloud without a size is one row; one of another size than it says is refused") {
  pcl::PointCloud<pcl::PointXYZ> points;
  points.points.resize(6);
  Made<Cloud> cloud;
  const auto shape = [&](std::uint32_t width, std::uint32_t height) {
    points.width = width, points.height = height;
    pcl::toROSMsg(points, *cloud);
    return std::vector<std::uint32_t>{cloud->width, cloud->height, cloud->row_step,
                                      static_cast<std::uint32_t>(cloud->data.size())};
  };
  using Shape = std::vector<std::uint32_t>;
  CHECK(shape(0, 0) == Shape{6, 1, 96, 96});
  CHECK(shape(6, 1) == Shape{6, 1, 96, 96});
  CHECK(shape(1, 6) == Shape{1, 6, 16, 96});
  CHECK(shape(2, 3) == Shape{2, 3, 32, 96});
  CHECK_THROWS_AS(shape(0, 6), std::runtime_error);
  CHECK_THROWS_AS(shape(6, 0), std::runtime_error);
  CHECK_THROWS_AS(shape(5, 1), std::runtime_error);
  CHECK_THROWS_AS(shape(7, 1), std::runtime_error);
  CHECK_THROWS_AS(lot::ros::shape<pcl::PointXYZ>(*cloud, 1U << 28), std::runtime_error);
  points.points.clear();
  CHECK(shape(0, 0) == Shape{0, 1, 0, 0});
}

TEST_CASE("points where they lie: as they are laid out, or a word why not") {
  pcl::PointCloud<pcl::PointXYZ> points(5, 2);
  for (std::size_t i = 0; i < 10; ++i) points[i].x = static_cast<float>(i);
  Made<Cloud> made;
  made->data.reserve(1 << 17);  // pieces that large are aligned
  pcl::toROSMsg(points, *made);
  const auto why = [](auto& cloud) -> std::string {
    try {
      (void)lot::ros::points<pcl::PointXYZ>(cloud);
      return "";
    } catch (const std::runtime_error& e) {
      return e.what();
    }
  };
  const auto says = [](const std::string& text, const char* what) {
    return text.find(what) != std::string::npos;
  };
  const Cloud& read = *made;
  REQUIRE(why(read) == "");
  CHECK(why(*made) == "");
  const auto there = lot::ros::points<pcl::PointXYZ>(read);
  CHECK(there.size() == 10);
  CHECK(!there.empty());
  CHECK(there.end() - there.begin() == 10);
  CHECK(there[9].x == 9);
  CHECK(lot::ros::points<pcl::PointXYZ>(*made).begin()->x == 0);

  const Cloud good = *made;
  const auto with = [&](auto&& change) {
    Cloud cloud = good;
    change(cloud);
    return why(cloud);
  };
  CHECK(says(with([](Cloud& c) { c.fields[1].name = "w"; }), "has no field y of that type"));
  CHECK(says(with([](Cloud& c) { c.fields[1].datatype = 8; }), "has no field y of that type"));
  CHECK(says(with([](Cloud& c) { c.fields[1].offset = 12; }), "laid out otherwise"));
  CHECK(says(with([](Cloud& c) { c.row_step = 81; }), "has only 160 bytes"));
  CHECK(says(with([](Cloud& c) { c.data.pop_back(); }), "5 x 2 points has only 159 bytes"));
  CHECK(says(with([](Cloud& c) { c.row_step = 79; }), "has only"));
  CHECK(says(with([](Cloud& c) { c.height = 1, c.row_step = 79; }), "has only"));
  CHECK(with([](Cloud& c) { c.height = 1, c.row_step = 1000; }) == "");
  CHECK(with([](Cloud& c) { c.height = 0; }) == "");
  CHECK(says(with([](Cloud& c) { c.row_step = 96, c.data.resize(200); }), "bytes apart"));
  CHECK(says(with([](Cloud& c) { c.point_step = 20, c.row_step = 100, c.data.resize(200); }),
             "20 bytes apart, and not 16"));
  Made<Cloud> coloured;
  coloured->data.reserve(1 << 17);
  pcl::toROSMsg(pcl::PointCloud<pcl::PointXYZRGB>(5, 2), *coloured);
  REQUIRE(coloured->fields.back().name == std::string("rgb"));
  CHECK(lot::ros::points<pcl::PointXYZRGB>(*coloured).size() == 10);
  CHECK(lot::ros::points<pcl::PointXYZRGBA>(*coloured).size() == 10);  // the same four bytes

  Cloud none;
  none.fields = good.fields;
  none.point_step = 16;
  CHECK(lot::ros::points<pcl::PointXYZ>(none).empty());

  pcl::PointCloud<pcl::PointXYZ> back;
  Cloud beyond = good;
  beyond.fields[2].offset = 13;
  CHECK_THROWS_AS(pcl::fromROSMsg(beyond, back), std::runtime_error);
  Cloud dense = good;
  dense.is_dense = 0;
  dense.header.seq = 77;
  pcl::fromROSMsg(dense, back);
  CHECK(!back.is_dense);
  CHECK(back.header.seq == 77);
  CHECK(back.width == 5);
  CHECK(back.height == 2);
  Made<Cloud> again;
  pcl::toROSMsg(back, *again);
  CHECK(again->header.seq == 77);
  CHECK(!again->is_dense);
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
