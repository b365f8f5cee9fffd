// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <typeinfo>
#include <utility>

#include <boost/shared_ptr.hpp>
#include <ros/advertise_options.h>
#include <ros/message_traits.h>
#include <ros/node_handle.h>
#include <ros/serialization.h>
#include <ros/subscribe_options.h>

#include "lot/detail/core.hpp"
#include "lot/pointers.hpp"
#include "lot/pusher.hpp"
#include "lot/ros/message.hpp"

/// The untyped halves of lot::ros::Publisher and Subscriber; they live in the library.
namespace lot::ros::detail {

/// What a boost::shared_ptr to a message in shared memory has as its deleter: LOT's own pointer.
template <class M>
struct Keeper {
  ShmSharedPtr<M> message;
  void operator()(const void*) noexcept { message.reset(); }
};

/// A message on its way: as callbacks get it, and where it is in the segment. One of the two
/// pointers may be null.
struct Parcel {
  boost::shared_ptr<void const> message;
  lot::detail::ControlCell* cell = nullptr;  ///< null: it lies on the heap
  /// The same as roscpp's own type, as the user has published it.
  boost::shared_ptr<void const> standard = nullptr;
};

template <class M>
Parcel parcel_of(ShmSharedPtr<const M> message) {
  const M* const place = message.get();
  lot::detail::ControlCell* const cell = lot::detail::PointerAccess::cell(message);
  return {boost::shared_ptr<M const>(place, Keeper<const M>{std::move(message)}), cell};
}

/// What must be known of the standard message of a type, sensor_msgs::Image of Message<Image_>.
struct StandardKind {
  const std::type_info* type;
  ::ros::SerializedMessage (*serialise)(const void* standard);
  void* (*make)();
  void (*destroy)(void* standard) noexcept;
  /// Makes it what `message` is, in the memory that it has.
  void (*assign)(void* standard, const void* message);
  /// A message in a loan that is what it is. Throws lot::OutOfMemory.
  Parcel (*copy_into)(const lot::detail::Loan& loan, const void* standard);
};

template <class M>
StandardKind standard_kind_of() {
  using S = Standard<M>;
  return {&typeid(S),
          [](const void* standard) {
            return ::ros::serialization::serializeMessage(*static_cast<const S*>(standard));
          },
          []() -> void* { return new S; },
          [](void* standard) noexcept { delete static_cast<S*>(standard); },
          [](void* standard, const void* message) {
            ros::assign(*static_cast<S*>(standard), *static_cast<const M*>(message));
          },
          [](const lot::detail::Loan& loan, const void* standard) {
            auto copy = lot::detail::build<M>(loan);
            ros::assign(*copy, *static_cast<const S*>(standard));
            return parcel_of(ShmSharedPtr<const M>(std::move(copy)));
          }};
}

/// What must be known of a message type.
struct Kind {
  const char* datatype;
  const char* md5sum;
  const char* definition;
  bool has_header;
  std::size_t least_bytes;  ///< that a message serialises to
  const std::type_info* type;
  const lot::detail::MessageType* layout;
  ::ros::SerializedMessage (*serialise)(const void* message);
  void (*set_sequence)(void* message, std::uint32_t sequence);
  /// A message that was pulled, as callbacks get it.
  boost::shared_ptr<void const> (*adopt)(const lot::detail::Borrowed& kept);
  /// A message on the heap that has come over a link.
  boost::shared_ptr<void> (*deserialise)(std::uint8_t* bytes, std::uint32_t length);
  /// A copy of it in a loan. Throws lot::OutOfMemory.
  Parcel (*copy_into)(const lot::detail::Loan& loan, const void* message);
  /// Where a message lies in the segment; null: it is on the heap.
  lot::detail::ControlCell* (*cell_of)(const boost::shared_ptr<void const>& message);
  StandardKind standard;
};

/// Hidden: each library that uses it has its own, whose functions are of its version.
template <class M>
[[gnu::visibility("hidden")]] const Kind& kind_of() {
  namespace traits = ::ros::message_traits;
  namespace serialization = ::ros::serialization;
  static const Kind kind{
      traits::DataType<M>::value(),
      traits::MD5Sum<M>::value(),
      traits::Definition<M>::value(),
      traits::HasHeader<M>::value,
      serialization::serializationLength(M()),
      &typeid(M),
      &lot::detail::message_type<M>(),
      [](const void* message) {
        return serialization::serializeMessage(*static_cast<const M*>(message));
      },
      [](void* message, std::uint32_t sequence) {
        if constexpr (traits::HasHeader<M>::value) {
          static_cast<M*>(message)->header.seq = sequence;
        } else {
          (void)message, (void)sequence;
        }
      },
      [](const lot::detail::Borrowed& kept) -> boost::shared_ptr<void const> {
        auto message =
            lot::detail::PointerAccess::shared(static_cast<const M*>(kept.root), kept.cell);
        const M* const place = message.get();
        return boost::shared_ptr<M const>(place, Keeper<const M>{std::move(message)});
      },
      [](std::uint8_t* bytes, std::uint32_t length) -> boost::shared_ptr<void> {
        auto message = boost::make_shared<M>();
        serialization::IStream stream(bytes, length);
        serialization::deserialize(stream, *message);
        return message;
      },
      [](const lot::detail::Loan& loan, const void* message) {
        auto copy = lot::detail::build<M>(loan);
        *copy = *static_cast<const M*>(message);
        return parcel_of(ShmSharedPtr<const M>(std::move(copy)));
      },
      [](const boost::shared_ptr<void const>& message) -> lot::detail::ControlCell* {
        const auto* keeper = boost::get_deleter<Keeper<const M>>(message);
        return keeper == nullptr ? nullptr : lot::detail::PointerAccess::cell(keeper->message);
      },
      standard_kind_of<M>()};
  return kind;
}

/// All that publishes one topic in this process.
///
/// Threads: all members may be called at once.
class Outlet {
 public:
  virtual ~Outlet() = default;
  /// cell null: LOT is off in this process, or out of memory: messages lie on the heap.
  virtual lot::detail::Loan loan() = 0;
  /// Makes memory for so many messages ready, `bytes` each; nothing where LOT is off.
  virtual void reserve(std::size_t count, std::size_t bytes) = 0;
  /// `fresh`: nobody else has the message yet, so that its header's number is ours to set. `end`:
  /// the user's end that it comes from.
  virtual void publish(const Parcel& parcel, bool fresh, std::uint64_t end) = 0;
  virtual std::uint64_t serialised() const = 0;  ///< messages so far
  virtual std::uint64_t by_link() const = 0;     ///< messages so far, each link for itself
  /// Links whose subscribers get what is published from now on.
  virtual std::uint32_t subscribers() const = 0;
};

/// An end of a topic that the user has: advertised until it is shut down or destroyed.
///
/// Threads: all members may be called at once.
class Advertisement {
 public:
  virtual ~Advertisement() = default;
  virtual std::uint64_t id() const = 0;
  virtual std::shared_ptr<Outlet> outlet() const = 0;  ///< null: shut down
  virtual ::ros::Publisher plain() const = 0;          ///< invalid: shut down
  virtual void shutdown() = 0;
};
/// Null when ROS refuses it, which it has logged.
std::shared_ptr<Advertisement> advertise(::ros::NodeHandle& node,
                                         const ::ros::AdvertiseOptions& options, const Kind& kind);

/// Threads: all members may be called at once.
class Subscription {
 public:
  virtual ~Subscription() = default;
  virtual std::uint32_t publishers() const = 0;
  /// Whether a node that messages came from latches; nothing: it has yet to say so.
  virtual std::optional<bool> latches(const std::string& publisher) const = 0;
  virtual std::string topic() const = 0;
  /// No callback begins after this, and none is at work when it returns, but in its own thread.
  virtual void shutdown() = 0;
};
/// Null when ROS refuses it. Throws ros::ConflictingSubscriptionException.
std::shared_ptr<Subscription> subscribe(::ros::NodeHandle& node,
                                        const ::ros::SubscribeOptions& options, const Kind& kind);

/// Makes standard messages of others. The memory of those that have gone is used again.
///
/// Threads: all members may be called at once.
/// Memory:  keeps that of at most `kIdle` messages that have no pointer left.
class Converter {
 public:
  using Pointer = boost::shared_ptr<void const>;
  static constexpr std::size_t kIdle = 4;
  virtual ~Converter() = default;
  /// One for the caller alone: roscpp lets a topic's only subscriber of a process change it.
  virtual Pointer make(const Pointer& message) = 0;
  /// One that all callers of this process share, as long as one of them has a pointer to it.
  virtual Pointer shared(const Pointer& message) = 0;
};
std::shared_ptr<Converter> make_converter(const Kind& kind);

/// Where a message may be made that no publisher has loaned; null: LOT is off in this process.
std::shared_ptr<lot::detail::PusherCore> maker();

}  // namespace lot::ros::detail
