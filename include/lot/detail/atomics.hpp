// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "lot/detail/patience.hpp"

namespace lot::detail {

/// The atomics policy of the library itself: the machine's real atomics.
///
/// Every algorithm of the protocol is a template. Its parameters are such a policy and the memory
/// it works on. So a model checker runs the very header that the library compiles:
/// tests/proof/model supplies a policy of checked atomics.
struct HardwareAtomics {
  template <class T>
  using Atomic = std::atomic<T>;

  static constexpr std::size_t kLine = 64;  ///< bytes of a cache line
  static constexpr unsigned kOwnWords = 6;  ///< words of ownership bits in a block
  static constexpr unsigned kBitsPerWord = 63;

  /// Tells the core that the caller spins.
  static void pause() noexcept {
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    asm volatile("yield");
#endif
  }

  /// How a thread waits for another thread of its process, and how it names that thread.
  using Patience = detail::Patience;
  static std::uint32_t this_thread() noexcept { return ThisThread::id(); }
  /// Called at the end of a section in which the hold word, or a lock, has named this thread.
  static void passed() noexcept { ThisThread::passed(); }

  /// The protocol reaches such a step only when a foreign write has damaged the words.
  static void damage_seen() noexcept {}

  /// What follows comes behind all that this thread has loaded.
  static void acquire_fence() noexcept {
    std::atomic_thread_fence(std::memory_order_acquire);  // acquire: the caller says why
  }
  /// What it stores then comes behind all that it has loaded or stored.
  static void release_fence() noexcept {
    std::atomic_thread_fence(std::memory_order_release);  // release: the caller says why
  }

  static void prefetch_read(const void* address) noexcept { __builtin_prefetch(address, 0); }
  /// The line is this core's alone then. By itself GCC makes no more than a prefetch for reading of
  /// it, and the store still waits for the other cores. Old processors take the instruction for
  /// none.
  static void prefetch_write(const void* address) noexcept {
#if defined(__x86_64__)
    asm volatile("prefetchw %0" : : "m"(*static_cast<const char*>(address)));
#else
    __builtin_prefetch(address, 1);
#endif
  }
};

static_assert(std::atomic<std::uint64_t>::is_always_lock_free,
              "lot: needs lock-free 64-bit atomics, else a killed process could hold their lock");
static_assert(std::atomic<std::uint32_t>::is_always_lock_free);
static_assert(sizeof(std::atomic<std::uint64_t>) == 8 && sizeof(std::atomic<std::uint32_t>) == 4);

}  // namespace lot::detail
