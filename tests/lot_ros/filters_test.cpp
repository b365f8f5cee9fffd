// SPDX-License-Identifier: Apache-2.0

// message_filters, tf2_ros and cameras with messages in shared memory, with a real master: run by
// ros_test.py.

#define DOCTEST_CONFIG_IMPLEMENT
#include <cmath>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <boost/bind/bind.hpp>
#include <boost/make_shared.hpp>
#include <doctest/doctest.h>
#include <message_filters/cache.h>
#include <message_filters/chain.h>
#include <message_filters/sync_policies/approximate_time.h>
#include <message_filters/synchronizer.h>
#include <message_filters/time_synchronizer.h>
#include <sensor_msgs/PointCloud2.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/message_filter.h>

#include "lot/ros/camera.hpp"
#include "lot/ros/message_filters.hpp"

#include "handles.hpp"

namespace {

using lot::ros::test::comes;
using lot::ros::test::fresh_topic;
using Image = lot::ros::Message<sensor_msgs::Image_>;
using Cloud = lot::ros::Message<sensor_msgs::PointCloud2_>;
template <class M>
using Source = lot::ros::message_filters::Subscriber<M>;

constexpr int kCount = 20;

template <class M>
void say(const lot::ros::Publisher<M>& publisher, double stamp, const char* frame = "camera") {
  auto message = publisher.loan();
  message->header.stamp = ros::Time(stamp);
  message->header.frame_id = frame;
  message->data.resize(10'000);
  publisher.publish(std::move(message));
}

/// Two publishers, and what feeds filters from them.
struct Pair {
  lot::ros::NodeHandle node;
  std::string left_topic = fresh_topic(), right_topic = fresh_topic();
  lot::ros::Publisher<Image> left_out = node.advertise<Image>(left_topic, 2 * kCount);
  lot::ros::Publisher<Cloud> right_out = node.advertise<Cloud>(right_topic, 2 * kCount);
  Source<Image> left{node, left_topic, 2 * kCount};
  Source<Cloud> right{node, right_topic, 2 * kCount};

  void wait_for_links() {
    REQUIRE(comes([this] {
      return left_out.getNumSubscribers() == 1 && right_out.getNumSubscribers() == 1;
    }));
  }
  std::uint64_t serialised() const { return left_out.serialised() + right_out.serialised(); }
};

}  // namespace

TEST_CASE("TimeSynchronizer: two topics of the same stamp, where they lie") {
  Pair pair;
  message_filters::TimeSynchronizer<Image, Cloud> both(pair.left, pair.right, 2 * kCount);
  int together = 0;
  std::set<const void*> places;
  both.registerCallback(boost::bind<void>(
      [&](const boost::shared_ptr<Image const>& image,
          const boost::shared_ptr<Cloud const>& cloud) {
        CHECK(image->header.stamp == cloud->header.stamp);
        places.insert(&image->data[0]);
        ++together;
      },
      boost::placeholders::_1, boost::placeholders::_2));
  pair.wait_for_links();
  std::set<const void*> written;
  for (int n = 1; n <= kCount; ++n) {
    auto image = pair.left_out.loan();
    image->header.stamp = ros::Time(n);
    image->data.resize(10'000);
    written.insert(&image->data[0]);
    pair.left_out.publish(std::move(image));
    if (n % 2 == 0) say(pair.right_out, n);
  }
  CHECK(comes([&] { return together == kCount / 2; }));
  CHECK(pair.serialised() == 0);
  for (const void* const place : places) CHECK(written.count(place) == 1);
}

TEST_CASE("ApproximateTime: the nearest of each") {
  Pair pair;
  using Policy = message_filters::sync_policies::ApproximateTime<Image, Cloud>;
  message_filters::Synchronizer<Policy> both(Policy(2 * kCount), pair.left, pair.right);
  int together = 0;
  both.registerCallback(boost::bind<void>(
      [&](const boost::shared_ptr<Image const>& image,
          const boost::shared_ptr<Cloud const>& cloud) {
        CHECK(std::abs((image->header.stamp - cloud->header.stamp).toSec()) < 0.02);
        ++together;
      },
      boost::placeholders::_1, boost::placeholders::_2));
  pair.wait_for_links();
  for (int n = 1; n <= kCount; ++n) {
    say(pair.left_out, n);
    say(pair.right_out, n + 0.01);
  }
  CHECK(comes([&] { return together >= kCount - 2; }));
  CHECK(pair.serialised() == 0);
}

TEST_CASE("the infos of an image's topic stand beside it") {
  CHECK(lot::ros::camera_info_topic("camera/image_raw") == "camera/camera_info");
  CHECK(lot::ros::camera_info_topic("/camera/image_raw/") == "/camera/camera_info");
  CHECK(lot::ros::camera_info_topic("camera/image_raw/lot") == "camera/camera_info");
  CHECK(lot::ros::camera_info_topic("image") == "camera_info");
  CHECK(lot::ros::camera_info_topic("lot") == "camera_info");
}

TEST_CASE("Cache and Chain") {
  Pair pair;
  message_filters::Cache<Image> cache(pair.left, kCount);
  message_filters::Chain<Cloud> chain;
  chain.addFilter(boost::make_shared<Source<Cloud>>(pair.node, pair.right_topic, 2 * kCount));
  int clouds = 0;
  chain.registerCallback(boost::function<void(const boost::shared_ptr<Cloud const>&)>(
      [&](const boost::shared_ptr<Cloud const>&) { ++clouds; }));
  pair.wait_for_links();
  for (int n = 1; n <= kCount; ++n) {
    say(pair.left_out, n);
    say(pair.right_out, n);
  }
  CHECK(comes([&] { return cache.getLatestTime() == ros::Time(kCount) && clouds == kCount; }));
  const auto some = cache.getInterval(ros::Time(5), ros::Time(9));
  REQUIRE(some.size() == 5);
  CHECK(some.front()->header.stamp == ros::Time(5));
  CHECK(pair.serialised() == 0);
}

TEST_CASE("tf2_ros::MessageFilter: until the frame is known") {
  Pair pair;
  tf2_ros::Buffer buffer;
  tf2_ros::MessageFilter<Image> filter(pair.left, buffer, "map", 2 * kCount, pair.node);
  int seen = 0;
  filter.registerCallback(boost::function<void(const boost::shared_ptr<Image const>&)>(
      [&](const boost::shared_ptr<Image const>& image) {
        CHECK(ros::message_traits::FrameId<Image>::value(*image) == "camera");
        ++seen;
      }));
  pair.wait_for_links();
  for (int n = 1; n <= kCount; ++n) say(pair.left_out, n);
  int rounds = 0;
  comes([&] { return ++rounds > 20; });
  CHECK(seen == 0);
  geometry_msgs::TransformStamped known;
  known.header.frame_id = "map";
  known.child_frame_id = "camera";
  known.transform.rotation.w = 1;
  buffer.setTransform(known, "test", true);
  CHECK(comes([&] { return seen == kCount; }));
  CHECK(pair.serialised() == 0);
}

TEST_CASE("a source leaves its topic, and comes back") {
  Pair pair;
  int seen = 0;
  pair.left.registerCallback(boost::function<void(const boost::shared_ptr<Image const>&)>(
      [&](const boost::shared_ptr<Image const>&) { ++seen; }));
  pair.wait_for_links();
  say(pair.left_out, 1);
  CHECK(comes([&] { return seen == 1; }));
  pair.left.unsubscribe();
  CHECK(comes([&] { return pair.left_out.getNumSubscribers() == 0; }));
  say(pair.left_out, 2);
  pair.left.subscribe();
  CHECK(pair.left.getTopic() == pair.left_topic);
  CHECK(comes([&] { return pair.left_out.getNumSubscribers() == 1; }));
  say(pair.left_out, 3);
  CHECK(comes([&] { return seen == 2; }));
  pair.left.subscribe(pair.node, "", 1);
  CHECK(pair.left.getTopic().empty());
  Source<Image> none;
  none.subscribe();
  CHECK_FALSE(none.getSubscriber());
}

TEST_CASE("a camera: image and info together") {
  lot::ros::NodeHandle node;
  const std::string topic = fresh_topic() + "/image_raw";
  lot::ros::CameraPublisher out(node, topic, 2 * kCount);
  int together = 0;
  lot::ros::CameraSubscriber in(
      node, topic, 2 * kCount,
      [&](const boost::shared_ptr<Image const>& image,
          const boost::shared_ptr<lot::ros::CameraSubscriber::CameraInfo const>& info) {
        CHECK(image->header.stamp == info->header.stamp);
        CHECK(info->header.frame_id == "lens");
        CHECK(info->D.size() == 5);
        ++together;
      });
  CHECK(out.getInfoTopic() == topic.substr(0, topic.rfind('/')) + "/camera_info");
  CHECK(in.getInfoTopic() == out.getInfoTopic());
  REQUIRE(comes([&] { return in.getNumPublishers() == 1 && out.getNumSubscribers() == 1; }));
  sensor_msgs::CameraInfo info;
  info.D.resize(5);
  for (int n = 1; n <= kCount; ++n) {
    auto image = out.loan();
    image->header.frame_id = "lens";
    image->data.resize(10'000);
    out.publish(std::move(image), info, ros::Time(n));
  }
  CHECK(comes([&] { return together == kCount; }));
  const auto image = boost::make_shared<sensor_msgs::Image>();
  image->header.stamp = ros::Time(kCount + 1);
  image->header.frame_id = "lens";
  out.publish(image, boost::make_shared<sensor_msgs::CameraInfo>(info));
  CHECK(comes([&] { return together == kCount + 1; }));
  CHECK(out.serialised() == 0);
  in.shutdown();
  CHECK(comes([&] { return out.getNumSubscribers() == 0; }));
  out.shutdown();
  CHECK_FALSE(out);
}

TEST_CASE("a camera that is ended in its callback, and an info that is late") {
  lot::ros::NodeHandle node;
  const std::string topic = fresh_topic() + "/image_raw";
  lot::ros::CameraPublisher out(node, topic, 2 * kCount);
  const auto infos = node.advertise<lot::ros::CameraPublisher::CameraInfo>(
      lot::ros::camera_info_topic(topic), 2 * kCount);
  lot::ros::CameraSubscriber in;
  std::vector<double> seen;
  in = {node, topic, 2 * kCount,
        [&](const boost::shared_ptr<Image const>& image,
            const boost::shared_ptr<lot::ros::CameraSubscriber::CameraInfo const>&) {
          seen.push_back(image->header.stamp.toSec());
          if (seen.size() == 2) in.shutdown();
        }};
  const auto images = node.advertise<Image>(topic, 2 * kCount);
  REQUIRE(comes([&] { return images.getNumSubscribers() == 1 && infos.getNumSubscribers() == 1; }));
  for (int n = 1; n <= 3; ++n) say(images, n);
  const auto tell = [&infos](int n) {
    auto info = infos.loan();
    info->header.stamp = ros::Time(n);
    infos.publish(std::move(info));
  };
  tell(2);  // 1 has lost its info then
  CHECK(comes([&] { return seen.size() == 1; }));
  tell(1);
  tell(3);
  CHECK(comes([&] { return seen.size() == 2; }));
  CHECK(seen == std::vector<double>{2, 3});
  CHECK_FALSE(in);
  CHECK(comes([&] { return images.getNumSubscribers() == 0; }));
}

int main(int argc, char** argv) {
  doctest::Context context(argc, argv);
  if (argc > 1 && std::string(argv[1]) == "-ltc") return context.run();  // needs no master
  ros::init(argc, argv, "filters");
  ros::NodeHandle keeps_ros;
  const int result = context.run();
  ros::shutdown();
  return result;
}
