// SPDX-License-Identifier: Apache-2.0
#include "robust_mutex/robust_mutex.hpp"

#include <algorithm>
#include <cerrno>
#include <linux/futex.h>
#include <system_error>

namespace lot {
namespace {

constexpr std::chrono::nanoseconds kLongest = std::chrono::hours(24 * 365);
/// Who sleeps looks by itself this often: one that was woken may have been killed.
constexpr std::chrono::milliseconds kLookPeriod{2};
constexpr int kWaiters = static_cast<int>(FUTEX_WAITERS);

/// The futex word of glibc's mutex, as the kernel knows it: the owner's thread id and a bit that
/// says that it has died (get_robust_list(2)).
bool is_held(int futex_word) {
  const auto word = static_cast<unsigned>(futex_word);
  return (word & FUTEX_TID_MASK) != 0 && (word & FUTEX_OWNER_DIED) == 0;
}

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

RobustMutex::Outcome RobustMutex::lock() noexcept { return lock_for(kLongest); }

RobustMutex::Outcome RobustMutex::lock_for(std::chrono::nanoseconds timeout) noexcept {
  const auto until =
      futex::Clock::now() + std::clamp(timeout, std::chrono::nanoseconds(0), kLongest);
  for (bool has_waited = false;; has_waited = true) {
    const Outcome result = try_lock();
    if (result != Outcome::Busy) {
      // Unlocking wakes one: there may be others who sleep.
      if (has_waited) __atomic_fetch_or(&mutex_.__data.__lock, kWaiters, __ATOMIC_RELAXED);
      return result;
    }
    const auto now = futex::Clock::now();
    if (now >= until) return Outcome::Busy;
    sleep_while_held(std::min(until, now + kLookPeriod));
  }
}

RobustMutex::Outcome RobustMutex::try_lock() noexcept {
  if (looks_held()) return Outcome::Busy;
  return outcome(pthread_mutex_trylock(&mutex_));
}

void RobustMutex::sleep_while_held(futex::Clock::time_point until) noexcept {
  int word = __atomic_load_n(&mutex_.__data.__lock, __ATOMIC_RELAXED);
  if (!is_held(word)) return;
  const int marked = word | kWaiters;
  // Relaxed: the futex looks at the word once more, and taking the lock orders what it guards.
  if (word != marked && !__atomic_compare_exchange_n(&mutex_.__data.__lock, &word, marked, false,
                                                     __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
    return;
  }
  futex::wait(&mutex_.__data.__lock, static_cast<std::uint32_t>(marked), until);
}

bool RobustMutex::looks_held() const noexcept {
  return is_held(__atomic_load_n(&mutex_.__data.__lock, __ATOMIC_ACQUIRE));
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
