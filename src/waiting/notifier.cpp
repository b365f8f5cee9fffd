// SPDX-License-Identifier: Apache-2.0
#include "waiting/notifier.hpp"

#include <algorithm>
#include <cerrno>
#include <mutex>
#include <optional>
#include <sys/eventfd.h>
#include <system_error>
#include <unistd.h>
#include <utility>

#include "lot/detail/no_signals.hpp"

#include "segment/descriptors.hpp"
#include "segment/system_limits.hpp"
#include "waiting/waiting.hpp"

namespace lot::waiting {
namespace {

using namespace std::chrono_literals;

/// Descriptors whose time comes so soon become readable together, so that the thread does not wake
/// for each.
constexpr auto kTogether = 100ms;

int make_descriptor() {
  const int fd = segment::above_standard(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (fd != -1) return fd;
  throw Error(errno, "eventfd", "no descriptor to wait for messages by",
              "close descriptors, or raise the limit (ulimit -n)");
}

}  // namespace

void Descriptors::stop() noexcept {
  if (!thread_.joinable()) return;
  {
    const std::lock_guard guard(mutex_);
    is_to_end_ = true;
    give_order();
  }
  thread_.join();
  is_to_end_ = false;
  ear_.reset();
}

void Descriptors::add(Notifier& notifier) {
  const std::lock_guard guard(mutex_);
  if (!thread_.joinable()) {
    ear_ = std::make_unique<Ear>(owner_);
    try {
      const detail::NoSignals quiet;
      thread_ = std::thread([this] { run(); });
    } catch (const std::system_error& e) {
      ear_.reset();
      throw Error(e.code().value(), "thread", "no thread to wait for messages",
                  segment::advice_on_threads());
    }
  }
  notifiers_.push_back(&notifier);
}

void Descriptors::remove(Notifier& notifier) noexcept {
  const std::lock_guard guard(mutex_);
  ear_->forget(notifier);
  notifiers_.remove(&notifier);
}

void Descriptors::take_news() noexcept {
  if (owner_.has_lost_ears()) return;
  ear_->take_news([](Ear::Client& client) { static_cast<Notifier&>(client).ring(); });
}

void Descriptors::look_by(detail::Clock::time_point time) noexcept {
  if (again_ && *again_ <= time) return;
  again_ = time;
  give_order();
}

void Descriptors::give_order() noexcept {
  orders_.fetch_add(1, std::memory_order_relaxed);  // relaxed: the mutex carries the order
  futex::wake_all(&orders_);
}

/// How the thread waits until it is told to end. Each look is its first, or comes after a sleep.
class Descriptors::Watcher : public waiting::Steps<Watcher> {
 public:
  explicit Watcher(Descriptors& all) : all_(all) {}

  /// True: it is told to end. Else it makes descriptors readable: those whose rings have news, and
  /// those whose time has come.
  bool look() {
    const std::lock_guard guard(all_.mutex_);
    if (all_.is_to_end_) return true;
    // A lost ear: the users' own looks say why.
    const bool hears = all_.ear_->take([](Ear::Client& c) { static_cast<Notifier&>(c).ring(); });
    const auto now = futex::Clock::now();
    if (!hears || (all_.again_ && *all_.again_ <= now)) ring_by(hears ? now + kTogether : kEver);
    return false;
  }
  std::optional<Sleep<detail::FutexWaits&>> arm() {
    const std::lock_guard guard(all_.mutex_);
    // Relaxed: all orders are given with the mutex. One that came since the look has a look.
    const std::uint32_t orders = all_.orders_.load(std::memory_order_relaxed);
    if (std::exchange(seen_, orders) != orders) return std::nullopt;
    waits_.clear();
    all_.ear_->prepare_to_sleep(waits_);
    waits_.push_back({&all_.orders_, seen_});
    return {{waits_, all_.again_}};
  }

 private:
  static constexpr auto kEver = futex::Clock::time_point::max();

  /// Makes those readable whose time comes by then, and finds the next time. REQUIRES: the mutex.
  void ring_by(futex::Clock::time_point then) {
    all_.again_.reset();
    for (Notifier* const notifier : all_.notifiers_) {
      auto& again = notifier->again_;
      if (again && *again <= then) notifier->ring();
      if (again) all_.again_ = std::min(all_.again_.value_or(*again), *again);
    }
  }

  Descriptors& all_;
  detail::FutexWaits waits_;
  std::uint32_t seen_ = 0;  ///< orders
};

void Descriptors::run() {
  pthread_setname_np(pthread_self(), "lot-notify");
  Watcher watcher(*this);
  if (!watcher.look()) waiting::wait(watcher, std::nullopt);
}

Notifier::Notifier(Descriptors& descriptors) : descriptors_(descriptors), fd_(make_descriptor()) {
  by_ear_.hear_by(this);
  try {
    descriptors_.add(*this);
  } catch (...) {
    close(fd_);
    throw;
  }
}

Notifier::~Notifier() {
  descriptors_.remove(*this);
  close(fd_);
}

void Notifier::watch(detail::Waitable& waitable) {
  {
    const std::lock_guard guard(descriptors_.mutex_);
    // Else the thread may take these news for later ones.
    descriptors_.take_news();
    // Before it is armed: what comes from now on makes it readable again.
    eventfd_t count;
    eventfd_read(fd_, &count);
  }
  std::optional<detail::Clock::time_point> again;
  try {
    again = waitable.arm(by_ear_);
  } catch (...) {
    const std::lock_guard guard(descriptors_.mutex_);
    ring();  // it may not be armed: the puller's user has to look again
    throw;
  }
  const std::lock_guard guard(descriptors_.mutex_);
  again_ = again;
  if (again_) {
    descriptors_.look_by(*again_);
  } else {
    ring();
  }
}

void Notifier::listen(std::uint32_t channel) {
  const std::lock_guard guard(descriptors_.mutex_);
  descriptors_.ear_->listen(*this, channel);
}

void Notifier::watch_directory(std::uint32_t version) {
  const std::lock_guard guard(descriptors_.mutex_);
  // Else the thread may sleep without the directory's version.
  if (descriptors_.ear_->watch_directory(*this, version)) descriptors_.give_order();
}

/// The puller's thread then looks, and arms it again.
void Notifier::ring() noexcept {
  again_.reset();
  eventfd_write(fd_, 1);
}

}  // namespace lot::waiting
