// SPDX-License-Identifier: Apache-2.0
// The ring as an algorithm, in one thread: every case knows the exact interleaving. What threads do
// to it is in tests/proof/stress/threads_test.cpp, what a model checker does in tests/proof/model.

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include <boost/lockfree/spsc_queue.hpp>
#include <doctest/doctest.h>

#include "lot/detail/atomics.hpp"

// The policy comes first: the algorithm takes its atomics and their memory orders from it.
#include "lockfree_ring/ring.hpp"
#include "lockfree_ring/sleep.hpp"
#include "lockfree_ring/words.hpp"
#include "support/raw.hpp"

namespace {

using lot::detail::HardwareAtomics;
using lot::ring::kNoBlock;
using lot::ring::kSequenceMask;
using lot::ring::kSleeper;
using lot::ring::Word;
using Reader = lot::ring::Reader<HardwareAtomics>;
using lot::ring::State;

constexpr std::uint32_t kGeneration = 7;
constexpr std::uint32_t kParticipant = 3;
enum class Policy { Overwrite, Blocking };

/// A live ring in plain memory, its writer, and what most cases do with the two.
template <class P>
struct BasicChannel {
  using Reader = lot::ring::Reader<P>;
  template <class T>
  using Atomic = typename P::template Atomic<T>;

  BasicChannel(std::uint32_t depth, Policy policy, std::uint32_t readers = 3, Word first = 0)
      : slots(depth), cells(readers), who(readers) {
    ring.writer = &writer_word;
    ring.slots = slots.data();
    ring.cells = cells.data();
    ring.who = who.data();
    ring.roster = &roster;
    ring.space = &space;
    ring.floor = &floor;
    ring.depth = depth;
    ring.readers = readers;
    ring.blocking = policy == Policy::Blocking;
    ring.first = first;
    ring.format();
    become(State::Live);
    writer = lot::ring::Writer<P>(ring);
  }

  void become(State state) {
    lot::test::raw(writer_word) = lot::ring::make_writer(kGeneration, state, kParticipant);
  }

  Reader join(std::uint64_t history = 0) {
    bool full = true;
    auto reader = Reader::join(ring, kGeneration, kParticipant, history, full);
    REQUIRE(reader.has_value());
    CHECK_FALSE(full);
    return *reader;
  }

  /// A subscriber that has not looked. REQUIRES: nothing was published yet.
  void await(std::uint32_t cell, std::uint32_t participant) {
    ring.await(cell, participant);
    writer = lot::ring::Writer<P>(ring);
  }

  /// Publishes blocks from, from + 1, ... to - 1.
  void publish(Word from, Word to) {
    for (Word block = from; block < to; ++block) {
      REQUIRE(writer.room());
      writer.publish(block);
    }
  }

  std::vector<Word> hazards() {
    std::vector<Word> found;
    writer.hazards([&](Word block) { found.push_back(block); });
    return found;
  }

  std::vector<Word> take_back(std::uint32_t keep) {
    std::vector<Word> gone;
    writer.take_back(keep, [&](Word block) { gone.push_back(block); });
    return gone;
  }

  std::vector<std::uint32_t> laggards() {
    std::vector<std::uint32_t> found;
    writer.laggards([&](std::uint32_t cell) { found.push_back(cell); });
    return found;
  }

  lot::ring::WriterWord<P> writer_word;
  std::vector<Atomic<Word>> slots;
  std::vector<lot::ring::Cell<P>> cells;
  std::vector<Atomic<std::uint32_t>> who;
  Atomic<std::uint32_t> roster{0};
  Atomic<Word> floor{0};
  Atomic<std::uint32_t> space{0};
  lot::ring::Ring<P> ring;
  lot::ring::Writer<P> writer;
};

using Channel = BasicChannel<HardwareAtomics>;

/// What a reader gets when it reads until there is nothing left.
struct Drained {
  std::vector<Word> blocks;
  std::uint64_t missed = 0;
};

template <class AnyReader>
Drained drain(AnyReader& reader) {
  Drained result;
  for (Word block; (block = reader.poll(result.missed)) != kNoBlock;) {
    result.blocks.push_back(block);
    reader.done();
  }
  return result;
}

using Blocks = std::vector<Word>;

Blocks blocks(Word from, Word to) {
  Blocks result;
  for (Word block = from; block < to; ++block) result.push_back(block);
  return result;
}

}  // namespace

TEST_SUITE_BEGIN("lockfree_ring");

// ---- words --------------------------------------------------------------------------------------

TEST_CASE("a slot word gives back the sequence and the block that it was made of") {
  for (const Word sequence : {Word{0}, Word{1}, kSequenceMask - 1, kSequenceMask}) {
    for (const Word block : {Word{0}, Word{5}, kNoBlock}) {
      const Word word = lot::ring::make(sequence, block);
      CHECK(lot::ring::sequence(word) == sequence);
      CHECK(lot::ring::block(word) == block);
      CHECK((word & kSleeper) == 0);
      for (Word w = word | kSleeper, n = 0; n < 10; w = lot::ring::next_round(w) | kSleeper, ++n) {
        CHECK(lot::ring::place(w) == word);
        CHECK(lot::ring::next_round(w) != (w & ~kSleeper));
      }
      CHECK(word != lot::ring::kIdle);
      CHECK(lot::ring::is_place(word));
      CHECK(lot::ring::is_awaited(lot::ring::awaited(sequence)));
      CHECK_FALSE(lot::ring::is_joining(lot::ring::awaited(sequence)));
      CHECK(lot::ring::is_joining(lot::ring::joining(sequence)));
      CHECK_FALSE(lot::ring::is_awaited(lot::ring::joining(sequence)));
      for (const Word other : {lot::ring::awaited(sequence), lot::ring::joining(sequence)}) {
        CHECK_FALSE(lot::ring::is_place(other));
        CHECK(other != lot::ring::kIdle);
        CHECK(lot::ring::sequence(other) == sequence);
        CHECK(lot::ring::block(other) == kNoBlock);
      }
    }
  }
}

TEST_CASE("distances are right on both sides of the wrap") {
  using lot::ring::distance;
  CHECK(distance(5, 3) == 2);
  CHECK(distance(3, 5) == -2);
  CHECK(distance(0, kSequenceMask) == 1);
  CHECK(distance(kSequenceMask, 0) == -1);
  CHECK(distance(2, kSequenceMask - 2) == 5);
  CHECK(lot::ring::next(kSequenceMask) == 0);
  CHECK(lot::ring::advance(kSequenceMask - 1, 5) == 3);
  CHECK(lot::ring::advance(3, Word{0} - 5) == kSequenceMask - 1);
}

TEST_CASE("a writer word gives back generation, state and owner") {
  const Word word = lot::ring::make_writer(0xfedcba98, State::Orphan, 0xabcdef);
  CHECK(lot::ring::writer_generation(word) == 0xfedcba98);
  CHECK((lot::ring::writer_state(word) == State::Orphan));
  CHECK(lot::ring::writer_owner(word) == 0xabcdef);
}

// ---- reading what was published -----------------------------------------------------------------

TEST_CASE("a new ring has nothing to read, nothing to evict and no readers") {
  for (const std::uint32_t depth : {1U, 3U, 8U}) {
    Channel channel(depth, Policy::Overwrite);
    CHECK(channel.ring.deserted());
    CHECK(channel.writer.active_readers() == 0);
    CHECK(channel.writer.evict_oldest() == kNoBlock);
    Reader reader = channel.join(Reader::kFromTheStart);
    const Drained drained = drain(reader);
    CHECK(drained.blocks.empty());
    CHECK(drained.missed == 0);
    CHECK_FALSE(reader.ready());
    CHECK_FALSE(channel.ring.deserted());
  }
}

