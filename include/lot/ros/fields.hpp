// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include <boost/array.hpp>
#include <boost/shared_ptr.hpp>
#include <std_msgs/Header.h>

#include "lot/message.hpp"

/// Strings, vectors and headers of messages in shared memory, which convert to and from the
/// standard ones:
///
///     std::string frame = image->header.frame_id;
///     if (image->encoding == sensor_msgs::image_encodings::BGR8) ...
///     std::vector<std::uint8_t> bytes = image->data;           // one copy
///     mine->header = theirs.header;                             // a std_msgs::Header
///
/// Each is one of lot:: (ShmString, ShmVector), with the same bytes; what ROS generates names its
/// fields' types by the message's allocator, and so this one is of a name of its own.
namespace lot::ros {

/// The allocator of containers in messages of ROS: ShmAllocator by another name, so that they can
/// be specialised.
///
/// Threads: as ShmAllocator.
/// Errors:  as ShmAllocator.
/// Memory:  as ShmAllocator.
/// Crash:   as ShmAllocator.
template <class T>
class Allocator : public ShmAllocator<T> {
 public:
  template <class U>
  struct rebind {
    using other = Allocator<U>;
  };

  Allocator() = default;
  /// Allocates in the same message as `other`, or on the heap as `other` does.
  template <class U>
  Allocator(const ShmAllocator<U>& other) noexcept : ShmAllocator<T>(other) {}
};

/// A string in a message of ROS; it converts to and from std::string by a copy.
using String = std::basic_string<char, std::char_traits<char>, Allocator<char>>;
/// An array in a message of ROS; it converts to and from std::vector by a copy.
template <class T>
using Vector = std::vector<T, Allocator<T>>;

namespace detail {

/// The type of a field in the standard message, and in the one in shared memory.
template <class T>
struct Kin {
  using Standard = T;
  using Shared = T;
};
template <template <class> class Generated>
struct Kin<Generated<Allocator<void>>> {
  using Standard = Generated<std::allocator<void>>;
  using Shared = Generated<Allocator<void>>;
};
template <template <class> class Generated>
struct Kin<Generated<std::allocator<void>>> : Kin<Generated<Allocator<void>>> {};
template <class A>
struct Kin<std::basic_string<char, std::char_traits<char>, A>> {
  using Standard = std::string;
  using Shared = String;
};
template <class T, class A>
struct Kin<std::vector<T, A>> {
  using Standard = std::vector<typename Kin<T>::Standard>;
  using Shared = Vector<typename Kin<T>::Shared>;
};
template <class T, std::size_t N>
struct Kin<boost::array<T, N>> {
  using Standard = boost::array<typename Kin<T>::Standard, N>;
  using Shared = boost::array<typename Kin<T>::Shared, N>;
};

/// T's counterpart: the standard type's is the shared one, and the other way round.
template <class T>
using Counterpart = std::conditional_t<std::is_same_v<T, typename Kin<T>::Standard>,
                                       typename Kin<T>::Shared, typename Kin<T>::Standard>;

template <class To>
void copy(To& to, const Counterpart<To>& from);

}  // namespace detail
}  // namespace lot::ros

namespace std {

/// lot::ros::String: a lot::ShmString that converts to and from std::string.
///
/// Threads: as a std::string: one thread changes it, any number read it.
/// Errors:  what makes it grow throws as ShmAllocator; a conversion to std::string std::bad_alloc.
/// Memory:  in the message that it is built in, else on the heap.
/// Crash:   it goes with its message.
template <>
class basic_string<char, char_traits<char>, lot::ros::Allocator<char>> : public lot::ShmString {
  using Shared = lot::ShmString;
  using Standard = string;

 public:
  using Shared::Shared;
  using Shared::operator=;
  basic_string() = default;
  basic_string(const basic_string&) = default;
  /// Takes the other's memory over only where both are of one message, or of none.
  basic_string(basic_string&& other) : Shared() { Shared::operator=(std::move(other)); }
  basic_string& operator=(const basic_string&) = default;
  basic_string& operator=(basic_string&&) = default;
  ~basic_string() = default;
  basic_string(const Shared& other) : Shared(other) {}
  basic_string(const Standard& other) : Shared(other.data(), other.size()) {}

  /// A copy on the heap.
  operator Standard() const { return {data(), size()}; }
  /// A copy, as that of a std::string; std::out_of_range where it begins behind the end.
  basic_string substr(size_type begin = 0, size_type count = npos) const {
    return basic_string(Shared::substr(begin, count));
  }

