// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <list>
#include <memory>
#include <thread>

#include "lot/detail/core.hpp"
#include "lot/detail/mutex.hpp"

#include "futex/futex.hpp"
#include "waiting/hearing.hpp"

namespace lot::waiting {

class Notifier;

/// The thread that makes the descriptors of a process readable: one for all pullers and queues of a
/// segment. It listens by the ear of its participant's index (docs/ear.md), and starts with the
/// first descriptor.
///
/// Threads: all members may be called at once. stop() when there is no Notifier any more.
/// Errors:  lot::Error when the system has no thread left.
/// Crash:   as Ear.
class Descriptors {
 public:
  explicit Descriptors(EarOwner& owner) noexcept : owner_(owner) {}
  ~Descriptors() { stop(); }
  Descriptors(const Descriptors&) = delete;
  Descriptors& operator=(const Descriptors&) = delete;

  /// Ends the thread. The next descriptor would start it again.
  void stop() noexcept;

 private:
  friend class Notifier;
  class Watcher;

  /// Throws lot::Error, std::bad_alloc.
  void add(Notifier& notifier);
  void remove(Notifier& notifier) noexcept;
  /// Makes the descriptors readable that have news. REQUIRES: mutex_.
  void take_news() noexcept;
  /// The thread looks again by this time. REQUIRES: mutex_.
  void look_by(detail::Clock::time_point time) noexcept;
  /// The thread looks again at once. REQUIRES: mutex_.
  void give_order() noexcept;
  void run();

  EarOwner& owner_;
  detail::Mutex mutex_{detail::Rank::Notifier};
  std::unique_ptr<Ear> ear_;  ///< as long as the thread runs
  std::list<Notifier*> notifiers_;
  futex::Deadline again_;  ///< when the thread looks by itself
  bool is_to_end_ = false;
  std::atomic<std::uint32_t> orders_{0};  ///< futex: bumped with each order
  std::thread thread_;
};

/// Makes a descriptor readable when a puller may have a message, or a queue an item: for epoll,
/// poll, Asio and GLib.
///
/// The puller's own thread looks and, when it finds nothing, leaves its marks. The thread of
/// Descriptors hears of news. So only the puller's user ever touches the puller.
///
/// Threads: watch() one at a time.
/// Errors:  lot::Error when the system has no descriptor or no thread left.
class Notifier final : private Ear::Client, private detail::Hearer {
 public:
  /// `descriptors` outlives this.
  explicit Notifier(Descriptors& descriptors);
  ~Notifier();
  Notifier(const Notifier&) = delete;
  Notifier& operator=(const Notifier&) = delete;

  int fd() const noexcept { return fd_; }
  /// The puller has nothing to read: from now on the descriptor is readable once it may have.
  void watch(detail::Waitable& waitable);

 private:
  friend class Descriptors;

  void listen(std::uint32_t channel) override;
  void watch_directory(std::uint32_t version) override;
  /// REQUIRES: the mutex of `descriptors_`.
  void ring() noexcept;

  Descriptors& descriptors_;
  const int fd_;
  detail::FutexWaits by_ear_;  ///< no word is ever among them
  /// When to make it readable in any case. None: it is readable, or its thread arms it now.
  futex::Deadline again_;
};

}  // namespace lot::waiting
