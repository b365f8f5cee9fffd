// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstring>
#include <memory>
#include <utility>

#include "lot/any_message.hpp"
#include "lot/detail/core.hpp"
#include "lot/duration.hpp"
#include "lot/mutable_value.hpp"
#include "lot/pointers.hpp"
#include "lot/stop_token.hpp"

namespace lot {

/// A message of any type that only its maker can see: as a ShmUniquePtr, built by its description.
///
/// Threads: one at a time.
/// Errors:  root() throws; so does what makes the message grow: see MutableValue.
/// Memory:  the message has its memory in the segment until this has gone, or it is pushed.
/// Crash:   another process frees the message.
class AnyLoan {
 public:
  /// None.
  AnyLoan() noexcept = default;
  /// For AnyPusher: a message that the publisher has lent, with nothing in it yet. Throws
  /// lot::Error as AnyPusher::loan(), and then the message is free again. `zeroed`: as
  /// loan_zeroed().
  AnyLoan(const detail::Loan& loan, AnyType type, bool zeroed)
      : message_(detail::PointerAccess::unique(static_cast<std::byte*>(loan.root), loan.control)),
        arena_(loan.arena),
        type_(std::move(type)) {
    if (zeroed) {
      std::memset(message_.get(), 0, type_.size());
    } else {
      root().construct();
    }
  }

  /// False: there is none.
  [[nodiscard]] explicit operator bool() const noexcept { return static_cast<bool>(message_); }
  /// The message, to be built. REQUIRES: there is one. Throws lot::Error (ECHILD).
  MutableValue root() const {
    return detail::mutable_value_of(type_.description(), message_.get(), arena_);
  }
  /// Where it lies, so many bytes as its type says; null: there is none. Throws nothing.
  void* data() const noexcept { return message_.get(); }
  /// What it is. Throws nothing.
  const AnyType& type() const noexcept { return type_; }
  /// Has a reference in the message refer to another message, which this one keeps then; null: to
  /// nothing. REQUIRES: `reference` is a place in root(). Throws lot::Error: EINVAL where it is no
  /// reference, or refers to messages of another type; as an assignment of a ShmRef.
  void refer(const MutableValue& reference, const AnyMessage& target) const {
    detail::refer(reference, target);
  }
  /// The message as it is, for all who get it from here on: to be pushed on several topics, or
  /// referred to by others. The loan is empty then. Throws nothing.
  [[nodiscard]] AnyMessage share() && noexcept {
    arena_ = nullptr;
    return AnyMessage(ShmSharedPtr<const void>(std::move(message_)), std::move(type_));
  }

 private:
  friend class AnyPusher;
  friend class AnyQueue;

  ShmUniquePtr<std::byte> message_;
  detail::Arena* arena_ = nullptr;
  AnyType type_;
};

/// Publishes messages on a topic without having their type: as ShmPusher. For
/// ShmEngine::advertise_any().
///
///     lot::AnyLoan message = pusher.loan();
///     message.root()["width"].set(640);
///     (void)pusher.push(std::move(message));
///     (void)pusher.push(seen);                 // an AnyMessage of another topic: no copy
///
/// Threads: all members may be called at once, but for assignment and destruction.
/// Errors:  as ShmPusher.
/// Memory:  as ShmPusher. The process keeps the description of each type that it publishes so,
///          once, until it leaves the segment.
/// Crash:   as ShmPusher.
class AnyPusher {
 public:
  /// For ShmEngine::advertise_any(). Throws nothing.
  AnyPusher(std::unique_ptr<detail::PusherCore> core, AnyType type,
            std::chrono::nanoseconds block_for)
      : core_(std::move(core)), type_(std::move(type)), block_for_(block_for) {}

  /// What the topic carries. Throws nothing.
  const AnyType& type() const noexcept { return type_; }

  /// A new message: numbers are zero, strings and vectors empty, references refer to nothing. What
  /// the type itself would give its fields for a start is not known here.
  /// Errors: lot::OutOfMemory as ShmPusher::loan(). lot::Error as ShmPusher; EINVAL when a part of
  /// the type is opaque: only its own programs can make that; EBADMSG when the description is
  /// damaged.
  [[nodiscard]] AnyLoan loan() {
    return {core_->loan(detail::type_of(*type_.known()), true), type_, false};
  }
  /// The same of a type that is opaque as a whole: all its bytes are zero. For a program that knows
  /// what they mean, as that of AnyType::opaque().
  /// Errors: EINVAL when the type is not opaque; else as loan().
  [[nodiscard]] AnyLoan loan_zeroed() {
    detail::require_opaque(type_);
    return {core_->loan(detail::type_of(*type_.known()), true), type_, true};
  }

  /// Publishes. It waits, and says Status::Full or Status::Stopped, as ShmPusher::push(): the
  /// message stays with the caller then, and where this throws. Throws lot::Error as ShmPusher, and
  /// EINVAL for a message of another publisher's type.
  [[nodiscard]] Status push(AnyLoan&& message, const StopToken& stop = {}) {
    return push(std::move(message), block_for_, stop);
  }
  /// The same with another limit than the options'. Throws the same.
  [[nodiscard]] Status push(AnyLoan&& message, Duration block_for, const StopToken& stop = {}) {
    require(message.type_);
    const Status status = core_->push_unique(detail::PointerAccess::control(message.message_),
                                             {block_for, stop.word()});
    if (status == Status::Ok) detail::PointerAccess::take(message.message_);
    return status;
  }
  /// Publishes a message that was received, or is kept: no copy. It waits, and says Status::Full,
  /// as the other push(). Throws lot::Error as that of a ShmSharedPtr, and EINVAL when the message
  /// is of another type than the topic's.
  [[nodiscard]] Status push(const AnyMessage& message, const StopToken& stop = {}) {
    return push(message, block_for_, stop);
  }
  /// The same with another limit than the options'. Throws the same.
  [[nodiscard]] Status push(const AnyMessage& message, Duration block_for,
                            const StopToken& stop = {}) {
    require(message.type());
    return core_->push_shared(detail::PointerAccess::control(message.pointer()),
                              message.pointer().get(), {block_for, stop.word()});
  }

  /// Subscribers that read this publisher: see ShmPusher::readers(). Throws the same.
  std::size_t readers() const { return core_->readers(); }
  /// Waits until so many read this publisher: see ShmPusher::wait_for_readers(). Throws the same.
  [[nodiscard]] bool wait_for_readers(std::size_t count, Duration timeout,
                                      const StopToken& stop = {}) {
    return core_->wait_for_readers(count, detail::Limit::until(detail::after(timeout), stop));
  }
  /// The same without a limit. Throws the same.
  [[nodiscard]] bool wait_for_readers(std::size_t count, const StopToken& stop) {
    return core_->wait_for_readers(count, detail::Limit::forever(stop));
  }
  /// Makes memory for `count` messages of `bytes` each: see ShmPusher::reserve(). Throws the same.
  void reserve(std::size_t count, std::size_t bytes) { core_->reserve(count, bytes); }

 private:
  /// A null message passes: the push refuses it.
  void require(const AnyType& type) const {
    if (type && type.known() != type_.known()) detail::require_same(type, type_);
  }

  std::unique_ptr<detail::PusherCore> core_;
  AnyType type_;
  std::chrono::nanoseconds block_for_;
};

}  // namespace lot
