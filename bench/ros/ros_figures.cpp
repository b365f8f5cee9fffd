// SPDX-License-Identifier: Apache-2.0

// From publish() to the callback, in one process and between two, of LOT, of roscpp and of
// image_transport: the two ends that bench/ros/figures.py starts.
//
//     ros_figures publisher ROUNDS MESSAGES SIZE...
//     ros_figures subscriber
//
// Each end prints "ARM BYTES ROUND NANOSECONDS" for what it was called back with.

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <boost/make_shared.hpp>
#include <image_transport/image_transport.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <ros/spinner.h>
#include <sensor_msgs/Image.h>

#include <lot/ros.hpp>

namespace {

using Image = lot::ros::Message<sensor_msgs::Image_>;

std::int64_t now_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }

struct Sample {
  const char* arm;
  std::size_t bytes;
  std::uint32_t round;
  std::int64_t ns;
};

/// What an arm is called back with, of one thread.
class Samples {
 public:
  explicit Samples(const char* arm) : arm_(arm) { samples_.reserve(1 << 16); }
  template <class Its>
  void add(const Its& image) {
    const std::int64_t now = now_ns();
    const auto sent = static_cast<std::int64_t>(image.header.stamp.toNSec());
    used_ += image.data[image.data.size() / 2];  // what nobody reads measures nothing
    if (image.height != 0) samples_.push_back({arm_, image.data.size(), image.width, now - sent});
  }
  void print() const {
    for (const Sample& s : samples_) {
      std::printf("%s %zu %u %lld\n", s.arm, s.bytes, s.round, static_cast<long long>(s.ns));
    }
    std::fprintf(stderr, "%s: %llu\n", arm_, static_cast<unsigned long long>(used_));
  }

 private:
  const char* arm_;
  std::vector<Sample> samples_;
  std::uint64_t used_ = 0;
};

/// A filled image; the first one of each block is height 0, and not counted.
template <class Its>
void fill(Its& image, std::size_t bytes, std::uint32_t round, std::uint32_t number) {
  image.width = round;
  image.height = number;
  image.data.resize(bytes);
  std::memset(image.data.data(), static_cast<int>(number), bytes);
}
template <class Its>
void stamp(Its& image) {
  image.header.stamp.fromNSec(static_cast<std::uint64_t>(now_ns()));
}

int subscribe() {
  ros::NodeHandle node;
  lot::ros::NodeHandle at_once;
  at_once.setCallbackQueue(lot::ros::immediate_queue());
  Samples between("lot-between"), raw("raw"), plugin("plugin");
  auto of_lot = at_once.subscribe<Image>("between", 5, [&](const Image& i) { between.add(i); });
  image_transport::ImageTransport transport(node);
  const auto of_raw = transport.subscribe(
      "images_raw", 5, [&](const sensor_msgs::ImageConstPtr& i) { raw.add(*i); }, ros::VoidPtr(),
      image_transport::TransportHints("raw"));
  const auto of_plugin = transport.subscribe(
      "images_lot", 5, [&](const sensor_msgs::ImageConstPtr& i) { plugin.add(*i); }, ros::VoidPtr(),
      image_transport::TransportHints("lot"));
  ros::spin();
  between.print(), raw.print(), plugin.print();
  return 0;
}

