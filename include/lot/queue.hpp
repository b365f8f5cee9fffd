// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <exception>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "lot/compliance.hpp"
#include "lot/detail/core.hpp"
#include "lot/detail/message_type.hpp"
#include "lot/detail/raise.hpp"
#include "lot/duration.hpp"
#include "lot/error.hpp"
#include "lot/options.hpp"
#include "lot/pointers.hpp"
#include "lot/pusher.hpp"
#include "lot/stop_token.hpp"

namespace lot {

/// How a handle of a queue keeps its items, and how it waits.
struct QueueOptions {
  std::uint32_t depth = 64;                ///< items of one handle that wait in it at most
  Policy policy = Policy::Block;           ///< where the queue is full
  QueueEngine engine = QueueEngine::Ring;  ///< LOT_QUEUE comes before it
  Wait wait = Wait::Adaptive;              ///< how a pop or a take passes the time
  /// Items are tasks. A worker takes a task (ShmQueue::wait_and_take()), and the task stays in the
  /// queue until that worker has called ShmTask::finish(). If the worker dies or gives up before,
  /// another worker gets the task. All handles of the queue must say the same. Not for items that
  /// each reader gets, nor with Policy::Overwrite.
  bool redeliver = false;
  bool fast_lane = true;  ///< PusherOptions::fast_lane; LOT_FAST_LANE comes before it
};

/// A task that this process works on, and has not finished: a read-only item of a queue that was
/// made with QueueOptions::redeliver.
///
///     lot::ShmTask<Job> task = queue.wait_and_take();
///     work(*task);    // if this throws, or the process is killed, another worker gets the task
///     task.finish();
///
/// Until finish() the task has its place in the queue, so it counts for the depth. If a worker
/// gives a task back, or dies, the task is the next one to be taken of those that its handle has
/// put. So a task is done at least once: a worker that is killed between its work and finish() has
/// done it, and another one does it again. A task that no worker can do is the next one again and
/// again: deliveries() says when it is time to finish it all the same.
///
/// Threads: as a std::unique_ptr: any thread may have it, one at a time.
/// Errors:  only finish() throws.
/// Memory:  the item has its place in the queue and its memory until finish(). The queue's core
///          lives until its handle and all its tasks have gone.
/// Crash:   the task comes back as soon as the death is seen (some milliseconds), in all processes.
template <class T>
class ShmTask {
 public:
  ShmTask() = default;
  /// For ShmQueue. Throws nothing.
  ShmTask(std::shared_ptr<detail::QueueCore> queue, const detail::Claim& claim)
      : queue_(std::move(queue)), claim_(claim) {}
  ShmTask(ShmTask&& other) noexcept : queue_(std::move(other.queue_)), claim_(other.claim_) {}
  ShmTask& operator=(ShmTask&& other) noexcept {
    if (this != &other) {
      give_back();
      queue_ = std::move(other.queue_);
      claim_ = other.claim_;
    }
    return *this;
  }
  ~ShmTask() { give_back(); }

  /// False: there was none in time, or it is finished, or given back.
  [[nodiscard]] explicit operator bool() const noexcept { return queue_ != nullptr; }
  /// The item where it lies, or null where there is no task.
  const T* get() const noexcept {
    return queue_ ? static_cast<const T*>(claim_.item.root) : nullptr;
  }
  /// The item. REQUIRES: there is a task.
  const T& operator*() const noexcept { return *get(); }
  /// A member of the item. REQUIRES: there is a task.
  const T* operator->() const noexcept { return get(); }
  /// How often workers have got this task, with this time: 1 at first. It counts up to 4095.
  std::uint32_t deliveries() const noexcept { return queue_ ? claim_.deliveries : 0; }

