// SPDX-License-Identifier: Apache-2.0
#include "robust_mutex/robust_mutex.hpp"

#include <algorithm>
#include <cerrno>
#include <system_error>
#include <thread>

namespace lot {
namespace {

constexpr std::chrono::nanoseconds kFirstPause = std::chrono::microseconds(20);
constexpr std::chrono::nanoseconds kLongestPause = std::chrono::milliseconds(1);

}  // namespace

void RobustMutex::construct(pthread_mutex_t& memory) {
  pthread_mutexattr_t attributes;
  pthread_mutexattr_init(&attributes);
  pthread_mutexattr_setpshared(&attributes, PTHREAD_PROCESS_SHARED);
  pthread_mutexattr_setrobust(&attributes, PTHREAD_MUTEX_ROBUST);
  const int result = pthread_mutex_init(&memory, &attributes);
  pthread_mutexattr_destroy(&attributes);
  if (result != 0) throw std::system_error(result, std::generic_category(), "pthread_mutex_init");
}

RobustMutex::Outcome RobustMutex::lock_for(std::chrono::nanoseconds timeout) noexcept {
  using Clock = std::chrono::steady_clock;
  constexpr std::chrono::nanoseconds kLongest = std::chrono::hours(24 * 365);
  const auto until = Clock::now() + std::min(timeout, kLongest);
  for (std::chrono::nanoseconds pause = kFirstPause;; pause = std::min(2 * pause, kLongestPause)) {
    const Outcome outcome = try_lock();
    const auto left = until - Clock::now();
    if (outcome != Outcome::Busy || left <= left.zero()) return outcome;
    std::this_thread::sleep_for(std::min<std::chrono::nanoseconds>(pause, left));
  }
}

RobustMutex::Outcome RobustMutex::try_lock() noexcept {
  return outcome(pthread_mutex_trylock(&mutex_));
}

void RobustMutex::unlock() noexcept { pthread_mutex_unlock(&mutex_); }

RobustMutex::Outcome RobustMutex::outcome(int result) noexcept {
  if (result == 0) return Outcome::Locked;
  if (result == EOWNERDEAD) {
    pthread_mutex_consistent(&mutex_);
    return Outcome::OwnerDied;
  }
  return Outcome::Busy;
}

}  // namespace lot
