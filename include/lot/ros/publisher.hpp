// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include <boost/get_pointer.hpp>
#include <boost/make_shared.hpp>
#include <ros/publisher.h>

#include "lot/ros/core.hpp"

namespace lot::ros {

/// A message that is being built, in shared memory, or on the heap where LOT is off: the same code
/// then works over TCPROS alone.
///
/// Shape:   like std::unique_ptr<M>.
/// Threads: one at a time.
/// Errors:  of the contents: lot::OutOfMemory when they grow and the segment has no room. No other
///          member throws but release().
/// Memory:  in the segment, or on the heap, until it is published or has gone.
/// Crash:   other processes free what a dead one was building.
template <class M>
class Loan {
 public:
  Loan() = default;
  /// In shared memory. Throws nothing.
  explicit Loan(ShmUniquePtr<M> message) : shared_(std::move(message)), place_(shared_.get()) {}
  /// On the heap. Throws nothing.
  explicit Loan(boost::shared_ptr<M> message) : heap_(std::move(message)), place_(heap_.get()) {}
  Loan(Loan&& other) noexcept
      : shared_(std::move(other.shared_)),
        heap_(std::move(other.heap_)),
        place_(std::exchange(other.place_, nullptr)) {}
  Loan& operator=(Loan&& other) noexcept {
    shared_ = std::move(other.shared_);
    heap_ = std::move(other.heap_);
    place_ = std::exchange(other.place_, nullptr);
    return *this;
  }

  /// The message, or null.
  M* get() const noexcept { return place_; }
  /// The message. REQUIRES: there is one.
  M& operator*() const noexcept { return *place_; }
  /// A member of the message. REQUIRES: there is one.
  M* operator->() const noexcept { return place_; }
  /// False: there is none, or it was published.
  [[nodiscard]] explicit operator bool() const noexcept { return place_ != nullptr; }
  /// True when others can read it where it is.
  bool is_shared() const noexcept { return bool(shared_); }

  /// As a parcel; the loan is empty then. For Publisher. Throws std::bad_alloc.
  [[nodiscard]] detail::Parcel release() {
    place_ = nullptr;
    if (!shared_) return {std::exchange(heap_, nullptr), nullptr};
    return detail::parcel_of(ShmSharedPtr<const M>(std::move(shared_)));
  }

 private:
  ShmUniquePtr<M> shared_;
  boost::shared_ptr<M> heap_;
  M* place_ = nullptr;
};

/// Publishes one topic: ros::Publisher's counterpart.
///
/// Shape:   a handle, copied as one likes; unadvertised when the last copy has gone.
/// Threads: all members may be called at once, but for assignment, shutdown() and destruction of
///          one handle; what one thread publishes arrives in its order.
/// Errors:  as roscpp; what LOT cannot do is said by ROS_WARN once, and goes over TCPROS.
///          lot::Error: ECHILD in a forked child, ESTALE in a process that was stopped and that
///          another process took for dead; with ~lot/queue mutex EBUSY when a stopped process keeps
///          the queue's lock for five seconds. std::bad_alloc.
/// Memory:  in the segment, a queue of `queue_size` messages, 16 at the least, and the messages in
///          it; one for each topic and process. What goes over TCPROS is serialised on the heap.
/// Crash:   LOT's subscribers read what was published to its end.
template <class M>
class Publisher {
 public:
  Publisher() = default;
  /// For NodeHandle::advertise(). Throws nothing.
  explicit Publisher(std::shared_ptr<detail::Advertisement> end) : end_(std::move(end)) {}

  /// A message to fill and to publish, on the heap where the segment has no room for it. It is
  /// empty when the publisher is. Throws lot::Error and std::bad_alloc as the class says.
  [[nodiscard]] Loan<M> loan() const {
    const auto outlet = end_ ? end_->outlet() : nullptr;
    if (!outlet) return {};
    const lot::detail::Loan loan = outlet->loan();
    if (loan.control == nullptr) return Loan<M>(boost::make_shared<M>());
    return Loan<M>(lot::detail::build<M>(loan));
  }

  /// Makes memory for `count` messages with `bytes` of contents each ready: touched for the first
  /// time now (milliseconds for each frame of 16 MB) and not when they are filled. Throws
  /// lot::OutOfMemory, and then nothing is reserved, and lot::Error as the class says; does nothing
  /// where LOT is off.
  void reserve(std::size_t count, std::size_t bytes) const {
    if (const auto outlet = end_ ? end_->outlet() : nullptr) outlet->reserve(count, bytes);
  }

