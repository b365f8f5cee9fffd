// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include <boost/array.hpp>
#include <ros/message_traits.h>
#include <ros/serialization.h>

#include "lot/compliance.hpp"
#include "lot/message.hpp"
#include "lot/ros/describe.hpp"
#include "lot/ros/fields.hpp"
#include "lot/type_identity.hpp"

/// Generated ROS messages in shared memory.
///
/// What ROS generates from a .msg file is a template on an allocator. With LOT's it is a message
/// that other processes read in place, with the same fields, md5, printer and serialised bytes:
///
///     using Image = lot::ros::Message<sensor_msgs::Image_>;
///     image->data.resize(16 << 20);                          // in the message, not zeroed
///     sensor_msgs::Image mine;
///     lot::ros::assign(mine, *image);                         // and back: assign(*image, mine)
///
/// A Message that is no loan (`Image copy = *image;`) is an ordinary object on the heap.
namespace lot::ros {

/// The message in shared memory of what ROS has generated: `Message<sensor_msgs::Image_>`.
template <template <class> class Generated>
using Message = Generated<Allocator<void>>;

namespace detail {

/// A stream for ROS's serialisers that notes where the fields of a message lie, in their order.
class Fields {
 public:
  template <class T>
  void next(const T& field) {
    places_.push_back(&field);
  }
  const void* place(std::size_t i) const { return places_[i]; }

 private:
  std::vector<const void*> places_;
};

/// A stream that copies the fields of another message into those that the serialiser names.
class Copier {
 public:
  explicit Copier(const Fields& from) : from_(from) {}
  template <class T>
  void next(T& field) {
    copy(field, *static_cast<const Counterpart<T>*>(from_.place(next_++)));
  }

 private:
  const Fields& from_;
  std::size_t next_ = 0;
};

template <class T>
inline constexpr bool is_vector = false;
template <class T, class A>
inline constexpr bool is_vector<std::vector<T, A>> = true;
template <class T>
inline constexpr bool is_array = false;
template <class T, std::size_t N>
inline constexpr bool is_array<boost::array<T, N>> = true;
template <class T>
inline constexpr bool is_string = false;
template <class A>
inline constexpr bool is_string<std::basic_string<char, std::char_traits<char>, A>> = true;

template <class To>
void copy(To& to, const Counterpart<To>& from) {
  if constexpr (std::is_same_v<To, Counterpart<To>>) {
    to = from;
  } else if constexpr (is_string<To>) {
    to.assign(from.data(), from.size());
  } else if constexpr (is_vector<To>) {
    using Element = typename To::value_type;
    to.resize(from.size());
    if constexpr (std::is_same_v<Element, Counterpart<Element>> &&
                  std::is_trivially_copyable_v<Element>) {
      if (!from.empty()) std::memcpy(to.data(), from.data(), from.size() * sizeof(Element));
    } else {
      for (std::size_t i = 0; i < from.size(); ++i) copy(to[i], from[i]);
    }
  } else if constexpr (is_array<To>) {
    for (std::size_t i = 0; i < from.size(); ++i) copy(to[i], from[i]);
  } else {
    Fields fields;
    ::ros::serialization::Serializer<Counterpart<To>>::write(fields, from);
    Copier copier(fields);
    ::ros::serialization::Serializer<To>::read(copier, to);
  }
}

}  // namespace detail

/// Makes `to` what `from` is: one copy of each field. Either may be the standard message. Throws
/// lot::OutOfMemory and lot::Error as ShmAllocator, std::bad_alloc.
template <class To>
void assign(To& to, const detail::Counterpart<To>& from) {
  detail::copy(to, from);
}

/// The standard message of a Message, sensor_msgs::Image of Message<sensor_msgs::Image_>.
template <class T>
using Standard = typename detail::Kin<T>::Standard;

}  // namespace lot::ros

namespace lot {

/// Its fields are numbers, and strings and vectors whose pointers are relative.
template <template <class> class Generated>
struct is_trusted_message<Generated<ros::Allocator<void>>>
    : std::bool_constant<::ros::message_traits::IsMessage<Generated<ros::Allocator<void>>>::value> {
};

/// The ROS name, and the md5 of its definition.
template <template <class> class Generated>
struct TypeIdentity<Generated<ros::Allocator<void>>> {
  using Type = Generated<ros::Allocator<void>>;
  static const char* name() { return ::ros::message_traits::DataType<Type>::value(); }
  static constexpr std::uint64_t hash() {
    return ::ros::message_traits::MD5Sum<Type>::static_value1 ^
           ::ros::message_traits::MD5Sum<Type>::static_value2;
  }
};

}  // namespace lot

namespace ros::message_traits {

/// As for the standard message, by the types that the message has. (The functions header() and
/// frameId() of roscpp return pointers into the standard message: they are for that alone.)
template <template <class> class Generated>
struct FrameId<Generated<lot::ros::Allocator<void>>,
               typename boost::enable_if<HasHeader<Generated<lot::ros::Allocator<void>>>>::type> {
  using Type = Generated<lot::ros::Allocator<void>>;
  static auto* pointer(Type& m) { return &m.header.frame_id; }
  static const auto* pointer(const Type& m) { return &m.header.frame_id; }
  static std::string value(const Type& m) {
    return {m.header.frame_id.data(), m.header.frame_id.size()};
  }
};
/// As for the standard message.
template <template <class> class Generated>
struct Header<Generated<lot::ros::Allocator<void>>,
              typename boost::enable_if<HasHeader<Generated<lot::ros::Allocator<void>>>>::type> {
  using Type = Generated<lot::ros::Allocator<void>>;
  static auto* pointer(Type& m) { return &m.header; }
  static const auto* pointer(const Type& m) { return &m.header; }
};

}  // namespace ros::message_traits
