// SPDX-License-Identifier: Apache-2.0

// Generated messages in shared memory: the same fields, bytes, md5 and print as the standard ones.

#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <cstdint>
#include <random>
#include <sstream>
#include <string>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>
#include <lot_test_msgs/Tracks.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/JointState.h>
#include <sensor_msgs/LaserScan.h>
#include <sensor_msgs/MultiEchoLaserScan.h>
#include <sensor_msgs/PointCloud.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_msgs/Bool.h>
#include <std_msgs/Empty.h>
#include <std_msgs/Float64MultiArray.h>
#include <std_msgs/Header.h>
#include <std_msgs/Int64.h>
#include <std_msgs/String.h>
#include <std_msgs/Time.h>
#include <std_msgs/UInt8MultiArray.h>
#include <tf2_msgs/TFMessage.h>

#include "lot/engine.hpp"
#include "lot/ros/message.hpp"

namespace {

namespace serialization = ros::serialization;
namespace traits = ros::message_traits;

/// A stream for ROS's serialisers that reads anything: it fills each field with random values.
class Anything {
 public:
  explicit Anything(std::uint64_t seed) : random_(seed) {}

  template <class T>
  void next(T& field) {
    if constexpr (std::is_arithmetic_v<T>) {
      field = static_cast<T>(static_cast<std::int8_t>(random_()));
    } else {
      fill(field);
    }
  }

 private:
  void fill(ros::Time& t) { t.fromNSec(random_() % (std::uint64_t{1} << 60)); }
  void fill(ros::Duration& d) {
    d.fromNSec(static_cast<std::int64_t>(random_() % 1'000'000'000'000));
  }
  void fill(std::string& s) {
    s.resize(random_() % 40);
    for (char& c : s) c = static_cast<char>('a' + random_() % 26);
  }
  template <class T>
  void fill(std::vector<T>& v) {
    v.resize(random_() % 9);
    for (T& x : v) next(x);
  }
  template <class T, std::size_t N>
  void fill(boost::array<T, N>& a) {
    for (T& x : a) next(x);
  }
  template <class M>
  std::enable_if_t<traits::IsMessage<M>::value> fill(M& message) {
    serialization::Serializer<M>::read(*this, message);
  }

  std::mt19937_64 random_;
};

template <class M>
std::vector<std::uint8_t> bytes_of(const M& message) {
  const ros::SerializedMessage s = serialization::serializeMessage(message);
  return {s.buf.get(), s.buf.get() + s.num_bytes};
}

template <class M>
std::string print_of(const M& message) {
  std::ostringstream out;
  out << message;
  return out.str();
}

lot::ShmEngine& engine() {
  static lot::ShmEngine engine([] {
    lot::EngineOptions options;
    options.segment =
        "lot_ros_messages_" + std::to_string(getpid());  // LOT_SEGMENT comes before it
    options.size_bytes = 64 << 20;
    return options;
  }());
  return engine;
}

/// A message of this type, filled with anything, is the same in shared memory.
template <template <class> class Generated>
void check() {
  using Plain = Generated<std::allocator<void>>;
  using Shared = lot::ros::Message<Generated>;
  static_assert(std::is_same_v<lot::ros::Standard<Shared>, Plain>);
  static_assert(traits::HasHeader<Shared>::value == traits::HasHeader<Plain>::value);
  static_assert(traits::IsFixedSize<Shared>::value == traits::IsFixedSize<Plain>::value);
  CAPTURE(traits::DataType<Plain>::value());
  CHECK(std::string(traits::MD5Sum<Shared>::value()) == traits::MD5Sum<Plain>::value());
  CHECK(std::string(traits::DataType<Shared>::value()) == traits::DataType<Plain>::value());
  CHECK(std::string(traits::Definition<Shared>::value()) == traits::Definition<Plain>::value());
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    CAPTURE(seed);
    Plain plain;
    Anything anything(seed);
    serialization::Serializer<Plain>::read(anything, plain);
    const auto bytes = bytes_of(plain);

    auto shared = engine().make<Shared>();
    lot::ros::assign(*shared, plain);
    CHECK(bytes_of(*shared) == bytes);
    CHECK(print_of(*shared) == print_of(plain));
    if constexpr (traits::HasHeader<Plain>::value) {
      CHECK(traits::FrameId<Shared>::value(*shared) == traits::FrameId<Plain>::value(plain));
      CHECK(traits::FrameId<Shared>::pointer(*shared) == &shared->header.frame_id);
      CHECK(traits::Header<Shared>::pointer(std::as_const(*shared)) == &shared->header);
      CHECK(traits::TimeStamp<Shared>::value(*shared) == traits::TimeStamp<Plain>::value(plain));
    } else {
      CHECK(traits::FrameId<Shared>::pointer(*shared) == nullptr);
    }

    Plain back;
    lot::ros::assign(back, *shared);
    CHECK(bytes_of(back) == bytes);

    auto read = engine().make<Shared>();
    auto copy = bytes;
    serialization::IStream stream(copy.data() + 4, static_cast<std::uint32_t>(copy.size() - 4));
    serialization::deserialize(stream, *read);
    CHECK(bytes_of(*read) == bytes);

    // An ordinary object on the heap, and its copy in shared memory.
    const Shared heap = *shared;
    CHECK(bytes_of(heap) == bytes);
    auto again = engine().make<Shared>();
    *again = heap;
    CHECK(bytes_of(*again) == bytes);
  }
}

}  // namespace

