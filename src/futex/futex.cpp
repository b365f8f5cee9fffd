// SPDX-License-Identifier: Apache-2.0
#include "futex/futex.hpp"

#include <bit>
#include <cerrno>
#include <climits>
#include <ctime>
#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

namespace lot::futex {
namespace {

timespec to_timespec(Clock::time_point at) {
  const auto ns =
      std::chrono::duration_cast<std::chrono::nanoseconds>(at.time_since_epoch()).count();
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

const void* low_half(const std::atomic<std::uint64_t>& word) noexcept {
  const auto* bytes = reinterpret_cast<const char*>(&word);
  return std::endian::native == std::endian::little ? bytes : bytes + 4;
}

bool wait(const void* word, std::uint32_t value, const Deadline& deadline) noexcept {
  timespec until{};
  if (deadline) until = to_timespec(*deadline);
  const long r = syscall(SYS_futex, word, FUTEX_WAIT_BITSET, value, deadline ? &until : nullptr,
                         nullptr, FUTEX_BITSET_MATCH_ANY);
  return !(r == -1 && errno == ETIMEDOUT);
}

bool wait_any(const Wait* waits, unsigned count, const Deadline& deadline) noexcept {
  if (count == 0) return true;
  if (count == 1) return wait(waits[0].word, waits[0].value, deadline);
  // Without futex_waitv (Linux before 5.16, some sandboxes), and of more words than it takes, only
  // some are slept on: so not for long.
  const Clock::time_point slice = Clock::now() + std::chrono::milliseconds(2);
  const bool last = deadline && *deadline <= slice;
  const Deadline soon = last ? *deadline : slice;
  const bool all = count <= kMaxWords;
  const Deadline& until = all ? deadline : soon;
  if (!all) count = kMaxWords;
  WaitvEntry entries[kMaxWords];
  for (unsigned i = 0; i < count; ++i) {
    entries[i] = {waits[i].value, reinterpret_cast<std::uint64_t>(waits[i].word), kSize32, 0};
  }
  const timespec at = until ? to_timespec(*until) : timespec{};
  const long r = syscall(kFutexWaitv, entries, count, 0, until ? &at : nullptr, CLOCK_MONOTONIC);
  if (r >= 0 || errno == EAGAIN || errno == EINTR) return true;
  if (errno == ETIMEDOUT) return !all && !last;
  return wait(waits[0].word, waits[0].value, soon) || !last;
}

void wake_all(const void* word) noexcept {
  syscall(SYS_futex, word, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
}

}  // namespace lot::futex
