// SPDX-License-Identifier: Apache-2.0
#include "waiting/notifier.hpp"

#include <cerrno>
#include <optional>
#include <sys/eventfd.h>
#include <system_error>
#include <unistd.h>

#include "lot/detail/no_signals.hpp"

#include "futex/futex.hpp"
#include "segment/descriptors.hpp"
#include "segment/system_limits.hpp"
#include "waiting/waiting.hpp"

namespace lot::waiting {

Notifier::Notifier() : fd_(segment::above_standard(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK))) {
  if (fd_ == -1) {
    throw Error(errno, "eventfd", "no descriptor to wait for messages by",
                "close descriptors, or raise the limit (ulimit -n)");
  }
  try {
    const detail::NoSignals quiet;
    thread_ = std::thread([this] { run(); });
  } catch (const std::system_error& e) {
    close(fd_);
    throw Error(e.code().value(), "thread", "no thread to wait for messages",
                segment::advice_on_threads());
  }
}

Notifier::~Notifier() {
  {
    const std::lock_guard guard(mutex_);
    order_ = Order::Stop;
    orders_.fetch_add(1, std::memory_order_relaxed);  // relaxed: the mutex carries the order
  }
  futex::wake_all(&orders_);
  thread_.join();
  close(fd_);
}

void Notifier::watch(detail::Waitable& waitable) {
  // First, so that what comes from now on makes it readable again.
  eventfd_t count;
  eventfd_read(fd_, &count);
  detail::FutexWaits waits;
  std::optional<detail::Clock::time_point> again;
  try {
    again = waitable.arm(waits);
  } catch (...) {
    ring();  // nothing watches: the puller's user has to look again
    throw;
  }
  if (!again) return ring();
  {
    const std::lock_guard guard(mutex_);
    waits_ = std::move(waits);
    again_ = *again;
    order_ = Order::Watch;
    orders_.fetch_add(1, std::memory_order_relaxed);  // relaxed: the mutex carries the order
  }
  futex::wake_all(&orders_);
}

/// How the notifier's thread waits until it is told to stop. Each look is its first, or comes after
/// a sleep.
struct Notifier::Watcher : waiting::Steps<Watcher> {
  explicit Watcher(Notifier& notifier) : notifier_(notifier) {}

  /// True: it is told to stop. Else it takes a new order, or makes the descriptor readable when a
  /// word of the puller, or the time, has ended its sleep.
  bool look() {
    bool rings = false;
    {
      const std::lock_guard guard(notifier_.mutex_);
      if (notifier_.order_ == Order::Stop) return true;
      if (notifier_.order_ == Order::Watch) {
        waits_ = notifier_.waits_;
        again_ = notifier_.again_;
        notifier_.order_ = Order::Idle;
      } else {
        rings = again_.has_value();
        waits_.clear();  // until the puller's thread has looked
        again_.reset();
      }
      // relaxed: all orders are given with the mutex
      seen_ = notifier_.orders_.load(std::memory_order_relaxed);
    }
    if (rings) notifier_.ring();
    return false;
  }
  std::optional<Sleep<detail::FutexWaits&>> arm() {
    waits_.push_back({&notifier_.orders_, seen_});
    return {{waits_, again_}};
  }

 private:
  Notifier& notifier_;
  detail::FutexWaits waits_;
  futex::Deadline again_;  ///< none: no puller is watched
  std::uint32_t seen_ = 0;
};

void Notifier::run() {
  pthread_setname_np(pthread_self(), "lot-notify");
  Watcher watcher(*this);
  if (!watcher.look()) waiting::wait(watcher, std::nullopt);
}

void Notifier::ring() noexcept { eventfd_write(fd_, 1); }

}  // namespace lot::waiting
