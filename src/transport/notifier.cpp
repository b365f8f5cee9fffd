// SPDX-License-Identifier: Apache-2.0
#include "transport/notifier.hpp"

#include <cerrno>
#include <optional>
#include <sys/eventfd.h>
#include <system_error>
#include <unistd.h>

#include "lot/detail/no_signals.hpp"

#include "futex/futex.hpp"
#include "segment/system_limits.hpp"

namespace lot::transport {

Notifier::Notifier() : fd_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
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

void Notifier::watch(detail::PullerCore& puller) {
  // First, so that what comes from now on makes it readable again.
  eventfd_t count;
  eventfd_read(fd_, &count);
  detail::FutexWaits waits;
  std::optional<detail::Clock::time_point> again;
  try {
    again = puller.arm(waits);
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

void Notifier::run() {
  pthread_setname_np(pthread_self(), "lot-notify");
  detail::FutexWaits waits;
  for (bool watching = false;;) {
    futex::Deadline until;
    std::uint32_t seen;
    {
      const std::lock_guard guard(mutex_);
      if (order_ == Order::Stop) return;
      if (order_ == Order::Watch) {
        waits = waits_;
        watching = true;
        order_ = Order::Idle;
      }
      until = watching ? futex::Deadline(again_) : std::nullopt;
      // relaxed: all orders are given with the mutex
      seen = orders_.load(std::memory_order_relaxed);
    }
    if (!watching) {
      futex::wait(&orders_, seen, until);
      continue;
    }
    waits.push_back({&orders_, seen});
    futex::wait_any(waits, until);
    waits.pop_back();
    if (orders_.load(std::memory_order_relaxed) != seen) continue;  // relaxed: as above
    ring();
    watching = false;  // until the puller's thread has looked
  }
}

void Notifier::ring() noexcept { eventfd_write(fd_, 1); }

}  // namespace lot::transport
