// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <type_traits>
#include <utility>

#include <boost/function.hpp>
#include <boost/shared_ptr.hpp>
#include <ros/console.h>
#include <ros/wall_timer.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "lot/detail/mutex.hpp"
#include "lot/ros/node_handle.hpp"
#include "lot/ros/publisher.hpp"
#include "lot/ros/subscriber.hpp"

/// Images with what is known of their camera, together.
namespace lot::ros {

/// "camera/image_raw" has its infos beside it, as "camera/camera_info"; so has
/// "camera/image_raw/lot", its topic for image_transport's nodes. Throws std::bad_alloc.
[[nodiscard]] inline std::string camera_info_topic(std::string image_topic) {
  const auto drop_slashes = [&] {
    while (!image_topic.empty() && image_topic.back() == '/') image_topic.pop_back();
  };
  drop_slashes();
  const std::string transport = "/lot";
  if (image_topic.size() > transport.size() &&
      image_topic.compare(image_topic.size() - transport.size(), transport.size(), transport) ==
          0) {
    image_topic.resize(image_topic.size() - transport.size());
    drop_slashes();
  }
  const auto slash = image_topic.rfind('/');
  return (slash == std::string::npos ? "" : image_topic.substr(0, slash + 1)) + "camera_info";
}

/// image_transport::CameraPublisher's counterpart: each image goes with an info of the same stamp
/// and frame, so that a CameraSubscriber, LOT's or image_transport's, finds the two.
///
/// Shape:   a handle, copied as one likes; both topics go when the last copy has gone.
/// Threads: all members may be called at once, but for assignment, shutdown() and destruction.
/// Errors:  as Publisher.
/// Memory:  as two Publishers.
/// Crash:   as Publisher. An image whose info was published, but not it itself, is never seen by a
///          CameraSubscriber.
class CameraPublisher {
 public:
  using Image = Message<sensor_msgs::Image_>;            ///< what it publishes
  using CameraInfo = Message<sensor_msgs::CameraInfo_>;  ///< and beside it

  CameraPublisher() = default;
  /// Advertises the image's topic, and camera_info_topic() of it. Throws as
  /// NodeHandle::advertise().
  CameraPublisher(NodeHandle& node, const std::string& topic, std::uint32_t queue_size,
                  bool latch = false) {
    const std::string resolved = node.resolveName(topic);
    images_ = node.advertise<Image>(topic, queue_size, latch);
    infos_ = node.advertise<CameraInfo>(camera_info_topic(resolved), queue_size, latch);
  }

  /// An image to fill and to publish. Throws as Publisher::loan().
  [[nodiscard]] Loan<Image> loan() const { return images_.loan(); }
  /// Memory for images, as Publisher::reserve(). Throws the same.
  void reserve(std::size_t count, std::size_t bytes) const { images_.reserve(count, bytes); }

  /// The info gets the stamp and the frame of the image. Nothing where the image is empty. Throws
  /// as Publisher::publish(); lot::OutOfMemory when the info's contents find no room.
  template <class Info>
  void publish(Loan<Image>&& image, const Info& info) const {
    if (!image) return;
    publish_info(info, image->header);
    images_.publish(std::move(image));
  }
  /// The same, and both get this stamp. Throws the same.
  template <class Info>
  void publish(Loan<Image>&& image, const Info& info, ::ros::Time stamp) const {
    if (image) image->header.stamp = stamp;
    publish(std::move(image), info);
  }
  /// Standard ones; the image is copied once. Throws the same.
  void publish(const sensor_msgs::Image& image, const sensor_msgs::CameraInfo& info) const {
    publish_info(info, image.header);
    images_.publish(image);
  }
  /// Standard ones by pointer; the image is copied once. Nothing where one is null. Throws the
  /// same.
  void publish(const sensor_msgs::ImageConstPtr& image,
               const sensor_msgs::CameraInfoConstPtr& info) const {
    if (image && info) publish(*image, *info);
  }

  /// The images' topic, resolved; empty where there is none. Throws std::bad_alloc.
  std::string getTopic() const { return images_.getTopic(); }
  /// The infos' topic, as getTopic(). Throws std::bad_alloc.
  std::string getInfoTopic() const { return infos_.getTopic(); }
  /// Subscribers of images, or of infos if more. Throws as Publisher::getNumSubscribers().
  std::uint32_t getNumSubscribers() const {
    return std::max(images_.getNumSubscribers(), infos_.getNumSubscribers());
  }
  /// As Publisher::serialised(), of both topics. Throws the same.
  std::uint64_t serialised() const { return images_.serialised() + infos_.serialised(); }
  /// Unadvertises both, though others have copies. Throws as Publisher::shutdown().
  void shutdown() {
    images_.shutdown();
    infos_.shutdown();
  }
  /// False: it was not advertised, or is shut down. Throws nothing.
  [[nodiscard]] explicit operator bool() const { return images_ && infos_; }

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
/// call. Where most find no counterpart for ten seconds, ROS_WARN says so.
///
/// Shape:   a handle, copied as one likes; both are unsubscribed when the last copy has gone.
/// Threads: as Subscriber. The callback comes from the node's queue, without a lock; by several
///          threads at once if these call that queue.
/// Errors:  as Subscriber. What the callback throws goes to the thread that calls the queue.
/// Memory:  `queue_size` images or infos wait for their counterparts, the oldest goes first.
/// Crash:   as Subscriber.
class CameraSubscriber {
 public:
  using Image = Message<sensor_msgs::Image_>;            ///< what it receives
  using CameraInfo = Message<sensor_msgs::CameraInfo_>;  ///< and with it
  using ImagePtr = boost::shared_ptr<Image const>;       ///< as the callback gets an image
  using InfoPtr = boost::shared_ptr<CameraInfo const>;   ///< as the callback gets an info
  /// What is called with each pair.
  using Callback = boost::function<void(const ImagePtr&, const InfoPtr&)>;

