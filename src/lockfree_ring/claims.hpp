// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>

#include "lockfree_ring/words.hpp"

/// Messages that stay in their slots until their reader has finished with them. Beside each slot is
/// a claim, which names the worker of its message. A worker that dies, or gives the message back,
/// leaves a slot that is as it was, so that nothing has to be put anywhere again.
///
/// The steps, and what a kill after each leaves (docs/queue.md):
///   claim()    the claim names the worker: its reaper takes the name away
///   empty()    the slot has no message: it is finished; the claim is out of date
///   unclaim()  any worker may claim the message; the readers were not told: the reaper tells them
///
/// Edges
///   C1  unclaim() (release) -> claim() (acquire)
///       carries: what the last worker has done; and of a reaper, that the dead one may have
///       emptied the slot.
///   C2  `returned` bump (release) -> load in Reader::look_back (acquire)
///       carries: the claims that were taken back.
namespace lot::ring {

/// True while a worker has the message of this sequence: true a moment ago.
template <class Claim>
bool is_claimed(const Claim& claim, Word sequence) {
  const Word seen = claim.load(std::memory_order_relaxed);
  return claim_sequence(seen) == sequence && claim_worker(seen) != 0;
}

/// Claims the message of this sequence for the participant. Returns the claim, or 0: another one
/// works on it, or it was finished long since. REQUIRES: the caller holds the block; then it looks
/// whether the message is still in its slot.
template <class Claim>
Word claim(Claim& word, Word sequence, std::uint32_t participant) {
  Word seen = word.load(std::memory_order_relaxed);
  for (;;) {
    const std::int64_t ahead = distance(claim_sequence(seen), sequence);
    if (ahead > 0 || (ahead == 0 && claim_worker(seen) != 0)) return 0;
    const Word before = ahead == 0 ? claim_deliveries(seen) : 0;
    const Word mine =
        make_claim(sequence, std::min(before + 1, kMostDeliveries), Word{participant} + 1);
    if (word.compare_exchange_weak(seen, mine, std::memory_order_acquire,
                                   std::memory_order_relaxed)) {  // C1
      return mine;
    }
  }
}

/// Takes a claim back: the message keeps its count of deliveries. Nothing where the claim is
/// another one by now.
template <class Claim>
void unclaim(Claim& word, Word claim) {
  word.compare_exchange_strong(claim, claim & ~kWorkerMask, std::memory_order_release,
                               std::memory_order_relaxed);  // C1
}

/// Takes the message of this sequence out of its slot. False: it is not there any more.
template <class Slot>
bool empty(Slot& slot, Word of_sequence) {
  Word seen = slot.load(std::memory_order_relaxed);
  while (sequence(seen) == of_sequence && block(seen) != kNoBlock) {
    if (slot.compare_exchange_weak(seen, seen | kNoBlock, std::memory_order_seq_cst,
                                   std::memory_order_relaxed)) {  // R6, R10
      return true;
    }
  }
  return false;
}

}  // namespace lot::ring