  /// The task is done: no worker gets it any more. Nothing where there is none. Throws lot::Error:
  /// ECHILD in a forked child, where the task is its parent's; ESTALE in a process that was taken
  /// for dead, whose tasks other workers get.
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
};

namespace detail {

/// What lies in shared memory for an item of type T, and which readers get it.
template <class T>
struct QueueItem {
  static_assert(std::is_object_v<T> && !std::is_array_v<T>,
                "lot: this item is an array, a reference or nothing; use std::array, or a struct");
  static_assert(std::is_copy_constructible_v<T>,
                "lot: this item is popped by value and cannot be copied; use "
                "ShmQueue<ShmUniquePtr<T>>");
  using Element = T;
  static constexpr Delivery kDelivery = Delivery::ToOne;
  static constexpr bool kMayComeBack = !std::is_nothrow_copy_constructible_v<T>;
  /// Result: T, or std::optional<T>. Built in place: a move might throw, when the item is gone.
  template <class Result, class... How>
  static Result from(QueueCore& queue, const Borrowed& borrowed, How... how) {
    const auto& element = *static_cast<const T*>(borrowed.root);
    if constexpr (kMayComeBack) {
      const End end{queue, borrowed};
      return Result(how..., element);
    } else {
      const LetGo let_go{borrowed.control};
      return Result(how..., element);
    }
  }