TEST_CASE("each generated message is the same in shared memory") {
  check<std_msgs::Bool_>();
  check<std_msgs::Empty_>();
  check<std_msgs::Float64MultiArray_>();
  check<std_msgs::Header_>();
  check<std_msgs::Int64_>();
  check<std_msgs::String_>();
  check<std_msgs::Time_>();
  check<std_msgs::UInt8MultiArray_>();
  check<geometry_msgs::PoseWithCovarianceStamped_>();
  check<geometry_msgs::TransformStamped_>();
  check<sensor_msgs::CameraInfo_>();
  check<sensor_msgs::CompressedImage_>();
  check<sensor_msgs::Image_>();
  check<sensor_msgs::Imu_>();
  check<sensor_msgs::JointState_>();
  check<sensor_msgs::LaserScan_>();
  check<sensor_msgs::MultiEchoLaserScan_>();
  check<sensor_msgs::PointCloud_>();
  check<sensor_msgs::PointCloud2_>();
  check<tf2_msgs::TFMessage_>();
}

TEST_CASE("so is one that was generated here") { check<lot_test_msgs::Tracks_>(); }

TEST_CASE("who gets one reads it where it was written") {
  using Image = lot::ros::Message<sensor_msgs::Image_>;
  using Tracks = lot::ros::Message<lot_test_msgs::Tracks_>;
  auto images = engine().advertise<Image>("images");
  auto tracks = engine().advertise<Tracks>("tracks");
  auto image_reader = engine().subscribe<Image>("images");
  auto track_reader = engine().subscribe<Tracks>("tracks");
  auto image = images.loan();
  image->encoding = "an encoding that is longer than what a string keeps in itself";
  image->data.resize(1 << 20);
  image->data.back() = 7;
  const auto* const place = image->data.data();
  images.push(std::move(image));
  const auto seen = image_reader.try_pull();
  REQUIRE(seen);
  CHECK(seen->data.data() == place);
  CHECK(seen->data.back() == 7);

  lot_test_msgs::Tracks mine;
  Anything anything(1);
  serialization::Serializer<lot_test_msgs::Tracks>::read(anything, mine);
  auto track = tracks.loan();
  lot::ros::assign(*track, mine);
  tracks.push(std::move(track));
  const auto got = track_reader.try_pull();
  REQUIRE(got);
  CHECK(bytes_of(*got) == bytes_of(mine));
}
