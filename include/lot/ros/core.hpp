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
#include "lot/detail/message_type.hpp"
#include "lot/pointers.hpp"
#include "lot/pusher.hpp"
#include "lot/ros/message.hpp"

/// The untyped halves of lot::ros::Publisher and Subscriber. They live in the library.
namespace lot::ros::detail {

/// What a boost::shared_ptr to a message in shared memory has as its deleter: LOT's own pointer.
template <class M>
struct Keeper {
  ShmSharedPtr<M> message;
  void operator()(const void*) noexcept { message.reset(); }
};

/// A message on its way: the pointer that callbacks get, and its place in the segment. One of the
/// two pointers may be null.
struct Parcel {
  boost::shared_ptr<void const> message;
  lot::detail::ControlBlock* control = nullptr;  ///< null: it lies on the heap
  /// The same message as roscpp's own type, as the user has published it.
  boost::shared_ptr<void const> standard = nullptr;
};

template <class M>
Parcel parcel_of(ShmSharedPtr<const M> message) {
  const M* const place = message.get();
  lot::detail::ControlBlock* const control = lot::detail::PointerAccess::control(message);
  return {boost::shared_ptr<M const>(place, Keeper<const M>{std::move(message)}), control};
}

/// What LOT must know of the standard message of a type, sensor_msgs::Image of Message<Image_>.
struct StandardKind {
  const std::type_info* type;
  ::ros::SerializedMessage (*serialise)(const void* standard);
  void* (*make)();
  void (*destroy)(void* standard) noexcept;
  /// Copies `message` into the standard message, in the memory that this one has.
  void (*assign)(void* standard, const void* message);
  /// Copies the standard message into a loan. Throws lot::OutOfMemory.
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

/// What LOT must know of a message type.
struct Kind {
  const char* datatype;
  const char* md5sum;
  const char* definition;
  bool has_header;
  std::size_t least_bytes;  ///< the fewest bytes that a message serialises to
  const std::type_info* type;
  const lot::detail::MessageType* layout;
  ::ros::SerializedMessage (*serialise)(const void* message);
  void (*set_sequence)(void* message, std::uint32_t sequence);
  /// The pointer that callbacks get to a message that LOT's thread has pulled.
  boost::shared_ptr<void const> (*adopt)(const lot::detail::Borrowed& kept);
  /// Makes a message on the heap from the bytes of a link's frame.
  boost::shared_ptr<void> (*deserialise)(std::uint8_t* bytes, std::uint32_t length);
  /// Copies a message into a loan. Throws lot::OutOfMemory.
  Parcel (*copy_into)(const lot::detail::Loan& loan, const void* message);
  /// Where a message lies in the segment; null: it is on the heap.
  lot::detail::ControlBlock* (*control_of)(const boost::shared_ptr<void const>& message);
  StandardKind standard;
};

/// Hidden: each library that uses it has its own copy, whose functions are of that library's
/// version.
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
            lot::detail::PointerAccess::shared(static_cast<const M*>(kept.root), kept.control);
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
      [](const boost::shared_ptr<void const>& message) -> lot::detail::ControlBlock* {
        const auto* keeper = boost::get_deleter<Keeper<const M>>(message);
        return keeper == nullptr ? nullptr : lot::detail::PointerAccess::control(keeper->message);
      },
      standard_kind_of<M>()};
  return kind;
}

/// One topic that this process publishes, for all of the user's publishers of it.
///
/// Threads: all members may be called at once.
class Outlet {
 public:
  virtual ~Outlet() = default;
  /// A place to build a message. `cell` null: LOT is off in this process or out of memory, and
  /// messages lie on the heap.
  virtual lot::detail::Loan loan() = 0;
  /// Makes memory ready for `count` messages of `bytes` each. Does nothing where LOT is off.
  virtual void reserve(std::size_t count, std::size_t bytes) = 0;
  /// Publishes a message. `fresh`: no other thread has the message yet, so the outlet may set the
  /// number in its header. `end`: the user's end that publishes it.
  virtual void publish(const Parcel& parcel, bool fresh, std::uint64_t end) = 0;
  virtual std::uint64_t serialised() const = 0;  ///< messages that were serialised so far
  virtual std::uint64_t by_link() const = 0;     ///< messages sent on links, for each link
  /// How many links there are whose subscribers get what is published from now on.
  virtual std::uint32_t subscribers() const = 0;
};

/// One publisher of the user's: advertised until it is shut down or destroyed.
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

/// One subscriber of the user's.
///
/// Threads: all members may be called at once.
class Subscription {
 public:
  virtual ~Subscription() = default;
  virtual std::uint32_t publishers() const = 0;
  /// Whether the node that sent messages latches. Nothing: the node has yet to say so.
  virtual std::optional<bool> latches(const std::string& publisher) const = 0;
  virtual std::string topic() const = 0;
  /// Ends the subscriber. When it returns, none of its callbacks begins any more, and none is at
  /// work, but one in the calling thread.
  virtual void shutdown() = 0;
};
/// Null when ROS refuses it. Throws ros::ConflictingSubscriptionException.
std::shared_ptr<Subscription> subscribe(::ros::NodeHandle& node,
                                        const ::ros::SubscribeOptions& options, const Kind& kind);

/// Makes standard messages of messages in shared memory. It uses the memory of released ones again.
///
/// Threads: all members may be called at once.
/// Memory:  keeps that of at most `kIdle` messages that have no pointer left.
class Converter {
 public:
  using Pointer = boost::shared_ptr<void const>;
  static constexpr std::size_t kIdle = 4;
  virtual ~Converter() = default;
  /// A standard message for the caller alone: roscpp lets a topic's only subscriber of a process
  /// change it.
  virtual Pointer make(const Pointer& message) = 0;
  /// A standard message that all callers of this process share, as long as one of them has a
  /// pointer to it.
  virtual Pointer shared(const Pointer& message) = 0;
};
std::shared_ptr<Converter> make_converter(const Kind& kind);

/// Makes messages that no publisher has loaned. Null: LOT is off in this process.
std::shared_ptr<lot::detail::PusherCore> maker();

}  // namespace lot::ros::detail
