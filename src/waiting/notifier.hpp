// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <mutex>
#include <thread>

#include "lot/detail/core.hpp"
#include "lot/detail/mutex.hpp"

namespace lot::waiting {

/// Makes a descriptor readable when a puller may have a message, or a queue an item: for epoll,
/// poll, Asio and GLib.
///
/// The puller's own thread looks and, when it finds nothing, hands over the words to sleep on. A
/// thread of the notifier sleeps on them. So only the puller's user ever touches the puller.
///
/// Threads: watch() one at a time.
/// Errors:  lot::Error when the system has no descriptor or no thread left.
class Notifier {
 public:
  Notifier();
  ~Notifier();
  Notifier(const Notifier&) = delete;
  Notifier& operator=(const Notifier&) = delete;

  int fd() const noexcept { return fd_; }
  /// The puller has nothing to read: from now on the descriptor is readable once it may have.
  void watch(detail::Waitable& waitable);

 private:
  struct Watcher;

  void run();
  void ring() noexcept;

  int fd_;
  detail::Mutex mutex_{detail::Rank::Notifier};
  detail::FutexWaits waits_;         ///< what to sleep on
  detail::Clock::time_point again_;  ///< the latest time to wake
  enum class Order { Idle, Watch, Stop } order_ = Order::Idle;
  std::atomic<std::uint32_t> orders_{0};  ///< futex: bumped with each order
  std::thread thread_;
};

}  // namespace lot::waiting
