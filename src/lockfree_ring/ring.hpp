// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "lockfree_ring/claims.hpp"
#include "lockfree_ring/slots.hpp"
#include "lockfree_ring/words.hpp"
#include "lockfree_ring/writer_word.hpp"
#include "robust_mutex/robust_condition.hpp"

/// A single-producer broadcast ring of blocks: a pure algorithm over memory that it is given. It
/// makes no system call. Return values tell the caller whom to wake and what to wait for.
///
/// There is no head word. The slots are the only truth: the newest message in them says how far
/// the ring has come.
///
/// `Writer` is the publisher's side and `Reader` is the subscriber's side. "The sender" is the
/// publisher where it waits for room.
///
/// Edges (the release side, the acquire side, and what is carried); docs/edges.md has them all
///   R1  slot exchange in Writer::publish   -> slot load in Reader::poll
///       carries: the message in the block.
///   R2  slot exchange, then position load in Writer::hazards (both seq_cst)
///       <-> position store, then second slot load in Reader::poll (both seq_cst)
///       either the reader sees that the slot has moved on, or the writer sees the hazard.
///   R3  position store in Reader::done, join -> position load in Writer::room, hazards
///       carries: "the payload has been read". From join(): what its caller has prepared.
///   R4  roster bump, then slot loads in Reader::join (seq_cst)
///       <-> slot exchange, then roster load in Writer::hazards / roster load before the exchange
///       in Writer::room (seq_cst): a joiner is on the writer's list, or starts behind the message.
///   H1  see lockfree_ring/ear.hpp
///   R5  clear_sleeper() (release)          -> sleeper's look at the slot (acquire)
///       carries: what was stored before the clearing: the writer word ORPHAN, the directory's new
///       version, or `returned`.
///   R6  space mark, then positions in Writer::room (seq_cst)
///       <-> position store, then space load on an empty poll (seq_cst)
///       the reader that makes room rings the sender that sleeps for it.
///   R7  LIVE (release)                     -> writer load in Reader::join, take_awaited (acquire)
///       carries: what format() and await() made.
///   R8  who = 0 in Reader::leave, reaper (release) -> claim of who in Reader::join (acquire)
///       carries: the former reader's last stores to the cell.
///   R9  ORPHAN (release)                   -> writer load in Reader::orphaned (acquire)
///       carries: the last messages.
///   R10 slot compare-and-swap in empty() -> slot load in Writer::room, Writer::each_taken
///       carries: the taker's hold on the block. Both are seq_cst, as in R2: the writer sees the
///       hazard of each reader that saw the message before it was taken.
///   R13 formed = 1 and who store, then pullers load in Ring::await_pullers (all seq_cst)
///       <-> pullers = 0 by the reaper, then formed and who loads in free_cells (all seq_cst):
///       the maker or the reaper takes the cell of a dead subscriber away, or both do.
///   R14 position store in Reader::join, of the wish or, in a guarded ring, of the place. The place
///       that follows a wish is in its release sequence.
///       -> position load, then second look at who, in make_idle
///       carries: the maker's who = 0, which let the joiner in. So the reaper does not take a
///       living joiner's place for the place of a dead subscriber.
///   R15 floor store, then roster load in Writer::close_off (seq_cst)
///       <-> roster bump, then floor load in Reader::join (seq_cst)
///       a joiner of a lossless ring begins behind what its writer takes back; or the writer sees
///       the joiner, then its place (R3), and takes back only what is before that place.
///
/// A queue whose messages are each for one reader (`taken`) is a ring as well. A reader that has
/// read a message takes it out of its slot. A reader that finds an empty slot goes on to the next.
/// Where workers must finish messages (`claims`), the message leaves its slot only when it is
/// finished (claims.hpp).
namespace lot::ring {

/// One reader's shared words, on a line of their own.
template <class P>
struct alignas(P::kLine) Cell {
  /// {cursor, hazard}, or a word that says that no reader is at work here (words.hpp). The reader
  /// writes it, and after its death its reaper. The ring's maker writes it for a subscriber that
  /// has not looked yet. The writer writes it once, when it gives a joiner its place.
  typename P::template Atomic<Word> position;
};

/// Takes a sleeper's mark away. True when there was one: the caller may have to wake a sleeper.
template <class Slot>
bool clear_sleeper(Slot& slot) {
  Word seen = slot.load(std::memory_order_relaxed);  // the compare-and-swap checks it
  for (;;) {
    // A read-modify-write even where no mark stands: edge R5 depends on it.
    const bool marked = (seen & kSleeper) != 0;
    if (slot.compare_exchange_weak(seen, marked ? next_round(seen) : seen,
                                   std::memory_order_seq_cst,
                                   std::memory_order_relaxed)) {  // R5, H1
      return marked;
    }
  }
}

/// A view of one ring in shared memory. Copyable; owns nothing.
template <class P>
struct Ring {
  template <class T>
  using Atomic = typename P::template Atomic<T>;

  WriterWord<P>* writer = nullptr;          ///< names the publisher
  Slots<P> slots;                           ///< [places()]
  Cell<P>* cells = nullptr;                 ///< [readers]
  Atomic<std::uint32_t>* who = nullptr;     ///< [readers] 0, or participant + 1
  Atomic<std::uint32_t>* roster = nullptr;  ///< bumped by each joiner: "look at who[] again"
  Atomic<std::uint32_t>* space = nullptr;   ///< futex; odd = the sender sleeps for room
  /// Joiners begin here at the earliest: the writer takes older messages back. Where messages are
  /// overwritten this is only a hint: a joiner that comes too late counts them as missed.
  Atomic<Word>* floor = nullptr;
  std::uint32_t depth = 0;
  std::uint32_t readers = 0;
  bool blocking = false;  ///< unread messages hold the writer back (else it overwrites them)
  bool taken = false;     ///< each message is for one reader, which takes it (else for all)
  Word first = 0;         ///< sequence of the first message, which goes into slot 0
  /// The mutex engine's condition: readers sleep on it. Null: they sleep on the slots.
  Atomic<std::uint32_t>* arrived = nullptr;
  /// [depth], where workers must finish the messages that they take. Else null, as is `returned`.
  Atomic<Word>* claims = nullptr;
  Atomic<std::uint32_t>* returned = nullptr;  ///< bumped when messages have come back
  /// [readers] Memory that the ring's maker has asked for, for each reader some. The ring itself
  /// never looks there. Null: there is none.
  void* extra = nullptr;
  std::uint32_t channel = 0;  ///< by which ears know it (ear.hpp)