int publish(int argc, char** argv) {
  const int rounds = std::stoi(argv[2]);
  const auto messages = static_cast<std::uint32_t>(std::stoul(argv[3]));
  lot::ros::NodeHandle node;
  ros::NodeHandle plain;
  // As the nodelets of a manager: a queue and a thread.
  Samples by_pointer("plain"), in_process("lot"), converted("converted"), standard("standard");
  auto of_plain = plain.subscribe<sensor_msgs::Image>(
      "plain", 5, [&](const sensor_msgs::ImageConstPtr& i) { by_pointer.add(*i); });
  auto of_lot = node.subscribe<Image>("lot", 5, [&](const Image& i) { in_process.add(i); });
  auto of_converted = plain.subscribe<sensor_msgs::Image>(
      "converted", 5, [&](const sensor_msgs::ImageConstPtr& i) { converted.add(*i); });
  auto of_standard = plain.subscribe<sensor_msgs::Image>(
      "standard", 5, [&](const sensor_msgs::ImageConstPtr& i) { standard.add(*i); });
  auto to_plain = plain.advertise<sensor_msgs::Image>("plain", 5);
  auto to_lot = node.advertise<Image>("lot", 5);
  auto to_converted = node.advertise<Image>("converted", 5);
  auto to_standard = node.advertise<Image>("standard", 5);
  auto to_between = node.advertise<Image>("between", 5);
  image_transport::ImageTransport transport(plain);
  const auto to_raw = transport.advertise("images_raw", 5);
  const auto to_plugin = transport.advertise("images_lot", 5);
  ros::AsyncSpinner spinner(1);
  spinner.start();
  while (ros::ok() && (to_between.getNumSubscribers() == 0 || to_raw.getNumSubscribers() == 0 ||
                       to_plugin.getNumSubscribers() == 0)) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  const auto of_standard_type = [](auto& publisher) {
    return [&publisher](std::size_t bytes, std::uint32_t round, std::uint32_t number) {
      auto image = boost::make_shared<sensor_msgs::Image>();
      fill(*image, bytes, round, number);
      stamp(*image);
      publisher.publish(image);
    };
  };
  const auto of_lot_type = [](auto& publisher) {
    return [&publisher](std::size_t bytes, std::uint32_t round, std::uint32_t number) {
      auto image = publisher.loan();
      fill(*image, bytes, round, number);
      stamp(*image);
      publisher.publish(std::move(image));
    };
  };
  // One memcpy of a frame, into memory that is there, as a conversion has it.
  const auto copy = [](std::size_t bytes, std::uint32_t round, std::uint32_t number) {
    static std::vector<std::uint8_t> from(64 << 20), to(64 << 20);
    std::memset(from.data(), static_cast<int>(number), bytes);
    const std::int64_t begin = now_ns();
    std::memcpy(to.data(), from.data(), bytes);
    const std::int64_t end = now_ns();
    if (number != 0 && to[bytes / 2] == static_cast<std::uint8_t>(number)) {
      std::printf("memcpy %zu %u %lld\n", bytes, round, static_cast<long long>(end - begin));
    }
  };
  const auto block = [&](std::size_t bytes, std::uint32_t round, const auto& send) {
    for (std::uint32_t n = 0; n <= messages && ros::ok(); ++n) {
      send(bytes, round, n);
      std::this_thread::sleep_for(std::chrono::milliseconds(bytes > (4 << 20) ? 40 : 10));
    }
  };
  for (int i = 4; i < argc; ++i) {
    const std::size_t bytes = std::stoul(argv[i]);
    for (std::uint32_t round = 0; round < static_cast<std::uint32_t>(rounds); ++round) {
      block(bytes, round, copy);
      block(bytes, round, of_standard_type(to_plain));
      block(bytes, round, of_lot_type(to_lot));
      block(bytes, round, of_lot_type(to_converted));
      block(bytes, round, of_standard_type(to_standard));
      block(bytes, round, of_lot_type(to_between));
      block(bytes, round, of_standard_type(to_raw));
      block(bytes, round, of_standard_type(to_plugin));
    }
  }
  spinner.stop();
  by_pointer.print(), in_process.print(), converted.print(), standard.print();
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "ros_figures", ros::init_options::AnonymousName);
  const std::string role = argc > 1 ? argv[1] : "";
  if (role == "subscriber") return subscribe();
  if (role == "publisher" && argc > 4) return publish(argc, argv);
  std::fprintf(stderr, "usage: ros_figures publisher ROUNDS MESSAGES SIZE... | subscriber\n");
  return 2;
}
