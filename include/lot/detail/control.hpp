// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "lot/detail/hold_word.hpp"

namespace lot::detail {

struct ControlCell;

/// What a pointer needs of the copy of the library that made it. It is reached through the pointer
/// itself, so a pointer may be released by code that was linked with another copy.
struct Hub {
  void (*drop_last)(ControlCell*) noexcept;  ///< drops what is most likely the last pointer here
  void (*abandoned)(ControlCell*) noexcept;  ///< a unique pointer let go of what was never shared
  void (*acquire)(ControlCell*) noexcept;    ///< a pointer hold on a block that is protected
  bool (*lock_weak)(ControlCell*, std::uint32_t generation) noexcept;
  std::uint32_t (*generation)(const ControlCell*) noexcept;
  std::size_t (*others)(const ControlCell*) noexcept;  ///< other processes that hold the block
  void (*weak_count)(ControlCell*, int change) noexcept;
  /// A unique pointer, whose message no reader has, becomes a shared one.
  void (*shared_from_unique)(ControlCell*) noexcept;
  void (*points)(ControlCell*) noexcept;             ///< pointers of this process have the message
  const char* (*path)(const ControlCell*) noexcept;  ///< of the segment
  std::uint64_t (*instance)(
      const ControlCell*) noexcept;  ///< of the segment: which one of its name
  /// True when the message of a weak pointer has died, or its process has left the segment.
  bool (*expired)(const ControlCell*, std::uint32_t generation) noexcept;
  /// True when there is one pointer to the message, and no queue, reader or other process has it.
  bool (*alone)(const ControlCell*) noexcept;
  const unsigned char* (*base)(const ControlCell*) noexcept;  ///< where it has mapped the segment
};

/// How the library handles a message without knowing its type.
struct MessageType {
  std::uint64_t size;
  std::uint64_t align;
  std::uint64_t hash;
  const char* name;
  void (*destroy)(void*) noexcept;  ///< null: nothing to do
  bool plain;                       ///< trivially copyable: has no memory beside its own bytes
};

/// True when a message of the one type may be taken for one of the other: what a topic compares.
inline bool is_same(const MessageType& a, const MessageType& b) noexcept {
  return a.size == b.size && a.align == b.align && a.hash == b.hash &&
         std::strcmp(a.name, b.name) == 0;
}

/// What this process knows of one block: the private hold word, and who releases it.
///
/// Memory: private to the process; lives as long as its participant.
struct alignas(32) ControlCell {
  std::atomic<std::uint64_t> hold;
  const Hub* hub;
  const MessageType* type;  ///< set while the block is at home here
  std::uint32_t block;
  /// Index of the pool that has it, while at home here. Written by the thread that claims it; one
  /// that comes late with an older message may read it (Pool::came_home).
  std::atomic<std::uint32_t> pool;

  /// Another pointer of this process. REQUIRES: one exists.
  void add_pointer() noexcept { hold.fetch_add(hold::kPointer, std::memory_order_relaxed); }

  /// One pointer less. The last one is dropped by the hub, which may be gone afterwards, and so
  /// this.
  void drop_pointer() noexcept {
    std::uint64_t v = hold.load(std::memory_order_relaxed);
    while (hold::pointers(v) > 1) {
      if (hold.compare_exchange_weak(v, v - hold::kPointer, std::memory_order_acq_rel,
                                     std::memory_order_relaxed)) {
        return;
      }
    }
    hub->drop_last(this);
  }
};
static_assert(sizeof(ControlCell) == 32);

}  // namespace lot::detail