TEST_CASE("each reader gets every message, in order, at its own pace") {
  for (const std::uint32_t depth : {1U, 2U, 3U, 5U, 7U, 8U}) {
    CAPTURE(depth);
    Channel channel(depth, Policy::Overwrite);
    Reader quick = channel.join();
    Reader slow = channel.join();
    for (Word round = 0; round < 3; ++round) {
      for (Word block = round * depth; block < (round + 1) * depth; ++block) {
        channel.publish(block, block + 1);
        CHECK(quick.ready());
        CHECK(quick.peek(0) == block);
        CHECK(drain(quick).blocks == Blocks{block});
        CHECK(quick.peek(0) == kNoBlock);
      }
      const Drained late = drain(slow);
      CHECK(late.blocks == blocks(round * depth, (round + 1) * depth));
      CHECK(late.missed == 0);
    }
  }
}

TEST_CASE("a reader that is lapped is told exactly how many it missed") {
  for (const std::uint32_t depth : {1U, 2U, 3U, 5U, 8U}) {
    for (Word published = 0; published < 4 * depth + 2; ++published) {
      CAPTURE(depth);
      CAPTURE(published);
      Channel channel(depth, Policy::Overwrite);
      Reader reader = channel.join();
      channel.publish(0, published);
      const Word lost = published > depth ? published - depth : 0;
      const Drained drained = drain(reader);
      CHECK(drained.blocks == blocks(lost, published));
      CHECK(drained.missed == lost);
    }
  }
}

TEST_CASE("a reader that is lapped again and again misses each message once") {
  Channel channel(3, Policy::Overwrite);
  Reader reader = channel.join();
  std::uint64_t missed = 0;
  std::uint64_t got = 0;
  for (Word published = 0; published < 100; published += 10) {
    channel.publish(published, published + 10);
    const Word block = reader.poll(missed);
    CHECK(block == published + 7);  // the oldest of the three that are left
    reader.done();
    ++got;
    CHECK(got + missed == block + 1);
  }
}

TEST_CASE("a slot that no publisher can have written ends a poll, and done() goes on behind it") {
  Channel channel(4, Policy::Overwrite);
  Reader reader = channel.join();
  channel.publish(0, 4);
  std::uint64_t missed = 0;
  SUBCASE("it is ahead by less than a round") {
    channel.slots[0] = lot::ring::make(3, 0);
    CHECK(reader.poll(missed) == lot::ring::kDamaged);
    reader.done();
    CHECK(reader.poll(missed) == 1);
    CHECK(missed == 0);
  }
  SUBCASE("the slots lead round and round the sequences") {
    constexpr Word kQuarter = (kSequenceMask + 1) / 4;
    for (Word i = 0; i < 4; ++i) {
      channel.slots[i] = lot::ring::make(lot::ring::advance((i + 1) * kQuarter, i), i);
    }
    CHECK(reader.poll(missed) == lot::ring::kDamaged);
  }
}

TEST_CASE("slots and claims that lead round and round the sequences end a look for a task") {
  constexpr Word kDepth = 8;
  Channel channel(kDepth, Policy::Overwrite);
  std::vector<std::atomic<Word>> claims(kDepth);
  std::atomic<std::uint32_t> returned{0};
  channel.ring.claims = claims.data();
  channel.ring.returned = &returned;
  channel.ring.taken = true;
  Reader reader = channel.join();
  // Each second slot is ahead of the cursor by a quarter of all numbers, and the message behind it
  // is another worker's: after a round the cursor stands where it stood.
  constexpr Word kQuarter = (kSequenceMask + 1) / 4;
  Word cursor = 0;
  for (Word i = 0; i < kDepth; i += 2) {
    const Word ahead = kQuarter + (i == 0 ? (kDepth - 2) * kDepth / 2 : 0);
    channel.slots[i] = lot::ring::make(lot::ring::advance(cursor, ahead), i);
    cursor = lot::ring::advance(cursor, ahead + 1 - kDepth);
    channel.slots[i + 1] = lot::ring::make(cursor, i + 1);
    claims[i + 1] = lot::ring::make_claim(cursor, 1, 1);
    cursor = lot::ring::advance(cursor, 1);
  }
  REQUIRE(cursor == 0);
  std::uint64_t missed = 0;
  CHECK(reader.poll_unclaimed(missed) == lot::ring::kDamaged);
}

TEST_CASE("what a dead worker claimed comes back, and readers are told though it claimed nothing") {
  Channel channel(4, Policy::Overwrite);
  std::vector<std::atomic<Word>> claims(4);
  std::atomic<std::uint32_t> returned{0};
  channel.ring.claims = claims.data();
  channel.ring.returned = &returned;
  channel.ring.taken = true;
  constexpr std::uint32_t kStranger = kParticipant + 1;
  const auto back_from = [&](std::uint32_t participant) {
    const bool reads = channel.ring.take_claims_back(participant);
    return std::pair(reads, returned.load());
  };
  using Told = std::pair<bool, std::uint32_t>;
  CHECK(back_from(kParticipant) == Told(false, 0));  // it does not read here
  Reader reader = channel.join();
  CHECK(back_from(kStranger) == Told(false, 0));
  CHECK(back_from(kParticipant) == Told(true, 1));  // it reads, and has claimed nothing

  channel.writer = lot::ring::Writer<HardwareAtomics>(channel.ring);
  channel.publish(0, 2);
  std::uint64_t missed = 0;
  REQUIRE(reader.poll_unclaimed(missed) == 0);
  REQUIRE(reader.claim(kStranger) != 0);  // without a cell: it left after it had claimed
  CHECK(reader.poll_unclaimed(missed) == 1);
  CHECK(back_from(kStranger) == Told(true, 2));
  CHECK(back_from(kStranger) == Told(false, 2));
  CHECK(reader.poll_unclaimed(missed) == 0);
}

TEST_CASE("publish hands back the block that it replaced") {
  for (const std::uint32_t depth : {1U, 3U}) {
    Channel channel(depth, Policy::Overwrite);
    for (Word block = 0; block < 3 * depth; ++block) {
      const auto published = channel.writer.publish(block);
      CHECK(published.replaced == (block < depth ? kNoBlock : block - depth));
      CHECK_FALSE(published.wake);
      CHECK(published.slot == &channel.slots[block % depth]);
    }
    CHECK(channel.writer.next_sequence() == 3 * depth);
  }
}

// ---- hazards ------------------------------------------------------------------------------------

TEST_CASE("a borrowed block is a hazard until it is given back") {
  Channel channel(2, Policy::Overwrite);
  Reader one = channel.join();
  Reader two = channel.join();
  channel.publish(10, 12);
  CHECK(channel.hazards().empty());
  std::uint64_t missed = 0;
  CHECK(one.poll(missed) == 10);
  CHECK(channel.hazards() == Blocks{10});
  CHECK(two.poll(missed) == 10);
  CHECK(channel.hazards() == Blocks{10, 10});
  channel.publish(12, 20);
  CHECK(channel.hazards() == Blocks{10, 10});  // overwritten, and still looked at
  one.done();
  CHECK(channel.hazards() == Blocks{10});
  two.leave();
  CHECK(channel.hazards().empty());
  CHECK(missed == 0);
  CHECK(one.poll(missed) == 18);
  CHECK(missed == 7);  // block 10 was read, 11 to 17 were not
}

