// SPDX-License-Identifier: Apache-2.0
#include "robust_mutex/robust_mutex.hpp"

#include <algorithm>
#include <cerrno>
#include <ctime>
#include <linux/futex.h>
#include <system_error>

namespace lot {

void RobustMutex::construct(pthread_mutex_t& memory) {
  pthread_mutexattr_t attributes;
  pthread_mutexattr_init(&attributes);
  pthread_mutexattr_setpshared(&attributes, PTHREAD_PROCESS_SHARED);
  pthread_mutexattr_setrobust(&attributes, PTHREAD_MUTEX_ROBUST);
  const int result = pthread_mutex_init(&memory, &attributes);
  pthread_mutexattr_destroy(&attributes);
  if (result != 0) throw std::system_error(result, std::generic_category(), "pthread_mutex_init");
}

RobustMutex::Outcome RobustMutex::lock() noexcept { return outcome(pthread_mutex_lock(&mutex_)); }

RobustMutex::Outcome RobustMutex::lock_for(std::chrono::nanoseconds timeout) noexcept {
  timespec until{};
  clock_gettime(CLOCK_MONOTONIC, &until);
  constexpr std::chrono::nanoseconds kLongest = std::chrono::hours(24 * 365);
  timeout = std::clamp(timeout, std::chrono::nanoseconds(0), kLongest);
  const long long ns = until.tv_nsec + timeout.count();
  until.tv_sec += static_cast<time_t>(ns / 1'000'000'000);
  until.tv_nsec = static_cast<long>(ns % 1'000'000'000);
  return outcome(pthread_mutex_clocklock(&mutex_, CLOCK_MONOTONIC, &until));
}

RobustMutex::Outcome RobustMutex::try_lock() noexcept {
  return outcome(pthread_mutex_trylock(&mutex_));
}

bool RobustMutex::looks_held() const noexcept {
  // The futex word of glibc's mutex, as the kernel knows it: the owner's thread id and a bit that
  // says that it has died (get_robust_list(2)).
  const auto word = static_cast<unsigned>(__atomic_load_n(&mutex_.__data.__lock, __ATOMIC_ACQUIRE));
  return (word & FUTEX_TID_MASK) != 0 && (word & FUTEX_OWNER_DIED) == 0;
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
