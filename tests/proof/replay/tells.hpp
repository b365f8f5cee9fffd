// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <unistd.h>

/// What a worker says to the conductor. A tell is a system call that no kernel has: the conductor
/// stops the worker there anyway, reads the registers, and answers in the kernel's place.
namespace lot::replay {

inline constexpr long kTell = 0x4c4f54;

enum class Tell : std::uint32_t {
  Operation,    ///< the next operation begins
  Advertise,    ///< topic: a publisher is about to come. Answers its channel
  Unadvertise,  ///< channel: its publisher has gone
  Subscribe,    ///< topic: a reader is about to come. Answers its number
  Subscribed,   ///< reader: it is there
  Unsubscribe,  ///< reader: it is about to go
  Push,         ///< channel, number: about to push it, and perhaps to wait for room
  Pushed,       ///< channel, number, 1: Ok
  Wait,         ///< reader: about to wait for a message
  Got,          ///< reader, channel, number, missed_total: a message
  GotNone,      ///< reader, missed_total: no message
  Put,          ///< number: about to put that item
  HasPut,       ///< number, 1: Ok
  Take,         ///< about to take an item
  Took,         ///< number of the item
  TookNone,
  Stage,  ///< number: sleeps until all workers have come to this stage
  Wrong,  ///< address, length: a violation that the worker itself has found
};

/// Topics of the workers.
inline constexpr std::uint64_t kFrames = 0, kLetters = 1;

/// The stages of a run, by which the workers wait for each other.
enum class Stage : std::uint32_t {
  Work,    ///< operations
  Drain,   ///< each reads what is left for it
  Let_go,  ///< publishers, readers and pointers go
  Leave,   ///< engines go: the segment must hold nothing when this stage begins
};

template <class... Parts>
long tell(Tell what, Parts... parts) {
  return syscall(kTell, static_cast<std::uint64_t>(what), static_cast<std::uint64_t>(parts)...);
}

}  // namespace lot::replay