TEST_CASE("a ring knows which blocks its readers look at, in whichever cells they are") {
  Channel channel(3, Policy::Overwrite);
  Reader first = channel.join();
  Reader second = channel.join();
  channel.publish(10, 13);
  std::uint64_t missed = 0;
  CHECK_FALSE(channel.ring.is_looked_at(10));
  CHECK(first.poll(missed) == 10);
  CHECK(channel.ring.is_looked_at(10));
  CHECK(second.poll(missed) == 10);
  second.done();
  CHECK(second.poll(missed) == 11);
  CHECK(channel.ring.is_looked_at(10));
  CHECK(channel.ring.is_looked_at(11));
  first.done();
  CHECK_FALSE(channel.ring.is_looked_at(10));
  CHECK(channel.ring.is_looked_at(11));
}

TEST_CASE("a writer foretells which block it replaces next, no further than one lap") {
  for (const std::uint32_t depth : {1U, 3U}) {
    Channel channel(depth, Policy::Overwrite);
    channel.publish(10, 10 + 2 * depth);
    for (std::uint32_t ahead = 0; ahead < depth; ++ahead) {
      CHECK(channel.writer.upcoming(ahead) == 10 + depth + ahead);
    }
    for (std::uint32_t ahead = depth; ahead < 3 * depth; ++ahead) {
      CHECK(channel.writer.upcoming(ahead) == kNoBlock);
    }
  }
}

TEST_CASE("a poll that borrows the next message or finds none lets the hazard before it go") {
  Channel channel(1, Policy::Overwrite);
  Reader reader = channel.join();
  std::uint64_t missed = 0;
  channel.publish(1, 2);
  CHECK(reader.poll(missed) == 1);
  channel.publish(2, 3);
  CHECK(reader.poll(missed) == 2);  // no done(): the first message counts as missed
  CHECK(missed == 1);
  CHECK(channel.hazards() == Blocks{2});
  CHECK(channel.writer.evict_oldest() == 2);
  CHECK(channel.hazards() == Blocks{2});
  CHECK(reader.poll(missed) == kNoBlock);
  CHECK(channel.hazards().empty());
  CHECK(missed == 2);
}

// ---- joining, history, leaving ------------------------------------------------------------------

TEST_CASE("a joiner gets as much history as it asks for and as the ring still has") {
  for (const Policy policy : {Policy::Overwrite, Policy::Blocking}) {
    for (const std::uint32_t depth : {1U, 3U, 4U}) {
      for (Word published = 0; published <= 3 * depth; ++published) {
        for (std::uint64_t history = 0; history <= depth + 2U; ++history) {
          CAPTURE(depth);
          CAPTURE(published);
          CAPTURE(history);
          Channel channel(depth, policy);
          channel.publish(0, published);
          // Under back-pressure the sender may be one message ahead of what a joiner sees.
          const Word kept = policy == Policy::Blocking ? depth - 1 : depth;
          const Word back = std::min({Word{history}, kept, published});
          Reader reader = channel.join(history);
          const Drained drained = drain(reader);
          CHECK(drained.blocks == blocks(published - back, published));
          CHECK(drained.missed == 0);
          channel.publish(published, published + 1);
          CHECK(drain(reader).blocks == Blocks{published});
        }
      }
    }
  }
}

TEST_CASE("history from the start counts what was overwritten before the reader came") {
  for (const std::uint32_t depth : {1U, 3U, 4U}) {
    for (Word published = 0; published <= 3 * depth; ++published) {
      Channel channel(depth, Policy::Overwrite);
      channel.publish(0, published);
      Reader reader = channel.join(Reader::kFromTheStart);
      const Word lost = published > depth ? published - depth : 0;
      const Drained drained = drain(reader);
      CHECK(drained.blocks == blocks(lost, published));
      CHECK(drained.missed == lost);
    }
  }
}

TEST_CASE("history from the start under back-pressure is what the ring can give for sure") {
  Channel channel(4, Policy::Blocking);
  channel.publish(0, 10);
  Reader reader = channel.join(Reader::kFromTheStart);
  const Drained drained = drain(reader);
  CHECK(drained.blocks == Blocks{7, 8, 9});
  CHECK(drained.missed == 0);
}

TEST_CASE("there are as many readers as cells, and a cell that was left can be joined again") {
  Channel channel(2, Policy::Overwrite, 2);
  Reader one = channel.join();
  Reader two = channel.join();
  CHECK(one.cell() != two.cell());
  CHECK(channel.writer.active_readers() == 2);
  bool full = false;
  CHECK_FALSE(Reader::join(channel.ring, kGeneration, kParticipant, 0, full).has_value());
  CHECK(full);
  const std::uint32_t space = channel.space;
  one.leave();
  CHECK(channel.space == space + 2);  // whoever sleeps for room looks again
  CHECK(channel.cells[one.cell()].position == lot::ring::kIdle);
  CHECK(channel.who[one.cell()] == 0);
  channel.publish(0, 1);
  Reader again = channel.join(1);
  CHECK(again.cell() == one.cell());
  CHECK(channel.who[again.cell()] == kParticipant + 1);
  CHECK(channel.writer.active_readers() == 2);
  CHECK(drain(again).blocks == Blocks{0});
  again.leave();
  two.leave();
  CHECK(channel.ring.deserted());
}

TEST_CASE("a joiner prepares the cell that it has got before the writer can see it there") {
  for (const Policy policy : {Policy::Overwrite, Policy::Blocking}) {
    Channel channel(2, policy, 1);
    const auto cells = [&] {
      std::vector<std::uint32_t> found;
      bool full = false;
      Reader::join(channel.ring, kGeneration, kParticipant, 0, full, [&](std::uint32_t cell) {
        found.push_back(cell);
        CHECK(channel.who[cell] == kParticipant + 1);
        CHECK(channel.cells[cell].position == lot::ring::kIdle);
        CHECK(channel.roster == 0);
      });
      return found;
    };
    channel.become(State::Init);
    CHECK(cells().empty());
    channel.become(State::Live);
    CHECK(cells() == std::vector<std::uint32_t>{0});
    CHECK(channel.roster == 1);
    CHECK(cells().empty());  // there is no free cell
  }
}

TEST_CASE("no reader joins a ring that is not live, or that has become another one") {
  Channel channel(2, Policy::Blocking);
  bool full = true;
  for (const State state : {State::Free, State::Init, State::Orphan}) {
    channel.become(state);
    CHECK_FALSE(Reader::join(channel.ring, kGeneration, kParticipant, 0, full).has_value());
    CHECK_FALSE(full);
  }
  channel.become(State::Live);
  CHECK_FALSE(Reader::join(channel.ring, kGeneration + 1, kParticipant, 0, full).has_value());
  CHECK_FALSE(full);
  CHECK(channel.ring.deserted());
  CHECK(channel.writer.room());
}

// ---- back-pressure ------------------------------------------------------------------------------

TEST_CASE("the slowest reader holds the sender back until it has read") {
  for (const std::uint32_t depth : {1U, 2U, 3U, 5U}) {
    CAPTURE(depth);
    Channel channel(depth, Policy::Blocking);
    Reader quick = channel.join();
    Reader slow = channel.join();
    std::uint64_t missed = 0;
    channel.publish(0, depth);
    CHECK_FALSE(channel.writer.room());
    CHECK(channel.laggards() == std::vector<std::uint32_t>{quick.cell(), slow.cell()});
    CHECK(drain(quick).blocks == blocks(0, depth));
    CHECK_FALSE(channel.writer.room());
    CHECK(channel.laggards() == std::vector<std::uint32_t>{slow.cell()});
    CHECK(slow.poll(missed) == 0);
    CHECK_FALSE(channel.writer.room());  // borrowed is not read
    slow.done();
    CHECK(channel.laggards().empty());
    CHECK(channel.writer.room());
    channel.publish(depth, depth + 1);
    CHECK_FALSE(channel.writer.room());
    CHECK(drain(slow).blocks == blocks(1, depth + 1));
    CHECK(drain(quick).blocks == Blocks{depth});
    CHECK(missed == 0);
  }
}

