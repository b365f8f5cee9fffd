// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

#include "lot/any_type.hpp"
#include "lot/detail/arena.hpp"
#include "lot/detail/control.hpp"
#include "lot/detail/message_type.hpp"
#include "lot/mutable_value.hpp"
#include "lot/pointers.hpp"
#include "lot/value.hpp"

namespace lot {

class AnyMessage;

namespace detail {

/// Where the parts of a message that is built in an arena get their memory.
MessageMemory memory_of(Arena* arena) noexcept;

/// A message of the segment, for reading. Throws lot::Error (EINVAL) when this copy of the library
/// has not mapped it.
Value value_of(const Description& description, const void* message);
/// The same of a message that this process has borrowed: so many bytes.
Value borrowed_value_of(const Description& description, const void* message, std::size_t size);
/// The same of a message that this process builds in that arena. Throws the same.
MutableValue mutable_value_of(const Description& description, void* message, Arena* arena);

/// Of a message that this process builds: a reference in it refers to that one, which it keeps.
/// Throws lot::Error (EINVAL), and as an assignment of a ShmRef.
void refer(const MutableValue& reference, const AnyMessage& target);

/// For a publisher or a reader of the type.
const MessageType& type_of(const registry::KnownType& type) noexcept;
/// Throws lot::Error (EINVAL) unless a message of the one type may be pushed on a topic of the
/// other.
void require_same(const AnyType& message, const AnyType& topic);
/// Throws lot::Error (EINVAL) unless the type is opaque as a whole.
void require_opaque(const AnyType& type);

}  // namespace detail

/// A message of any type, and the description of that type: as a ShmSharedPtr, for programs that do
/// not have the type.
///
///     lot::AnyMessage message = seen;                             // a ShmSharedPtr<const Frame>
///     std::cout << message.root() << '\n';
///     if (const auto frame = message.as<Frame>()) use(*frame);
///
/// Threads: distinct objects freely, one object with synchronisation. In a forked child what it has
///          inherited counts nothing.
/// Errors:  the constructor from a pointer throws std::bad_alloc, at its first call for a type;
///          root() and description() throw lot::Error.
/// Memory:  a ShmSharedPtr, and a share of the description, which lies in private memory.
/// Crash:   as a ShmSharedPtr.
class AnyMessage {
 public:
  /// Null.
  AnyMessage() noexcept = default;
  /// Null.
  AnyMessage(std::nullptr_t) noexcept {}
  /// Shares the message of a pointer to the whole of it. Throws std::bad_alloc.
  template <class T>
  AnyMessage(const ShmSharedPtr<T>& message)
      : message_(message), type_(message ? AnyType::of<T>() : AnyType()) {}
  /// A message of that type. REQUIRES: the pointer leads to the whole of it. Throws nothing.
  AnyMessage(ShmSharedPtr<const void> message, AnyType type) noexcept
      : message_(std::move(message)), type_(std::move(type)) {}

  /// False: it is null.
  [[nodiscard]] explicit operator bool() const noexcept { return static_cast<bool>(message_); }
  /// The message, to be read: valid as long as it is held. REQUIRES: it is not null. Throws
  /// lot::Error: EINVAL when this copy of the library has not joined its segment, EBADMSG when the
  /// description is damaged.
  Value root() const { return detail::value_of(type_.description(), message_.get()); }
  /// What it is. None where it is null. Throws nothing.
  const AnyType& type() const noexcept { return type_; }

  /// A pointer to the message, if it is a T, as AnyType::is_same() says. Else null. Throws
  /// std::bad_alloc.
  template <class T>
  [[nodiscard]] ShmSharedPtr<const T> as() const {
    if (!message_ || !type_.is_same(AnyType::of<T>())) return nullptr;
    return {message_, static_cast<const T*>(message_.get())};
  }
  /// The pointer that it is. Throws nothing.
  const ShmSharedPtr<const void>& pointer() const noexcept { return message_; }

  /// Lets the message go, and is null.
  void reset() noexcept { *this = AnyMessage(); }
  /// Exchanges the messages.
  void swap(AnyMessage& other) noexcept {
    message_.swap(other.message_);
    std::swap(type_, other.type_);
  }

 private:
  ShmSharedPtr<const void> message_;
  AnyType type_;
};

}  // namespace lot
