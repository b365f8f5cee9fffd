// SPDX-License-Identifier: Apache-2.0
// The ring and the ownership of blocks under real threads. Payloads are plain memory: where the
// protection fails, ThreadSanitizer sees a race, and without it a checksum is wrong.
//
// Sleeps have no deadline: a lost wake hangs, and the watchdog ends the test.

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <random>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/atomics.hpp"
#include "lot/detail/hold_word.hpp"

#include "futex/futex.hpp"
#include "lockfree_ring/ring.hpp"
#include "refcount/ownership.hpp"

namespace {

using lot::detail::HardwareAtomics;
namespace futex = lot::futex;
namespace hold = lot::detail::hold;
using lot::ring::kNoBlock;
using lot::ring::Word;
using Ring = lot::ring::Ring<HardwareAtomics>;
using Cell = lot::ring::Cell<HardwareAtomics>;
using Writer = lot::ring::Writer<HardwareAtomics>;
using Reader = lot::ring::Reader<HardwareAtomics>;
using lot::refcount::Left;
using Ownership = lot::refcount::Ownership<HardwareAtomics>;

struct Watchdog {  // beside others that compute, each yield() costs a slice of theirs
  Watchdog() { alarm(300); }
  ~Watchdog() { alarm(0); }
};

std::uint32_t new_seed() {
  const std::uint32_t seed = std::random_device{}();
  MESSAGE("seed " << seed);
  return seed;
}

/// A message that says which one it is, in every word.
struct Payload {
  void write(std::uint64_t index) {
    for (std::uint64_t i = 0; i < words.size(); ++i) words[i] = index * 0x9e3779b97f4a7c15 + i;
    sum = index;
  }
  bool is(std::uint64_t index) const {
    bool good = sum == index;
    for (std::uint64_t i = 0; i < words.size(); ++i) {
      good = good && words[i] == index * 0x9e3779b97f4a7c15 + i;
    }
    return good;
  }

  std::array<std::uint64_t, 15> words{};
  std::uint64_t sum = 0;
};

constexpr std::uint32_t kReaders = 3;

/// A live ring and as few blocks as will do: one per slot, per reader's hazard, and to write into.
struct Channel {
  Channel(std::uint32_t depth, bool blocking)
      : slots(depth), cells(kReaders), who(kReaders), blocks(depth + kReaders + 1) {
    ring.writer = &writer_word;
    ring.slots = slots.data();
    ring.cells = cells.data();
    ring.who = who.data();
    ring.roster = &roster;
    ring.space = &space;
    ring.floor = &floor;
    ring.depth = depth;
    ring.readers = kReaders;
    ring.blocking = blocking;
    ring.first = lot::ring::kSequenceMask - 1000;  // wraps on the way
    ring.format();
    writer_word.go_live(1, 1);
  }

  std::optional<Reader> join(std::uint64_t history) {
    bool full = false;
    return Reader::join(ring, 1, 1, history, full);
  }

  /// What the reaper does for a publisher that has gone.
  void end() {
    writer_word.end(1, 1);
    ring.clear_sleepers();
    for (const auto& slot : slots) futex::wake_all(futex::low_half(slot));
  }

  std::uint64_t index_of(Word sequence) const {
    return static_cast<std::uint64_t>(lot::ring::distance(sequence, ring.first));
  }