TEST_CASE("a sender without readers, or whose last reader has left, is never held back") {
  Channel channel(2, Policy::Blocking);
  channel.publish(0, 10);
  Reader reader = channel.join();
  channel.publish(10, 12);
  CHECK_FALSE(channel.writer.room());
  reader.leave();
  CHECK(channel.writer.room());
  CHECK(channel.laggards().empty());
  channel.publish(12, 20);
}

TEST_CASE("a sender that knew of room looks again when a reader has joined further back") {
  Channel channel(4, Policy::Blocking);
  Reader ahead = channel.join();
  channel.publish(0, 4);
  drain(ahead);
  REQUIRE(channel.writer.room());   // known now: four more would fit
  Reader behind = channel.join(3);  // starts at 1, so only one more does
  channel.publish(4, 5);
  CHECK_FALSE(channel.writer.room());
  CHECK(channel.laggards() == std::vector<std::uint32_t>{behind.cell()});
  CHECK(drain(behind).blocks == blocks(1, 5));
  CHECK(channel.writer.room());
}

TEST_CASE("a joiner that has not found its place yet gets one from the sender") {
  for (const Word history : {Word{0}, Word{1}, Word{9}}) {
    Channel channel(4, Policy::Blocking);
    Reader reader = channel.join();
    channel.publish(0, 2);
    drain(reader);
    // What Reader::join() has done when it is stopped before it stores its cursor.
    channel.who[1] = kParticipant + 1;
    channel.cells[1].position = lot::ring::joining(history);
    ++channel.roster;
    CHECK(channel.laggards().empty());
    CHECK(channel.hazards().empty());
    CHECK(channel.writer.room());  // an empty queue is not full because of a joiner
    const Word begin = 2 - std::min<Word>(history, 2);
    CHECK(channel.cells[1].position == lot::ring::make(begin, kNoBlock));
    channel.publish(2, begin + 4);
    drain(reader);
    CHECK_FALSE(channel.writer.room());
    CHECK(channel.laggards() == std::vector<std::uint32_t>{1});
  }
}

// ---- cells for those who have subscribed before -------------------------------------------------

TEST_CASE("a subscriber that looks late gets every message of a lossless ring") {
  Channel channel(4, Policy::Blocking);
  channel.await(1, kParticipant);
  channel.publish(0, 4);
  CHECK_FALSE(channel.writer.room());
  CHECK(channel.laggards() == std::vector<std::uint32_t>{1});
  channel.become(State::Orphan);
  CHECK_FALSE(channel.ring.deserted());
  CHECK_FALSE(Reader::take_awaited(channel.ring, kParticipant + 1));
  auto reader = Reader::take_awaited(channel.ring, kParticipant);
  REQUIRE(reader);
  CHECK_FALSE(Reader::take_awaited(channel.ring, kParticipant));  // one cell, one reader
  CHECK(drain(*reader).blocks == blocks(0, 4));
  CHECK(reader->ended());
  reader->leave();
  CHECK(channel.ring.deserted());
}

TEST_CASE("a subscriber that looks late counts what was overwritten") {
  for (std::uint32_t sent = 0; sent < 14; ++sent) {
    Channel channel(4, Policy::Overwrite, 3, kSequenceMask - 2);
    channel.await(2, kParticipant);
    channel.publish(0, sent);
    CHECK(channel.writer.room());
    auto reader = Reader::take_awaited(channel.ring, kParticipant);
    REQUIRE(reader);
    const auto seen = drain(*reader);
    const std::uint32_t begin = sent > 4 ? sent - 4 : 0;
    CHECK(seen.blocks == blocks(begin, sent));
    CHECK(seen.missed == begin);
  }
}

TEST_CASE("a subscriber that goes without having looked frees its cell") {
  Channel channel(2, Policy::Blocking);
  channel.await(0, kParticipant);
  channel.await(1, kParticipant);
  channel.publish(0, 2);
  auto reader = Reader::take_awaited(channel.ring, kParticipant);
  REQUIRE(reader);
  drain(*reader);
  CHECK_FALSE(channel.writer.room());
  CHECK_FALSE(channel.ring.unsubscribe(kParticipant + 1));
  CHECK(channel.ring.unsubscribe(kParticipant));
  CHECK_FALSE(channel.ring.unsubscribe(kParticipant));  // the other one has looked
  CHECK(channel.writer.room());
  CHECK(channel.cells[1].position == lot::ring::kIdle);
  CHECK(channel.who[1] == 0);
}

TEST_CASE("overwriting always has room, but knows which readers are behind") {
  Channel channel(2, Policy::Overwrite);
  Reader reader = channel.join();
  channel.publish(0, 5);
  CHECK(channel.writer.room());
  CHECK(channel.laggards() == std::vector<std::uint32_t>{reader.cell()});
}

TEST_CASE("a sender that waits for room is rung once by the reader that makes some") {
  Channel channel(1, Policy::Blocking);
  Reader reader = channel.join();
  std::uint64_t missed = 0;
  channel.publish(0, 1);
  CHECK_FALSE(reader.sender_waits());
  REQUIRE_FALSE(channel.writer.room());
  const std::uint32_t value = channel.writer.mark_waiting();
  CHECK(value == channel.space);
  CHECK(channel.writer.mark_waiting() == value);  // marked once is enough
  CHECK(reader.sender_waits());
  CHECK(reader.poll(missed) == 0);
  CHECK(reader.done());
  CHECK(channel.writer.room());
  CHECK(Reader::ring_bell(channel.space));
  CHECK(channel.space != value);  // the sleep, if it has not begun, does not begin
  CHECK_FALSE(Reader::ring_bell(channel.space));
  CHECK_FALSE(reader.sender_waits());
  channel.publish(1, 2);
  CHECK(reader.poll(missed) == 1);
  CHECK_FALSE(reader.done());
}

TEST_CASE("readers ask a quarter of the ring at a time, and when they find nothing") {
  Channel channel(8, Policy::Blocking);
  Reader reader = channel.join();
  std::uint64_t missed = 0;
  for (lot::ring::Word m = 0; m < 8; ++m) channel.publish(m, m + 1);
  channel.writer.mark_waiting();
  const auto read = [&] {
    REQUIRE(reader.poll(missed) != lot::ring::kNoBlock);
    return reader.done();
  };
  CHECK_FALSE(read());
  CHECK(read());  // a quarter of it
  CHECK_FALSE(read());
  CHECK(read());  // nobody has rung
  CHECK(Reader::ring_bell(channel.space));
  CHECK_FALSE(read());
  CHECK_FALSE(read());  // the sender does not wait any more
  CHECK_FALSE(read());
  channel.writer.mark_waiting();
  CHECK(read());
  CHECK(reader.poll(missed) == lot::ring::kNoBlock);
  CHECK(reader.sender_waits());  // whoever finds nothing sees a mark that still stands
}

TEST_CASE("a reader that leaves changes what a sender sleeps on and keeps its mark") {
  Channel channel(1, Policy::Blocking);
  Reader reader = channel.join();
  channel.publish(0, 1);
  const std::uint32_t value = channel.writer.mark_waiting();
  reader.leave();
  CHECK(channel.space != value);
  CHECK(Reader::ring_bell(channel.space));
}

TEST_CASE("no reader rings for a sender that never waits") {
  Channel channel(1, Policy::Overwrite);
  Reader reader = channel.join();
  std::uint64_t missed = 0;
  channel.publish(0, 1);
  channel.writer.mark_waiting();
  CHECK(reader.poll(missed) == 0);
  CHECK_FALSE(reader.done());
  CHECK_FALSE(reader.sender_waits());
}

