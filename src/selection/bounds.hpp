// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>

#include "lockfree_ring/ring.hpp"

/// A publisher that selects its readers: it says to each reader of its ring which messages are for
/// that reader, and sends the reader the other messages by a second path (docs/ros.md: TCPROS).
///
/// The publisher says so in the reader's bounds, before it pushes the message. So a reader that has
/// read the message knows whether it is for this reader. A pure algorithm over the extra memory of
/// a ring; it makes no system call.
///
/// A worked example of what goes wrong without rounds: the publisher finds reader A in a cell, and
/// is held up. A leaves, B takes the cell. The publisher now says to the cell that message 7 is
/// A's. B would deliver message 7, which the publisher also sends to B by the second path. With
/// rounds the publisher names A's round, and its compare-and-swap fails in B's.
///
/// Edges (the release side, the acquire side, and what is carried); docs/edges.md has them all
///   S1  `to` by compare-and-swap in Selector::select (release) -> `to` in Selection::is_ours
///       (acquire)
///       carries: `from`, which was set before. A reader that sees that the old end is taken back
///       sees the new beginning.
///   S2  `from` in begin_round (release) -> `from` in Selector::select (acquire)
///       carries: whose cell it is. A publisher that sees the round sees the reader's name.
///   R1  (lockfree_ring/ring.hpp) the slot of a message carries to which readers it is given.
///   R3  position store in Reader::join -> position load in Selector::select (acquire)
///       carries: "the reader's round has begun". From Reader::done: "the reader has asked whose
///       the message is".
///   R8  carries from one reader of a cell to the next which round was the last.
///
/// Crash: nothing is repaired. Bounds that a dead publisher has set go with its ring. Bounds of a
///        dead reader stay in the cell until the next reader begins its own round; the publisher
///        sees by `who` that the reader has gone.
namespace lot::selection {

using ring::Word;

/// Where the messages for one reader begin or end. {set : 1 | round : 21 | sequence : 42}. Each
/// reader of a cell begins a round of its own, so that a late publisher tells the cell's next
/// reader nothing.
inline constexpr Word kSet = Word{1} << 63;
inline constexpr unsigned kBoundBits = 64 - ring::kSequenceShift;
inline constexpr Word kBoundRounds = Word{1} << (63 - kBoundBits);

constexpr Word make_bound(Word round, Word sequence) {
  return kSet | (round % kBoundRounds) << kBoundBits | sequence;
}
/// A bound that is not set yet. `answer`: what its reader answers to the publisher that asked it to
/// join again (0: nothing).
constexpr Word make_unbound(Word round, Word answer = 0) {
  return (round % kBoundRounds) << kBoundBits | answer;
}
constexpr bool is_set(Word bound) { return (bound & kSet) != 0; }
constexpr Word bound_round(Word bound) { return (bound & ~kSet) >> kBoundBits; }
constexpr Word bound_sequence(Word bound) { return bound & ring::kSequenceMask; }

constexpr bool precedes(Word sequence, Word bound) {
  return ring::distance(sequence, bound_sequence(bound)) < 0;
}
/// Whether a message lies between two bounds. Nothing: the publisher has not said so yet, and may
/// still say it.
constexpr std::optional<bool> lies_between(Word sequence, Word from, Word to) {
  if (is_set(to) && !precedes(sequence, to)) return std::nullopt;
  if (!is_set(from)) return std::nullopt;
  return !precedes(sequence, from);
}

/// What the publisher has said to the reader of one cell: the messages from `from` on and before
/// `to` are for that reader. A reader that joins unsets both; then the publisher sets them. Zero
/// bytes are the bounds of a cell that no reader has had.
///
/// Memory:  16 bytes of the ring's extra memory for each reader, address-free.
template <class P>
struct Bounds {
  typename P::template Atomic<Word> from;
  typename P::template Atomic<Word> to;
};

/// The bounds of a cell. REQUIRES: the ring has extra memory.
template <class P>
Bounds<P>& bounds_of(const ring::Ring<P>& ring, std::uint32_t cell) {
  return static_cast<Bounds<P>*>(ring.extra)[cell];
}

/// A reader that joins begins its round in the cell, with an answer. Called by Reader::join once
/// the cell is this reader's, and before the publisher sees the reader there.
///
/// Crash: killed here, the reader has no place yet: the publisher says nothing to it.
template <class P>
void begin_round(const ring::Ring<P>& ring, std::uint32_t cell, Word answer) {
  auto& [from, to] = bounds_of(ring, cell);
  // A publisher that sees this reader (R4) also sees that no message is for it yet. Relaxed: R8
  // carries the former reader's round.
  const Word round = bound_round(from.load(std::memory_order_relaxed)) + 1;
  from.store(make_unbound(round, answer), std::memory_order_release);  // S2
  to.store(make_unbound(round), std::memory_order_relaxed);            // R3 carries it
}

}  // namespace lot::selection
