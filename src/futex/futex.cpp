// SPDX-License-Identifier: Apache-2.0
#include "futex/futex.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <ctime>
#include <linux/futex.h>
#include <span>
#include <sys/syscall.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include "lot/detail/no_signals.hpp"

namespace lot::futex {
namespace {

/// A time before the epoch becomes the epoch: both have passed. For negative seconds the kernel
/// returns EINVAL, and the sleep would end as if by a wake, again and again.
timespec to_timespec(Clock::time_point at) {
  const std::chrono::nanoseconds since = std::max(at, Clock::time_point()).time_since_epoch();
  const auto ns = since.count();
  return {static_cast<time_t>(ns / 1'000'000'000), static_cast<long>(ns % 1'000'000'000)};
}

#ifndef SYS_futex_waitv
constexpr long kFutexWaitv = 449;
#else
constexpr long kFutexWaitv = SYS_futex_waitv;
#endif

struct WaitvEntry {  // struct futex_waitv of newer kernel headers
  std::uint64_t value;
  std::uint64_t address;
  std::uint32_t flags;
  std::uint32_t reserved;
};
constexpr std::uint32_t kSize32 = 2;  // FUTEX_32, shared

}  // namespace

bool wait(const void* word, std::uint32_t value, const Deadline& deadline) noexcept {
  timespec until{};
  if (deadline) until = to_timespec(*deadline);
  const long r = syscall(SYS_futex, word, FUTEX_WAIT_BITSET, value, deadline ? &until : nullptr,
                         nullptr, FUTEX_BITSET_MATCH_ANY);
  return !(r == -1 && errno == ETIMEDOUT);
}

namespace {

constexpr auto kSlice = std::chrono::milliseconds(2);

/// Sleeps on at most kMaxWords words.
bool wait_some(std::span<const detail::FutexWait> waits, const Deadline& deadline) noexcept {
  WaitvEntry entries[kMaxWords];
  for (std::size_t i = 0; i < waits.size(); ++i) {
    entries[i] = {waits[i].value, reinterpret_cast<std::uint64_t>(waits[i].word), kSize32, 0};
  }
  const timespec at = deadline ? to_timespec(*deadline) : timespec{};
  const long r =
      syscall(kFutexWaitv, entries, waits.size(), 0, deadline ? &at : nullptr, CLOCK_MONOTONIC);
  if (r >= 0 || errno == EAGAIN || errno == EINTR) return true;
  if (errno == ETIMEDOUT) return false;
  // There is no futex_waitv: this sleeps on the first word only, so not for long.
  const Clock::time_point soon = Clock::now() + kSlice;
  const bool last = deadline && *deadline <= soon;
  return wait(waits[0].word, waits[0].value, last ? *deadline : soon) || !last;
}

/// Each group of words has a thread that sleeps on it. The thread that wakes first rings a bell for
/// all the others.
bool wait_chained(const detail::FutexWaits& waits, const Deadline& deadline) {
  std::atomic<std::uint32_t> bell{0};
  const auto sleep = [&](std::size_t begin) {
    const std::size_t end = std::min(waits.size(), begin + kMaxWords - 1);
    std::array<detail::FutexWait, kMaxWords> group;
    std::copy(waits.begin() + static_cast<std::ptrdiff_t>(begin),
              waits.begin() + static_cast<std::ptrdiff_t>(end), group.begin());
    group[end - begin] = {&bell, 0};
    const bool woken = wait_some({group.data(), end - begin + 1}, deadline);
    bell.store(1, std::memory_order_relaxed);  // it tells only to wake; the caller looks again
    wake_all(&bell);
    return woken;
  };
  std::vector<std::thread> others;  // libc++ 19 has no std::jthread
  try {
    const detail::NoSignals quiet;
    for (std::size_t begin = kMaxWords - 1; begin < waits.size(); begin += kMaxWords - 1) {
      others.emplace_back([&sleep, begin] { sleep(begin); });
    }
  } catch (...) {  // no further thread can start: the others wake up, and the caller looks again
    bell.store(1, std::memory_order_relaxed);  // it tells only to wake
    wake_all(&bell);
    std::this_thread::sleep_for(kSlice);
  }
  const bool woken = sleep(0);
  for (std::thread& other : others) other.join();
  return woken;
}

}  // namespace

bool wait_any(const detail::FutexWaits& waits, const Deadline& deadline) noexcept {
  if (waits.empty()) return true;
  if (waits.size() == 1) return wait(waits[0].word, waits[0].value, deadline);
  if (waits.size() <= kMaxWords) return wait_some(waits, deadline);
  wait_chained(waits, deadline);
  return !(deadline && Clock::now() >= *deadline);
}

bool waits_for_many() noexcept {
  // The kernel refuses to sleep on no word: with EINVAL if it knows the call, else with ENOSYS.
  return syscall(kFutexWaitv, nullptr, 0, 0, nullptr, CLOCK_MONOTONIC) == -1 && errno == EINVAL;
}

int wake(const void* word, int count) noexcept {
  return static_cast<int>(syscall(SYS_futex, word, FUTEX_WAKE, count, nullptr, nullptr, 0));
}

void wake_one(const void* word) noexcept { wake(word, 1); }

void wake_all(const void* word) noexcept { wake(word, INT_MAX); }

}  // namespace lot::futex