// ---- eviction -----------------------------------------------------------------------------------

TEST_CASE("what was evicted counts as missed, and only for readers that have not read it") {
  for (const std::uint32_t depth : {1U, 3U, 4U}) {
    for (Word published = 1; published <= 2 * depth; ++published) {
      const Word held = std::min(Word{depth}, published);
      for (Word evicted = 1; evicted <= held; ++evicted) {
        CAPTURE(depth);
        CAPTURE(published);
        CAPTURE(evicted);
        Channel channel(depth, Policy::Overwrite);
        Reader unread = channel.join();
        Reader read = channel.join();
        for (Word block = 0; block < published; ++block) {
          channel.publish(block, block + 1);
          drain(read);
        }
        for (Word i = 0; i < evicted; ++i) {
          CHECK(channel.writer.evict_oldest() == published - held + i);
        }
        const Drained late = drain(unread);
        CHECK(late.blocks == blocks(published - held + evicted, published));
        CHECK(late.missed == published - held + evicted);
        CHECK(drain(read).missed == 0);
        Reader joiner = channel.join(depth);
        CHECK(drain(joiner).missed == evicted);
      }
    }
  }
}

TEST_CASE("the block of an evicted slot is not handed back a second time") {
  Channel channel(3, Policy::Overwrite);
  channel.publish(0, 3);
  CHECK(channel.writer.evict_oldest() == 0);
  CHECK(channel.writer.publish(3).replaced == kNoBlock);
  CHECK(channel.writer.publish(4).replaced == 1);
  for (const Word block : {2U, 3U, 4U}) CHECK(channel.writer.evict_oldest() == block);
  CHECK(channel.writer.evict_oldest() == kNoBlock);
}

TEST_CASE("a sleeper's mark survives an eviction") {
  Channel channel(2, Policy::Overwrite);
  channel.publish(0, 2);
  Reader reader = channel.join();
  const auto mark = reader.mark_sleeping();
  REQUIRE(mark.has_value());
  CHECK(channel.writer.evict_oldest() == 0);
  CHECK(reader.slot() != *mark);           // it will not fall asleep on the old word
  CHECK((reader.slot() & kSleeper) != 0);  // and if it sleeps already,
  CHECK(channel.writer.publish(2).wake);   // it is woken
  CHECK(drain(reader).blocks == Blocks{2});
}

TEST_CASE("of a lossless ring comes back what all have read, and nothing else") {
  for (const Word first : {Word{0}, kSequenceMask - 2}) {
    for (const std::uint32_t depth : {1U, 3U, 4U}) {
      for (Word read = 0; read <= depth; ++read) {
        CAPTURE(first);
        CAPTURE(depth);
        CAPTURE(read);
        Channel channel(depth, Policy::Blocking, 4, first);
        Reader ahead = channel.join();
        Reader behind = channel.join();
        channel.publish(0, depth);
        CHECK(channel.writer.read_slots() == 0);
        CHECK(channel.writer.evict_oldest() == kNoBlock);
        drain(ahead);
        std::uint64_t missed = 0;
        for (Word block = 0; block < read; ++block) {
          CHECK(behind.poll(missed) == block);
          behind.done();
        }
        CHECK(channel.writer.read_slots() == read);
        for (Word block = 0; block < read; ++block) CHECK(channel.writer.evict_oldest() == block);
        CHECK(channel.writer.evict_oldest() == kNoBlock);

        Reader late = channel.join(depth);
        const Drained past = drain(late);
        CHECK(past.blocks == blocks(std::max(read, Word{1}), depth));
        CHECK(past.missed == 0);
        const Drained rest = drain(behind);
        CHECK(rest.blocks == blocks(read, depth));
        CHECK(rest.missed == 0);

        for (Word block = depth; block < 2 * depth; ++block) {
          REQUIRE(channel.writer.room());
          CHECK(channel.writer.publish(block).replaced ==
                (block - depth < read ? kNoBlock : block - depth));
        }
        CHECK(drain(behind).blocks == blocks(depth, 2 * depth));
      }
    }
  }
}

TEST_CASE("what a reader looks at, or one that has not looked yet, does not come back") {
  Channel channel(3, Policy::Blocking);
  channel.await(0, kParticipant);
  channel.publish(0, 3);
  CHECK(channel.writer.evict_oldest() == kNoBlock);
  auto reader = Reader::take_awaited(channel.ring, kParticipant);
  REQUIRE(reader);
  std::uint64_t missed = 0;
  CHECK(reader->poll(missed) == 0);
  CHECK(channel.writer.evict_oldest() == kNoBlock);
  reader->done();
  CHECK(channel.writer.evict_oldest() == 0);
  CHECK(channel.writer.evict_oldest() == kNoBlock);
  reader->leave();
  CHECK(channel.writer.evict_oldest() == 1);
  CHECK(channel.writer.evict_oldest() == 2);
  CHECK(channel.writer.evict_oldest() == kNoBlock);
}

TEST_CASE("a reader that joins a lossless ring begins behind all that came back, without a gap") {
  const auto only = [](Word wanted) { return [wanted](Word block) { return block == wanted; }; };
  Channel channel(5, Policy::Blocking, 4, kSequenceMask - 2);
  channel.publish(0, 5);
  CHECK(channel.writer.evict_oldest(only(2)) == 2);
  Reader one = channel.join(4);
  CHECK(drain(one).blocks == Blocks{3, 4});
  CHECK(channel.writer.evict_oldest(only(0)) == 0);  // before what came back first
  Reader two = channel.join(Reader::kFromTheStart);
  CHECK(two.skipped() == 3);
  const Drained drained = drain(two);
  CHECK(drained.blocks == Blocks{3, 4});
  CHECK(drained.missed == 0);
  CHECK(channel.writer.evict_oldest(only(4)) == 4);
  Reader three = channel.join(4);
  CHECK(drain(three).blocks.empty());
  channel.publish(5, 6);
  CHECK(drain(three).blocks == Blocks{5});
  Reader four = channel.join(4);
  CHECK(drain(four).blocks == Blocks{5});
}

TEST_CASE("a reader that joins while its publisher looks for what to take back misses nothing") {
  Channel channel(4, Policy::Blocking);
  Reader ahead = channel.join();
  channel.publish(0, 4);
  drain(ahead);
  std::optional<Reader> joiner;
  const auto all_but_the_oldest = [&](Word block) {
    if (!joiner) joiner = channel.join(4);
    return block != 0;
  };
  CHECK(channel.writer.evict_oldest(all_but_the_oldest) == kNoBlock);
  REQUIRE(joiner);
  const Drained drained = drain(*joiner);
  CHECK(drained.blocks == blocks(1, 4));
  CHECK(drained.missed == 0);
}