  lot::ring::WriterWord<lot::detail::HardwareAtomics> writer_word;
  std::vector<std::atomic<Word>> slots;
  std::vector<Cell> cells;
  std::vector<std::atomic<std::uint32_t>> who;
  std::atomic<std::uint32_t> roster{0};
  std::atomic<std::uint32_t> space{0};
  std::atomic<Word> floor{0};
  std::vector<Payload> blocks;
  Ring ring;
};

void wake_sender(Channel& channel) {
  if (Reader::ring_bell(channel.space)) futex::wake_all(&channel.space);
}

/// What one reader has seen; written by its thread, read after the join.
struct Seen {
  std::uint64_t got = 0;
  std::uint64_t missed = 0;
  std::uint64_t wrong = 0;
  std::uint64_t end = 0;  ///< index of the message that it would have read next
};

/// Reads and checks until the ring has ended. After about every `stay` messages, when that is not
/// 0, it leaves and joins again.
Seen read_all(Channel& channel, Reader reader, std::uint32_t seed, std::uint32_t stay) {
  Seen seen;
  std::mt19937 random(seed);
  for (;;) {
    const std::uint64_t before = channel.index_of(reader.cursor());
    std::uint64_t missed = 0;
    const Word block = reader.poll(missed);
    seen.missed += missed;
    if (block != kNoBlock) {
      if (!channel.blocks[block].is(before + missed)) ++seen.wrong;
      ++seen.got;
      if (random() % 64 == 0) std::this_thread::yield();  // hold it while the writer goes on
      if (!channel.blocks[block].is(before + missed)) ++seen.wrong;
      if (reader.done()) wake_sender(channel);
      if (stay != 0 && random() % stay == 0) {
        seen.end = channel.index_of(reader.cursor());
        reader.leave();
        futex::wake_all(&channel.space);
        const auto again = channel.join(random() % (channel.ring.depth + 2));
        if (!again) return seen;  // the publisher has gone
        reader = *again;
      }
      continue;
    }
    if (reader.sender_waits()) wake_sender(channel);
    const auto mark = reader.mark_sleeping();
    if (!mark) continue;
    if (reader.ended()) break;
    futex::wait(futex::low_half(reader.slot()), static_cast<std::uint32_t>(*mark), std::nullopt);
  }
  seen.end = channel.index_of(reader.cursor());
  return seen;
}

/// The sender under overwrite: writes into whatever block nobody can be looking at.
class Overwriter {
 public:
  explicit Overwriter(Channel& channel) : channel_(channel), writer_(channel.ring) {
    for (Word block = 0; block < channel.blocks.size(); ++block) free_.push_back(block);
  }

  void publish(std::uint64_t index) {
    while (free_.empty()) collect();
    const Word block = free_.back();
    free_.pop_back();
    channel_.blocks[block].write(index);
    const auto published = writer_.publish(block);
    if (published.wake) futex::wake_all(futex::low_half(*published.slot));
    retire(published.replaced);
  }

  void evict() { retire(writer_.evict_oldest()); }

 private:
  void retire(Word block) {
    if (block != kNoBlock) retired_.push_back(block);
  }

  void collect() {
    std::vector<bool> borrowed(channel_.blocks.size());
    writer_.hazards([&](Word block) { borrowed[block] = true; });
    std::vector<Word> kept;
    for (const Word block : retired_) (borrowed[block] ? kept : free_).push_back(block);
    retired_ = kept;
  }

  Channel& channel_;
  Writer writer_;
  std::vector<Word> free_;
  std::vector<Word> retired_;
};

/// Starts one reader per seat, runs `send`, ends the ring, and returns what the readers saw.
std::vector<Seen> run(Channel& channel, std::uint32_t seed,
                      const std::array<std::uint32_t, kReaders>& stays,
                      const std::function<void()>& send) {
  std::vector<Seen> seen(kReaders);
  std::vector<std::thread> threads;
  for (std::uint32_t i = 0; i < kReaders; ++i) {
    const auto reader = channel.join(0);  // here, so that nobody comes after the first message
    REQUIRE(reader.has_value());
    threads.emplace_back([&channel, &seen, reader, seed, i, stay = stays[i]] {
      seen[i] = read_all(channel, *reader, seed + i, stay);
    });
  }
  send();
  channel.end();
  for (auto& thread : threads) thread.join();
  return seen;
}

}  // namespace

TEST_SUITE_BEGIN("stress");

