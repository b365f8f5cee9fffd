// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>

#include "lot/any_message.hpp"
#include "lot/any_pusher.hpp"
#include "lot/any_type.hpp"
#include "lot/detail/core.hpp"
#include "lot/duration.hpp"
#include "lot/options.hpp"
#include "lot/pointers.hpp"
#include "lot/stop_token.hpp"
#include "lot/wait_set.hpp"

namespace lot {

/// A task of any type that this process works on, and has not finished: as ShmTask.
///
/// Threads: any thread may have it, one at a time.
/// Errors:  root() and finish() throw.
/// Memory:  as ShmTask.
/// Crash:   as ShmTask.
class AnyTask {
 public:
  /// None.
  AnyTask() noexcept = default;
  /// For AnyQueue. Throws nothing.
  AnyTask(std::shared_ptr<detail::QueueCore> queue, const detail::Claim& claim, AnyType type)
      : queue_(std::move(queue)), claim_(claim), type_(std::move(type)) {}
  AnyTask(AnyTask&& other) noexcept
      : queue_(std::move(other.queue_)), claim_(other.claim_), type_(std::move(other.type_)) {}
  AnyTask& operator=(AnyTask&& other) noexcept {
    if (this != &other) {
      give_back();
      queue_ = std::move(other.queue_);
      claim_ = other.claim_;
      type_ = std::move(other.type_);
    }
    return *this;
  }
  ~AnyTask() { give_back(); }

  /// False: there was none in time, or it is finished, or given back.
  [[nodiscard]] explicit operator bool() const noexcept { return queue_ != nullptr; }
  /// The item, to be read as long as this has it. REQUIRES: there is a task. Throws lot::Error:
  /// EBADMSG when the description is damaged.
  Value root() const { return detail::value_of(type_.description(), claim_.item.root); }
  /// What it is. Throws nothing.
  const AnyType& type() const noexcept { return type_; }
  /// How often workers have got this task: see ShmTask::deliveries().
  std::uint32_t deliveries() const noexcept { return queue_ ? claim_.deliveries : 0; }

  /// The item, to be kept longer than the task; null where there is none. Throws nothing.
  [[nodiscard]] AnyMessage keep() const noexcept {
    if (!queue_) return {};
    return {
        detail::PointerAccess::shared(claim_.item.root, detail::acquire_block(claim_.item.control)),
        type_};
  }

  /// The task is done: see ShmTask::finish(). Throws the same.
  void finish() {
    if (!queue_) return;
    queue_->finish(claim_);
    queue_.reset();
  }
  /// Gives the task back: another worker may do it, or this one later.
  void give_back() noexcept {
    if (!queue_) return;
    queue_->give_back(claim_);
    queue_.reset();
  }

 private:
  std::shared_ptr<detail::QueueCore> queue_;  ///< null: no task
  detail::Claim claim_;
  AnyType type_;
};

/// A queue whose items are each taken by one reader, for programs that do not have their type: it
/// meets ShmQueue<T> and ShmQueue<ShmUniquePtr<T>>. For ShmEngine::queue_any(). A queue whose items
/// each reader gets is a topic: AnyPusher and AnyPuller work on it.
///
///     lot::AnyQueue jobs = engine.queue_any("jobs", job, options);
///     lot::AnyLoan made = jobs.loan();
///     made.root()["number"].set(7);
///     (void)jobs.put_until(std::move(made), lot::Deadline(soon));
///
/// Threads: all members may be called at once, but for assignment and destruction.
/// Errors:  as ShmQueue.
/// Memory:  as ShmQueue. The process keeps the description of each type, once, until it leaves the
///          segment.
/// Crash:   as ShmQueue.
class AnyQueue {
 public:
  /// For ShmEngine::queue_any(). Throws nothing.
  AnyQueue(std::shared_ptr<detail::QueueCore> core, AnyType type)
      : core_(std::move(core)), type_(std::move(type)) {}

  /// What an item is. Throws nothing.
  const AnyType& type() const noexcept { return type_; }

  /// A new item, to be put: as AnyPusher::loan(). Throws the same, and as ShmQueue::make().
  [[nodiscard]] AnyLoan loan() {
    return {core_->loan(detail::type_of(*type_.known())), type_, false};
  }
  /// The same of a type that is opaque as a whole: all its bytes are zero. Throws the same; EINVAL
  /// when the type is not opaque.
  [[nodiscard]] AnyLoan loan_zeroed() {
    detail::require_opaque(type_);
    return {core_->loan(detail::type_of(*type_.known())), type_, true};
  }
  /// Puts the item, and waits for a place until then. Status::Full: the item stays with the caller.
  /// Throws as ShmQueue::put(), and lot::Error (EINVAL) for an item of another type.
  [[nodiscard]] Status put_until(AnyLoan&& item, Deadline deadline, const StopToken& stop = {}) {
    return put(std::move(item), detail::Limit::until(deadline, stop));
  }
  /// The same, and never waits. Throws the same.
  [[nodiscard]] Status try_put(AnyLoan&& item) {
    return put(std::move(item), detail::Limit::now());
  }

  /// The next item, if one comes until then; else null. Nothing can change it from here on. Throws
  /// as ShmQueue::wait_and_pop_until().
  [[nodiscard]] AnyMessage wait_and_pop_until(Deadline deadline, const StopToken& stop = {}) {
    return pop(detail::Limit::until(deadline, stop));
  }
  /// The next item, if there is one now. Throws the same.
  [[nodiscard]] AnyMessage try_pop() { return pop(detail::Limit::now()); }
  /// The next task, if one comes until then. Throws as ShmQueue::wait_and_take_until().
  [[nodiscard]] AnyTask wait_and_take_until(Deadline deadline, const StopToken& stop = {}) {
    return take(detail::Limit::until(deadline, stop));
  }
  /// The next task, if there is one now. Throws the same.
  [[nodiscard]] AnyTask try_take() { return take(detail::Limit::now()); }

  /// Begins to read: see ShmQueue::listen(). Throws the same.
  void listen() { core_->listen(); }
  /// Items that this handle could pop now: see ShmQueue::size(). Throws the same.
  std::size_t size() { return core_->size(); }
  /// A descriptor: see ShmQueue::fd(). Throws the same.
  int fd() { return core_->fd(); }
  /// Items that one handle has in the queue at most.
  std::size_t capacity() const noexcept { return core_->capacity(); }

 private:
  friend class WaitSet;

  Status put(AnyLoan&& item, detail::Limit limit) {
    if (item.type_.known() != type_.known()) detail::require_same(item.type_, type_);
    const Status status = core_->put_unique(detail::PointerAccess::control(item.message_), limit);
    if (status == Status::Ok) detail::PointerAccess::take(item.message_);
    return status;
  }
  AnyMessage pop(detail::Limit limit) {
    detail::Borrowed item;
    if (!core_->pop(item, limit, false)) return {};
    auto* const root = static_cast<std::byte*>(const_cast<void*>(item.root));
    return {ShmSharedPtr<const void>(detail::PointerAccess::unique(root, item.control)), type_};
  }
  AnyTask take(detail::Limit limit) {
    detail::Claim claim;
    if (!core_->take(claim, limit)) return {};
    return {core_, claim, type_};
  }

  std::shared_ptr<detail::QueueCore> core_;
  AnyType type_;
};

inline void WaitSet::add(AnyQueue& queue, Handler handler) {
  queue.listen();
  add(*queue.core_, std::move(handler));
}
inline void WaitSet::remove(AnyQueue& queue) { remove(*queue.core_); }

}  // namespace lot