TEST_CASE("what all have read is taken back, but for the newest, and readers miss nothing") {
  for (const Policy policy : {Policy::Overwrite, Policy::Blocking}) {
    for (const Word first : {Word{0}, kSequenceMask - 2}) {
      for (const std::uint32_t depth : {1U, 3U, 4U}) {
        for (Word read = 0; read <= depth; ++read) {
          for (std::uint32_t keep = 0; keep <= depth + 1; ++keep) {
            CAPTURE((policy == Policy::Blocking));
            CAPTURE(first);
            CAPTURE(depth);
            CAPTURE(read);
            CAPTURE(keep);
            Channel channel(depth, policy, 4, first);
            Reader ahead = channel.join();
            Reader behind = channel.join();
            channel.publish(0, depth);
            drain(ahead);
            std::uint64_t missed = 0;
            for (Word block = 0; block < read; ++block) {
              CHECK(behind.poll(missed) == block);
              behind.done();
            }
            const Word left = depth - std::min<Word>(keep, depth);
            const Word gone = std::min(read, left);
            CHECK(channel.take_back(keep) == blocks(0, gone));
            CHECK(channel.take_back(keep).empty());  // not a second time
            CHECK(channel.hazards().empty());

            Reader joiner = channel.join(depth);
            const Drained past = drain(joiner);
            const bool all = policy == Policy::Overwrite;  // else one less than the depth
            CHECK(past.blocks == blocks(std::max(gone, Word{all ? 0U : 1U}), depth));
            CHECK(past.missed == 0);
            const Drained rest = drain(behind);
            CHECK(rest.blocks == blocks(read, depth));
            CHECK(rest.missed == 0);

            // The next round goes on as ever.
            for (Word block = depth; block < 2 * depth; ++block) {
              REQUIRE(channel.writer.room());
              CHECK(channel.writer.publish(block).replaced ==
                    (block - depth < gone ? kNoBlock : block - depth));
            }
            const Drained next = drain(behind);
            CHECK(next.blocks == blocks(depth, 2 * depth));
            CHECK(next.missed == 0);
          }
        }
      }
    }
  }
}

TEST_CASE("what is taken back stops at the first that a reader, or one to come, has to read") {
  Channel channel(4, Policy::Overwrite);
  channel.await(0, kParticipant);
  Reader reader = channel.join();
  channel.publish(0, 3);
  drain(reader);
  CHECK(channel.take_back(0).empty());  // one has subscribed that has not looked
  auto late = Reader::take_awaited(channel.ring, kParticipant);
  REQUIRE(late);
  std::uint64_t missed = 0;
  CHECK(late->poll(missed) == 0);
  CHECK(channel.take_back(0).empty());  // it looks at the first
  late->done();
  CHECK(channel.take_back(0) == Blocks{0});
  CHECK(late->poll(missed) == 1);
  CHECK(channel.take_back(0).empty());
  late->leave();
  CHECK(channel.take_back(1) == Blocks{1});
  CHECK(channel.take_back(0) == Blocks{2});
  reader.leave();
  channel.publish(3, 5);
  CHECK(channel.take_back(0) == Blocks{3, 4});  // no reader is there
  CHECK(missed == 0);
}

TEST_CASE("a reader that was lapped keeps all that the ring has for it") {
  Channel channel(3, Policy::Overwrite);
  Reader reader = channel.join();
  channel.publish(0, 8);
  CHECK(channel.take_back(0).empty());
  const Drained drained = drain(reader);
  CHECK(drained.blocks == Blocks{5, 6, 7});
  CHECK(drained.missed == 5);
}

TEST_CASE("what is to be taken by one reader is not taken back") {
  Channel channel(3, Policy::Overwrite);
  channel.ring.taken = true;
  channel.writer = lot::ring::Writer<HardwareAtomics>(channel.ring);
  channel.publish(0, 2);
  CHECK(channel.take_back(0).empty());
}

TEST_CASE("a lossless ring whose messages are taken gives none of them up") {
  Channel channel(3, Policy::Blocking);
  channel.ring.taken = true;
  channel.writer = lot::ring::Writer<HardwareAtomics>(channel.ring);
  channel.publish(0, 2);
  CHECK(channel.writer.read_slots() == 0);
  CHECK(channel.writer.evict_oldest() == kNoBlock);
}

// ---- sleeping -----------------------------------------------------------------------------------

TEST_CASE("a sleeper's mark is seen by the next publish and by no other") {
  for (const std::uint32_t depth : {1U, 3U}) {
    Channel channel(depth, Policy::Overwrite);
    Reader one = channel.join();
    Reader two = channel.join();
    for (Word block = 0; block < 10; ++block) {
      bool left_before = true;
      const auto mark = one.mark_sleeping(left_before);
      REQUIRE(mark.has_value());
      CHECK_FALSE(left_before);
      CHECK((*mark & kSleeper) != 0);
      CHECK(*mark == one.slot());
      bool stood = false;
      CHECK(two.mark_sleeping(stood) == mark);  // two may sleep on one mark
      CHECK(stood);
      CHECK_FALSE(one.ready());
      const auto published = channel.writer.publish(block);
      CHECK(published.wake);
      CHECK(published.slot == &one.slot());
      // The futex is the low half: it has changed, whatever the block.
      CHECK(static_cast<std::uint32_t>(*mark) !=
            static_cast<std::uint32_t>(published.slot->load()));
      CHECK(drain(one).blocks == Blocks{block});
      CHECK(drain(two).blocks == Blocks{block});
      ++block;
      CHECK_FALSE(channel.writer.publish(block).wake);
      CHECK(drain(one).blocks == Blocks{block});
      CHECK(drain(two).blocks == Blocks{block});
    }
  }
}

TEST_CASE("no reader sleeps while there is something to look at") {
  Channel channel(2, Policy::Overwrite);
  Reader reader = channel.join();
  channel.publish(0, 1);
  CHECK_FALSE(reader.mark_sleeping().has_value());
  channel.publish(1, 9);
  CHECK_FALSE(reader.mark_sleeping().has_value());  // lapped
  drain(reader);
  CHECK(reader.mark_sleeping().has_value());
}

TEST_CASE("a mark does not hide the message that its slot still holds") {
  Channel channel(1, Policy::Overwrite);
  Reader first = channel.join();
  Reader second = channel.join();
  channel.publish(5, 6);
  CHECK(drain(first).blocks == Blocks{5});
  CHECK(first.mark_sleeping().has_value());
  CHECK(second.ready());
  CHECK(second.peek(0) == 5);
  std::uint64_t missed = 0;
  CHECK(second.poll(missed) == 5);
  CHECK(channel.hazards() == Blocks{5});
  const auto published = channel.writer.publish(6);
  CHECK(published.wake);
  CHECK(published.replaced == 5);
}

TEST_CASE("clearing the marks changes the word that a sleeper waits on") {
  Channel channel(3, Policy::Overwrite);
  Reader reader = channel.join();
  const auto mark = reader.mark_sleeping();
  REQUIRE(mark.has_value());
  channel.ring.clear_sleepers();
  CHECK(reader.slot() == lot::ring::next_round(*mark));
  CHECK_FALSE(channel.writer.publish(0).wake);
}

TEST_CASE("a new ring wakes those that sleep in the other rings of its topic, and for a ring") {
  Channel one(2, Policy::Overwrite);
  Channel two(2, Policy::Overwrite);
  one.ring.channel = 4;
  two.ring.channel = 9;
  Reader reader = two.join();
  Reader awake = one.join();
  const auto mark = reader.mark_sleeping();
  REQUIRE(mark.has_value());
  const Word before = awake.slot();
  lot::ring::DirectoryVersion<HardwareAtomics> directory;
  std::vector<const void*> woken;
  std::vector<std::uint32_t> ears;
  lot::ring::announce(
      directory, std::vector{one.ring, two.ring}, [&](auto& word) { woken.push_back(&word); },
      [&](std::uint32_t channel) { ears.push_back(channel); });
  CHECK(directory.load() == 1);
  CHECK(woken == std::vector<const void*>{&reader.slot(), &directory.word()});
  CHECK(ears == std::vector<std::uint32_t>{4, 9});
  CHECK(reader.slot() == lot::ring::next_round(*mark));
  CHECK(awake.slot() == before);
}

// ---- the end ------------------------------------------------------------------------------------