  /// True where messages travel in the slots themselves (slots.hpp).
  bool in_slots() const { return slots.have_messages(); }
  /// How many slots there are. Where messages are in the slots there is one more than `depth`: the
  /// slot that is written next has no message. So a publisher that is killed while it writes takes
  /// none away. A lossless ring whose messages are taken needs none: it writes into empty slots.
  std::uint32_t places() const { return depth + (in_slots() && !(taken && blocking) ? 1 : 0); }
  /// How many messages may lie before the newest one's end. A publisher of messages that are taken
  /// may have been killed before it has emptied the slot that is written next.
  std::uint32_t most() const { return taken ? places() : depth; }
  /// True where the cursor of a reader does not hold the sender back: a hazard protects the block
  /// that it looks at, or a message in its slot is copied.
  bool guarded() const { return taken || !blocking; }

  /// Makes the words of a new ring. REQUIRES: writer is INIT and the caller owns it.
  void format() {
    // All are relaxed: LIVE, which the caller stores afterwards, carries them (R7).
    roster->store(0, std::memory_order_relaxed);                             // R7
    space->store(0, std::memory_order_relaxed);                              // R7
    if (returned != nullptr) returned->store(0, std::memory_order_relaxed);  // R7
    floor->store(first, std::memory_order_relaxed);                          // R7
    for (std::uint32_t i = 0; i < places(); ++i) {
      const Word before = advance(first, Word{i} - places());
      slots.format(i, advance(first, i), before);  // R7
      // R7
      if (claims != nullptr) claims[i].store(make_claim(before, 0, 0), std::memory_order_relaxed);
    }
    for (std::uint32_t c = 0; c < readers; ++c) {
      cells[c].position.store(kIdle, std::memory_order_relaxed);  // R7
      who[c].store(0, std::memory_order_relaxed);                 // R7
    }
  }

  /// Gives a cell to each reader that subscribed before this ring was made. The cell stands for
  /// the reader until it looks (Reader::take_awaited) or unsubscribes. pullers(p) says how many
  /// readers participant p has. subscribes(p) says, by a seq_cst load (R13), whether p still has
  /// some. REQUIRES: INIT; the caller has called format(); living subscribers are kept away.
  ///
  /// Crash: killed before LIVE, the ring was never there.
  template <class Pullers, class Subscribes>
  void await_pullers(std::uint32_t participants, Pullers&& pullers, Subscribes&& subscribes) {
    std::uint32_t c = 0;
    for (std::uint32_t p = 1; p < participants; ++p) {
      const std::uint32_t count = pullers(p);
      for (std::uint32_t n = 0; n < count && c < readers; ++n, ++c) {
        await(c, p);
        if (!subscribes(p)) await_no_more(c);  // R13: p has died
      }
    }
  }
  void await(std::uint32_t c, std::uint32_t participant) {
    cells[c].position.store(awaited(first), std::memory_order_relaxed);  // R7 carries it
    who[c].store(participant + 1, std::memory_order_seq_cst);            // R13
  }
  void await_no_more(std::uint32_t c) {
    cells[c].position.store(kIdle, std::memory_order_relaxed);  // R7 carries it
    who[c].store(0, std::memory_order_relaxed);                 // R7 carries it
  }
  /// A reader of the participant leaves before it has looked. False: no cell awaits such a reader.
  /// The caller wakes `space` unconditionally. REQUIRES: no process recycles the ring meanwhile.
  ///
  /// Crash: the reaper does the rest, as in Reader::leave.
  bool unsubscribe(std::uint32_t participant) {
    for (std::uint32_t c = 0; c < readers; ++c) {
      // Relaxed: the lock against joiners carries what the ring's maker has stored.
      if (who[c].load(std::memory_order_relaxed) != participant + 1) continue;
      Word position =
          cells[c].position.load(std::memory_order_relaxed);  // the compare-and-swap checks it
      // Relaxed: this reader has looked at no message.
      if (!is_awaited(position) ||
          !cells[c].position.compare_exchange_strong(position, kIdle, std::memory_order_relaxed,
                                                     std::memory_order_relaxed)) {
        continue;
      }
      free_cell(c);
      return true;
    }
    return false;
  }
  /// The last steps of a reader that leaves. The caller wakes `space` unconditionally.
  void free_cell(std::uint32_t c) {
    space->fetch_add(2, std::memory_order_release);  // R6
    who[c].store(0, std::memory_order_release);      // R3, R8
  }

  /// How many messages before `head` a joiner may begin that wants `history` of them. `published`:
  /// how many there ever were.
  ///
  /// For a reader that no hazard guards the limit is the depth less one: the sender must not
  /// overtake it, and may be one message ahead of what the joiner saw. The floor is a limit as
  /// well, unless the ring left it behind so long ago that the sequences have wrapped.
  std::uint64_t reach(Word head, std::uint64_t published, std::uint64_t history, Word lowest,
                      bool is_guarded) const {
    const std::uint64_t limit = std::uint64_t{most()} - (is_guarded ? 0 : 1);
    const std::uint64_t back = std::min({history, limit, published});
    const std::int64_t since = distance(head, lowest);
    const bool limits = lowest != first && since >= 0;
    return limits ? std::min(back, static_cast<std::uint64_t>(since)) : back;
  }
  /// The number of all messages that were ever published before `head`. When that number has
  /// wrapped the ring has long been full, and this is the most that it may have. `last`: the word
  /// of the last slot, as it was when `head` was found. A later one may be of a message that came
  /// behind `head`.
  std::uint64_t published(Word head, Word last) const {
    const std::int64_t since_first = distance(head, first);
    const bool is_full = was_used(places() - 1, last);
    if (since_first < 0 || (since_first < places() && is_full)) return most();
    return static_cast<std::uint64_t>(since_first);
  }
  /// False if this word of slot i is as format() made it.
  bool was_used(std::uint32_t i, Word word) const {
    return block(word) != kNoBlock || sequence(word) != advance(first, Word{i} - places());
  }

  /// True when a reader's position names the block: a hint.
  bool is_looked_at(Word b) const {
    for (std::uint32_t c = 0; c < readers; ++c) {
      const Word position = cells[c].position.load(std::memory_order_relaxed);  // a hint
      if (position != kIdle && block(position) == b) return true;
    }
    return false;
  }

  /// Takes the sleepers' marks away. So a reader that is about to sleep sees what was stored
  /// before. The caller then wakes all sleepers, whatever the marks were.
  void clear_sleepers() {
    if (arrived != nullptr) return RobustCondition(*arrived).renew();
    for (std::uint32_t i = 0; i < places(); ++i) clear_sleeper(slots[i]);
  }
  /// Calls wake(word) for each word on which a reader may sleep.
  template <class Wake>
  void wake_sleepers(Wake&& wake) {
    if (arrived != nullptr) return wake(*arrived);
    for (std::uint32_t i = 0; i < places(); ++i) wake(slots[i]);
  }