TEST_CASE("a borrowed message is never overwritten, and what is missed is counted exactly") {
  Watchdog watchdog;
  const std::uint32_t seed = new_seed();
  const std::uint64_t messages = 150000;
  for (const std::uint32_t depth : {1U, 3U, 8U}) {
    CAPTURE(seed);
    CAPTURE(depth);
    Channel channel(depth, false);
    const auto seen = run(channel, seed, {0, 0, 50}, [&] {
      std::mt19937 random(seed ^ depth);
      Overwriter sender(channel);
      for (std::uint64_t i = 0; i < messages; ++i) {
        sender.publish(i);
        if (random() % 50 == 0) sender.evict();
        if (random() % 16 == 0) std::this_thread::yield();
      }
    });
    for (std::uint32_t i = 0; i < kReaders; ++i) {
      CAPTURE(i);
      CHECK(seen[i].wrong == 0);
      CHECK(seen[i].got > 0);
      if (i == 2) continue;  // came and went
      CHECK(seen[i].end == messages);
      CHECK(seen[i].got + seen[i].missed == messages);
    }
  }
}

TEST_CASE("under back-pressure every reader gets every message, and none sleeps for ever") {
  Watchdog watchdog;
  const std::uint32_t seed = new_seed();
  const std::uint64_t messages = 40000;
  for (const std::uint32_t depth : {1U, 3U, 8U}) {
    CAPTURE(seed);
    CAPTURE(depth);
    Channel channel(depth, true);
    const auto seen = run(channel, seed, {0, 0, 50}, [&] {
      Writer writer(channel.ring);
      Word block = depth;  // slot i begins with nothing; then blocks go round
      for (std::uint64_t i = 0; i < messages; ++i) {
        while (!writer.room()) {
          const std::uint32_t value = writer.mark_waiting();
          if (!writer.room()) futex::wait(&channel.space, value, std::nullopt);
        }
        channel.blocks[block].write(i);
        const auto published = writer.publish(block);
        if (published.wake) futex::wake_all(futex::low_half(*published.slot));
        block = published.replaced != kNoBlock ? published.replaced : i;
      }
    });
    for (std::uint32_t i = 0; i < kReaders; ++i) {
      CAPTURE(i);
      CHECK(seen[i].wrong == 0);
      CHECK(seen[i].missed == 0);
      if (i == 2) continue;  // came and went
      CHECK(seen[i].got == messages);
    }
  }
}

TEST_CASE("a lossless sender takes back only what all have read, and no reader misses any") {
  Watchdog watchdog;
  const std::uint32_t seed = new_seed();
  const std::uint64_t messages = 40000;
  for (const std::uint32_t depth : {1U, 3U, 8U}) {
    CAPTURE(seed);
    CAPTURE(depth);
    Channel channel(depth, true);
    std::uint64_t came_back = 0;
    const auto seen = run(channel, seed, {0, 20, 50}, [&] {
      std::mt19937 random(seed ^ depth);
      Writer writer(channel.ring);
      std::vector<Word> free;
      for (Word block = 0; block < channel.blocks.size(); ++block) free.push_back(block);
      for (std::uint64_t i = 0; i < messages; ++i) {
        while (!writer.room()) {
          const std::uint32_t value = writer.mark_waiting();
          if (!writer.room()) futex::wait(&channel.space, value, std::nullopt);
        }
        while (random() % 2 == 0) {
          const Word block = writer.evict_oldest();
          if (block == kNoBlock) break;
          free.push_back(block);
          ++came_back;
        }
        const Word block = free.back();  // what came back last is written first
        free.pop_back();
        channel.blocks[block].write(i);
        const auto published = writer.publish(block);
        if (published.wake) futex::wake_all(futex::low_half(*published.slot));
        if (published.replaced != kNoBlock) free.push_back(published.replaced);
      }
    });
    CHECK(came_back > 0);
    for (std::uint32_t i = 0; i < kReaders; ++i) {
      CAPTURE(i);
      CHECK(seen[i].wrong == 0);
      CHECK(seen[i].missed == 0);
      if (i == 0) CHECK(seen[i].got == messages);
    }
  }
}

namespace {

/// One block that four threads of two processes hold, lock weakly, let die and write anew.
class Family {
 public:
  Family(std::uint32_t deaths, std::uint32_t give_back_every)
      : deaths_(deaths), give_back_every_(give_back_every) {}