TEST_CASE("a ring ends when its publisher has gone and everything was read, not before") {
  Channel channel(2, Policy::Overwrite);
  Reader reader = channel.join();
  CHECK_FALSE(reader.ended());
  channel.publish(0, 2);
  CHECK_FALSE(reader.ended());
  channel.become(State::Orphan);
  CHECK(reader.orphaned());
  CHECK_FALSE(reader.ended());
  std::uint64_t missed = 0;
  CHECK(reader.poll(missed) == 0);
  CHECK_FALSE(reader.ended());
  reader.done();
  CHECK_FALSE(reader.ended());
  CHECK(reader.poll(missed) == 1);
  reader.done();
  CHECK(reader.ended());
  CHECK(reader.poll(missed) == kNoBlock);
  CHECK(missed == 0);
}

TEST_CASE("a reader that has read everything is not at the end while the publisher lives") {
  Channel channel(2, Policy::Blocking);
  Reader reader = channel.join();
  channel.publish(0, 1);
  drain(reader);
  CHECK_FALSE(reader.ended());
  CHECK_FALSE(reader.orphaned());
  channel.become(State::Orphan);
  CHECK(reader.ended());
}

TEST_CASE("a lapped reader is not at the end until it has read what is left") {
  Channel channel(2, Policy::Overwrite);
  Reader reader = channel.join();
  channel.publish(0, 7);
  channel.become(State::Orphan);
  CHECK_FALSE(reader.ended());
  CHECK(drain(reader).blocks == Blocks{5, 6});
  CHECK(reader.ended());
}

// ---- the wrap -----------------------------------------------------------------------------------

TEST_CASE("sequences that wrap at 2^42 change nothing") {
  for (const Policy policy : {Policy::Overwrite, Policy::Blocking}) {
    for (const std::uint32_t depth : {1U, 3U, 4U, 7U}) {
      for (Word before = 0; before <= 2 * depth; ++before) {
        CAPTURE(depth);
        CAPTURE(before);
        // `before` more messages fit below the limit; sequence 0 is the one after the last of them.
        Channel channel(depth, policy, 3, (kSequenceMask + 1 - before) & kSequenceMask);
        Reader reader = channel.join();
        for (Word block = 0; block < 4 * depth; ++block) {
          const auto mark = reader.mark_sleeping();
          REQUIRE(mark.has_value());
          REQUIRE(channel.writer.room());
          CHECK(channel.writer.publish(block).wake);
          CHECK(drain(reader).blocks == Blocks{block});
        }
        CHECK(channel.writer.next_sequence() == lot::ring::advance(channel.ring.first, 4 * depth));
      }
    }
  }
}

TEST_CASE("missed messages and history are counted across the wrap") {
  for (const std::uint32_t depth : {1U, 3U, 4U}) {
    for (Word before = 0; before <= 3 * depth; ++before) {
      CAPTURE(depth);
      CAPTURE(before);
      Channel channel(depth, Policy::Overwrite, 3, (kSequenceMask + 1 - before) & kSequenceMask);
      Reader lapped = channel.join();
      channel.publish(0, 3 * depth);
      Reader late = channel.join(Reader::kFromTheStart);
      Reader recent = channel.join(depth);
      const Blocks kept = blocks(2 * depth, 3 * depth);
      const std::pair<Reader*, Word> expected[] = {
          {&lapped, 2 * depth}, {&late, 2 * depth}, {&recent, 0}};
      for (const auto& [reader, missed] : expected) {
        const Drained drained = drain(*reader);
        CHECK(drained.blocks == kept);
        CHECK(drained.missed == missed);
      }
    }
  }
}

TEST_CASE("back-pressure holds across the wrap") {
  for (Word before = 0; before <= 6; ++before) {
    CAPTURE(before);
    Channel channel(3, Policy::Blocking, 3, (kSequenceMask + 1 - before) & kSequenceMask);
    Reader reader = channel.join();
    for (Word block = 0; block < 9; block += 3) {
      channel.publish(block, block + 3);
      CHECK_FALSE(channel.writer.room());
      CHECK(channel.laggards().size() == 1);
      CHECK(drain(reader).blocks == blocks(block, block + 3));
    }
  }
}

// ---- between two steps
// -----------------------------------------------------------------------------

namespace {

/// Runs once, in the middle of a ring operation, when the given word is reached.
struct Interruption {
  const void* at = nullptr;
  std::function<void()> act = {};
};
Interruption interruption;

void reached(const void* word) {
  if (word != interruption.at) return;
  interruption.at = nullptr;
  interruption.act();
}

/// An atomic that can be interrupted after a store or an addition and before a compare-and-swap.
template <class T>
struct InterruptedAtomic : std::atomic<T> {
  using std::atomic<T>::atomic;
  using std::atomic<T>::operator=;

  void store(T value, std::memory_order order) {
    std::atomic<T>::store(value, order);
    reached(this);
  }
  T fetch_add(T value, std::memory_order order) {
    const T before = std::atomic<T>::fetch_add(value, order);
    reached(this);
    return before;
  }
  bool compare_exchange_strong(T& expected, T desired, std::memory_order success,
                               std::memory_order failure) {
    reached(this);
    return std::atomic<T>::compare_exchange_strong(expected, desired, success, failure);
  }
};

struct InterruptedAtomics : HardwareAtomics {
  template <class T>
  using Atomic = InterruptedAtomic<T>;
};

using InterruptedChannel = BasicChannel<InterruptedAtomics>;

}  // namespace

TEST_CASE("a message that is overwritten between a reader's look and its hazard is not borrowed") {
  InterruptedChannel channel(1, Policy::Overwrite);
  auto reader = channel.join();
  channel.publish(1, 2);
  interruption = {&channel.cells[reader.cell()].position, [&] {
                    CHECK(channel.hazards() == Blocks{1});
                    channel.publish(2, 3);
                  }};
  std::uint64_t missed = 0;
  CHECK(reader.poll(missed) == 2);
  CHECK(missed == 1);
  CHECK(channel.hazards() == Blocks{2});
  CHECK(interruption.at == nullptr);
}

TEST_CASE("a message that is evicted between a reader's look and its hazard is not borrowed") {
  InterruptedChannel channel(2, Policy::Overwrite);
  auto reader = channel.join();
  channel.publish(1, 2);
  interruption = {&channel.cells[reader.cell()].position,
                  [&] { CHECK(channel.writer.evict_oldest() == 1); }};
  std::uint64_t missed = 0;
  CHECK(reader.poll(missed) == kNoBlock);
  CHECK(missed == 1);
  CHECK(channel.hazards().empty());
  CHECK(interruption.at == nullptr);
}

TEST_CASE("a joiner that is overtaken begins where the sender has put it, and misses nothing") {
  for (const Word first : {Word{0}, kSequenceMask - 5}) {
    for (const std::uint32_t depth : {1U, 3U, 4U}) {
      for (const std::uint64_t history : {std::uint64_t{0}, std::uint64_t{2}}) {
        for (std::uint32_t before = 0; before < 2 * depth + 1; ++before) {
          InterruptedChannel channel(depth, Policy::Blocking, 3, first);
          channel.publish(0, before);
          std::uint32_t sent = before;
          interruption = {&channel.roster, [&] {
                            while (channel.writer.room()) {
                              channel.publish(sent, sent + 1);
                              ++sent;
                            }
                          }};
          auto reader = channel.join(history);
          CHECK(interruption.at == nullptr);
          const auto begin = static_cast<std::uint32_t>(
              before - std::min<std::uint64_t>({history, depth - 1, before}));
          CHECK(drain(reader).blocks == blocks(begin, sent));
          CHECK(sent == begin + depth);
        }
      }
    }
  }
}