  /// Takes back the claims of a dead worker, so that any worker may claim those messages again.
  /// True: the caller wakes all readers, unconditionally, so that they look for the messages.
  /// REQUIRES: the participant is dead; if it has a cell, the cell still names it.
  ///
  /// Crash: may be repeated. Returns true for each participant that has a cell here, even if it has
  /// no claim: it may have been killed after it gave a message back and before it woke the readers.
  bool take_claims_back(std::uint32_t participant) {
    bool reads = false;
    for (std::uint32_t c = 0; c < readers && !reads; ++c) {
      // Relaxed: the byte lock of the dead carries the name that the dead one stored itself. It
      // does not matter whether this sees a name that the ring's maker stored for it.
      reads = who[c].load(std::memory_order_relaxed) == participant + 1;
    }
    for (std::uint32_t i = 0; i < depth; ++i) {
      const Word seen = claims[i].load(std::memory_order_relaxed);  // the dead one's byte lock
      if (claim_worker(seen) != participant + 1) continue;
      unclaim(claims[i], seen);
      reads = true;
    }
    if (reads) returned->fetch_add(1, std::memory_order_release);  // C2
    return reads;
  }
  /// A worker gives the message of a slot back. The caller wakes the readers that sleep.
  void give_back(std::uint32_t i, Word claim) {
    unclaim(claims[i], claim);
    returned->fetch_add(1, std::memory_order_release);  // C2
  }

  /// True when no reader needs this ring any more. REQUIRES: the ring has ended; no reader joins,
  /// takes or leaves a cell that awaits it meanwhile.
  ///
  /// A reader that is at work in the ring needs it. A reader that the ring awaits needs it only if
  /// the ring has news for it; else that reader never learns that the ring was there. Messages that
  /// one reader is to take keep the ring until they are taken.
  bool deserted() const {
    bool awaits = false;
    for (std::uint32_t c = 0; c < readers; ++c) {
      if (who[c].load(std::memory_order_acquire) == 0) continue;  // R3: leave()
      // Relaxed: the lock against joiners carries what makes and what ends `awaited`.
      if (!is_awaited(cells[c].position.load(std::memory_order_relaxed))) return false;
      awaits = true;
    }
    return (!awaits && !taken) || !has_news();
  }
  /// True when a reader that has not looked yet gets a message here, or must count one as missed.
  bool has_news() const {
    if (depth == 0) return false;  // a process that was killed in recycling leaves a ring like this
    // Relaxed: the lock for ended rings, as below.
    if (!taken) return was_used(0, slots[0].load(std::memory_order_relaxed));
    for (std::uint32_t i = 0; i < places(); ++i) {
      // Relaxed: the lock for ended rings carries what was written or taken under it.
      if (block(slots[i].load(std::memory_order_relaxed)) != kNoBlock) return true;
    }
    return false;
  }
};

/// The publisher's side: private state of the thread that publishes. One thread at a time.
template <class P>
class Writer {
 public:
  /// What publish() leaves to the caller.
  struct Published {
    Word replaced;  ///< block that the slot held before, or kNoBlock: the caller retires it
    bool wake;      ///< a reader may sleep: wake `slot`, or `arrived` if the ring has one
    typename P::template Atomic<Word>* slot;
  };

  Writer() = default;
  explicit Writer(const Ring<P>& ring)
      : ring_(ring), places_(ring.places()), next_(ring.first), floor_(ring.first) {
    active_.reserve(ring.readers);
    if (ring.taken && !ring.in_slots()) put_.resize(ring.depth, kNoBlock);
  }

  /// True if the next publish overwrites nothing that a reader still needs. Always true where
  /// messages are overwritten. Looks at the readers only when the cached minimum does not suffice.
  bool room() {
    if (!ring_.blocking) return true;
    if (ring_.taken) {
      return block(ring_.slots[index_].load(std::memory_order_seq_cst)) == kNoBlock;  // R6, R10
    }
    refresh_roster();
    if (minimum_known_ && distance(next_, minimum_) < ring_.depth) return true;
    find_slowest();
    return distance(next_, minimum_) < ring_.depth;
  }

  /// The number of the oldest slots that no reader needs to read any more, counted from the slot
  /// that the next message will take. All slots where messages are overwritten. None where each
  /// message of a lossless ring is for one reader.
  std::uint32_t read_slots() { return ring_.blocking ? slots_read_by_all() : ring_.depth; }

  /// Publishes a block; the caller's hold on it becomes the ring's. REQUIRES: room().
  ///
  /// Crash: killed before the exchange, the message was never published and its block is freed by
  /// the reaper; after it, the message is published, and the reaper adopts it and wakes sleepers.
  /// Inlined: its three results then need no memory, which costs as much as its own steps.
  [[gnu::always_inline]] Published publish(Word block) {
    auto& slot = ring_.slots[index_];
    // R1, R2, R4, H1
    const Word old = slot.exchange(make(next_, block), std::memory_order_seq_cst);
    Published published{ring::block(old), (old & kSleeper) != 0, &slot};
    if (ring_.arrived != nullptr) published.wake = RobustCondition(*ring_.arrived).changed();
    if (!put_.empty()) {
      published.replaced = std::exchange(put_[index_], block);
      if (published.replaced != kNoBlock && oldest_ == index_) oldest_ = after(index_);
    }
    next_ = next(next_);
    if (++index_ == places_) {
      index_ = 0;
      ++laps_;
    }
    prefetch_ahead();
    return published;
  }
  /// Publishes a message in its slot: so many words of it, the last of which may end behind it, and
  /// the time of the push if `time` is not null. It replaces no block. REQUIRES: room(); the
  /// messages of the ring are in its slots.
  ///
  /// Crash: killed before the exchange, the message was never published. Killed behind it, the
  /// message is there; where messages are overwritten, so is the one that it should have replaced.
  [[gnu::hot]] Published publish(const void* message, std::size_t words, const Word* time) {
    ring_.slots.write(index_, message, words, time);
    Published published = publish(kInSlot);
    published.replaced = kNoBlock;
    if (!ring_.taken) {
      ring_.slots.begin(index_, next_);
    } else if (!ring_.blocking) {
      // A taker that is in its copy there will find that the message is not its own. Or it was
      // quicker: then its copy comes before what is written there next. It has no hazard to see.
      ring_.slots[index_].fetch_or(kNoBlock, std::memory_order_acquire);  // R10
    }
    return published;
  }
  /// Fetches the slot of the next message into this core's cache: a reader that looked at it has
  /// its line.
  void prefetch() const { ring_.slots.prefetch_write(index_); }
  /// Where messages lie in their slots, the same for a later message: each takes lines of its own.
  /// In a lossless ring only if no reader has still to read what is there.
  void prefetch_ahead() const {
    if (!ring_.in_slots()) return prefetch();
    const bool is_read =
        !ring_.blocking || (minimum_known_ && distance(next_, minimum_) + kAhead < ring_.depth);
    const std::uint32_t i = index_ + (is_read ? kAhead : 0);
    ring_.slots.prefetch_write(i < places_ ? i : i - places_);
  }

