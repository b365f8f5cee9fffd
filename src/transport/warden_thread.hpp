// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pthread.h>
#include <sched.h>
#include <thread>
#include <utility>

namespace lot::transport {

/// The thread of the warden. Units below the warden ask whether they run in it: it must not wait,
/// since it watches the other processes.
///
/// Threads: start() and join() from one thread, before and after all others.
class WardenThread {
 public:
  /// Throws std::system_error.
  template <class F>
  void start(F&& f) {
    thread_ = std::thread(std::forward<F>(f));
  }
  void join() { thread_.join(); }
  bool is_current() const noexcept { return std::this_thread::get_id() == thread_.get_id(); }

  /// Lets the calling thread run on the warden's cores. It was started by a thread that may have a
  /// core of its own.
  void lend_cores() noexcept {
    cpu_set_t cores;
    if (thread_.joinable() &&
        pthread_getaffinity_np(thread_.native_handle(), sizeof(cores), &cores) == 0) {
      pthread_setaffinity_np(pthread_self(), sizeof(cores), &cores);
    }
  }
  /// The same, with the priority of a batch thread: it takes no core from a thread that runs.
  void place_beside() noexcept {
    lend_cores();
    const sched_param none{};
    pthread_setschedparam(pthread_self(), SCHED_BATCH, &none);
  }

 private:
  std::thread thread_;
};

}  // namespace lot::transport
