// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#if defined(__SANITIZE_ADDRESS__)
#define LOT_POISONS 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define LOT_POISONS 1
#endif
#endif

#ifdef LOT_POISONS
#include <sanitizer/asan_interface.h>
#endif

/// Under AddressSanitizer a piece that a container has given back to its message must not be
/// touched: the sanitizer then reports the line that does. Without it these functions do nothing.
///
/// The sanitizer's notes are private to the process, and the segment is not. So memory is poisoned
/// only in the process that builds a message, and only while no other process can have it: until
/// the message is published or dies, or the run goes back to the segment. Library and program are
/// built alike, with AddressSanitizer or without.
namespace lot::detail {

#ifdef LOT_POISONS
inline constexpr bool kPoisons = true;
#else
inline constexpr bool kPoisons = false;
#endif

inline void poison([[maybe_unused]] const void* memory,
                   [[maybe_unused]] std::size_t bytes) noexcept {
#ifdef LOT_POISONS
  __asan_poison_memory_region(memory, bytes);
#endif
}

inline void unpoison([[maybe_unused]] const void* memory,
                     [[maybe_unused]] std::size_t bytes) noexcept {
#ifdef LOT_POISONS
  __asan_unpoison_memory_region(memory, bytes);
#endif
}

}  // namespace lot::detail