  /// Calls gone(block) for messages that readers have taken out of their slots. The caller retires
  /// the holds on them. REQUIRES: the messages of the ring are taken.
  ///
  /// Without claims it stops at the oldest message that is still there. With claims it finds every
  /// finished message: one task that takes long must not hold up the others.
  template <class Gone>
  void each_taken(Gone&& gone) {
    if (put_.empty()) return;
    if (ring_.claims != nullptr) return each_finished(gone);
    for (std::uint32_t n = 0; n < ring_.depth; ++n) {
      Word& put = put_[oldest_];
      if (put != kNoBlock) {
        if (block(ring_.slots[oldest_].load(std::memory_order_seq_cst)) != kNoBlock) return;  // R10
        gone(std::exchange(put, kNoBlock));
      } else if (oldest_ == index_) {
        return;
      }
      oldest_ = after(oldest_);
    }
  }
  template <class Gone>
  void each_finished(Gone& gone) {
    for (std::uint32_t i = 0; i < ring_.depth; ++i) {
      if (put_[i] == kNoBlock) continue;
      if (block(ring_.slots[i].load(std::memory_order_seq_cst)) != kNoBlock) continue;  // R10
      gone(std::exchange(put_[i], kNoBlock));
    }
  }
  /// Calls hold(block) for each message whose hold the ring still has. REQUIRES: as each_taken().
  template <class Hold>
  void each_put(Hold&& hold) const {
    for (const Word b : put_) {
      if (b != kNoBlock) hold(b);
    }
  }

  /// The block that will be replaced `ahead` publishes from now, or kNoBlock when there is none or
  /// a reader may still need it. For prefetching only.
  Word upcoming(std::uint32_t ahead) const {
    if (ahead >= ring_.depth) return kNoBlock;
    if (ring_.blocking &&
        (!minimum_known_ || distance(advance(next_, Word{ahead} - ring_.depth), minimum_) >= 0)) {
      return kNoBlock;
    }
    return held(ahead);
  }
  /// The block in the slot that the message `ahead` of the next one will take, or kNoBlock.
  /// REQUIRES: ahead < depth.
  Word held(std::uint32_t ahead) const {
    // Relaxed: only the writer puts a block into a slot.
    return block(ring_.slots[oldest_slot(ahead)].load(std::memory_order_relaxed));
  }

  /// Evicts: takes out of the ring the oldest message that may(block) lets go. For a publisher
  /// whose memory has run out. Returns its block, or kNoBlock when the ring holds none.
  ///
  /// Where messages are overwritten, readers that have not read the message count it as missed. In
  /// a lossless ring it goes only when all readers have read it, so no reader looks at it.
  ///
  /// Crash: killed after the floor was stored: joiners that are under way get less of the past.
  /// Killed after the fetch_or: the reaper finds a block that no ring names.
  template <class May>
  Word evict_oldest(May&& may) {
    const std::uint32_t slots = read_slots();
    for (std::uint32_t n = empty_slots(); n < slots; ++n) {
      const std::uint32_t i = oldest_slot(n);
      // Relaxed: only the writer puts a block into a slot.
      const Word held =
          !put_.empty() ? put_[i] : block(ring_.slots[i].load(std::memory_order_relaxed));
      if (held == kNoBlock) note_empty(n);
      if (held == kNoBlock || !may(held)) continue;
      return take_out(n) ? held : kNoBlock;
    }
    return kNoBlock;
  }
  Word evict_oldest() {
    return evict_oldest([](Word) { return true; });
  }

  /// Takes out of the ring the messages that all readers have read, except for the newest `keep`
  /// ones. Calls gone(block) for each, the oldest first. Takes none where each message is for one
  /// reader. The blocks are like evicted ones: hazards() says whether a reader still looks at one,
  /// whatever the places of the readers say.
  ///
  /// Crash: as in evict_oldest(), after each of them.
  template <class Gone>
  void take_back(std::uint32_t keep, Gone&& gone) {
    std::uint32_t end = slots_read_by_all();
    end = std::min(end, ring_.depth - std::min(keep, ring_.depth));
    // A message that is older than an empty slot went before. Or an eviction passed it over, since
    // may() kept it: then it stays until it is overwritten.
    std::uint32_t n = end;
    while (n > 0 && held(n - 1) != kNoBlock) --n;
    if (n < end && ring_.guarded()) raise_floor(advance(next_, Word{end} - ring_.depth));
    for (; n < end; ++n) {
      const Word b = held(n);
      if (!take_out(n)) return;
      gone(b);
    }
  }

  /// True when readers may look at what publish(), take_back() or evict_oldest() has just replaced:
  /// the caller asks hazards() before it uses that block again. REQUIRES: the call comes behind the
  /// replacement. A joiner that this does not see finds the slot as it is now (R4).
  bool readers_may_look() {
    if (ring_.in_slots()) return false;  // there are no blocks
    return ring_.guarded() || observers_may_look();
  }
  /// The same of a ring whose messages are in blocks, and that is not guarded().
  bool observers_may_look() {
    refresh_roster();
    return observers_ != 0;
  }

  /// Calls seen(block) for each block that a reader may be looking at now.
  template <class Seen>
  void hazards(Seen&& seen) {
    refresh_roster();
    for (const std::uint32_t c : active_) {
      const Word position = ring_.cells[c].position.load(std::memory_order_seq_cst);  // R2, R3
      if (position != kIdle && block(position) != kNoBlock) seen(block(position));
    }
  }

  /// Calls lag(cell) for each reader that seems to hold the sender back.
  template <class Lag>
  void laggards(Lag&& lag) {
    refresh_roster();
    for (const std::uint32_t c : active_) {
      const Word position = ring_.cells[c].position.load(std::memory_order_relaxed);  // a hint
      if (position == kIdle || ring_.taken || is_observer(position)) continue;
      if (is_joining(position)) continue;  // room() gives it a place
      if (distance(next_, sequence(position)) >= ring_.depth) lag(c);
    }
  }

  /// Calls f(participant, cell) for each reader that is no observer. For that it takes a joiner
  /// that has not said yet what it is.
  template <class F>
  void each_reader(F&& f) {
    refresh_roster();
    for (const std::uint32_t c : active_) {
      // Relaxed, both: a hint. The reader may leave at any time.
      const std::uint32_t who = ring_.who[c].load(std::memory_order_relaxed);
      const Word position = ring_.cells[c].position.load(std::memory_order_relaxed);
      if (who != 0 && !is_observer(position)) f(who - 1, c);
    }
  }

  /// Announces on `space` that the sender is about to sleep; returns the value to sleep on. The
  /// caller looks at room() once more, and sleeps only if there is still none.
  std::uint32_t mark_waiting() {
    // A mark may stand from the last time, and a reader may have left since.
    std::uint32_t v = ring_.space->load(std::memory_order_acquire);  // R6
    while ((v & 1) == 0) {
      if (ring_.space->compare_exchange_strong(v, v + 1, std::memory_order_seq_cst,
                                               std::memory_order_relaxed)) {  // R6
        return v + 1;
      }
    }
    return v;
  }

