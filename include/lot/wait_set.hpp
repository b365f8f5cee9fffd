// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "lot/detail/core.hpp"
#include "lot/duration.hpp"
#include "lot/envelope.hpp"
#include "lot/options.hpp"
#include "lot/puller.hpp"
#include "lot/stop_token.hpp"

namespace lot {

namespace detail {
class WaitSetCore;
}
template <class T>
class ShmQueue;
class AnyMessage;
class AnyPuller;
class AnyQueue;

/// One thread for many pullers, queues, timers and a stop request.
///
///     lot::WaitSet set;
///     set.add(camera, [&] { while (auto frame = camera.try_pull()) show(*frame); });
///     set.add(lidar, [&] { while (auto scan = lidar.try_pull()) show(*scan); });
///     set.add_timer(100ms, [&] { report(); });
///     set.run();                            // until another thread, or a signal, calls stop()
///
/// It sleeps on the queues of all its pullers at once. However many they are, a wake-up costs the
/// same: it learns which queues have news (docs/ear.md). A handler that leaves messages unread is
/// called again.
///
/// Threads: stop() at any time, also in a signal handler; all others by the thread that runs.
///          Handlers run in it, and may add, remove and stop, but not run.
/// Errors:  what a handler throws leaves run() and run_once(), which can be called again. So does
///          lot::Error (ECHILD, ESTALE) of a puller. lot::Error (EINVAL) for an empty handler and
///          for a period of nothing. std::bad_alloc.
/// Memory:  private: an entry for each puller and timer. A set of more than 8 queues has an ear in
///          the segment of its pullers, and keeps the segment until it has removed the last of them
///          or is destroyed; all sets of a segment have 192. One without an ear sleeps on 128
///          queues at most (futex_waitv), and threads of its own help with the rest.
/// Crash:   an ear is freed by the reaper.
class WaitSet {
 public:
  /// What is called when there is something to do.
  using Handler = std::function<void()>;
  /// Names a timer.
  enum class Timer : std::uint64_t {};

  /// With Wait::Adaptive it spins for some microseconds before it sleeps, where that has helped
  /// lately; its pullers' own PullerOptions::wait does not count here. Throws std::bad_alloc.
  explicit WaitSet(Wait wait = Wait::Park);
  ~WaitSet();
  WaitSet(const WaitSet&) = delete;
  WaitSet& operator=(const WaitSet&) = delete;

  /// Calls `handler` when the puller may have something to read.
  /// REQUIRES: the puller is removed before it is destroyed or moved from.
  /// Throws lot::Error (EINVAL) when the handler is empty, std::bad_alloc.
  template <class T>
  void add(ShmPuller<T>& puller, Handler handler) {
    add(*puller.core_, std::move(handler));
  }
  /// Calls `handler` when the queue may have an item to pop or to take; a handler uses try_pop() or
  /// try_take(). Other threads may use the handle, too. It begins to read as ShmQueue::listen().
  /// REQUIRES: the queue is removed before its handle is destroyed or moved from.
  /// Throws as listen(), and lot::Error (EINVAL) when the handler is empty.
  template <class T>
  void add(ShmQueue<T>& queue, Handler handler) {
    queue.listen();
    add(*queue.core_, std::move(handler));
  }
  /// The same of a puller that has no type. Throws the same.
  void add(AnyPuller& puller, Handler handler);
  /// The same of a queue whose items have no type here. Throws as that of a ShmQueue.
  void add(AnyQueue& queue, Handler handler);
  /// Calls its handlers no more; does nothing for a puller that was not added. Throws nothing.
  template <class T>
  void remove(ShmPuller<T>& puller) {
    remove(*puller.core_);
  }
  /// The same of a puller that has no type. Throws nothing.
  void remove(AnyPuller& puller);
  /// The same of a queue whose items have no type here. Throws nothing.
  void remove(AnyQueue& queue);
  /// The same of a queue. Throws nothing.
  template <class T>
  void remove(ShmQueue<T>& queue) {
    remove(*queue.core_);
  }

  /// Calls `handler` every `period`, for the first time after one. Periods that were slept through
  /// are left out. A timer that a handler adds is called in the next round at the earliest. Throws
  /// lot::Error (EINVAL) for an empty handler or a period of nothing, std::bad_alloc.
  Timer add_timer(Duration period, Handler handler);
  /// Calls `handler` once, after `delay`; where that is nothing or negative, in the next round.
  /// Throws lot::Error (EINVAL) for an empty handler, std::bad_alloc.
  Timer add_timer_once(Duration delay, Handler handler);
  /// Calls it no more; does nothing for a timer that has gone. Throws nothing.
  void remove(Timer timer);

  /// Calls handlers until stop(), or until the token was told to stop. Throws what a handler
  /// throws, and lot::Error of a puller.
  void run(const StopToken& stop = {});
  /// Waits until something can be done, or the time is up, and does it: the number of handlers that
  /// were called. 0 as well when stop() was called, or the token was told to stop. Throws as run().
  std::size_t run_once(Duration timeout, const StopToken& stop = {});
  /// The same until a time of the steady clock. Throws the same.
  std::size_t run_once_until(Deadline deadline, const StopToken& stop = {});

