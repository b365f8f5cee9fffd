// SPDX-License-Identifier: Apache-2.0
#include "robust_mutex/robust_mutex.hpp"

#include <algorithm>
#include <cerrno>
#include <linux/futex.h>
#include <system_error>

namespace lot {
namespace {

constexpr std::chrono::nanoseconds kLongest = std::chrono::hours(24 * 365);
/// Who sleeps looks by itself as well, since one that was woken may have been killed: first after
/// this time, then ever more seldom.
constexpr std::chrono::milliseconds kFirstLook{2};
constexpr std::chrono::milliseconds kSeldomest{64};
constexpr int kWaiters = static_cast<int>(FUTEX_WAITERS);

// The futex word of glibc's mutex, as the kernel knows it: the owner's thread id, a bit that says
// that it has died, and one that says that somebody sleeps (get_robust_list(2)).
bool is_free(int word) {
  return word == 0 || (static_cast<unsigned>(word) & FUTEX_OWNER_DIED) != 0;
}
bool is_held(int word) {
  return (static_cast<unsigned>(word) & FUTEX_TID_MASK) != 0 && !is_free(word);
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
  auto period = kFirstLook;
  for (bool has_waited = false;; has_waited = true) {
    const int result = attempt();
    if (result != EBUSY) {
      if (has_waited) mark();  // unlocking wakes one: there may be others who sleep
      return outcome(result);
    }
    const auto now = futex::Clock::now();
    if (now >= until) return Outcome::Busy;
    sleep_while_held(std::min(until, now + period));
    period = std::min(2 * period, kSeldomest);
  }
}

RobustMutex::Outcome RobustMutex::try_lock() noexcept { return outcome(attempt()); }

int RobustMutex::attempt() noexcept {
  return looks_held() ? EBUSY : pthread_mutex_trylock(&mutex_);
}

// Relaxed, as all that touches the mark: the futex looks at the word once more, and taking the lock
// orders what it guards.
void RobustMutex::mark() noexcept {
  int word = __atomic_load_n(&mutex_.__data.__lock, __ATOMIC_RELAXED);
  while (is_held(word) && (word & kWaiters) == 0 &&
         !__atomic_compare_exchange_n(&mutex_.__data.__lock, &word, word | kWaiters, false,
                                      __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
  }
}

void RobustMutex::sleep_while_held(futex::Clock::time_point until) noexcept {
  mark();
  const int word = __atomic_load_n(&mutex_.__data.__lock, __ATOMIC_RELAXED);
  if (!is_free(word)) futex::wait(&mutex_.__data.__lock, static_cast<std::uint32_t>(word), until);
}

bool RobustMutex::looks_held() const noexcept {
  return is_held(__atomic_load_n(&mutex_.__data.__lock, __ATOMIC_ACQUIRE));
}

std::optional<detail::FutexWait> RobustMutex::watch() noexcept {
  mark();
  const int word = __atomic_load_n(&mutex_.__data.__lock, __ATOMIC_ACQUIRE);
  if (!is_held(word) || (word & kWaiters) == 0) return std::nullopt;
  return detail::FutexWait{&mutex_.__data.__lock, static_cast<std::uint32_t>(word)};
}

void RobustMutex::unlock() noexcept {
  // The C library would wake while the kernel still counts us among those who may have the lock: so
  // the mark goes first. One that is set just now is woken by the C library.
  int& word = mutex_.__data.__lock;
  const bool wakes = (__atomic_load_n(&word, __ATOMIC_RELAXED) & kWaiters) != 0 &&
                     (__atomic_fetch_and(&word, ~kWaiters, __ATOMIC_RELAXED) & kWaiters) != 0;
  pthread_mutex_unlock(&mutex_);
  if (wakes) futex::wake_one(&word);
}

RobustMutex::Outcome RobustMutex::outcome(int result) noexcept {
  if (result == 0) return Outcome::Locked;
  if (result == EOWNERDEAD) {
    pthread_mutex_consistent(&mutex_);
    return Outcome::OwnerDied;
  }
  return Outcome::Busy;
}

}  // namespace lot