  Word next_sequence() const { return next_; }
  std::uint32_t depth() const { return ring_.depth; }
  const Ring<P>& ring() const { return ring_; }
  /// Observers do not count.
  std::size_t active_readers() {
    refresh_roster();
    return active_.size() - observers_;
  }

 private:
  std::uint32_t after(std::uint32_t i) const { return i + 1 == places_ ? 0 : i + 1; }
  /// The slot of the n-th oldest message that the ring can hold. REQUIRES: n < depth.
  std::uint32_t oldest_slot(std::uint32_t n) const {
    const std::uint32_t places = places_;
    const std::uint32_t i = index_ + (places - ring_.depth) + n;
    return i < places ? i : i - places;
  }

  /// The number of the oldest slots that all readers have read. None where each message is for one
  /// reader. Where messages are overwritten the places of readers are only hints: nothing depends
  /// on the result there.
  std::uint32_t slots_read_by_all() {
    if (ring_.taken) return 0;
    refresh_roster();
    find_slowest();
    const std::int64_t behind = distance(next_, minimum_);
    if (behind < 0 || behind >= ring_.depth) return 0;  // below 0: a word is damaged
    return ring_.depth - static_cast<std::uint32_t>(behind);
  }

  /// How many messages were published: the place of the oldest slot. Does not wrap, as next_ does.
  std::uint64_t place() const { return laps_ * places_ + index_; }
  /// So many of the oldest slots hold no message, for sure. So an eviction need not look at what
  /// the evictions before it have emptied.
  std::uint32_t empty_slots() const {
    return emptied_ > place() ? static_cast<std::uint32_t>(emptied_ - place()) : 0;
  }
  void note_empty(std::uint32_t n) {
    if (n == empty_slots()) emptied_ = place() + n + 1;
  }

  /// Empties the slot of the n-th oldest message. False: a joiner of a lossless ring was quicker.
  bool take_out(std::uint32_t n) {
    const std::uint32_t i = oldest_slot(n);
    if (!ring_.guarded() && !close_off(advance(next_, Word{n} - ring_.depth))) return false;
    // fetch_or makes the block kNoBlock and leaves sequence and sleeper as they are.
    ring_.slots[i].fetch_or(kNoBlock, std::memory_order_seq_cst);  // R2
    if (!put_.empty()) put_[i] = kNoBlock;
    if (oldest_ == i) oldest_ = after(i);
    note_empty(n);
    return true;
  }

  /// Looks where the slowest reader stands. REQUIRES: refresh_roster().
  void find_slowest() {
    minimum_ = next_;
    minimum_known_ = true;
    for (const std::uint32_t c : active_) {
      const Word position = place_of(c);
      if (position == kIdle || is_observer(position)) continue;
      if (distance(sequence(position), minimum_) < 0) minimum_ = sequence(position);
    }
  }

  /// True when all readers of a lossless ring are beyond this message, also those that are joining
  /// now. False: a joiner was quicker. REQUIRES: read_slots() said that all have read it.
  bool close_off(Word message) {
    raise_floor(next(message));
    refresh_roster();
    if (!minimum_known_) find_slowest();
    return distance(message, minimum_) < 0;
  }

  void raise_floor(Word lowest) {
    // The floor never goes down. A floor that seems to lie behind the next message is from before
    // the sequences wrapped.
    const std::int64_t before = distance(next_, floor_);
    if (before < 0 || before > distance(next_, lowest)) {
      floor_ = lowest;
      ring_.floor->store(lowest, std::memory_order_seq_cst);  // R15
    }
  }

  /// Where the reader of a cell stands, or kIdle. Gives a place to a joiner that has none yet, so
  /// that a joiner that is held up does not hold up the sender.
  Word place_of(std::uint32_t c) {
    auto& word = ring_.cells[c].position;
    Word position = word.load(std::memory_order_seq_cst);  // R3, R6
    while (is_joining(position)) {
      // Relaxed: the writer has written the slots itself.
      const Word last = ring_.slots[places_ - 1].load(std::memory_order_relaxed);
      const std::uint64_t back = ring_.reach(next_, ring_.published(next_, last),
                                             sequence(position), floor_, ring_.guarded());
      const Word place = make(advance(next_, Word{0} - back), kNoBlock);
      // Relaxed: the place is all that it tells. If the joiner was quicker, its own place counts,
      // which the failing compare-and-swap acquires (R3).
      if (word.compare_exchange_strong(position, place, std::memory_order_relaxed,
                                       std::memory_order_acquire)) {
        return place;
      }
    }
    return position;
  }

  /// Each push looks at the roster, and it seldom changes: so what is done then lies apart.
  void refresh_roster() {
    const std::uint32_t now = ring_.roster->load(std::memory_order_seq_cst);  // R4, R15
    if (now != roster_) [[unlikely]]
      read_roster(now);
  }
  [[gnu::noinline]] void read_roster(std::uint32_t now) {
    roster_ = now;
    minimum_known_ = false;  // a late joiner may stand behind the cached minimum
    active_.clear();
    observers_ = 0;
    for (std::uint32_t c = 0; c < ring_.readers; ++c) {
      // R3: a reader that has left has read. The roster makes sure that joiners are seen (R4).
      if (ring_.who[c].load(std::memory_order_acquire) == 0) continue;
      active_.push_back(c);
      // The roster carries what an observer has stored before it bumped it (R4). R3: one that is
      // none any more has read, and no hazard is asked for on its account.
      observers_ += is_observer(ring_.cells[c].position.load(std::memory_order_acquire));
    }
  }

  /// How far before its turn a slot that has a message is fetched.
  static constexpr std::uint32_t kAhead = 2;
  static constexpr std::uint64_t kUnread = ~std::uint64_t{0};  ///< no roster says so

  Ring<P> ring_;
  std::uint32_t places_ = 0;  ///< ring_.places()
  Word next_ = 0;
  Word minimum_ = 0;
  Word floor_ = 0;           ///< what *ring_.floor says
  std::uint32_t index_ = 0;  ///< slot of next_; kept apart so that depth need not be a power of two
  std::uint64_t roster_ = kUnread;  ///< what the roster said when `active_` was made
  bool minimum_known_ = false;
  std::vector<std::uint32_t> active_;
  std::size_t observers_ = 0;  ///< of active_; a number that may be too large when some have left
  /// By slot: the block whose hold the ring has, if blocks are taken. Else it is empty.
  std::vector<Word> put_;
  std::uint32_t oldest_ = 0;   ///< slot of the oldest of put_
  std::uint64_t laps_ = 0;     ///< how often index_ has come back to 0
  std::uint64_t emptied_ = 0;  ///< no slot before this place holds a message; counted as place()
};

/// The subscriber's side: private state of one reader, used by one thread at a time.
template <class P>
class Reader {
 public:
  /// A history that asks for every message since the ring was made.
  static constexpr std::uint64_t kFromTheStart = ~std::uint64_t{0};
  /// How often in one lap of the ring done() asks whether the sender sleeps for room.
  static constexpr std::uint32_t kBellsPerLap = 4;
  /// How far behind the slot that prefetch() looks at it fetches the word that it will look at.
  static constexpr std::uint32_t kNextLook = 2;
  /// Of a reader that joins. Nothing waits for an observer: it misses what is overwritten, also in
  /// a lossless ring.
  enum class Manner { Reads, Observes };
  /// A reader that joins and prepares nothing.
  struct Nothing {
    void operator()(std::uint32_t) const noexcept {}
  };

