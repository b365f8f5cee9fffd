// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "lot/detail/hold_word.hpp"

namespace lot::detail {

struct ControlBlock;
struct Described;

/// What a pointer needs of the copy of the library that made it. The pointer itself leads to it. So
/// code that was linked with another copy can release the pointer.
struct Hub {
  /// Drops what is most likely the last pointer of this process.
  void (*drop_last)(ControlBlock*) noexcept;
  /// A unique pointer gives up a message that was never shared.
  void (*abandoned)(ControlBlock*) noexcept;
  /// Takes a pointer hold on a block that is protected.
  void (*acquire)(ControlBlock*) noexcept;
  bool (*lock_weak)(ControlBlock*, std::uint32_t generation) noexcept;
  std::uint32_t (*generation)(const ControlBlock*) noexcept;
  std::size_t (*others)(const ControlBlock*) noexcept;  ///< other processes that hold the block
  void (*weak_count)(ControlBlock*, int change) noexcept;
  /// Turns a unique pointer, whose message no reader has, into a shared one.
  void (*shared_from_unique)(ControlBlock*) noexcept;
  /// Notes that pointers of this process have the message.
  void (*points)(ControlBlock*) noexcept;
  const char* (*path)(const ControlBlock*) noexcept;  ///< path of the segment
  /// Tells the segment from earlier and later ones of its name.
  std::uint64_t (*instance)(const ControlBlock*) noexcept;
  /// True when the message of a weak pointer has died, or this process has left the segment.
  bool (*expired)(const ControlBlock*, std::uint32_t generation) noexcept;
  /// True when there is one pointer to the message, and no queue, reader or other process has it.
  bool (*alone)(const ControlBlock*) noexcept;
  /// Where that copy of the library has mapped the segment.
  const unsigned char* (*base)(const ControlBlock*) noexcept;
};

/// How the library handles a message without knowing its type.
struct MessageType {
  std::uint64_t size;
  std::uint64_t align;
  std::uint64_t hash;
  const char* name;
  void (*destroy)(void*) noexcept;  ///< the destructor; null: the type needs none
  bool plain;                       ///< trivially copyable: it has no memory beside its own bytes
  /// What it is made of; null: that is not known. Throws std::bad_alloc.
  const Described& (*described)(const MessageType&);
  const MessageType* element = nullptr;  ///< of a queue's: what one item is; null: the type itself
};

/// What this process knows of one block: the private hold word, and the library copy that releases
/// the block.
///
/// Memory:  private to the process; lives as long as its participant.
struct alignas(32) ControlBlock {
  HoldWord<std::atomic<std::uint64_t>> hold;
  const Hub* hub;
  const MessageType* type;  ///< set while this process is the home of the block
  std::uint32_t block;
  /// Index of the pool that has the block, while this process is the home. The thread that claims
  /// the block writes it. A thread that comes late with an older message may read it
  /// (Pool::last_hold_gone).
  std::atomic<std::uint32_t> pool;

  /// Counts one pointer less. The hub drops the last pointer. Afterwards the hub, and with it this
  /// control block, may be gone.
  void drop_pointer() noexcept {
    if (!hold.drop_pointer_of_several()) hub->drop_last(this);
  }
};
static_assert(sizeof(ControlBlock) == 32);

}  // namespace lot::detail
