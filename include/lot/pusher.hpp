// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <memory>
#include <utility>

#include "lot/compliance.hpp"
#include "lot/detail/core.hpp"
#include "lot/detail/message_type.hpp"
#include "lot/duration.hpp"
#include "lot/pointers.hpp"
#include "lot/stop_token.hpp"

namespace lot {

namespace detail {

/// Builds a T in a loan; containers in it that are default-constructed meanwhile belong to it.
template <class T, class... Args>
ShmUniquePtr<T> build(const Loan& loan, Args&&... args) {
  void* const root = alone(loan.root);
  struct Abandon {  // when the constructor of T throws
    ControlBlock* control;
    ~Abandon() {
      if (control == nullptr) return;
      control->type = nullptr;
      control->hub->abandoned(control);
    }
  } abandon{alone(loan.control)};
  T* object;
  if constexpr (sizeof...(Args) == 0 && std::is_trivially_default_constructible_v<T>) {
    object = ::new (root) T;  // no zeroing of pixels
  } else {
    const BuildScope scope(loan.arena);
    // As const: a move would take memory along that is not the message's.
    if constexpr (sizeof...(Args) == 0) {
      object = ::new (root) T;
    } else if constexpr (std::is_constructible_v<T, const Args&...>) {
      object = ::new (root) T(static_cast<const Args&>(args)...);
    } else {
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
      object = ::new (root) T{static_cast<const Args&>(args)...};
#pragma GCC diagnostic pop
    }
  }
  return PointerAccess::unique(object, std::exchange(abandon.control, nullptr));
}

/// The control block of a message that is to be pushed. Throws lot::Error (EINVAL) for a pointer
/// that was converted to one to a base: readers would find a message of another type. The type is
/// known where the message was made; one that was taken from a queue is not looked at.
template <class T>
ControlBlock* whole(const ShmUniquePtr<T>& message, const MessageType& type = message_type<T>()) {
  ControlBlock* const control = PointerAccess::control(message);
  if (control != nullptr && control->type != &type && control->type != nullptr) {
    require_type(*control, type);
  }
  return control;
}

}  // namespace detail

/// Publishes messages of type T on a topic.
///
///     auto frame = pusher.loan();
///     frame->data.resize(16 << 20);         // not zeroed
///     (void)pusher.push(std::move(frame));  // readers see these bytes
///
/// A push costs the same for any number of readers that are awake, and makes no system call. Where
/// readers sleep it makes one, which takes longer with each of them.
///
/// Threads: all members may be called at once, but for assignment and destruction.
/// Errors:  lot::Error: ECHILD in a forked child, ESTALE in a process that was taken for dead; with
///          QueueEngine::Mutex EBUSY when a stopped process keeps the queue's lock for five
///          seconds. lot::OutOfMemory when the segment has no room for a message, std::bad_alloc
///          when the process has none. What throws has published nothing.
/// Memory:  in the segment a queue of PusherOptions::depth slots and EngineOptions::readers cells,
///          the messages in it, and what reserve() made. Messages keep their memory for the next
///          loans, and give it back when they are idle for some seconds.
/// Crash:   readers read what was pushed to its end; other processes free what was only loaned.
template <class T>
class ShmPusher {
 public:
  /// For ShmEngine::advertise(). Throws nothing.
  ShmPusher(std::unique_ptr<detail::PusherCore> core, std::chrono::nanoseconds block_for)
      : core_(std::move(core)), block_for_(block_for) {}

  /// A new message, built in shared memory from args. Plain types are not zeroed.
  /// Errors: lot::OutOfMemory; under Policy::Block after PusherOptions::block_for, if readers have
  /// yet to read what has the memory. lot::Error as the class says. What the constructor of T
  /// throws.
  template <class... Args>
  [[nodiscard]] ShmUniquePtr<T> loan(Args&&... args) {
    return detail::build<T>(core_->loan(*type_, true), std::forward<Args>(args)...);
  }
  /// The same, but null at once when the segment has no room for the struct. Vectors and strings in
  /// it ask for memory when they grow, as those of a loan() do, and throw lot::OutOfMemory.
  /// Errors: lot::Error as the class says; what the constructor of T throws.
  template <class... Args>
  [[nodiscard]] ShmUniquePtr<T> try_loan(Args&&... args) {
    const detail::Loan loan = core_->loan(*type_, false);
    if (loan.control == nullptr) return nullptr;
    return detail::build<T>(loan, std::forward<Args>(args)...);
  }