  Reader() = default;

  /// Joins a ring of the given generation, starting with the newest `history` messages. Returns
  /// no reader when the ring has no free cell (then `full` is set), or when it has ended. An ended
  /// ring whose messages are taken can be joined: any reader may take what waits there.
  /// REQUIRES: no process recycles the ring meanwhile.
  ///
  /// prepare(cell) is called once the cell is this reader's, and before the writer sees the reader
  /// there. R8 has brought what the cell's former readers did, and R3 brings the writer what
  /// prepare() did.
  ///
  /// Crash: killed after the claim of who[c], the reaper makes the cell idle and frees it.
  template <class Prepare = Nothing>
  static std::optional<Reader> join(const Ring<P>& ring, std::uint32_t generation,
                                    std::uint32_t participant, std::uint64_t history, bool& full,
                                    Prepare&& prepare = {}, Manner manner = Manner::Reads) {
    full = false;
    std::uint32_t c = 0;
    for (; c < ring.readers; ++c) {
      std::uint32_t nobody = 0;
      if (ring.who[c].compare_exchange_strong(nobody, participant + 1, std::memory_order_acquire,
                                              std::memory_order_relaxed)) {  // R8
        break;
      }
    }
    if (c == ring.readers) {
      full = true;
      return std::nullopt;
    }
    const Word writer = ring.writer->load(std::memory_order_acquire);  // R7
    const bool is_open = writer_state(writer) == State::Live ||
                         (ring.taken && writer_state(writer) == State::Orphan);
    if (!is_open || writer_generation(writer) != generation) {
      ring.who[c].store(0, std::memory_order_relaxed);  // this reader did nothing with the cell
      return std::nullopt;
    }
    prepare(c);
    auto& position = ring.cells[c].position;
    Reader reader;
    const bool observes = manner == Manner::Observes;
    reader.mark_ = observes ? std::uint32_t{kObserves} : 0;
    reader.guarded_ = ring.guarded() || observes;
    reader.hazards_ = reader.guarded_ && !ring.in_slots();
    Word wish = observes ? kObserverJoins : joining(std::min<std::uint64_t>(history, ring.depth));
    if (observes || !ring.guarded()) position.store(wish, std::memory_order_release);  // R3, R14
    ring.roster->fetch_add(1, std::memory_order_seq_cst);                              // R4, R15
    reader.ring_ = ring;
    reader.places_ = ring.places();
    reader.cell_ = c;
    reader.start_at_newest(history);
    // From here the cursor holds the sender back. The former reader of the cell may have borrowed a
    // message: this store lets its hazard go (R3).
    const Word place = make(reader.cursor_, kNoBlock) | reader.mark_;
    if (reader.guarded_) {
      position.store(place, std::memory_order_release);  // R3, R14
      // Relaxed: the place belongs to the release sequence of the wish, which carries R3 and R14.
    } else if (!position.compare_exchange_strong(wish, place, std::memory_order_relaxed,
                                                 std::memory_order_relaxed)) {
      reader.start_at(sequence(wish));  // the sender was quicker, and gave the place
      const std::int64_t before = distance(reader.cursor_, ring.first);
      reader.skipped_ = history == kFromTheStart && before > 0 ? static_cast<Word>(before) : 0;
    }
    reader.asked_ = low_half(reader.cursor_);
    return reader;
  }

  /// The reader that a cell awaits (Ring::await). It begins with the first message, however late it
  /// comes. Nothing: no cell awaits this participant. REQUIRES: no process recycles the ring
  /// meanwhile.
  static std::optional<Reader> take_awaited(const Ring<P>& ring, std::uint32_t participant) {
    (void)ring.writer->load(std::memory_order_acquire);  // R7
    for (std::uint32_t c = 0; c < ring.readers; ++c) {
      // Relaxed: R7 carries the name.
      if (ring.who[c].load(std::memory_order_relaxed) != participant + 1) continue;
      auto& word = ring.cells[c].position;
      Word position = word.load(std::memory_order_relaxed);  // the compare-and-swap checks it
      // Relaxed: the reader has done nothing in this ring before, so its place is all that it
      // tells.
      if (!is_awaited(position) ||
          !word.compare_exchange_strong(position, position & ~kSleeper, std::memory_order_relaxed,
                                        std::memory_order_relaxed)) {
        continue;
      }
      Reader reader;
      reader.ring_ = ring;
      reader.places_ = ring.places();
      reader.guarded_ = ring.guarded();
      reader.hazards_ = reader.guarded_ && !ring.in_slots();
      reader.cell_ = c;
      reader.cursor_ = sequence(position);  // in slot 0
      reader.asked_ = low_half(reader.cursor_);
      return reader;
    }
    return std::nullopt;
  }

  /// Borrows the next message: its block, or kNoBlock when there is none. The block and its payload
  /// are protected until done(). kInSlot: the caller copies the message, which nothing protects.
  /// Adds to `missed` the messages that were overwritten before this reader could read them.
  /// kDamaged: a process that is no publisher here has written into the ring; done() goes on behind
  /// that slot.
  [[gnu::hot]] Word poll(std::uint64_t& missed) {
    Word lapped = 0;
    return poll(missed, lapped);
  }
  /// `lapped`: how many messages this look has passed over so far. More than there can be is
  /// damage.
  [[gnu::hot]] Word poll(std::uint64_t& missed, Word& lapped) {
    for (;;) {
      auto& slot = ring_.slots[index_];
      const Word seen = place(slot.load(std::memory_order_acquire));  // R1
      const std::int64_t ahead = distance(sequence(seen), cursor_);
      if (ahead < 0) {
        when_empty();
        return kNoBlock;
      }
      if (ahead > 0) {  // lapped: the oldest message still there is one lap behind `seen`
        lapped += static_cast<Word>(ahead);
        // No publisher leaps by less than whole laps. A leap through half of all sequences is
        // damage, too: the loop might never end.
        if (ahead % places_ != 0 || lapped > kSequenceMask / 2) return kDamaged;
        skip(static_cast<Word>(ahead) + 1 - ring_.most(), missed);
        continue;
      }
      if (block(seen) == kNoBlock) {  // evicted, or taken by another reader
        skip(1, missed);
        continue;
      }
      if (hazards_) {
        auto& position = ring_.cells[cell_].position;
        position.store(seen | mark_, std::memory_order_seq_cst);            // R2
        if (place(slot.load(std::memory_order_seq_cst)) != seen) continue;  // R2
      }
      drained_ = false;
      return block(seen);
    }
  }