  /// Ends run() after the handler that is at work, or the next run() at once. What was written
  /// before it is seen after run().
  void stop() noexcept;

  /// As add() of the puller or queue that it is the untyped half of: the library's own business.
  /// Throws the same.
  void add(detail::Waitable& waitable, Handler handler);
  /// As remove() of that. Throws nothing.
  void remove(detail::Waitable& waitable);

 private:
  std::unique_ptr<detail::WaitSetCore> core_;
};

/// A thread of the library's: how it is seen and scheduled.
struct ThreadOptions {
  std::string name = "lot-listen";  ///< 15 bytes, as ps and top show it
  std::vector<unsigned> cpus;       ///< it runs on these only; none: on all
  int policy = 0;                   ///< SCHED_OTHER, SCHED_FIFO, SCHED_RR ... (sched(7))
  int priority = 0;                 ///< of SCHED_FIFO and SCHED_RR
  /// Told what goes wrong (a damaged message; too many are kept); default: prints it to stderr.
  std::function<void(const Error&)> on_error;
};

/// Calls back for each message of a topic, on a thread of its own; until it is destroyed. See
/// ShmEngine::listen(). One that was moved from may only be destroyed or assigned to.
///
/// Threads: the callback runs on that thread alone. When the listener has been destroyed it is not
///          running any more; it must not destroy its own listener.
/// Errors:  what the callback throws ends the program, as in a std::thread; but lot::Error goes to
///          ThreadOptions::on_error. That callback's message is gone; the next one is called back.
/// Memory:  a thread with its stack, and what its puller has.
/// Crash:   as ShmPuller.
class ShmListener {
 public:
  /// Takes the puller over, and begins.
  /// Errors: lot::Error: EAGAIN when the system starts no thread; EINVAL or EPERM when the thread
  /// cannot run on these cores, or be scheduled like this; std::bad_alloc.
  template <class T, class Callback>
  ShmListener(ShmPuller<T>&& puller, Callback&& callback, Wait wait, const ThreadOptions& thread) {
    static_assert(
        is_callback<Callback, const ShmSharedPtr<const T>&>,
        "lot: this callback does not take a message: (const lot::ShmSharedPtr<const T>&)");
    call_back(std::move(puller), std::forward<Callback>(callback), wait, thread);
  }
  /// The same of a puller that has no type. Throws the same.
  template <class Callback>
  ShmListener(AnyPuller&& puller, Callback&& callback, Wait wait, const ThreadOptions& thread) {
    static_assert(is_callback<Callback, const AnyMessage&>,
                  "lot: this callback does not take a message: (const lot::AnyMessage&)");
    call_back(std::move(puller), std::forward<Callback>(callback), wait, thread);
  }
  /// For ShmServer: calls on_ready() while there may be something. The waitable outlives this.
  /// Throws the same.
  ShmListener(detail::Waitable& waitable, std::function<void()> on_ready, Wait wait,
              const ThreadOptions& thread) {
    start(waitable, std::move(on_ready), wait, thread);
  }
  ~ShmListener();
  ShmListener(ShmListener&&) noexcept;
  ShmListener& operator=(ShmListener&&) noexcept;

 private:
  static constexpr unsigned kAtOnce = 64;

  template <class Callback, class Message>
  static constexpr bool takes_envelope =
      std::is_invocable_v<std::decay_t<Callback>&, Message, const Envelope&>;
  template <class Callback, class Message>
  static constexpr bool is_callback =
      takes_envelope<Callback, Message> || std::is_invocable_v<std::decay_t<Callback>&, Message>;

  template <class T>
  static detail::PullerCore& core_of(ShmPuller<T>& puller) noexcept {
    return *puller.core_;
  }
  static detail::PullerCore& core_of(AnyPuller& puller) noexcept;

  template <class Puller, class Callback>
  void call_back(Puller&& puller, Callback&& callback, Wait wait, const ThreadOptions& thread) {
    auto mine = std::make_shared<std::decay_t<Puller>>(std::forward<Puller>(puller));
    start(
        core_of(*mine),
        [mine, callback = std::forward<Callback>(callback)]() mutable {
          // So many at most, and then a look whether to stop.
          for (unsigned n = 0; n < kAtOnce; ++n) {
            const auto message = mine->try_pull();
            if (!message) {
              if (mine->status() == Status::HoldsTooMuch) core_of(*mine).refuse_to_hold();
              return;
            }
            if constexpr (takes_envelope<Callback, decltype(message)&>) {
              callback(message, mine->envelope());
            } else {
              callback(message);
            }
          }
        },
        wait, thread);
  }
  void start(detail::Waitable& waitable, std::function<void()> on_ready, Wait wait,
             const ThreadOptions& thread);

  struct Impl;
  std::shared_ptr<Impl> impl_;  // shared: the constructor is a template, and Impl the library's
};

}  // namespace lot