  CameraSubscriber() = default;
  /// Subscribes to the image's topic, and to camera_info_topic() of it. Throws as
  /// NodeHandle::subscribe().
  CameraSubscriber(NodeHandle& node, const std::string& topic, std::uint32_t queue_size,
                   Callback callback, const ::ros::TransportHints& hints = ::ros::TransportHints())
      : both_(std::make_shared<Both>(std::max(queue_size, 1U), std::move(callback))) {
    both_->start(both_, node, topic, hints);
  }

  /// The images' topic, resolved; empty where there is none. Throws std::bad_alloc.
  std::string getTopic() const { return both_ ? both_->images.getTopic() : ""; }
  /// The infos' topic, as getTopic(). Throws std::bad_alloc.
  std::string getInfoTopic() const { return both_ ? both_->infos.getTopic() : ""; }
  /// Publishers of images, or of infos if more. Throws as Subscriber::getNumPublishers().
  std::uint32_t getNumPublishers() const {
    return both_ ? std::max(both_->images.getNumPublishers(), both_->infos.getNumPublishers()) : 0;
  }
  /// Unsubscribes both, though others have copies. May be called in the callback. Throws as
  /// Subscriber::shutdown().
  void shutdown() {
    if (both_) both_->end();
    both_.reset();
  }
  /// False: it was not subscribed, or is shut down. Throws nothing.
  [[nodiscard]] explicit operator bool() const { return both_ != nullptr; }

 private:
  struct Both {
    Both(std::uint32_t most, Callback user) : queue_size(most), callback(std::move(user)) {}

    /// Called once, before other threads know of this object. Each call of take() keeps the object
    /// alive: the user's callback may end the subscriber.
    void start(const std::weak_ptr<Both>& self, NodeHandle& node, const std::string& topic,
               const ::ros::TransportHints& hints) {
      look = node.createWallTimer(::ros::WallDuration(10), [self](const ::ros::WallTimerEvent&) {
        if (const auto both = self.lock()) both->warn();
      });
      const std::string info_topic = camera_info_topic(node.resolveName(topic));
      infos = node.subscribe<CameraInfo>(
          info_topic, queue_size,
          boost::function<void(const InfoPtr&)>([self](const InfoPtr& info) {
            if (const auto both = self.lock()) both->take(info->header.stamp, nullptr, info);
          }),
          ::ros::VoidConstPtr(), hints);
      images = node.subscribe<Image>(
          topic, queue_size, boost::function<void(const ImagePtr&)>([self](const ImagePtr& image) {
            if (const auto both = self.lock()) both->take(image->header.stamp, image, nullptr);
          }),
          ::ros::VoidConstPtr(), hints);
    }

    void take(::ros::Time stamp, const ImagePtr& image, const InfoPtr& info) {
      std::pair<ImagePtr, InfoPtr> pair;
      std::map<::ros::Time, std::pair<ImagePtr, InfoPtr>> late;  // released without the lock
      {
        const std::lock_guard guard(mutex);
        ++(image ? image_count : info_count);
        auto& waiting = waiting_for[stamp];
        if (image) waiting.first = image;
        if (info) waiting.second = info;
        if (waiting.first && waiting.second) {
          pair = waiting;
          ++pair_count;
          // Older ones have lost their counterparts.
          for (auto at = waiting_for.begin(); at != waiting_for.end() && at->first <= stamp;) {
            late.insert(waiting_for.extract(at++));
          }
        } else if (waiting_for.size() > queue_size) {
          late.insert(waiting_for.extract(waiting_for.begin()));
        }
      }
      if (pair.first) callback(pair.first, pair.second);
    }

    /// The handles stay as they are: other threads may be asking them.
    void end() {
      ::ros::WallTimer timer = look;
      timer.stop();
      for (Subscriber each : {images, infos}) each.shutdown();
    }

    void warn() {
      const std::lock_guard guard(mutex);
      const unsigned most = std::max(image_count, info_count);
      if (most >= 3 && pair_count <= most / 3) {
        ROS_WARN(
            "LOT: %s and its infos do not go together: in 10 s there were %u images, %u infos and "
            "%u pairs of the same stamp",
            images.getTopic().c_str(), image_count, info_count, pair_count);
      }
      image_count = info_count = pair_count = 0;
    }

    const std::uint32_t queue_size;
    const Callback callback;
    lot::detail::Mutex mutex{lot::detail::Rank::Camera};
    std::map<::ros::Time, std::pair<ImagePtr, InfoPtr>> waiting_for;
    unsigned image_count = 0, info_count = 0, pair_count = 0;
    ::ros::WallTimer look;
    Subscriber images, infos;
  };

  std::shared_ptr<Both> both_;
};

}  // namespace lot::ros