 private:
  struct LetGo {
    ControlBlock* control;
    ~LetGo() { control->drop_pointer(); }
  };
  struct End {
    QueueCore& queue;
    const Borrowed& item;
    const int exceptions = std::uncaught_exceptions();
    ~End() {
      if (std::uncaught_exceptions() > exceptions) {  // of the copy
        queue.hand_back(item);
      } else {
        item.control->drop_pointer();
        queue.copied();
      }
    }
  };
};
template <class U>
struct QueueItem<ShmUniquePtr<U>> {
  using Element = U;
  static constexpr Delivery kDelivery = Delivery::ToOne;
  static constexpr bool kMayComeBack = false;
  template <class Result, class... How>
  static Result from(QueueCore&, const Borrowed& borrowed, How... how) {
    return Result(how..., PointerAccess::unique(static_cast<U*>(const_cast<void*>(borrowed.root)),
                                                borrowed.control));
  }
};
template <class U>
struct QueueItem<ShmSharedPtr<U>> {
  static_assert(std::is_const_v<U>,
                "lot: this item goes to several processes, so it cannot change; use "
                "ShmQueue<ShmSharedPtr<const T>>, or ShmQueue<ShmUniquePtr<T>>");
  using Element = std::remove_const_t<U>;
  static constexpr Delivery kDelivery = Delivery::ToAll;
  static constexpr bool kMayComeBack = false;
  template <class Result, class... How>
  static Result from(QueueCore&, const Borrowed& borrowed, How... how) {
    return Result(how..., PointerAccess::shared(static_cast<U*>(borrowed.root), borrowed.control));
  }
};

/// The name of the MessageType of a queue whose items are taken begins so; no topic's does, since
/// no C++ name has a space there.
inline constexpr std::string_view kQueueTypes = "ShmQueue ";
/// That name. Throws std::bad_alloc.
inline std::string queue_type_name(const char* item, bool redelivers) {
  return std::string(kQueueTypes) + (redelivers ? "with redelivery of " : "of ") + item;
}

/// The MessageType of a queue whose items are each taken by one reader: no topic's.
template <class U>
const MessageType& taken_type() {
  static const std::string name = queue_type_name(message_type<U>().name, false);
  static const MessageType type = [] {
    MessageType t = message_type<U>();
    t.name = name.c_str();
    if (t.hash != 0) t.hash = ~t.hash;
    t.element = &message_type<U>();
    return t;
  }();
  return type;
}
/// The MessageType of a queue whose items are tasks: a handle that redelivers and one that does not
/// never meet.
template <class U>
const MessageType& task_type() {
  static const std::string name = queue_type_name(message_type<U>().name, true);
  static const MessageType type = [] {
    MessageType t = taken_type<U>();
    t.name = name.c_str();
    return t;
  }();
  return type;
}

/// How the items of a queue are delivered. Throws lot::Error (EINVAL) where items that each reader
/// gets are to be redelivered.
template <class T>
Delivery delivery_of(const QueueOptions& options) {
  if (!options.redeliver) return QueueItem<T>::kDelivery;
  if (QueueItem<T>::kDelivery == Delivery::ToAll) {
    raise_not_redelivered(message_type<typename QueueItem<T>::Element>().name);
  }
  return Delivery::ToWorker;
}
template <class T>
const MessageType& queue_type(const QueueOptions& options) {
  using Element = typename QueueItem<T>::Element;
  switch (delivery_of<T>(options)) {
    case Delivery::ToOne:
      return taken_type<Element>();
    case Delivery::ToWorker:
      return task_type<Element>();
    case Delivery::ToAll:
      break;
  }
  return message_type<Element>();
}

/// The untyped half of a queue. Throws as ShmEngine::queue().
inline std::unique_ptr<QueueCore> make_queue(std::shared_ptr<transport::Participant> participant,
                                             std::string_view name, const MessageType& type,
                                             const QueueOptions& options, Delivery delivery) {
  PusherOptions putting;
  putting.depth = options.depth;
  putting.policy = options.policy;
  putting.engine = options.engine;
  putting.fast_lane = options.fast_lane;
  PullerOptions popping;
  popping.wait = options.wait;
  return make_queue(std::move(participant), name, type, putting, popping, delivery);
}

}  // namespace detail

/// A queue between threads of one process and of many.
///
///     auto queue = engine.queue<lot::ShmUniquePtr<Task>>("tasks");
///     (void)queue.put(queue.make(1, 2, 3));
///     lot::ShmUniquePtr<Task> task = queue.wait_and_pop();
///
/// T says what an item is and which readers get it:
/// - `ShmSharedPtr<const U>`: each reader gets every item and becomes one of its owners. Such a
///   queue is a topic: ShmPusher and ShmPuller of U work on it as well.
/// - `ShmUniquePtr<U>`: one of the readers takes it, and owns it alone. It may change the item, but
///   only its maker's process can make it grow.
/// - any other T: one of the readers takes it, by value. T is a message type. Such a queue and one
///   of `ShmUniquePtr<T>` are the same: one process may put values and another pop pointers.
///
/// Each handle that puts has a queue of its own (depth items, in their order); a handle that pops
/// reads all of them. Threads that share a handle share its items: one of these threads gets each
/// item. A handle reads from its first look on (a pop, is_empty(), size(), listen()). Of shared
/// items it gets what is put after that, however late it pops, also when the handle that put them
/// has gone or its process was killed. Items for one reader wait in the queue until a handle takes
/// them, also when all handles that have put some have gone. The last process that leaves a segment
/// removes it, with all that waits there, unless one of its processes has asked for
/// EngineOptions::persist. A queue with QueueOptions::redeliver has tasks instead: see ShmTask.
///
/// Threads: all members may be called at once, on one handle or several, but for assignment and
///          destruction.
/// Errors:  lot::Error: ECHILD in a forked child, ESTALE in a process that was taken for dead;
///          EINVAL where tasks are popped, or items taken; EBADMSG for an item that another process
///          has damaged; with QueueEngine::Mutex EBUSY when a stopped process keeps the queue's
///          lock for five seconds. The first put, make() or emplace() of a handle makes its queue,
///          and throws as ShmEngine::advertise(), too; the first pop, take, listen(), size() or
///          is_empty() throws as ShmEngine::subscribe(), too. Where a value cannot be copied out
///          (its copy constructor throws: no memory), the pop throws that, and the handle has the
///          item for its next pop. When the handle goes, it puts the item back into the queue,
///          behind the others; if there is no room or no memory for that, it drops the item. EDQUOT
///          when a handle that pops shared items holds too many of them
///          (PullerOptions::max_held_bytes, its default). lot::OutOfMemory when all blocks
///          (EngineOptions::blocks) are in use and an item of QueueOptions::fast_lane is to be
///          popped or taken: it stays in the queue.
/// Memory:  in the segment, for a handle that puts, a queue of QueueOptions::depth slots with its
///          items; for one that pops, a cell in each of these. An item has its memory until its
///          last owner has gone.
/// Crash:   what was put stays. An item for one reader that a killed process has not taken yet goes
///          to another. One that it has taken is freed, also one that it could not copy.
template <class T>
class ShmQueue {
  using Item = detail::QueueItem<T>;

 public:
  using value_type = T;
  /// What lies in the segment for an item.
  using Element = typename Item::Element;

  /// For ShmEngine::queue(). Throws nothing.
  explicit ShmQueue(std::shared_ptr<detail::QueueCore> core) : core_(std::move(core)) {}

