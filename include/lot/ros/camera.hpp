// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

#include <boost/function.hpp>
#include <boost/shared_ptr.hpp>
#include <message_filters/time_synchronizer.h>
#include <ros/console.h>
#include <ros/wall_timer.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "lot/ros/message_filters.hpp"
#include "lot/ros/node_handle.hpp"
#include "lot/ros/publisher.hpp"

/// Images with what is known of their camera, together. Who includes it links message_filters.
namespace lot::ros {

/// "camera/image_raw" has its infos beside it, as "camera/camera_info".
inline std::string camera_info_topic(std::string image_topic) {
  while (!image_topic.empty() && image_topic.back() == '/') image_topic.pop_back();
  const auto slash = image_topic.rfind('/');
  return (slash == std::string::npos ? "" : image_topic.substr(0, slash + 1)) + "camera_info";
}

/// image_transport::CameraPublisher's counterpart: each image goes with an info of the same stamp
/// and frame, so that a CameraSubscriber, LOT's or image_transport's, finds the two.
///
/// Shape:   a handle, copied as one likes; both topics are unadvertised when the last copy has
/// gone. Threads: all members may be called at once.
class CameraPublisher {
 public:
  using Image = Message<sensor_msgs::Image_>;
  using CameraInfo = Message<sensor_msgs::CameraInfo_>;

  CameraPublisher() = default;
  CameraPublisher(NodeHandle& node, const std::string& topic, std::uint32_t queue_size,
                  bool latch = false) {
    const std::string resolved = node.resolveName(topic);
    images_ = node.advertise<Image>(topic, queue_size, latch);
    infos_ = node.advertise<CameraInfo>(camera_info_topic(resolved), queue_size, latch);
  }

  /// An image to fill and to publish.
  Loan<Image> loan() const { return images_.loan(); }
  void reserve(std::size_t count, std::size_t bytes) const { images_.reserve(count, bytes); }

  /// The info gets the stamp and the frame of the image. Nothing where the image is empty.
  template <class Info>
  void publish(Loan<Image>&& image, const Info& info) const {
    if (!image) return;
    publish_info(info, image->header);
    images_.publish(std::move(image));
  }
  /// The same, and both get this stamp.
  template <class Info>
  void publish(Loan<Image>&& image, const Info& info, ::ros::Time stamp) const {
    if (image) image->header.stamp = stamp;
    publish(std::move(image), info);
  }
  /// Standard ones; the image is copied once.
  void publish(const sensor_msgs::Image& image, const sensor_msgs::CameraInfo& info) const {
    publish_info(info, image.header);
    images_.publish(image);
  }
  void publish(const sensor_msgs::ImageConstPtr& image,
               const sensor_msgs::CameraInfoConstPtr& info) const {
    if (image && info) publish(*image, *info);
  }

  std::string getTopic() const { return images_.getTopic(); }
  std::string getInfoTopic() const { return infos_.getTopic(); }
  /// Of images, or of infos if more.
  std::uint32_t getNumSubscribers() const {
    return std::max(images_.getNumSubscribers(), infos_.getNumSubscribers());
  }
  /// As Publisher::serialised(), of both topics.
  std::uint64_t serialised() const { return images_.serialised() + infos_.serialised(); }
  void shutdown() {
    images_.shutdown();
    infos_.shutdown();
  }
  explicit operator bool() const { return images_ && infos_; }

 private:
  template <class Info, class Header>
  void publish_info(const Info& info, const Header& header) const {
    auto copy = infos_.loan();
    if (!copy) return;
    if constexpr (std::is_same_v<Info, CameraInfo>) {
      *copy = info;
    } else {
      assign(*copy, info);
    }
    copy->header.stamp = header.stamp;
    copy->header.frame_id.assign(header.frame_id.data(), header.frame_id.size());
    infos_.publish(std::move(copy));
  }

  Publisher<Image> images_;
  Publisher<CameraInfo> infos_;
};

/// image_transport::CameraSubscriber's counterpart: an image and the info of the same stamp in one
/// call. Where most find no counterpart for ten seconds, it says so.
///
/// Shape:   a handle, copied as one likes; both are unsubscribed when the last copy has gone.
/// Threads: as Subscriber. The callback comes from the node's queue.
class CameraSubscriber {
 public:
  using Image = Message<sensor_msgs::Image_>;
  using CameraInfo = Message<sensor_msgs::CameraInfo_>;
  using Callback = boost::function<void(const boost::shared_ptr<Image const>&,
                                        const boost::shared_ptr<CameraInfo const>&)>;

  CameraSubscriber() = default;
  CameraSubscriber(NodeHandle& node, const std::string& topic, std::uint32_t queue_size,
                   const Callback& callback,
                   const ::ros::TransportHints& hints = ::ros::TransportHints())
      : both_(std::make_shared<Both>(node, topic, queue_size, callback, hints)) {}

  std::string getTopic() const { return both_ ? both_->images.getSubscriber().getTopic() : ""; }
  std::string getInfoTopic() const { return both_ ? both_->infos.getSubscriber().getTopic() : ""; }
  std::uint32_t getNumPublishers() const {
    return both_ ? std::max(both_->images.getSubscriber().getNumPublishers(),
                            both_->infos.getSubscriber().getNumPublishers())
                 : 0;
  }
  /// Unsubscribes, whoever has copies.
  void shutdown() {
    if (both_) both_->end();
    both_.reset();
  }
  explicit operator bool() const { return both_ != nullptr; }

 private:
  struct Both {
    Both(NodeHandle& node, const std::string& topic, std::uint32_t queue_size, Callback user,
         const ::ros::TransportHints& hints)
        : images(node, topic, queue_size, hints),
          infos(node, camera_info_topic(node.resolveName(topic)), queue_size, hints),
          pairs(images, infos, queue_size),
          callback(std::move(user)) {
      images.registerCallback([this](const boost::shared_ptr<Image const>&) { ++image_count; });
      infos.registerCallback([this](const boost::shared_ptr<CameraInfo const>&) { ++info_count; });
      pairs.registerCallback(&Both::pair, this);
      look = node.createWallTimer(::ros::WallDuration(10), [this](const auto&) { warn(); });
    }
    ~Both() { end(); }

    void pair(const boost::shared_ptr<Image const>& image,
              const boost::shared_ptr<CameraInfo const>& info) {
      ++pair_count;
      callback(image, info);
    }
    void end() {
      look.stop();
      images.unsubscribe();
      infos.unsubscribe();
    }
    void warn() {
      const unsigned seen_images = image_count.exchange(0);
      const unsigned seen_infos = info_count.exchange(0);
      const unsigned seen_pairs = pair_count.exchange(0);
      const unsigned most = std::max(seen_images, seen_infos);
      if (most < 3 || seen_pairs > most / 3) return;
      ROS_WARN(
          "LOT: %s and %s do not go together: in 10 s there were %u images, %u infos and %u pairs "
          "of the same stamp",
          images.getSubscriber().getTopic().c_str(), infos.getSubscriber().getTopic().c_str(),
          seen_images, seen_infos, seen_pairs);
    }

    std::atomic<unsigned> image_count{0}, info_count{0}, pair_count{0};
    message_filters::Subscriber<Image> images;
    message_filters::Subscriber<CameraInfo> infos;
    ::message_filters::TimeSynchronizer<Image, CameraInfo> pairs;
    const Callback callback;
    ::ros::WallTimer look;
  };

  std::shared_ptr<Both> both_;
};

}  // namespace lot::ros
