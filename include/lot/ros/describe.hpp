// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include <boost/array.hpp>
#include <ros/duration.h>
#include <ros/message_traits.h>
#include <ros/serialization.h>
#include <ros/time.h>

#include "lot/describe.hpp"
#include "lot/ros/fields.hpp"

/// Describes generated ROS messages (lot/description.hpp): a message's serialiser says where its
/// fields lie and what they are, and its definition says what they are called.
///
///     for (const auto& field : lot::describe<Image>().root().fields) ...  // header, height, ...
///
/// A message has its ROS name. `bool` is a UInt of one byte, as in the generated struct: a
/// publisher may put any number there. A time is a Struct `time` of sec and nsec, a duration a
/// Struct `duration`.
namespace lot::ros::detail {

/// The names of the fields in the text of a definition, in their order. Definitions of other
/// messages may follow.
inline std::vector<std::string> field_names(const std::string& definition) {
  std::vector<std::string> names;
  std::istringstream lines(definition);
  for (std::string line; std::getline(lines, line) && line.compare(0, 5, "=====") != 0;) {
    line.resize(std::min(line.find('#'), line.size()));
    if (line.find('=') != std::string::npos) continue;  // a constant
    std::istringstream words(line);
    std::string type, name;
    if (words >> type >> name) names.push_back(std::move(name));
  }
  return names;
}

/// A stream for ROS's serialisers that describes the fields of a message.
template <class Describer, class Message>
class FieldsDescribed {
 public:
  FieldsDescribed(Describer& describer, const Message& message, Description::Type& type)
      : describer_(describer), begin_(reinterpret_cast<std::uintptr_t>(&message)), type_(type) {}

  template <class F>
  void next(const F& field) {
    const std::uint64_t offset = reinterpret_cast<std::uintptr_t>(std::addressof(field)) - begin_;
    if (offset > sizeof(Message) || sizeof(F) > sizeof(Message) - offset) {
      all_lie_inside_ = false;
    } else {
      describer_.template add_field<F>(type_, {}, offset);
    }
  }
  /// False: the serialiser was written by hand, and has named what is no field.
  bool all_lie_inside() const { return all_lie_inside_; }

 private:
  Describer& describer_;
  std::uintptr_t begin_;
  Description::Type& type_;
  bool all_lie_inside_ = true;
};

/// `T`: a time or a duration.
template <class T>
struct TimeDescribed {
  static constexpr bool known = true;
  template <class Describer>
  static void fill_as(const char* name, Describer& describer, Description::Type& type) {
    type.kind = Kind::Struct;
    type.name = name;
    const T zero;
    FieldsDescribed<Describer, T> fields(describer, zero, type);
    fields.next(zero.sec);
    fields.next(zero.nsec);
    type.fields[0].name = "sec";
    type.fields[1].name = "nsec";
  }
};

}  // namespace lot::ros::detail

namespace lot::detail {

/// A generated message.
template <template <class> class Generated>
struct DescribedBy<Generated<ros::Allocator<void>>> {
  using Message = Generated<ros::Allocator<void>>;
  static constexpr bool known = ::ros::message_traits::IsMessage<Message>::value;

  template <class Describer>
  static void fill(Describer& describer, Description::Type& type) {
    type.name = ::ros::message_traits::DataType<Message>::value();
    const auto message = std::make_unique<const Message>();  // it may be too large for a stack
    ros::detail::FieldsDescribed<Describer, Message> fields(describer, *message, type);
    ::ros::serialization::Serializer<Message>::write(fields, *message);
    if (!fields.all_lie_inside()) {
      type.fields.clear();  // it stays opaque
      return;
    }
    type.kind = Kind::Struct;
    auto names = ros::detail::field_names(::ros::message_traits::Definition<Message>::value());
    if (names.size() != type.fields.size()) return;
    for (std::size_t i = 0; i < names.size(); ++i) type.fields[i].name = std::move(names[i]);
  }
};

/// An array of fixed length.
template <class T, std::size_t N>
struct DescribedBy<boost::array<T, N>> {
  static constexpr bool known = true;
  template <class Describer>
  static void fill(Describer& describer, Description::Type& type) {
    if constexpr (N == 0) {
      type.kind = Kind::Struct;  // its bytes are no element's
    } else {
      describer.template fill_array<T>(type, N);
    }
  }
};

/// A point in time.
template <>
struct DescribedBy<::ros::Time> : ros::detail::TimeDescribed<::ros::Time> {
  template <class Describer>
  static void fill(Describer& describer, Description::Type& type) {
    fill_as("time", describer, type);
  }
};
/// A span of time.
template <>
struct DescribedBy<::ros::Duration> : ros::detail::TimeDescribed<::ros::Duration> {
  template <class Describer>
  static void fill(Describer& describer, Description::Type& type) {
    fill_as("duration", describer, type);
  }
};

}  // namespace lot::detail