  /// Publishes a loan, without a copy; nothing where it or the publisher is empty. Throws
  /// lot::Error and std::bad_alloc as the class says.
  void publish(Loan<M>&& message) const {
    if (end_ && message) send(message.release(), true);
  }
  /// Copies it once. Throws the same.
  void publish(const M& message) const {
    publish_with([&message](M& copy) { copy = message; });
  }
  /// The standard message, sensor_msgs::Image. Copies it once. Throws the same.
  template <class S, std::enable_if_t<std::is_same_v<S, Standard<M>>, int> = 0>
  void publish(const S& message) const {
    publish_with([&message](M& copy) { assign(copy, message); });
  }
  /// Plain subscribers of this process get it by pointer, as by ros::Publisher: do not change it
  /// any more. It is copied once if a subscriber reads shared memory. Throws the same.
  void publish(const boost::shared_ptr<Standard<M> const>& message) const {
    if (end_ && message) send({nullptr, nullptr, message}, false);
  }
  /// A message that `fill` makes of an empty one, in shared memory; where that has no room for it,
  /// once more on the heap. Throws the same, and what `fill` throws.
  template <class Fill>
  void publish_with(Fill&& fill) const {
    auto message = loan();
    if (!message) return;
    try {
      fill(*message);
    } catch (const OutOfMemory&) {
      message = Loan<M>(boost::make_shared<M>());
      fill(*message);
    }
    publish(std::move(message));
  }
  /// A message that was received, or published already: without a copy. Throws the same.
  void publish(const ShmSharedPtr<const M>& message) const {
    if (end_ && message) send(detail::parcel_of(message), false);
  }
  /// The same when it lies in shared memory; else it is copied once. Throws the same.
  void publish(const boost::shared_ptr<M const>& message) const {
    if (!end_ || !message) return;
    if (const auto* keeper = boost::get_deleter<detail::Keeper<const M>>(message)) {
      send({message, lot::detail::PointerAccess::control(keeper->message)}, false);
    } else {
      publish(*message);
    }
  }
  /// The same by a pointer that could change the message: do not do so any more. Throws the same.
  void publish(const boost::shared_ptr<M>& message) const {
    publish(boost::shared_ptr<M const>(message));
  }

  /// The topic, resolved; empty where there is none. Throws std::bad_alloc.
  std::string getTopic() const { return plain().getTopic(); }
  /// Subscribers that are linked now, plain ones and LOT's. Throws std::bad_alloc.
  std::uint32_t getNumSubscribers() const {
    const auto outlet = end_ ? end_->outlet() : nullptr;
    return outlet ? outlet->subscribers() : 0;
  }
  /// True when this end latches. Throws nothing.
  bool isLatched() const {
    const auto plain = this->plain();
    return plain && plain.isLatched();
  }
  /// How many messages had to be serialised so far, because a subscriber does not read the ring.
  /// Throws nothing.
  std::uint64_t serialised() const {
    const auto outlet = end_ ? end_->outlet() : nullptr;
    return outlet ? outlet->serialised() : 0;
  }
  /// How many went to a subscriber by its link, and not by the ring or from hand to hand:
  /// serialised, or by pointer to a plain one of this process. Throws nothing.
  std::uint64_t by_link() const {
    const auto outlet = end_ ? end_->outlet() : nullptr;
    return outlet ? outlet->by_link() : 0;
  }
  /// Unadvertises, though others have copies; the last end of a topic waits 0.1 s at most for
  /// subscribers that have just come. Throws lot::Error (ECHILD, ESTALE) as the class says.
  void shutdown() {
    if (end_) end_->shutdown();
    end_.reset();
  }
  /// False: it was not advertised, or is shut down. Throws nothing.
  [[nodiscard]] explicit operator bool() const { return bool(plain()); }
  /// There is none: what a ros::Publisher sends is serialised. Does not compile, so throws nothing.
  template <class P, std::enable_if_t<std::is_same_v<P, ::ros::Publisher>, int> = 0>
  operator P() const {
    static_assert(
        !std::is_same_v<P, ::ros::Publisher>,
        "keep it as lot::ros::Publisher<M>, or auto: a ros::Publisher would serialise "
        "each message. (For diagnostic_updater: tick a TopicDiagnostic beside publish().)");
    return {};
  }
  friend bool operator==(const Publisher& a, const Publisher& b) { return a.end_ == b.end_; }
  friend bool operator!=(const Publisher& a, const Publisher& b) { return a.end_ != b.end_; }
  friend bool operator<(const Publisher& a, const Publisher& b) { return a.end_ < b.end_; }

 private:
  ::ros::Publisher plain() const { return end_ ? end_->plain() : ::ros::Publisher(); }
  void send(const detail::Parcel& parcel, bool fresh) const {
    if (const auto outlet = end_->outlet()) outlet->publish(parcel, fresh, end_->id());
  }

  std::shared_ptr<detail::Advertisement> end_;
};

}  // namespace lot::ros
