// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <bit>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "lot/detail/wait.hpp"

/// Sleeping on a word in shared memory until another process wakes the sleeper.
///
/// All futexes are shared ones: a private one does not wake another process. Deadlines are on the
/// steady clock. Every time_point is a valid deadline; one before the epoch has passed. A sleep may
/// end without a reason: the caller looks again.
///
/// Threads: all functions may be called at once.
/// Crash:   a sleeper that is killed leaves nothing behind.
/// Source:  futex(2), FUTEX_WAIT_BITSET for absolute deadlines; futex_waitv(2) for many words.
namespace lot::futex {

using Clock = std::chrono::steady_clock;
using Deadline = std::optional<Clock::time_point>;  ///< none: for ever

/// The futex of a 64-bit slot: its low half.
inline const void* low_half(const std::atomic<std::uint64_t>& word) noexcept {
  const auto* bytes = reinterpret_cast<const char*>(&word);
  return std::endian::native == std::endian::little ? bytes : bytes + 4;
}

/// Sleeps while *word == value. False when the deadline has passed.
[[gnu::hot]] bool wait(const void* word, std::uint32_t value, const Deadline& deadline) noexcept;

/// Sleeps while all the words have their values. False when the deadline has passed.
///
/// The kernel takes kMaxWords at once (futex_waitv). If there are more, additional threads sleep on
/// the rest. Where the kernel has no futex_waitv (Linux before 5.16, some sandboxes) the sleep
/// takes a few milliseconds at most.
inline constexpr std::size_t kMaxWords = 128;
[[gnu::hot]] bool wait_any(const detail::FutexWaits& waits, const Deadline& deadline) noexcept;

/// True where the kernel lets a thread sleep on many words for as long as it likes.
bool waits_for_many() noexcept;

/// Wakes `count` sleepers at most, those that have slept longest first. Returns how many.
[[gnu::hot]] int wake(const void* word, int count) noexcept;
void wake_one(const void* word) noexcept;
void wake_all(const void* word) noexcept;

/// A push wakes so many of the sleepers of a word, and a sleeper that was woken wakes as many more.
inline constexpr int kWakes = 2;

}  // namespace lot::futex
