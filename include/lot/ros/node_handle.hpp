// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <exception>
#include <string>
#include <type_traits>
#include <utility>

#include <boost/bind/bind.hpp>
#include <boost/function.hpp>
#include <boost/shared_ptr.hpp>
#include <ros/console.h>
#include <ros/node_handle.h>

#include "lot/ros/core.hpp"
#include "lot/ros/publisher.hpp"
#include "lot/ros/subscriber.hpp"

namespace lot::ros {

/// roscpp's NodeHandle, which carries messages in shared memory where it can.
///
///     lot::ros::NodeHandle nh;
///     using Image = lot::ros::Message<sensor_msgs::Image_>;
///     auto pub = nh.advertise<Image>("/camera/image", 10);
///     auto img = pub.loan();
///     img->data.resize(16 << 20);
///     pub.publish(std::move(img));
///     auto sub = nh.subscribe<Image>("/camera/image", 10, &callback);
///
/// A callback is a function, a member function, boost::function, or anything that can be called; it
/// takes const M&, M, boost::shared_ptr<M const>, boost::shared_ptr<M>, lot::ShmSharedPtr<const M>
/// (each also by const&), const ros::MessageEvent<M const>& or const ros::MessageEvent<M>&. A
/// callback that takes a message to change it gets a copy.
///
/// Everything else is roscpp's own: it is a ros::NodeHandle, and messages that are no
/// lot::ros::Message are advertised and subscribed to as ever.
///
/// Threads: as ros::NodeHandle.
/// Errors:  as ros::NodeHandle. What LOT cannot do (no segment, no room) ROS_WARN says, and
///          messages go over TCPROS. The first end of a process starts LOT's thread:
///          std::system_error where the system has none.
/// Memory:  with the first end, the process joins the segment: see ShmEngine.
/// Crash:   as ShmEngine. A node can be started again at once.
class NodeHandle : public ::ros::NodeHandle {
 public:
  /// What a callback takes where its type does not say it.
  template <class M>
  using ToPointer = const boost::shared_ptr<M const>&;

  NodeHandle() = default;
  /// The same node handle as `plain`. Throws as the copy of that one.
  explicit NodeHandle(const ::ros::NodeHandle& plain) : ::ros::NodeHandle(plain) {}

  using ::ros::NodeHandle::advertise;
  using ::ros::NodeHandle::NodeHandle;
  using ::ros::NodeHandle::subscribe;

  /// A Publisher<M>, or a ros::Publisher where M is no lot::ros::Message; an empty one where ROS
  /// refuses it, which it logs: another type on the topic, say. Throws ros::InvalidNameException,
  /// std::bad_alloc and std::system_error.
  template <class M>
  [[nodiscard]] auto advertise(const std::string& topic, std::uint32_t queue_size,
                               bool latch = false) {
    return advertise<M>(topic, queue_size, ::ros::SubscriberStatusCallback(),
                        ::ros::SubscriberStatusCallback(), ::ros::VoidConstPtr(), latch);
  }
  /// The same, and calls back when a subscriber comes and goes. Throws the same.
  template <class M>
  [[nodiscard]] auto advertise(
      const std::string& topic, std::uint32_t queue_size,
      const ::ros::SubscriberStatusCallback& connect,
      const ::ros::SubscriberStatusCallback& disconnect = ::ros::SubscriberStatusCallback(),
      const ::ros::VoidConstPtr& tracked_object = ::ros::VoidConstPtr(), bool latch = false) {
    ::ros::AdvertiseOptions options;
    options.template init<M>(topic, queue_size, connect, disconnect);
    options.tracked_object = tracked_object;
    options.latch = latch;
    if constexpr (detail::is_lot_message<M>) {
      return Publisher<M>(detail::advertise(*this, options, detail::kind_of<M>()));
    } else {
      return ::ros::NodeHandle::advertise(options);
    }
  }