TEST_CASE("what comes back while a reader joins is not what it gets, at each step") {
  for (const Word first : {Word{0}, kSequenceMask - 5}) {
    for (const std::uint64_t history : {std::uint64_t{0}, std::uint64_t{2}, std::uint64_t{9}}) {
      for (int step = 0; step < 3; ++step) {
        CAPTURE(history);
        CAPTURE(step);
        InterruptedChannel channel(4, Policy::Blocking, 3, first);
        channel.publish(0, 4);
        Blocks back;
        const auto take_back = [&] {
          for (Word block; (block = channel.writer.evict_oldest()) != kNoBlock;) {
            back.push_back(block);
          }
        };
        auto& position = channel.cells[0].position;
        switch (step) {
          case 0:  // it has told its wish, and nobody has seen it
            interruption = {&position, take_back};
            break;
          case 1:  // it is on the roster, and gets a place
            interruption = {&channel.roster, take_back};
            break;
          default:  // it has found one itself
            interruption = {&position, [&] { interruption = {&position, take_back}; }};
        }
        auto reader = channel.join(history);
        CHECK(interruption.at == nullptr);
        take_back();
        const Drained drained = drain(reader);
        CHECK(drained.missed == 0);
        Blocks all = back;
        all.insert(all.end(), drained.blocks.begin(), drained.blocks.end());
        CHECK(all == blocks(0, 4));
        if (step != 0) CHECK(drained.blocks.size() == std::min<std::size_t>(history, 3));
      }
    }
  }
}

TEST_CASE("a reader that joins behind the floor's step keeps no message from coming back") {
  InterruptedChannel channel(4, Policy::Blocking);
  channel.publish(0, 4);
  std::optional<BasicChannel<InterruptedAtomics>::Reader> joiner;
  interruption = {&channel.floor, [&] { joiner = channel.join(9); }};
  CHECK(channel.writer.evict_oldest() == 0);
  REQUIRE(joiner);
  CHECK(drain(*joiner).blocks == Blocks{1, 2, 3});
}

TEST_CASE("a message that comes while a reader marks its slot is not slept through") {
  InterruptedChannel channel(2, Policy::Overwrite);
  auto reader = channel.join();
  interruption = {&reader.slot(), [&] { channel.publish(7, 8); }};
  CHECK_FALSE(reader.mark_sleeping().has_value());
  CHECK(interruption.at == nullptr);
  CHECK((reader.slot() & kSleeper) == 0);
  std::uint64_t missed = 0;
  CHECK(reader.poll(missed) == 7);
}

// ---- oracles ------------------------------------------------------------------------------------

TEST_CASE("random operations agree with a deque") {
  const std::uint32_t seed = std::random_device{}();
  MESSAGE("seed " << seed);
  std::mt19937 random(seed);
  auto below = [&](std::uint32_t n) { return static_cast<std::uint32_t>(random() % n); };

  for (int round = 0; round < 300; ++round) {
    const std::uint32_t depth = 1 + below(9);
    const Policy policy = below(2) == 0 ? Policy::Overwrite : Policy::Blocking;
    const Word first = below(2) == 0 ? 0 : kSequenceMask - below(40);
    CAPTURE(seed);
    CAPTURE(round);
    CAPTURE(depth);
    CAPTURE((policy == Policy::Blocking));
    Channel channel(depth, policy, 3, first);

    std::deque<std::optional<Word>> kept;  // the newest messages, oldest first; empty: evicted
    Word published = 0;
    Word floor = 0;  // of a lossless ring: index behind what has come back
    struct Model {
      Reader reader;
      Word next;  // index of the message that it reads next
    };
    std::vector<Model> readers;

    for (int step = 0; step < 300; ++step) {
      switch (below(8)) {
        case 0:
        case 1:
        case 2: {
          bool room = true;
          for (const Model& model : readers) room = room && published - model.next < depth;
          REQUIRE(channel.writer.room() == (policy == Policy::Overwrite || room));
          if (!channel.writer.room()) break;
          std::optional<Word> replaced;
          if (kept.size() == depth) {
            replaced = kept.front();
            kept.pop_front();
          }
          REQUIRE(channel.writer.publish(published).replaced == replaced.value_or(kNoBlock));
          kept.emplace_back(published++);
          break;
        }
        case 3:
        case 4:
        case 5: {
          if (readers.empty()) break;
          Model& model = readers[below(static_cast<std::uint32_t>(readers.size()))];
          std::uint64_t missed = 0;
          const Word block = model.reader.poll(missed);
          const Word oldest = published - kept.size();
          const Word before = model.next;
          model.next = std::max(model.next, oldest);
          while (model.next < published && !kept[model.next - oldest]) ++model.next;
          REQUIRE(missed == model.next - before);
          if (model.next == published) {
            REQUIRE(block == kNoBlock);
          } else {
            REQUIRE(block == *kept[model.next - oldest]);
            model.reader.done();
            ++model.next;
          }
          break;
        }
        case 6: {
          Word expected = kNoBlock;
          for (auto& message : kept) {
            if (!message) continue;
            bool goes = true;
            for (const Model& m : readers) {
              goes = goes && (policy == Policy::Overwrite || m.next > *message);
            }
            if (!goes) break;  // back-pressure does not lose messages
            expected = *message;
            if (policy == Policy::Blocking) floor = expected + 1;
            message.reset();
            break;
          }
          REQUIRE(channel.writer.evict_oldest() == expected);
          break;
        }
        case 7: {
          if (readers.size() == 3 || (!readers.empty() && below(3) == 0)) {
            const std::uint32_t i = below(static_cast<std::uint32_t>(readers.size()));
            readers[i].reader.leave();
            readers.erase(readers.begin() + i);
            break;
          }
          const std::uint64_t history = below(4) == 0 ? Reader::kFromTheStart : below(depth + 3);
          Word back = policy == Policy::Blocking ? depth - 1 : depth;
          if (history == Reader::kFromTheStart && policy == Policy::Overwrite) back = published;
          back = std::min({back, Word{history}, published - floor});
          readers.push_back({channel.join(history), published - back});
          break;
        }
        default:
          break;
      }
    }
  }
}

TEST_CASE("a ring that was lapped gives up all that is taken of it") {
  Channel channel(3, Policy::Overwrite);
  channel.ring.taken = true;
  channel.writer = lot::ring::Writer<HardwareAtomics>(channel.ring);
  Reader reader = channel.join();
  std::uint64_t missed = 0;
  const auto take_all = [&] {
    while (reader.poll(missed) != kNoBlock) {
      CHECK(reader.take());
      reader.done();
    }
  };
  const auto given_up = [&] {
    std::vector<Word> blocks;
    channel.writer.each_taken([&](Word block) { blocks.push_back(block); });
    return blocks;
  };
  channel.publish(0, 5);  // laps the first two
  take_all();
  CHECK(given_up() == std::vector<Word>{2, 3, 4});
  channel.publish(5, 6);
  take_all();
  CHECK(given_up() == std::vector<Word>{5});
  CHECK(missed == 0);
}

TEST_CASE("one reader under back-pressure behaves like boost's queue") {
  const std::uint32_t seed = std::random_device{}();
  MESSAGE("seed " << seed);
  std::mt19937 random(seed);
  for (std::uint32_t depth = 1; depth <= 9; ++depth) {
    CAPTURE(seed);
    CAPTURE(depth);
    Channel channel(depth, Policy::Blocking, 1, kSequenceMask - 500);
    Reader reader = channel.join();
    boost::lockfree::spsc_queue<Word> oracle(depth);
    std::uint64_t missed = 0;
    for (Word block = 0; block < 2000; ++block) {
      if (random() % 2 == 0) {
        const bool room = channel.writer.room();
        REQUIRE(oracle.push(block) == room);
        if (room) channel.writer.publish(block);
      } else {
        Word expected = kNoBlock;
        const bool any = oracle.pop(expected);
        const Word got = reader.poll(missed);
        REQUIRE(got == expected);
        if (any) reader.done();
      }
    }
    CHECK(missed == 0);
  }
}

TEST_SUITE_END();
