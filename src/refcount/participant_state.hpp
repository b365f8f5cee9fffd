// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "lot/detail/changed_by.hpp"

namespace lot::refcount {

/// Whether an index has a participant: 0 no, 1 yes. While it is 1, bits and homes of the index
/// count, and a reaper has work if the participant is dead. All its changes are here.
///
/// Edges
///   state  take(), free() (release) -> each look at the word (acquire)
///       carries: what the participant has written before it came, and what its reaper has done.
///       Byte k of two lock files may be two locks. Then a process that finds the index free has
///       only this word.
///
/// Threads: the process that has byte lock k calls take() and free().
/// Crash:   killed before take(), the index is as it was. Killed before free(), the next reaper
///          does it all again.
template <class P>
class ParticipantState
    : public detail::ChangedBy<typename P::template Atomic<std::uint32_t>, ParticipantState<P>> {
 public:
  void take() { this->store(1, std::memory_order_release); }  // edge "state"
  void free() { this->store(0, std::memory_order_release); }  // edge "state"
};

}  // namespace lot::refcount