  friend Standard operator+(const basic_string& a, const Standard& b) { return Standard(a) += b; }
  friend Standard operator+(const Standard& a, const basic_string& b) {
    return Standard(a).append(b.data(), b.size());
  }
  friend bool operator==(const basic_string& a, const Standard& b) { return a.compare(b) == 0; }
  friend bool operator!=(const basic_string& a, const Standard& b) { return a.compare(b) != 0; }
  friend bool operator<(const basic_string& a, const Standard& b) { return a.compare(b) < 0; }
  friend bool operator>(const basic_string& a, const Standard& b) { return a.compare(b) > 0; }
  friend bool operator<=(const basic_string& a, const Standard& b) { return a.compare(b) <= 0; }
  friend bool operator>=(const basic_string& a, const Standard& b) { return a.compare(b) >= 0; }
  friend bool operator==(const Standard& a, const basic_string& b) { return b == a; }
  friend bool operator!=(const Standard& a, const basic_string& b) { return b != a; }
  friend bool operator<(const Standard& a, const basic_string& b) { return b > a; }
  friend bool operator>(const Standard& a, const basic_string& b) { return b < a; }
  friend bool operator<=(const Standard& a, const basic_string& b) { return b >= a; }
  friend bool operator>=(const Standard& a, const basic_string& b) { return b <= a; }
};

/// As that of std::string.
template <>
struct hash<lot::ros::String> : hash<lot::ShmString> {};

/// lot::ros::Vector: a lot::ShmVector that converts to and from std::vector, and so do its
/// elements.
///
/// Threads: as a std::vector: one thread changes it, any number read it.
/// Errors:  what makes it grow throws as ShmAllocator; a conversion to std::vector std::bad_alloc.
/// Memory:  in the message that it is built in, else on the heap.
/// Crash:   it goes with its message.
template <class T>
class vector<T, lot::ros::Allocator<T>> : public lot::ShmVector<T> {
  using Shared = lot::ShmVector<T>;
  using StandardElement = typename lot::ros::detail::Kin<T>::Standard;
  using Standard = vector<StandardElement>;

 public:
  using Shared::operator=;
  using Shared::push_back;
  using Shared::Shared;
  vector() = default;
  vector(const vector&) = default;
  /// Takes the other's memory over only where both are of one message, or of none.
  vector(vector&& other) : Shared() { Shared::operator=(std::move(other)); }
  vector& operator=(const vector&) = default;
  vector& operator=(vector&&) = default;
  ~vector() = default;
  vector(const Shared& other) : Shared(other) {}
  vector(const Standard& other) { *this = other; }

  /// Becomes what a std::vector is: one copy.
  vector& operator=(const Standard& other) {
    lot::ros::detail::copy(*this, other);
    return *this;
  }
  /// A copy on the heap.
  operator Standard() const {
    Standard made;
    lot::ros::detail::copy(made, *this);
    return made;
  }
  /// A standard message, into a vector of messages.
  template <class S, enable_if_t<is_same_v<S, StandardElement> && !is_same_v<S, T>, int> = 0>
  void push_back(const S& element) {
    this->emplace_back();
    lot::ros::detail::copy(this->back(), element);
  }

  friend bool operator==(const vector& a, const Standard& b) {
    return a.size() == b.size() && equal(a.begin(), a.end(), b.begin());
  }
  friend bool operator!=(const vector& a, const Standard& b) { return !(a == b); }
  friend bool operator==(const Standard& a, const vector& b) { return b == a; }
  friend bool operator!=(const Standard& a, const vector& b) { return !(b == a); }
};

}  // namespace std

namespace std_msgs {

/// As it is generated, and assignable to and from the standard one.
template <>
struct Header_<lot::ros::Allocator<void>> {
  using Type = Header_;
  using Ptr = boost::shared_ptr<Header_>;
  using ConstPtr = boost::shared_ptr<Header_ const>;
  using _seq_type = uint32_t;
  using _stamp_type = ::ros::Time;
  using _frame_id_type = lot::ros::String;

  Header_() = default;
  explicit Header_(const lot::ros::Allocator<void>& allocator) : frame_id(allocator) {}
  Header_(const Header_<std::allocator<void>>& other)
      : seq(other.seq), stamp(other.stamp), frame_id(other.frame_id) {}

  operator Header_<std::allocator<void>>() const {
    Header_<std::allocator<void>> made;
    made.seq = seq;
    made.stamp = stamp;
    made.frame_id = frame_id;
    return made;
  }

  _seq_type seq = 0;
  _stamp_type stamp;
  _frame_id_type frame_id;
};

}  // namespace std_msgs
