// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include <ros/message_traits.h>
#include <ros/serialization.h>

namespace lot_test {

/// An image, as a node says that was built when its definition was another one.
template <class Allocator>
struct Changed_ {
  std::uint32_t data = 0;
};

}  // namespace lot_test

namespace ros {
namespace message_traits {

template <class A>
struct IsMessage<lot_test::Changed_<A>> : TrueType {};
template <class A>
struct IsMessage<lot_test::Changed_<A> const> : TrueType {};
template <class A>
struct MD5Sum<lot_test::Changed_<A>> {
  static const char* value() { return "0123456789abcdeffedcba9876543210"; }
  static const char* value(const lot_test::Changed_<A>&) { return value(); }
  static const std::uint64_t static_value1 = 0x0123456789abcdef;
  static const std::uint64_t static_value2 = 0xfedcba9876543210;
};
template <class A>
struct DataType<lot_test::Changed_<A>> {
  static const char* value() { return "sensor_msgs/Image"; }
  static const char* value(const lot_test::Changed_<A>&) { return value(); }
};
template <class A>
struct Definition<lot_test::Changed_<A>> {
  static const char* value() { return "uint32 data\n"; }
  static const char* value(const lot_test::Changed_<A>&) { return value(); }
};

}  // namespace message_traits
namespace serialization {

template <class A>
struct Serializer<lot_test::Changed_<A>> {
  template <class Stream, class T>
  static void allInOne(Stream& stream, T message) {
    stream.next(message.data);
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

}  // namespace serialization
}  // namespace ros