  struct Process {
    Ownership own;
    Ownership::Hold word{};
  };

  void work(Process& me, std::uint32_t seed) {
    std::mt19937 random(seed);
    while (died_ < deaths_) {
      if (random() % 2 != 0) {  // else somebody would hold it all the time, and it would not die
        std::this_thread::yield();
        continue;
      }
      const std::uint64_t ticket = ticket_.load(std::memory_order_acquire);
      const auto generation = static_cast<std::uint32_t>(ticket);
      if (ticket != kNothing && me.own.acquire_weak(words_, me.word, generation) == Left::Held) {
        if (!payload_.is(generation)) ++wrong_;
        if (random() % 2 == 0) {  // a copy; we hold the block, so this needs no protection
          me.own.acquire(words_, me.word, hold::kPointer);
          if (random() % 8 == 0) std::this_thread::yield();
          release(me, random);
        }
        if (!payload_.is(generation)) ++wrong_;
        ++locked_;
        release(me, random);
      } else if (me.own.claim(words_, me.word)) {
        write(me);
        release(me, random);
      } else {
        std::this_thread::yield();
      }
    }
  }

  std::uint64_t wrong() const { return wrong_; }
  std::uint64_t locked() const { return locked_; }

 private:
  static constexpr std::uint64_t kNothing = ~std::uint64_t{0};

  /// REQUIRES: the block is exclusively ours.
  void write(Process& me) {
    if (writers_.fetch_add(1) != 0) ++wrong_;
    const auto generation = lot::refcount::generation_of(words_.life.load());
    if ((words_.home.load() != me.own.self + 1)) ++wrong_;
    payload_.write(generation);
    if (writers_.fetch_sub(1) != 1) ++wrong_;
    ticket_.store(generation, std::memory_order_release);
  }

  /// Lets go of one pointer; if that was the last, the block is written anew or given back.
  void release(Process& me, std::mt19937& random) {
    while (me.own.release(words_, me.word, hold::kPointer) == Left::Home && died_ < deaths_) {
      if (random() % 8 == 0) std::this_thread::yield();  // others may lock it before we reclaim
      if (!me.own.reclaim(words_, me.word, 0)) return;
      ++died_;
      if (give_back_every_ != 0 && random() % give_back_every_ == 0) {
        me.own.give_back(words_, me.word);
        return;
      }
      write(me);
      while (random() % 4 != 0) std::this_thread::yield();  // time to be locked
    }
  }

  const std::uint32_t deaths_;
  const std::uint32_t give_back_every_;
  lot::refcount::BlockWords<HardwareAtomics> words_{};
  Payload payload_;
  std::atomic<std::uint64_t> ticket_{kNothing};  ///< generation of the message that may be locked
  std::atomic<std::uint32_t> died_{0};
  std::atomic<std::uint32_t> writers_{0};
  std::atomic<std::uint64_t> wrong_{0};
  std::atomic<std::uint64_t> locked_{0};
};

void run_family(Family& family, std::uint32_t seed) {
  Family::Process processes[] = {{Ownership{1}}, {Ownership{70}}};
  std::vector<std::thread> threads;
  for (std::uint32_t i = 0; i < 4; ++i) {
    threads.emplace_back([&family, &me = processes[i / 2], seed, i] { family.work(me, seed + i); });
  }
  for (auto& thread : threads) thread.join();
}

}  // namespace

TEST_CASE("a message never changes while a thread holds it, whichever ones lock, copy and let go") {
  Watchdog watchdog;
  const std::uint32_t seed = new_seed();
  Family family(100000, 0);
  run_family(family, seed);
  CHECK(family.wrong() == 0);
  CHECK(family.locked() > 0);
}

TEST_CASE("a block that goes from process to process has one owner at a time") {
  Watchdog watchdog;
  const std::uint32_t seed = new_seed();
  Family family(100000, 3);
  run_family(family, seed);
  CHECK(family.wrong() == 0);
  CHECK(family.locked() > 0);
}

TEST_SUITE_END();
