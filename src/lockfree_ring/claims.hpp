// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>

#include "lockfree_ring/words.hpp"

/// Messages that stay in their slots until a worker has finished them. Beside each slot is a claim,
/// which names the worker of its message. A worker that dies, or gives the message back, leaves the
/// slot as it was. So no process has to put the message back anywhere.
///
/// The steps, and what a kill after each leaves (docs/queue.md):
///   claim()    The claim names the worker. The worker's reaper takes the name away.
///   empty()    The slot has no message: it is finished. The claim is out of date.
///   unclaim()  Any worker may claim the message. The worker was killed before it told the readers:
///              the reaper tells them.
///
/// Edges
///   C1  unclaim() (release) -> claim() (acquire)
///       carries: what the last worker has done. From a reaper: that the dead worker may have
///       emptied the slot.
///   C2  `returned` bump (release) -> load in Reader::look_back (acquire)
///       carries: the claims that were taken back.
namespace lot::ring {

/// True when a worker has the message of this sequence: a hint, since it may change at any time.
template <class Claim>
bool is_claimed(const Claim& claim, Word sequence) {
  const Word seen = claim.load(std::memory_order_relaxed);  // a hint
  return claim_sequence(seen) == sequence && claim_worker(seen) != 0;
}

/// Claims the message of this sequence for the participant. Returns the claim, or 0 when another
/// worker has it, or when the slot has had a newer message since. REQUIRES: the caller holds the
/// block; afterwards it looks whether the message is still in its slot.
template <class Claim>
Word claim(Claim& word, Word sequence, std::uint32_t participant) {
  Word seen = word.load(std::memory_order_relaxed);  // the compare-and-swap checks it
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

/// Takes a claim back. The message keeps its count of deliveries. Does nothing where the word has
/// another claim by now.
template <class Claim>
void unclaim(Claim& word, Word claim) {
  word.compare_exchange_strong(claim, claim & ~kWorkerMask, std::memory_order_release,
                               std::memory_order_relaxed);  // C1
}

/// Takes the message of this sequence out of its slot. False: it is not there any more.
template <class Slot>
bool empty(Slot& slot, Word of_sequence) {
  Word seen = slot.load(std::memory_order_relaxed);  // the compare-and-swap checks it
  while (sequence(seen) == of_sequence && block(seen) != kNoBlock) {
    if (slot.compare_exchange_weak(seen, seen | kNoBlock, std::memory_order_seq_cst,
                                   std::memory_order_relaxed)) {  // R6, R10
      return true;
    }
  }
  return false;
}

}  // namespace lot::ring
