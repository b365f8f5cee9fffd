// SPDX-License-Identifier: Apache-2.0
/// image_transport's transport `lot`: images in shared memory for nodes that know nothing of LOT.
///
///     rosrun image_view image_view image:=/camera/image _image_transport:=lot
///
/// The images of /camera/image go as /camera/image/lot, of type sensor_msgs/Image: nodes of
/// lot::ros read and write that topic, too. A publisher copies an image once, into shared memory. A
/// subscriber copies it once, out of shared memory, since its callback takes standard images. All
/// subscribers of the process share that copy.
#include <algorithm>
#include <cstdint>
#include <exception>
#include <string>

#include <image_transport/publisher_plugin.h>
#include <image_transport/single_subscriber_publisher.h>
#include <image_transport/subscriber_plugin.h>
#include <pluginlib/class_list_macros.hpp>
#include <ros/console.h>
#include <ros/single_subscriber_publisher.h>

#include "lot/ros.hpp"

namespace lot::ros {
namespace {

using Image = Message<sensor_msgs::Image_>;

constexpr const char* kName = "lot";
std::string topic_of(const std::string& base) { return base + "/" + kName; }

class ImagePublisher final : public image_transport::PublisherPlugin {
 public:
  std::string getTransportName() const override { return kName; }
  std::uint32_t getNumSubscribers() const override { return images_.getNumSubscribers(); }
  std::string getTopic() const override { return images_.getTopic(); }
  void publish(const sensor_msgs::Image& image) const override { images_.publish(image); }
  void publish(const sensor_msgs::ImageConstPtr& image) const override { images_.publish(image); }
  /// Publishes pixels that are in no message yet.
  void publish(const sensor_msgs::Image& image, const std::uint8_t* pixels) const override {
    images_.publish_with([&](auto& made) {
      assign(made.header, image.header);
      made.height = image.height;
      made.width = image.width;
      made.encoding.assign(image.encoding.data(), image.encoding.size());
      made.is_bigendian = image.is_bigendian;
      made.step = image.step;
      const std::size_t bytes = std::size_t{image.step} * image.height;
      made.data.resize(bytes);
      std::copy_n(pixels, bytes, made.data.data());
    });
  }
  void shutdown() override { images_.shutdown(); }

 private:
  using Greeting = image_transport::SubscriberStatusCallback;

  void advertiseImpl(::ros::NodeHandle& node, const std::string& base, std::uint32_t queue_size,
                     const Greeting& came, const Greeting& went, const ::ros::VoidPtr& tracked,
                     bool latch) override {
    images_ = NodeHandle(node).advertise<Image>(topic_of(base), queue_size, greeting(came),
                                                greeting(went), tracked, latch);
  }

  /// Wraps the user's connect callback, which may publish to the one subscriber alone. Empty where
  /// the user has none, since a publisher that greets serves its peers over TCPROS first.
  ::ros::SubscriberStatusCallback greeting(const Greeting& users) const {
    if (!users) return {};
    return [this, users](const ::ros::SingleSubscriberPublisher& peer) {
      const image_transport::SingleSubscriberPublisher images(
          peer.getSubscriberName(), getTopic(), [this] { return getNumSubscribers(); },
          [&peer](const sensor_msgs::Image& image) { peer.publish(image); });
      users(images);
    };
  }

  Publisher<Image> images_;
};

class ImageSubscriber final : public image_transport::SubscriberPlugin {
 public:
  std::string getTransportName() const override { return kName; }
  std::string getTopic() const override { return images_.getTopic(); }
  std::uint32_t getNumPublishers() const override { return images_.getNumPublishers(); }
  void shutdown() override { images_.shutdown(); }

 private:
  void subscribeImpl(::ros::NodeHandle& node, const std::string& base, std::uint32_t queue_size,
                     const Callback& callback, const ::ros::VoidPtr& tracked,
                     const image_transport::TransportHints& hints) override {
    using Pointer = const boost::shared_ptr<Image const>&;
    const boost::function<void(Pointer)> give =
        [callback, standard = ToStandard<Image>()](Pointer image) { callback(standard(image)); };
    images_ = NodeHandle(node).subscribe<Image>(topic_of(base), queue_size, give, tracked,
                                                hints.getRosHints());
  }

  Subscriber images_;
};

}  // namespace
}  // namespace lot::ros

PLUGINLIB_EXPORT_CLASS(lot::ros::ImagePublisher, image_transport::PublisherPlugin)
PLUGINLIB_EXPORT_CLASS(lot::ros::ImageSubscriber, image_transport::SubscriberPlugin)
