// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

#include <boost/function.hpp>
#include <boost/get_pointer.hpp>
#include <ros/parameter_adapter.h>
#include <ros/subscriber.h>

#include "lot/detail/message_type.hpp"
#include "lot/ros/core.hpp"

namespace lot::ros {

/// ros::Subscriber's counterpart.
///
/// Shape:   a handle, copied as one likes; unsubscribed when the last copy has gone.
/// Threads: all members may be called at once, but for assignment, shutdown() and destruction of
///          one handle. The callback comes from the node's callback queue.
/// Errors:  what the callback throws goes to the thread that calls the queue. A message that
///          another process has damaged is logged, and dropped.
/// Memory:  a cell in the queue of each publisher of the topic, one for all subscribers of the
///          process; `queue_size` messages that wait for the callback are kept in the segment.
/// Crash:   as ShmPuller: publishers go on.
class Subscriber {
 public:
  Subscriber() = default;
  /// For NodeHandle::subscribe(). Throws nothing.
  explicit Subscriber(std::shared_ptr<detail::Subscription> end) : end_(std::move(end)) {}

  /// The topic, resolved; empty where there is none. Throws std::bad_alloc.
  std::string getTopic() const { return end_ ? end_->topic() : std::string(); }
  /// Publishers that are linked now, plain ones and LOT's. Throws nothing.
  std::uint32_t getNumPublishers() const { return end_ ? end_->publishers() : 0; }
  /// Unsubscribes, though others have copies. It waits for a callback that is at work, unless that
  /// is what calls it. Throws std::bad_alloc.
  void shutdown() {
    if (end_) end_->shutdown();
    end_.reset();
  }
  /// False: it was not subscribed, or is shut down. Throws nothing.
  [[nodiscard]] explicit operator bool() const { return end_ != nullptr; }
  /// There is none: a ros::Subscriber ends nothing here. Does not compile, so throws nothing.
  template <class S, std::enable_if_t<std::is_same_v<S, ::ros::Subscriber>, int> = 0>
  operator S() const {
    static_assert(!std::is_same_v<S, ::ros::Subscriber>,
                  "keep it as lot::ros::Subscriber, or auto: a ros::Subscriber ends nothing here");
    return {};
  }
  friend bool operator==(const Subscriber& a, const Subscriber& b) { return a.end_ == b.end_; }
  friend bool operator!=(const Subscriber& a, const Subscriber& b) { return a.end_ != b.end_; }
  friend bool operator<(const Subscriber& a, const Subscriber& b) { return a.end_ < b.end_; }

 private:
  std::shared_ptr<detail::Subscription> end_;
};

namespace detail {

template <class T>
inline constexpr bool is_lot_message = false;
template <template <class> class Generated>
inline constexpr bool is_lot_message<Generated<Allocator<void>>> =
    ::ros::message_traits::IsMessage<Generated<Allocator<void>>>::value;

/// The one parameter of a callback: a function, a member function, or an object with one
/// operator(). void: the callback has several, or is a template.
template <class F, class = void>
struct Parameter {
  using Type = void;
};
template <class R, class P>
struct Parameter<R (*)(P)> {
  using Type = P;
};
template <class R, class C, class P>
struct Parameter<R (C::*)(P)> {
  using Type = P;
};
template <class R, class C, class P>
struct Parameter<R (C::*)(P) const> {
  using Type = P;
};
template <class F>
struct Parameter<F, std::void_t<decltype(&F::operator())>> : Parameter<decltype(&F::operator())> {};
template <class R, class P>
struct Parameter<boost::function<R(P)>> {
  using Type = P;
};

/// The parameter of a callback for messages M. The callback may be a template (boost::bind, a
/// lambda of auto): then it gets a pointer, as in roscpp.
template <class M, class F>
using ParameterFor = std::conditional_t<std::is_void_v<typename Parameter<std::decay_t<F>>::Type>,
                                        const boost::shared_ptr<M const>&,
                                        typename Parameter<std::decay_t<F>>::Type>;

/// The message of a parameter in any of its shapes.
template <class P>
using MessageOf = typename ::ros::ParameterAdapter<P>::Message;

/// LOT's pointer to the message of a callback; if the message is not in shared memory, to a copy
/// that is. Throws lot::Error when LOT is off in this process, lot::OutOfMemory.
template <class M>
ShmSharedPtr<const M> shared_from(const boost::shared_ptr<M const>& message) {
  if (const auto* keeper = boost::get_deleter<Keeper<const M>>(message)) return keeper->message;
  const auto place = maker();
  if (!place) {
    throw Error(ENODEV, "ShmSharedPtr", "LOT is off in this process, so nothing is shared",
                "take the message by const reference or boost::shared_ptr");
  }
  auto copy = lot::detail::build<M>(place->loan(lot::detail::message_type<M>(), true));
  *copy = *message;
  return ShmSharedPtr<const M>(std::move(copy));
}

}  // namespace detail
}  // namespace lot::ros

namespace ros {

/// Callbacks that take LOT's pointer.
template <class M>
struct ParameterAdapter<lot::ShmSharedPtr<M const>> {
  using Message = M;
  using Event = ros::MessageEvent<M const>;
  using Parameter = lot::ShmSharedPtr<M const>;
  static const bool is_const = true;
  static Parameter getParameter(const Event& event) {
    return lot::ros::detail::shared_from<M>(event.getConstMessage());
  }
};
/// The same by reference.
template <class M>
struct ParameterAdapter<const lot::ShmSharedPtr<M const>&>
    : ParameterAdapter<lot::ShmSharedPtr<M const>> {};

}  // namespace ros
