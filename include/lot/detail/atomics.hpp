// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "lot/detail/patience.hpp"

namespace lot::detail {

/// The atomics policy of the library itself: real atomics of the machine.
///
/// Every algorithm of the protocol is a template on such a policy over memory that it is given, so
/// that the header which the library compiles is the one that a model checker runs
/// (tests/proof/model supplies a policy of checked atomics).
struct HardwareAtomics {
  template <class T>
  using Atomic = std::atomic<T>;

  static constexpr std::size_t kLine = 64;  ///< bytes that travel together between cores
  static constexpr unsigned kOwnWords = 6;  ///< words of ownership bits of a block
  static constexpr unsigned kBitsPerWord = 63;

  /// Tells the core that the caller spins.
  static void pause() noexcept {
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    asm volatile("yield");
#endif
  }

  /// How a thread waits for another one of its process, and how that one is named.
  using Patience = detail::Patience;
  static std::uint32_t this_thread() noexcept { return ThisThread::id(); }
  /// Behind a section in which this thread was named.
  static void passed() noexcept { ThisThread::passed(); }

  /// A step that only somebody else's write into the words can lead to.
  static void damage_seen() noexcept {}

  static void prefetch_read(const void* address) noexcept { __builtin_prefetch(address, 0); }
  static void prefetch_write(const void* address) noexcept { __builtin_prefetch(address, 1); }
};

static_assert(std::atomic<std::uint64_t>::is_always_lock_free,
              "lot: needs lock-free 64-bit atomics, else a killed process could hold their lock");
static_assert(std::atomic<std::uint32_t>::is_always_lock_free);
static_assert(sizeof(std::atomic<std::uint64_t>) == 8 && sizeof(std::atomic<std::uint32_t>) == 4);

}  // namespace lot::detail
