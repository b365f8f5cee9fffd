// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

/// The words of the ring and how they are read. Widths and meanings are part of the layout
/// (docs/layout.md).
namespace lot::ring {

/// A slot:  {sequence : 42 | round : 2 | sleeper : 1 | block : 19}.
///
/// One atomic word says all about a slot: which message is in it, in which block, and whether a
/// reader sleeps until the *next* message comes into it. Its low 32 bits are the futex. Taking a
/// mark away without a message begins a new round of the slot. So a reader that was about to sleep
/// on its own mark does not take the next reader's mark for it.
///
/// A reader's position has the same format. {cursor | 0 | kNoBlock} is a place. {sequence | 0 |
/// block} is a place and a hazard. The sleeper bit is never part of a place: a word that has it
/// says that no reader is at work here. Those are kIdle, awaited() and joining(). An observer's
/// position has the round 2, or 3 until it has a place.
using Word = std::uint64_t;

inline constexpr unsigned kBlockBits = 19;
inline constexpr Word kNoBlock = (Word{1} << kBlockBits) - 1;
inline constexpr Word kSleeper = Word{1} << kBlockBits;
inline constexpr unsigned kRoundBits = 2;
inline constexpr Word kRound = kSleeper << 1;
inline constexpr Word kRoundMask = kRound * ((Word{1} << kRoundBits) - 1);
inline constexpr unsigned kSequenceShift = kBlockBits + 1 + kRoundBits;
inline constexpr Word kSequenceMask = (Word{1} << (64 - kSequenceShift)) - 1;

inline constexpr Word kIdle = ~Word{0};  ///< position: no reader

constexpr Word make(Word sequence, Word block) { return sequence << kSequenceShift | block; }
constexpr Word sequence(Word word) { return word >> kSequenceShift; }
constexpr Word block(Word word) { return word & kNoBlock; }
/// A position that the ring's maker has stored for a reader that had subscribed before. The reader
/// has not looked yet, and will begin at this sequence.
constexpr Word awaited(Word sequence) { return make(sequence, kNoBlock) | kSleeper; }
constexpr bool is_awaited(Word position) {
  return (position & (kSleeper | kRoundMask)) == kSleeper;
}
/// The position of a joiner that has no place yet, and wants this many messages of the past: its
/// wish. A sender that must not overtake the joiner gives it a place.
constexpr Word joining(Word back) { return make(back, kNoBlock) | kSleeper | kRound; }
constexpr bool is_joining(Word position) {
  return (position & (kSleeper | kRoundMask)) == (kSleeper | kRound);
}
/// The position of a reader that only observes, OR'ed to it: nothing waits for that reader.
inline constexpr Word kObserves = kRound << 1;
inline constexpr Word kObserverJoins = make(0, kNoBlock) | kObserves | kRound;
constexpr bool is_observer(Word position) {
  return (position & (kSleeper | kObserves)) == kObserves;
}
/// True for the position of a reader that is at work.
constexpr bool is_place(Word position) { return (position & kSleeper) == 0; }
/// A slot's sequence and block: the position of a reader that looks at its message.
constexpr Word place(Word slot) { return slot & ~(kSleeper | kRoundMask); }
/// The slot word without its mark, in the next round.
constexpr Word next_round(Word slot) {
  return (slot & ~(kSleeper | kRoundMask)) | ((slot + kRound) & kRoundMask);
}

/// What Reader::poll() returns for a slot that no publisher can have written. It names no block.
inline constexpr Word kDamaged = kNoBlock + 1;

/// a - b of two sequences, as a signed number. Sequences wrap after 2^42 messages. Two that are
/// compared are never further apart than 2^41.
constexpr std::int64_t distance(Word a, Word b) {
  return static_cast<std::int64_t>((a - b) << kSequenceShift) >> kSequenceShift;
}
constexpr Word next(Word sequence) { return (sequence + 1) & kSequenceMask; }
constexpr Word advance(Word sequence, Word by) { return (sequence + by) & kSequenceMask; }

/// A claim names the worker of a slot's message: {sequence : 42 | deliveries : 12 | worker : 10}.
/// The worker is participant + 1, or 0. Where the sequence is older than the slot's, the message
/// was never delivered. Deliveries are counted up to kMostDeliveries.
inline constexpr unsigned kWorkerBits = 10;
inline constexpr Word kWorkerMask = (Word{1} << kWorkerBits) - 1;
inline constexpr Word kMostDeliveries = (Word{1} << (kSequenceShift - kWorkerBits)) - 1;

constexpr Word make_claim(Word sequence, Word deliveries, Word worker) {
  return sequence << kSequenceShift | deliveries << kWorkerBits | worker;
}
constexpr Word claim_sequence(Word claim) { return claim >> kSequenceShift; }
constexpr Word claim_deliveries(Word claim) { return claim >> kWorkerBits & kMostDeliveries; }
constexpr Word claim_worker(Word claim) { return claim & kWorkerMask; }

/// The writer word of a ring: {generation : 32 | state : 8 | owner : 24}.
enum class State : std::uint8_t { Free = 0, Init = 1, Live = 2, Orphan = 3 };

constexpr Word make_writer(Word generation, State state, Word owner) {
  return generation << 32 | Word{static_cast<std::uint8_t>(state)} << 24 | owner;
}
constexpr std::uint32_t writer_generation(Word w) { return static_cast<std::uint32_t>(w >> 32); }
constexpr State writer_state(Word w) { return static_cast<State>(w >> 24 & 0xff); }
constexpr std::uint32_t writer_owner(Word w) { return static_cast<std::uint32_t>(w & 0xffffff); }

}  // namespace lot::ring