  /// Copies the message that poll() has found in its slot, and the time of its push if `time` is
  /// not null. False: it was overwritten meanwhile, and counts as missed; the caller polls again.
  /// Damaged: as kDamaged of poll(). REQUIRES: poll() has returned kInSlot; the message is not
  /// longer than the ring's slots have room for.
  ///
  /// It may be called again until done(): without loss it is then the same message.
  [[gnu::hot]] Copy copy(void* into, std::size_t words, Word* time, std::uint64_t& missed) {
    const Copy copy = ring_.slots.read(index_, cursor_, places_, into, words, time);
    // The take, or the second look behind the claim, says whether the copy is whole.
    if (ring_.taken) return Copy::Whole;
    if (copy == Copy::Overwritten) skip(1, missed);
    return copy;
  }

  /// Takes the message that poll() has found out of the ring, for this reader alone. False: another
  /// reader was faster. REQUIRES: the messages of the ring are taken; the caller holds the block.
  ///
  /// Crash: killed before this step, the message stays in its slot. Killed after it, the message is
  /// lost with its taker.
  bool take() { return empty(ring_.slots[index_], cursor_); }

  /// As poll(), where workers must finish messages: passes over a message that a worker has
  /// claimed, and begins again when messages have come back.
  Word poll_unclaimed(std::uint64_t& missed) {
    Word lapped = 0;
    return poll_unclaimed(missed, lapped);
  }
  Word poll_unclaimed(std::uint64_t& missed, Word& lapped) {
    look_back();
    for (;;) {
      const Word b = poll(missed, lapped);
      if (b == kNoBlock || b == kDamaged || !is_claimed(ring_.claims[index_], cursor_)) return b;
      step(1);
    }
  }
  /// As take(), where workers must finish messages: the message stays in its slot(). Returns the
  /// claim, or 0 when another worker has or had the message.
  ///
  /// Crash: killed after this step, the message comes back.
  Word claim(std::uint32_t participant) {
    auto& word = ring_.claims[index_];
    const Word mine = ring::claim(word, cursor_, participant);
    if (mine == 0) return 0;
    // The claim may be of a worker that died after it had finished the message. Relaxed: C1
    // carries the empty slot.
    const Word seen = ring_.slots[index_].load(std::memory_order_relaxed);
    if (sequence(seen) == cursor_ && block(seen) != kNoBlock) return mine;
    unclaim(word, mine);
    return 0;
  }
  std::uint32_t index() const { return index_; }

  /// The block of the message that is `ahead` of the next one, or kNoBlock. For prefetching only:
  /// it may be wrong.
  Word peek(std::uint32_t ahead) const {
    if (ahead >= ring_.depth) return kNoBlock;
    // Relaxed: for prefetching only.
    const Word seen = ring_.slots[slot_ahead(ahead)].load(std::memory_order_relaxed);
    return sequence(seen) == advance(cursor_, ahead) ? block(seen) : kNoBlock;
  }
  /// Fetches the slot of the message that is `ahead` of the next one, if that is there. REQUIRES:
  /// messages are in their slots.
  ///
  /// A look at a word that another core has would hold up all that comes behind it. So the word of
  /// a later slot is fetched, too, which one of the next calls looks at.
  void prefetch(std::uint32_t ahead) const {
    if (peek(ahead) != kInSlot) return;
    ring_.slots.prefetch_rest(slot_ahead(ahead));
    if (ahead + kNextLook < places_) ring_.slots.prefetch_first(slot_ahead(ahead + kNextLook));
  }

  /// Ends a borrow. Returns true when the sender sleeps for room: the caller then calls ring_bell()
  /// and, if that says so, wakes `space`. It asks only a few times in a lap: a wake for each
  /// message would cost both sides more than the message.
  bool done() {
    step(1);
    ring_.cells[cell_].position.store(make(cursor_, kNoBlock) | mark_,
                                      std::memory_order_release);  // R3
    if (!ring_.blocking || mark_ != 0 || low_half(cursor_) - asked_ < ring_.depth / kBellsPerLap) {
      return false;
    }
    asked_ = low_half(cursor_);
    // Relaxed: this may see a stale even number, and not every message makes this call. In both
    // cases the next empty poll rings, or the sender finds the room by its own look every
    // millisecond.
    return (ring_.space->load(std::memory_order_relaxed) & 1) != 0;
  }

  /// After an empty poll under back-pressure: true when the sender sleeps for room.
  bool sender_waits() {
    return ring_.blocking && (ring_.space->load(std::memory_order_seq_cst) & 1) != 0;  // R6
  }

  /// Takes the sender's mark away. True when the caller must wake `space`.
  static bool ring_bell(typename P::template Atomic<std::uint32_t>& space) {
    std::uint32_t v = space.load(std::memory_order_relaxed);  // the compare-and-swap checks it
    // A loop: a reader that leaves, or its reaper, adds 2, and the sender sleeps on. Relaxed: the
    // futex call of the wake orders.
    while ((v & 1) != 0) {
      if (space.compare_exchange_weak(v, v + 1, std::memory_order_relaxed,
                                      std::memory_order_relaxed)) {
        return true;
      }
    }
    return false;
  }

  /// Leaves a sleeper's mark in the slot that the next publish will exchange. Returns the slot word
  /// to sleep on, or nothing when there may be a message. Before the caller sleeps it must look at
  /// ended() and the directory.
  std::optional<Word> mark_sleeping() {
    bool stood = false;
    return mark_sleeping(stood);
  }
  /// The same. `stood`: the mark was there. Of all readers that sleep on one word, one has left it.
  std::optional<Word> mark_sleeping(bool& stood) {
    auto& slot = ring_.slots[index_];
    Word seen = slot.load(std::memory_order_seq_cst);  // R5, H1: the mark may be another reader's
    if (distance(sequence(seen), cursor_) >= 0) return std::nullopt;
    stood = (seen & kSleeper) != 0;
    if (!stood) {
      if (!slot.compare_exchange_strong(seen, seen | kSleeper, std::memory_order_acquire,
                                        std::memory_order_relaxed)) {  // R5
        return std::nullopt;
      }
      seen |= kSleeper;
    }
    return seen;
  }

  /// As mark_sleeping(), where readers sleep on the mutex engine's condition. REQUIRES: its lock.
  std::optional<std::uint32_t> announce_sleeping(bool& stood) {
    if (ready()) return std::nullopt;
    return RobustCondition(*ring_.arrived).announce(stood);
  }

