// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include <message_filters/simple_filter.h>
#include <message_filters/subscriber.h>
#include <ros/message_event.h>
#include <ros/node_handle.h>
#include <ros/subscribe_options.h>

#include "lot/ros/core.hpp"
#include "lot/ros/node_handle.hpp"
#include "lot/ros/subscriber.hpp"

/// What feeds message_filters and tf2_ros with messages from shared memory. Link
/// message_filters.
namespace lot::ros::message_filters {

/// message_filters::Subscriber's counterpart: the source of a TimeSynchronizer, Synchronizer,
/// Cache, TimeSequencer, Chain or tf2_ros::MessageFilter.
///
///     lot::ros::message_filters::Subscriber<Image> left(nh, "left", 10), right(nh, "right", 10);
///     message_filters::TimeSynchronizer<Image, Image> both(left, right, 10);
///     both.registerCallback(&callback);
///
/// Threads: as lot::ros::Subscriber. Callbacks come from the queue that is given, or the node's;
///          none is at work when it is destroyed, or unsubscribe() has returned.
/// Errors:  as lot::ros::Subscriber. What a callback throws goes to the thread that calls the
///          queue.
/// Memory:  a filter keeps messages by pointer, in the segment: as many as its queue takes.
/// Crash:   as lot::ros::Subscriber.
template <class M>
class Subscriber final : public ::message_filters::SubscriberBase,
                         public ::message_filters::SimpleFilter<M> {
  static_assert(detail::is_lot_message<M>,
                "use message_filters::Subscriber for messages that are no lot::ros::Message");

 public:
  using MConstPtr = boost::shared_ptr<M const>;    ///< as filters get a message
  using EventType = ::ros::MessageEvent<M const>;  ///< and with what is known of it

  Subscriber() = default;
  /// Subscribes, as subscribe() does. Throws the same.
  Subscriber(::ros::NodeHandle& node, const std::string& topic, std::uint32_t queue_size,
             const ::ros::TransportHints& hints = ::ros::TransportHints(),
             ::ros::CallbackQueueInterface* callbacks = nullptr) {
    start(node, topic, queue_size, hints, callbacks);
  }
  ~Subscriber() override { subscriber_.shutdown(); }

  /// Leaves the topic that it had. An empty one: it has none then. Throws as
  /// NodeHandle::subscribe().
  void subscribe(::ros::NodeHandle& node, const std::string& topic, std::uint32_t queue_size,
                 const ::ros::TransportHints& hints = ::ros::TransportHints(),
                 ::ros::CallbackQueueInterface* callbacks = nullptr) override {
    start(node, topic, queue_size, hints, callbacks);
  }
  /// To the same topic once more; nothing where there was none. Throws the same.
  void subscribe() override {
    subscriber_.shutdown();
    if (!options_.topic.empty()) subscriber_ = node_.template subscribe<M>(options_);
  }
  /// Leaves the topic; subscribe() comes back to it. Throws as lot::ros::Subscriber::shutdown().
  void unsubscribe() override { subscriber_.shutdown(); }

  /// The topic as it was given. Throws std::bad_alloc.
  std::string getTopic() const { return options_.topic; }
  /// The subscription, to ask it. Throws nothing.
  const lot::ros::Subscriber& getSubscriber() const { return subscriber_; }

  /// Does nothing: it is the first of a message_filters::Chain. Throws nothing.
  template <class Filter>
  void connectInput(Filter& /*filter*/) {}
  /// Does nothing, as connectInput(). Throws nothing.
  void add(const EventType& /*event*/) {}

 private:
  void start(::ros::NodeHandle& node, const std::string& topic, std::uint32_t queue_size,
             const ::ros::TransportHints& hints, ::ros::CallbackQueueInterface* callbacks) {
    subscriber_.shutdown();
    options_ = ::ros::SubscribeOptions();
    if (topic.empty()) return;
    options_.template initByFullCallbackType<const EventType&>(
        topic, queue_size, [this](const EventType& event) { this->signalMessage(event); });
    options_.callback_queue = callbacks;
    options_.transport_hints = hints;
    node_ = NodeHandle(node);
    subscriber_ = node_.template subscribe<M>(options_);
  }

  NodeHandle node_;
  ::ros::SubscribeOptions options_;
  lot::ros::Subscriber subscriber_;
};

}  // namespace lot::ros::message_filters
