// SPDX-License-Identifier: Apache-2.0

// Generated messages in shared memory: the same fields, bytes, md5 and print as the standard ones.

#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <cstdint>
#include <random>
#include <sstream>
#include <string>
#include <string_view>
#include <unistd.h>
#include <unordered_map>
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
#include <sensor_msgs/image_encodings.h>
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

TEST_CASE("a message that was generated here is the same in shared memory, too") {
  check<lot_test_msgs::Tracks_>();
}

TEST_CASE("a subscriber reads a message where it was written") {
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
  REQUIRE(images.push(std::move(image)) == lot::Status::Ok);
  const auto seen = image_reader.try_pull();
  REQUIRE(seen);
  CHECK(seen->data.data() == place);
  CHECK(seen->data.back() == 7);

  lot_test_msgs::Tracks mine;
  Anything anything(1);
  serialization::Serializer<lot_test_msgs::Tracks>::read(anything, mine);
  auto track = tracks.loan();
  lot::ros::assign(*track, mine);
  REQUIRE(tracks.push(std::move(track)) == lot::Status::Ok);
  const auto got = track_reader.try_pull();
  REQUIRE(got);
  CHECK(bytes_of(*got) == bytes_of(mine));
}

namespace {

std::string taken(const std::string& text) { return text; }

}  // namespace

TEST_CASE("strings, vectors and headers convert to and from the standard ones") {
  using Image = lot::ros::Message<sensor_msgs::Image_>;
  using Cloud = lot::ros::Message<sensor_msgs::PointCloud2_>;
  Image m;
  const Image& seen = m;
  sensor_msgs::Image other;

  m.encoding = std::string("rgb8");
  CHECK(m.encoding == std::string("rgb8"));
  CHECK(std::string("bgr8") != m.encoding);
  CHECK(m.encoding == sensor_msgs::image_encodings::RGB8);
  CHECK(m.encoding == "rgb8");
  CHECK(std::string("bgr8") < m.encoding);
  CHECK(m.encoding <= m.encoding);
  CHECK(sensor_msgs::image_encodings::bitDepth(seen.encoding) == 8);
  std::string s = seen.encoding;
  CHECK(s == "rgb8");
  s = seen.header.frame_id;
  CHECK(s.empty());
  s = "a" + m.encoding + std::string("z");
  s += m.encoding;
  CHECK(s == "argb8zrgb8");
  CHECK(std::string("k") + m.encoding == "krgb8");
  CHECK(taken(m.encoding) == "rgb8");
  CHECK(std::unordered_map<std::string, int>{{"rgb8", 3}}[m.encoding] == 3);
  CHECK(std::string_view(m.encoding) == "rgb8");
  const std::string tail = m.encoding.substr(3);
  CHECK(tail == "8");
  CHECK(m.encoding.substr(0, 3) == std::string("rgb"));
  CHECK(std::hash<lot::ros::String>()(m.encoding) == std::hash<std::string_view>()("rgb8"));

  other.header.frame_id = "lens";
  other.header.seq = 3;
  other.header.stamp = ros::Time(1, 2);
  m.header = other.header;
  CHECK(m.header == other.header);
  const std_msgs::Header copy = m.header;
  CHECK(copy == other.header);
  other.header = Image().header;
  CHECK(other.header.frame_id.empty());

  std::vector<std::uint8_t> bytes{1, 2, 3};
  m.data = bytes;
  CHECK(m.data == bytes);
  bytes = m.data;
  bytes.push_back(4);
  CHECK(bytes != m.data);
  const std::vector<std::uint8_t> made = seen.data;
  CHECK(made.size() == 3);

  Cloud cloud;
  sensor_msgs::PointField field;
  field.name = "x";
  cloud.fields.push_back(field);
  cloud.fields.push_back(cloud.fields.front());
  const std::vector<sensor_msgs::PointField> fields = cloud.fields;
  CHECK(fields.size() == 2);
  CHECK(fields[1].name == "x");
  cloud.fields = std::vector<sensor_msgs::PointField>(5, field);
  CHECK(cloud.fields[4].name == field.name);
}

TEST_CASE("strings and vectors compare with the standard ones as these do with each other") {
  const std::vector<std::string> texts{"", "a", "ab", "b"};
  for (const std::string& a : texts) {
    for (const std::string& b : texts) {
      CAPTURE(a);
      CAPTURE(b);
      const lot::ros::String x = a;
      const lot::ros::String y = b;
      const auto orders = [](const auto& one, const auto& other) {
        return std::vector<bool>{one == other, one != other, one<other, one> other, one <= other,
                                 one >= other};
      };
      CHECK(orders(x, b) == orders(a, b));
      CHECK(orders(a, y) == orders(a, b));
      CHECK(orders(x, y) == orders(a, b));
      CHECK(x + b == a + b);
      CHECK(a + y == a + b);
      const std::vector<char> p(a.begin(), a.end());
      const std::vector<char> q(b.begin(), b.end());
      const lot::ros::Vector<char> in_message = p;
      CHECK((in_message == q) == (p == q));
      CHECK((in_message != q) == (p != q));
      CHECK((q == in_message) == (p == q));
      CHECK((q != in_message) == (p != q));
    }
  }
}

TEST_CASE("what is assigned to a field in shared memory lies there") {
  auto pusher = engine().advertise<lot::ros::Message<sensor_msgs::PointCloud2_>>("/fields");
  auto cloud = pusher.loan();
  const auto* const begin = reinterpret_cast<const char*>(cloud.get());
  const auto is_there = [begin](const void* place) {
    const auto distance = static_cast<const char*>(place) - begin;
    return distance > -(64 << 20) && distance < (64 << 20);
  };
  std_msgs::Header header;
  header.frame_id = std::string(100, 'f');
  cloud->header = header;
  cloud->data = std::vector<std::uint8_t>(1000, 1);
  sensor_msgs::PointField field;
  field.name = std::string(50, 'n');
  cloud->fields.push_back(field);
  cloud->fields = std::vector<sensor_msgs::PointField>(3, field);
  CHECK(is_there(cloud->header.frame_id.data()));
  CHECK(is_there(cloud->data.data()));
  CHECK(is_there(cloud->fields.data()));
  for (const auto& each : cloud->fields) CHECK(is_there(each.name.data()));
  CHECK(!is_there(field.name.data()));
}

TEST_CASE("what is moved out of a message lies outside of it") {
  using Image = lot::ros::Message<sensor_msgs::Image_>;
  auto pusher = engine().advertise<Image>("/moved");
  auto loan = pusher.loan();
  loan->data.assign(5000, 7);
  loan->encoding = std::string(100, 'e');
  const auto* const inside = loan->data.data();
  std::vector<Image> all;
  all.push_back(std::move(*loan));
  loan.reset();
  CHECK(all[0].data.data() != inside);
  CHECK(all[0].data == std::vector<std::uint8_t>(5000, 7));
  CHECK(all[0].encoding == std::string(100, 'e'));
  const auto* const outside = all[0].data.data();
  const Image last = std::move(all[0]);
  CHECK(last.data.data() == outside);  // no copy between what lies on the heap
}