  /// A new item, built in shared memory from args, to be put later. Throws lot::OutOfMemory, under
  /// Policy::Block after a second; lot::Error as the class says; what the constructor throws.
  template <class... Args>
  [[nodiscard]] ShmUniquePtr<Element> make(Args&&... args) {
    return detail::build<Element>(core_->loan(detail::message_type<Element>()),
                                  std::forward<Args>(args)...);
  }

  // Putting: of a copy of an item, of an item that is moved. Status::Full when the queue was full
  // (at once under Policy::Refuse, when the time is up under Policy::Block: put() and emplace()
  // wait for ever); the item then stays with the caller. A shared item is a pointer to a whole
  // message: lot::Error (EINVAL) for one to a part of it, to private memory, or to nothing; the
  // message can not grow from then on. Under Policy::Overwrite it is never full: the oldest item
  // that no handle has popped is dropped. A unique pointer is moved: put(std::move(item)).
  //
  // They wait for a place in the queue. Where the segment has no memory for one more item, since
  // items that no handle has taken have it, make() and a put of a value throw lot::OutOfMemory,
  // under Policy::Block after a second: give the queue a depth whose items the segment holds.

  /// Puts a copy of a value, or shares a message, and waits for ever for a place. Throws
  /// lot::OutOfMemory where a value finds no memory, lot::Error as the class says, and EINVAL for a
  /// pointer to anything else than a whole message of this segment; what a copy of the value
  /// throws.
  [[nodiscard]] Status put(const T& item, const StopToken& stop = {}) {
    return put_copy(item, detail::Limit::forever(stop));
  }
  /// Puts the item itself: a pointer is null afterwards, if it was put. Throws the same.
  [[nodiscard]] Status put(T&& item, const StopToken& stop = {}) {
    return put_moved(std::move(item), detail::Limit::forever(stop));
  }
  /// As put(), and waits so long for a place at most. Throws the same.
  [[nodiscard]] Status put_for(const T& item, Duration timeout, const StopToken& stop = {}) {
    return put_until(item, detail::after(timeout), stop);
  }
  /// As put() of an item that is moved. Throws the same.
  [[nodiscard]] Status put_for(T&& item, Duration timeout, const StopToken& stop = {}) {
    return put_until(std::move(item), detail::after(timeout), stop);
  }
  /// As put(), and waits for a place until then. Throws the same.
  [[nodiscard]] Status put_until(const T& item, Deadline deadline, const StopToken& stop = {}) {
    return put_copy(item, detail::Limit::until(deadline, stop));
  }
  /// As put() of an item that is moved. Throws the same.
  [[nodiscard]] Status put_until(T&& item, Deadline deadline, const StopToken& stop = {}) {
    return put_moved(std::move(item), detail::Limit::until(deadline, stop));
  }
  /// As put(), and never waits for a place. Throws the same.
  [[nodiscard]] Status try_put(const T& item) { return put_copy(item, detail::Limit::now()); }
  /// As put() of an item that is moved. Throws the same.
  [[nodiscard]] Status try_put(T&& item) {
    return put_moved(std::move(item), detail::Limit::now());
  }
  /// Builds the item in place, from args, and puts it as put(): the item is lost where it says
  /// Status::Full. Throws as make() and put().
  template <class... Args>
  [[nodiscard]] Status emplace(Args&&... args) {
    return put_made(make(std::forward<Args>(args)...), detail::Limit::forever({}));
  }

  // Popping. Nothing when there was none in time. A pointer comes in an optional: (*item)->member.

  /// The next item; waits for ever for one. Throws lot::Error as the class says, EDQUOT of shared
  /// items; what the copy of a value throws.
  [[nodiscard]] T wait_and_pop() {
    detail::Borrowed item;
    core_->pop(item, detail::Limit::forever({}), Item::kMayComeBack);
    return Item::template from<T>(*core_, item);
  }
  /// The next item, or nothing once it was told to stop. Throws the same.
  [[nodiscard]] std::optional<T> wait_and_pop(const StopToken& stop) {
    return pop(detail::Limit::forever(stop));
  }
  /// The next item, if one comes in that time. Throws the same.
  [[nodiscard]] std::optional<T> wait_and_pop_for(Duration timeout, const StopToken& stop = {}) {
    return wait_and_pop_until(detail::after(timeout), stop);
  }
  /// The next item, if one comes until then. Throws the same.
  [[nodiscard]] std::optional<T> wait_and_pop_until(Deadline deadline, const StopToken& stop = {}) {
    return pop(detail::Limit::until(deadline, stop));
  }
  /// The next item, if there is one now. Throws the same.
  [[nodiscard]] std::optional<T> try_pop() { return pop(detail::Limit::now()); }