  /// True when the publisher has gone: no message will follow those that are in the ring.
  bool orphaned() const {
    return writer_state(ring_.writer->load(std::memory_order_acquire)) == State::Orphan;  // R9
  }

  /// True when the publisher has gone and this reader has read everything. It loads the writer word
  /// first and then the slot: else a last message could come in between.
  bool ended() const {
    // R9 carries the slot.
    return orphaned() &&
           distance(sequence(ring_.slots[index_].load(std::memory_order_relaxed)), cursor_) < 0;
  }

  /// True when poll() would find something.
  bool ready() const {
    // Relaxed: a hint. poll() acquires the message.
    return distance(sequence(ring_.slots[index_].load(std::memory_order_relaxed)), cursor_) >= 0 ||
           has_returns();
  }
  /// True when messages have come back since poll_unclaimed() looked.
  bool has_returns() const {
    // Relaxed: a hint. A reader that is about to sleep has acquired it (R5).
    return ring_.returned != nullptr &&
           ring_.returned->load(std::memory_order_relaxed) != returned_;
  }
  /// True while the ring has messages that no worker has finished: claimed or not.
  bool is_unfinished() const { return ring_.claims != nullptr && ring_.has_news(); }
  /// True when the publisher has gone, and no message that it left can come back.
  bool is_closing() const { return orphaned() && !is_unfinished(); }

  /// Frees the cell. The caller wakes `space` unconditionally. Crash: the reaper does the rest.
  void leave() {
    ring_.cells[cell_].position.store(kIdle, std::memory_order_release);  // R3
    ring_.free_cell(cell_);
  }

  /// Of a reader that joined from the start: how many messages were overwritten before it came.
  std::uint64_t skipped() const { return skipped_; }

  typename P::template Atomic<Word>& slot() const { return ring_.slots[index_]; }

  /// How many messages are there to be read: a hint while the publisher works.
  std::uint32_t size() const {
    if (ring_.claims != nullptr) return unclaimed();
    std::uint32_t n = 0;
    std::uint32_t i = index_;
    // All places: where there is one more than the depth, the empty one may lie anywhere.
    for (std::uint32_t ahead = 0; ahead < places_; ++ahead) {
      const Word seen = ring_.slots[i].load(std::memory_order_relaxed);  // only counted
      if (distance(sequence(seen), advance(cursor_, ahead)) < 0) break;
      if (block(seen) != kNoBlock) ++n;
      if (++i == places_) i = 0;
    }
    return std::min(n, ring_.depth);
  }

  const Ring<P>& ring() const { return ring_; }
  Word cursor() const { return cursor_; }
  std::uint32_t cell() const { return cell_; }

 private:
  static std::uint32_t low_half(Word sequence) { return static_cast<std::uint32_t>(sequence); }

  /// Puts the cursor `history` messages before the newest one, as far as the ring goes back.
  void start_at_newest(std::uint64_t history) {
    // The floor before the slots: so the floor is not beyond the newest message found in them.
    const Word lowest = ring_.floor->load(std::memory_order_seq_cst);  // R15
    newest_index_ = 0;
    Word word = ring_.slots[0].load(std::memory_order_seq_cst);  // R4
    newest_ = sequence(word);
    for (std::uint32_t i = 1; i < places_; ++i) {
      word = ring_.slots[i].load(std::memory_order_seq_cst);  // R4
      if (distance(sequence(word), newest_) > 0) {
        newest_ = sequence(word);
        newest_index_ = i;
      }
    }
    const Word head = next(newest_);
    const std::uint64_t published = ring_.published(head, word);
    std::uint64_t back = ring_.reach(head, published, history, lowest, guarded_);
    if (history == kFromTheStart && guarded_ && !ring_.taken) {
      back = published;  // poll() counts overwritten messages as missed
    }
    start_at(advance(head, Word{0} - back));
    if (history == kFromTheStart && !ring_.taken) skipped_ = published - back;
  }

  /// Begins again when messages have come back: they lie behind the cursor.
  void look_back() {
    const std::uint32_t now = ring_.returned->load(std::memory_order_acquire);  // C2
    if (now == returned_) return;
    returned_ = now;
    start_at_newest(kFromTheStart);
  }
  std::uint32_t unclaimed() const {
    std::uint32_t n = 0;
    for (std::uint32_t i = 0; i < ring_.depth; ++i) {
      const Word seen = ring_.slots[i].load(std::memory_order_relaxed);  // only counted
      n += block(seen) != kNoBlock && !is_claimed(ring_.claims[i], sequence(seen));
    }
    return n;
  }

  /// Puts the cursor at this sequence. The message newest_ was once in the slot newest_index_.
  void start_at(Word cursor) {
    cursor_ = cursor;
    // Sequences and indexes advance together, also where the sequences wrap.
    const std::int64_t places = places_;
    const std::int64_t ahead = distance(cursor, newest_) % places + places;
    index_ = static_cast<std::uint32_t>((newest_index_ + ahead) % places);
  }
  /// REQUIRES: ahead < places_.
  std::uint32_t slot_ahead(std::uint32_t ahead) const {
    const std::uint32_t i = index_ + ahead;
    return i < places_ ? i : i - places_;
  }

  void step(Word by) {
    cursor_ = advance(cursor_, by);
    if (by == 1) {
      if (++index_ == places_) index_ = 0;
    } else {
      index_ = static_cast<std::uint32_t>((index_ + by) % places_);
    }
  }

  void skip(Word by, std::uint64_t& missed) {
    if (!ring_.taken) missed += by;  // if taken: another reader has got them
    step(by);
    drained_ = false;
  }

  void when_empty() {
    auto& position = ring_.cells[cell_].position;
    if (hazards_) {
      position.store(make(cursor_, kNoBlock) | mark_,
                     std::memory_order_release);  // R3: lets a hazard go
    } else if (!drained_) {
      drained_ = true;
      position.store(make(cursor_, kNoBlock) | mark_, std::memory_order_seq_cst);  // R6
    }
  }

  Ring<P> ring_;
  Word cursor_ = 0;
  std::uint64_t skipped_ = 0;
  Word newest_ = 0;                 ///< the newest message when this reader joined
  std::uint32_t newest_index_ = 0;  ///< the slot of newest_
  std::uint32_t index_ = 0;
  std::uint32_t places_ = 0;  ///< ring_.places()
  std::uint32_t cell_ = 0;
  std::uint32_t asked_ = 0;     ///< low half of cursor_ when done() last asked for the sender
  std::uint32_t returned_ = 0;  ///< the ring's `returned` when look_back() last looked
  std::uint32_t mark_ = 0;      ///< kObserves, or 0: a part of each position
  bool drained_ = false;
  bool guarded_ = false;  ///< its cursor does not hold the sender back
  bool hazards_ = false;  ///< its hazard protects the block that it looks at
};

}  // namespace lot::ring
