// SPDX-License-Identifier: Apache-2.0
#include "robust_mutex/robust_mutex.hpp"

#include <algorithm>
#include <cerrno>

#include "lot/error.hpp"

#include "futex/futex.hpp"

namespace lot {
namespace {

constexpr std::chrono::nanoseconds kLongest = std::chrono::hours(24 * 365);
/// A process that sleeps also looks by itself: first after kFirstLook, and then after ever longer
/// times up to kSeldomest.
constexpr std::chrono::milliseconds kFirstLook{2};
constexpr std::chrono::milliseconds kSeldomest{64};

using Steps = lock::LockWord<detail::HardwareAtomics>;

}  // namespace

void LockOwner::require_place(const std::string& path) const {
  if (name() != 0) return;
  throw Error(ESTALE, path, "this process has no place in the segment any more",
              "make new lot objects");
}

RobustMutex::Outcome RobustMutex::lock_for(std::chrono::nanoseconds timeout) noexcept {
  const std::uint32_t name = owner_.name();
  if (name == 0) return Outcome::Busy;
  if (Steps(word_).try_lock(name, false)) return Outcome::Locked;
  const Outcome outcome = wait_for(timeout, name);
  if (outcome == Outcome::Busy || owner_.name() == name) return outcome;
  // Others took the process for dead meanwhile. It must not act under its old name.
  if (Steps(word_).unlock(name)) futex::wake_one(&word_);
  return Outcome::Busy;
}

RobustMutex::Outcome RobustMutex::wait_for(std::chrono::nanoseconds timeout,
                                           std::uint32_t name) noexcept {
  Steps word(word_);
  const auto until =
      futex::Clock::now() + std::clamp(timeout, std::chrono::nanoseconds(0), kLongest);
  auto period = kFirstLook;
  for (auto due = std::min(until, futex::Clock::now() + period);;) {
    const std::uint32_t seen = word.announce();
    if (seen != 0) futex::wait(&word_, seen, due);
    if (word.try_lock(name, true)) return Outcome::Locked;
    const auto now = futex::Clock::now();
    if (now < due) continue;  // signals and other waiters do not delay the look
    if (seen != 0 && take_over(seen, name)) return Outcome::OwnerDied;
    if (now >= until || owner_.name() != name) return Outcome::Busy;
    period = std::min(2 * period, kSeldomest);
    due = std::min(until, now + period);
  }
}

RobustMutex::Outcome RobustMutex::try_lock() noexcept {
  Steps word(word_);
  const std::uint32_t name = owner_.name();
  if (name == 0) return Outcome::Busy;
  if (word.try_lock(name, false)) return Outcome::Locked;
  const std::uint32_t seen = word.seen();
  return seen != 0 && take_over(seen, name) ? Outcome::OwnerDied : Outcome::Busy;
}

bool RobustMutex::take_over(std::uint32_t seen, std::uint32_t name) noexcept {
  const std::uint32_t holder = lock::name(seen);
  return holder != name && owner_.is_gone(holder) && Steps(word_).take_over(seen, name);
}

std::uint32_t RobustMutex::holder() const noexcept { return lock::name(Steps(word_).seen()); }

void RobustMutex::unlock() noexcept {
  const std::uint32_t name = owner_.name();
  if (name != 0 && Steps(word_).unlock(name)) futex::wake_one(&word_);
}

}  // namespace lot