  // Taking tasks, where the queue was made with QueueOptions::redeliver; popping is not for those.
  // lot::Error (EINVAL) for the one where the other is meant. An empty task when there was none in
  // time.

  /// The next task; waits for ever for one, or until it is told to stop. Throws lot::Error as the
  /// class says.
  [[nodiscard]] ShmTask<Element> wait_and_take(const StopToken& stop = {}) {
    return take(detail::Limit::forever(stop));
  }
  /// The next task, if one comes in that time. Throws the same.
  [[nodiscard]] ShmTask<Element> wait_and_take_for(Duration timeout, const StopToken& stop = {}) {
    return wait_and_take_until(detail::after(timeout), stop);
  }
  /// The next task, if one comes until then. Throws the same.
  [[nodiscard]] ShmTask<Element> wait_and_take_until(Deadline deadline,
                                                     const StopToken& stop = {}) {
    return take(detail::Limit::until(deadline, stop));
  }
  /// The next task, if there is one now. Throws the same.
  [[nodiscard]] ShmTask<Element> try_take() { return take(detail::Limit::now()); }

  /// Begins to read: of shared items this handle gets all that are put from now on. Throws
  /// lot::Error as the class says.
  void listen() { core_->listen(); }
  /// Items that this handle could pop now: true a moment ago, when others pop or put meanwhile.
  /// Throws lot::Error as the class says.
  std::size_t size() { return core_->size(); }
  /// True when size() is 0. Throws the same.
  [[nodiscard]] bool is_empty() { return size() == 0; }
  /// A descriptor as ShmPuller::fd(): readable from when an item may have come until a try_pop() or
  /// try_take() has found none. It belongs to the handle. It begins to read as listen() does.
  /// Throws as that, and lot::Error as ShmPuller::fd().
  int fd() { return core_->fd(); }
  /// Items that one handle has in the queue at most.
  std::size_t capacity() const noexcept { return core_->capacity(); }

 private:
  friend class WaitSet;
  template <class Request, class Response>
  friend class ShmServer;

  Status put_copy(const T& item, detail::Limit limit) {
    if constexpr (Item::kDelivery == detail::Delivery::ToAll) {
      return core_->put_shared(detail::PointerAccess::control(item), item.get(), limit);
    } else {
      static_assert(std::is_same_v<T, Element>,
                    "lot: this item has one owner and can only be moved; use std::move()");
      if (limit.is_stopped()) return Status::Stopped;
      return put_made(make(item), limit);
    }
  }
  Status put_moved(T&& item, detail::Limit limit) {
    if constexpr (Item::kDelivery == detail::Delivery::ToAll) {
      const Status status =
          core_->put_shared(detail::PointerAccess::control(item), item.get(), limit);
      if (status == Status::Ok) item.reset();
      return status;
    } else if constexpr (std::is_same_v<T, Element>) {
      if (limit.is_stopped()) return Status::Stopped;
      return put_made(make(static_cast<const T&>(item)), limit);
    } else {
      return put_made(std::move(item), limit);
    }
  }

  std::optional<T> pop(detail::Limit limit) {
    detail::Borrowed item;
    if (!core_->pop(item, limit, Item::kMayComeBack)) return std::nullopt;
    return Item::template from<std::optional<T>>(*core_, item, std::in_place);
  }

  ShmTask<Element> take(detail::Limit limit) {
    detail::Claim claim;
    if (!core_->take(claim, limit)) return {};
    return {core_, claim};
  }

  template <class Made>
  Status put_made(Made&& made, detail::Limit limit) {
    const Status status = core_->put_unique(detail::whole(made), limit);
    if (status == Status::Ok) detail::PointerAccess::take(made);
    return status;
  }

  std::shared_ptr<detail::QueueCore> core_;
};

}  // namespace lot