  /// A Subscriber, or a ros::Subscriber where M is no lot::ros::Message: calls back what can be
  /// called with a message, from the node's callback queue. Empty where ROS refuses it, which it
  /// logs. Throws ros::ConflictingSubscriptionException when the process has subscribed to the
  /// topic with another type, ros::InvalidNameException, std::bad_alloc and std::system_error;
  /// lot::Error (EDEADLK) when a callback queue of the user's own subscribes while a callback is
  /// added to it, and the topic is just being left.
  template <class M, class Callback,
            std::enable_if_t<!std::is_member_function_pointer_v<Callback>, int> = 0>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               Callback&& callback,
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    using P = detail::ParameterFor<M, Callback>;
    return subscribe_to<P>(topic, queue_size,
                           boost::function<void(P)>(std::forward<Callback>(callback)),
                           ::ros::VoidConstPtr(), hints);
  }
  /// The same, a function. Throws the same.
  template <class P>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (*callback)(P),
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe_to<P>(topic, queue_size, boost::function<void(P)>(callback),
                           ::ros::VoidConstPtr(), hints);
  }
  /// The same, and it is not called any more when the tracked object has gone. Throws the same.
  template <class M, class P>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               const boost::function<void(P)>& callback,
                               const ::ros::VoidConstPtr& tracked_object = ::ros::VoidConstPtr(),
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe_to<P>(topic, queue_size, callback, tracked_object, hints);
  }
  /// A member function of an object that outlives the subscriber. Throws the same.
  template <class P, class T>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (T::*callback)(P), T* object,
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe_to<P>(topic, queue_size, on<P>(object, callback), ::ros::VoidConstPtr(),
                           hints);
  }
  /// A const one. Throws the same.
  template <class P, class T>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (T::*callback)(P) const, T* object,
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe_to<P>(topic, queue_size, on<P>(object, callback), ::ros::VoidConstPtr(),
                           hints);
  }
  /// A member function of an object; it is not called any more when that has gone. Throws the same.
  template <class P, class T>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (T::*callback)(P), const boost::shared_ptr<T>& object,
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe_to<P>(topic, queue_size, on<P>(object.get(), callback), object, hints);
  }
  /// A const one. Throws the same.
  template <class P, class T>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (T::*callback)(P) const, const boost::shared_ptr<T>& object,
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe_to<P>(topic, queue_size, on<P>(object.get(), callback), object, hints);
  }
  // roscpp has these beside those above, which would be chosen there: each of them hides one.
  /// A function that takes a pointer, where M is said. Throws the same.
  template <class M>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (*callback)(ToPointer<M>),
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe<ToPointer<M>>(topic, queue_size, callback, hints);
  }
  /// A boost::function that takes a pointer, where M is said. Throws the same.
  template <class M>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               const boost::function<void(ToPointer<M>)>& callback,
                               const ::ros::VoidConstPtr& tracked_object = ::ros::VoidConstPtr(),
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe_to<ToPointer<M>>(topic, queue_size, callback, tracked_object, hints);
  }
  /// A member function that takes a pointer, where M is said. Throws the same.
  template <class M, class T>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (T::*callback)(ToPointer<M>), T* object,
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe<ToPointer<M>, T>(topic, queue_size, callback, object, hints);
  }
  /// A const one. Throws the same.
  template <class M, class T>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (T::*callback)(ToPointer<M>) const, T* object,
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe<ToPointer<M>, T>(topic, queue_size, callback, object, hints);
  }
  /// The same, not called any more when the object has gone. Throws the same.
  template <class M, class T>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (T::*callback)(ToPointer<M>),
                               const boost::shared_ptr<T>& object,
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe<ToPointer<M>, T>(topic, queue_size, callback, object, hints);
  }
  /// A const one. Throws the same.
  template <class M, class T>
  [[nodiscard]] auto subscribe(const std::string& topic, std::uint32_t queue_size,
                               void (T::*callback)(ToPointer<M>) const,
                               const boost::shared_ptr<T>& object,
                               const ::ros::TransportHints& hints = ::ros::TransportHints()) {
    return subscribe<ToPointer<M>, T>(topic, queue_size, callback, object, hints);
  }
  /// All of roscpp's options. REQUIRES: `options.helper` takes messages M. Throws the same.
  template <class M>
  [[nodiscard]] Subscriber subscribe(const ::ros::SubscribeOptions& options) {
    static_assert(detail::is_lot_message<M>, "use ros::NodeHandle for other messages");
    return Subscriber(detail::subscribe(*this, options, detail::kind_of<M>()));
  }

 private:
  template <class P, class T, class Member>
  static boost::function<void(P)> on(T* object, Member member) {
    return [object, member](P message) { (object->*member)(std::forward<P>(message)); };
  }

  template <class P>
  auto subscribe_to(const std::string& topic, std::uint32_t queue_size,
                    const boost::function<void(P)>& callback,
                    const ::ros::VoidConstPtr& tracked_object, const ::ros::TransportHints& hints) {
    using M = detail::MessageOf<P>;
    if constexpr (std::is_same_v<std::decay_t<P>, ShmSharedPtr<const M>>) {
      // The callback takes LOT's pointer, so a message that came over a link is copied into shared
      // memory. If that fails, the node logs it and the callback does not get the message.
      using Plain = const boost::shared_ptr<M const>&;
      return subscribe_to<Plain>(topic, queue_size,
                                 boost::function<void(Plain)>([callback](Plain message) {
                                   ShmSharedPtr<const M> shared;
                                   try {
                                     shared = detail::shared_from<M>(message);
                                   } catch (const std::exception& e) {
                                     ROS_ERROR_THROTTLE(1, "a message is dropped: %s", e.what());
                                     return;
                                   }
                                   callback(shared);
                                 }),
                                 tracked_object, hints);
    }
    ::ros::SubscribeOptions options;
    options.template initByFullCallbackType<P>(topic, queue_size, callback);
    options.tracked_object = tracked_object;
    options.transport_hints = hints;
    if constexpr (detail::is_lot_message<M>) {
      return Subscriber(detail::subscribe(*this, options, detail::kind_of<M>()));
    } else {
      return ::ros::NodeHandle::subscribe(options);
    }
  }
};

}  // namespace lot::ros