  /// Publishes. Under Policy::Block it waits for a slow reader, at most PusherOptions::block_for
  /// (or `block_for`); Status::Full then, and the message stays with the caller. So it does where
  /// the StopToken was told to stop: Status::Stopped, under each policy. Else always Status::Ok.
  ///
  /// Errors: lot::Error as the class says, and EINVAL for an empty pointer or a message of another
  /// segment. The message stays with the caller then, too.
  [[nodiscard]] Status push(ShmUniquePtr<T>&& message, const StopToken& stop = {}) {
    return push(std::move(message), block_for_, stop);
  }
  /// The same with another limit than the options'. Throws the same.
  [[nodiscard]] Status push(ShmUniquePtr<T>&& message, Duration block_for,
                            const StopToken& stop = {}) {
    const Status status =
        core_->push_unique(detail::whole(message, *type_), {block_for, stop.word()});
    if (status == Status::Ok) detail::PointerAccess::take(message);
    return status;
  }
  /// The same, and never waits for a reader. Throws the same.
  [[nodiscard]] Status try_push(ShmUniquePtr<T>&& message) {
    return push(std::move(message), Duration());
  }

  /// Publishes a message that was received, or is kept: no copy, but for one that travels in a slot
  /// (PusherOptions::fast_lane). It can not grow from then on; its
  /// elements must not be written any more either, since readers look at them. It waits, and says
  /// Status::Full, as the push of a ShmUniquePtr.
  ///
  /// Errors: lot::Error as the class says, and EINVAL when the pointer is empty, or of a message in
  /// another segment, or points to something else than its whole message: to a part of it, to
  /// private memory, to nothing. In the process that made the message its type is compared, too; in
  /// others, the place and that a T fits there.
  [[nodiscard]] Status push(const ShmSharedPtr<const T>& message, const StopToken& stop = {}) {
    return push(message, block_for_, stop);
  }
  /// The same with another limit than the options'. Throws the same.
  [[nodiscard]] Status push(const ShmSharedPtr<const T>& message, Duration block_for,
                            const StopToken& stop = {}) {
    return core_->push_shared(detail::PointerAccess::control(message), message.get(),
                              {block_for, stop.word()});
  }
  /// The same by a pointer that could change the message. Throws the same.
  [[nodiscard]] Status push(const ShmSharedPtr<T>& message, const StopToken& stop = {}) {
    return push(message, block_for_, stop);
  }
  /// The same with another limit than the options'. Throws the same.
  [[nodiscard]] Status push(const ShmSharedPtr<T>& message, Duration block_for,
                            const StopToken& stop = {}) {
    return core_->push_shared(detail::PointerAccess::control(message), message.get(),
                              {block_for, stop.word()});
  }

  /// Subscribers that read this publisher: each gets what is pushed from now on, also one that has
  /// not looked yet. Throws lot::Error (ECHILD, ESTALE).
  std::size_t readers() const { return core_->readers(); }
  /// Waits until so many read this publisher; it looks each millisecond. False: the time is up, or
  /// it was told to stop, and there are fewer. Throws lot::Error (ECHILD, ESTALE).
  [[nodiscard]] bool wait_for_readers(std::size_t count, Duration timeout,
                                      const StopToken& stop = {}) {
    return core_->wait_for_readers(count, detail::Limit::until(detail::after(timeout), stop));
  }
  /// The same without a limit. Throws the same.
  [[nodiscard]] bool wait_for_readers(std::size_t count, const StopToken& stop) {
    return core_->wait_for_readers(count, detail::Limit::forever(stop));
  }
  /// Makes memory for `count` messages of `bytes` each and touches it, so that the first frames are
  /// as fast as the later ones, and those of a publisher that seldom publishes.
  ///
  /// count: the depth, the loans at once, and the messages that readers keep; of messages that
  /// travel in slots (PusherOptions::fast_lane) only the loans at once. bytes: of all vectors and
  /// strings of a message. No other publisher gets it; it counts for PusherOptions::max_bytes.
  /// Under Policy::Block it waits for memory as loan() does.
  /// Errors: lot::OutOfMemory, and then nothing is reserved; lot::Error as the class says.
  void reserve(std::size_t count, std::size_t bytes) { core_->reserve(count, bytes); }

 private:
  std::unique_ptr<detail::PusherCore> core_;
  std::chrono::nanoseconds block_for_;
  /// kept, since each call of message_type() looks whether it is the first
  const detail::MessageType* type_ = &detail::message_type<T>();
};

}  // namespace lot
