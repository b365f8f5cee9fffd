// SPDX-License-Identifier: Apache-2.0
// Ownership in one thread: who holds a block, when its message dies, and who gets its memory then.
// What threads do to it is in tests/proof/stress/threads_test.cpp.

#include <atomic>
#include <cstdint>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/detail/atomics.hpp"
#include "lot/detail/hold_word.hpp"

// The policy comes first: the algorithm takes its atomics and their memory orders from it.
#include "refcount/ownership.hpp"
#include "support/lent_priority.hpp"
#include "support/raw.hpp"

namespace {

using lot::detail::HardwareAtomics;
using Ownership = lot::refcount::Ownership<HardwareAtomics>;
using Words = lot::refcount::BlockWords<HardwareAtomics>;
using lot::refcount::generation_of;
using lot::refcount::Left;
namespace hold = lot::detail::hold;

/// One process: its index, and its private hold word for the one block of a case.
struct Participant {
  explicit Participant(std::uint32_t index) : own{index} {}

  bool claim(Words& b) { return own.claim(b, word); }
  void give_back(Words& b) { own.give_back(b, word); }
  void acquire(Words& b, std::uint64_t amount = hold::kPointer) { own.acquire(b, word, amount); }
  bool release(Words& b, std::uint64_t amount = hold::kPointer) {
    return own.release(b, word, amount) == Left::Home;
  }
  bool lock(Words& b, std::uint32_t generation) {
    return own.acquire_weak(b, word, generation) == Left::Held;
  }
  bool reclaim(Words& b, std::uint64_t expected) { return own.reclaim(b, word, expected); }

  /// True when the shared word says that this process holds the block.
  bool holds(Words& b) const {
    return (Ownership::word(b, own.self).load() & Ownership::bit(own.self)) != 0;
  }

  Ownership own;
  Ownership::Hold word{};
};

/// One block and three processes; the bit of `far` stands in another word than those of the others.
struct Block {
  std::uint32_t generation() const { return generation_of(words.life.load()); }
  std::uint64_t version() const { return words.life.load() >> 32; }
  bool die(const Participant& p) {
    std::uint64_t seen = 0;
    return p.own.die(words, seen);
  }
  bool unheld() const {
    for (const auto& bits : words.own) {
      if (bits.load() != 0) return false;
    }
    return true;
  }

  Words words{};
  Participant home{1};
  Participant other{2};
  Participant far{70};
};

}  // namespace

TEST_SUITE_BEGIN("refcount");

TEST_CASE("the next generation wraps and leaves the version alone") {
  CHECK(lot::refcount::next_generation(0x5'00000007) == 0x5'00000008);
  CHECK(lot::refcount::next_generation(0x5'ffffffff) == 0x5'00000000);
}

// ---- claim and give back ------------------------------------------------------------------------

TEST_CASE_FIXTURE(Block, "a claimed block is exclusively ours: one pointer, one bit, one home") {
  CHECK(home.claim(words));
  CHECK(words.home.load() == 2);
  CHECK(home.holds(words));
  CHECK(hold::pointers(home.word.load()) == 1);
  CHECK((home.word.load() & hold::kHome) != 0);
  CHECK((home.word.load() & hold::kBusy) == 0);
}

TEST_CASE_FIXTURE(Block, "a block that a process owns cannot be claimed") {
  REQUIRE(home.claim(words));
  CHECK_FALSE(other.claim(words));
  CHECK_FALSE(home.claim(words));
  CHECK(other.word.load() == 0);
  CHECK_FALSE(other.holds(words));
  CHECK(hold::pointers(home.word.load()) == 1);
}

TEST_CASE_FIXTURE(Block, "a block that was given back is free for any process") {
  for (Participant* next : {&home, &other, &far, &home}) {
    REQUIRE(next->claim(words));
    CHECK(next->holds(words));
    next->give_back(words);
    CHECK(words.home.load() == lot::refcount::kHomeFree);
    CHECK(next->word.load() == 0);
    CHECK(unheld());
  }
}

// ---- acquire and release ------------------------------------------------------------------------

TEST_CASE_FIXTURE(Block, "at home only the hold word counts, and the last release says so") {
  REQUIRE(home.claim(words));
  const std::uint64_t life = words.life.load();
  home.acquire(words);
  home.acquire(words, hold::kRing);
  CHECK(hold::pointers(home.word.load()) == 2);
  CHECK_FALSE(home.release(words));
  CHECK_FALSE(home.release(words));
  CHECK(home.release(words, hold::kRing));  // true: now try reclaim()
  CHECK(home.holds(words));                 // the home's bit stands until give_back
  CHECK(words.life.load() == life);
}

TEST_CASE_FIXTURE(Block, "elsewhere the first hold sets the bit and the last one clears it") {
  REQUIRE(home.claim(words));
  for (Participant* guest : {&other, &far, &other}) {
    const std::uint64_t before = version();
    guest->acquire(words);
    CHECK(guest->holds(words));
    CHECK(version() == before + 1);
    guest->acquire(words);
    guest->acquire(words, hold::kRing);
    CHECK(version() == before + 1);  // copies touch no shared word
    CHECK_FALSE(guest->release(words));
    CHECK_FALSE(guest->release(words, hold::kRing));
    CHECK(guest->holds(words));
    CHECK_FALSE(guest->release(words));
    CHECK_FALSE(guest->holds(words));
    CHECK(guest->word.load() == 0);
  }
  CHECK(generation() == 0);
}

// ---- death --------------------------------------------------------------------------------------

TEST_CASE_FIXTURE(Block, "a message dies only when no process holds it") {
  REQUIRE(home.claim(words));
  CHECK_FALSE(Ownership::die_in_orphanage(words));  // home's own bit counts unless it is excepted
  far.acquire(words);
  CHECK_FALSE(die(home));
  far.release(words);
  other.acquire(words);
  CHECK_FALSE(die(home));
  CHECK(generation() == 0);
  other.release(words);
  const std::uint64_t before = version();
  CHECK(die(home));
  CHECK(generation() == 1);
  CHECK(version() == before);
}

TEST_CASE_FIXTURE(Block, "the excepted bit excepts that participant and not its namesake") {
  Participant namesake{70 - HardwareAtomics::kBitsPerWord};  // the same bit, in another word
  REQUIRE(far.claim(words));
  namesake.acquire(words);
  CHECK_FALSE(die(far));
  namesake.release(words);
  CHECK(die(far));
}

// ---- reclaim ------------------------------------------------------------------------------------

TEST_CASE_FIXTURE(Block, "a holder besides two is found in any word; a wish is no holder") {
  const auto besides = [&](std::uint32_t one, std::uint32_t two) {
    return Ownership::has_holder_besides(words, one, two);
  };
  REQUIRE(home.claim(words));
  CHECK(besides(2, 3));
  CHECK_FALSE(besides(1, 2));
  other.acquire(words);
  CHECK(besides(1, 3));
  CHECK_FALSE(besides(1, 2));
  far.acquire(words);
  CHECK(besides(1, 2));
  far.release(words);
  CHECK_FALSE(Ownership::is_awaited(words));
  CHECK(home.release(words));
  CHECK_FALSE(home.reclaim(words, 0));
  CHECK(Ownership::is_awaited(words));
  CHECK_FALSE(besides(1, 2));
  CHECK(besides(1, 3));
}

TEST_CASE_FIXTURE(Block, "the last release at home makes the block ours again, as a new message") {
  REQUIRE(home.claim(words));
  for (std::uint32_t message = 0; message < 3; ++message) {
    CHECK(generation() == message);
    REQUIRE(home.release(words));
    CHECK(home.reclaim(words, 0));
    CHECK(hold::pointers(home.word.load()) == 1);
    CHECK(generation() == message + 1);
    CHECK((home.word.load() & hold::kTagMask) == hold::tag_of(message + 1));
  }
}

TEST_CASE_FIXTURE(Block, "a block that others still hold is reclaimed once they have let go") {
  REQUIRE(home.claim(words));
  other.acquire(words);
  far.acquire(words);
  REQUIRE(home.release(words));
  CHECK_FALSE(home.reclaim(words, 0));
  other.release(words);
  CHECK_FALSE(home.reclaim(words, 0));
  CHECK((home.word.load() & hold::kHolds) == 0);
  CHECK((home.word.load() & hold::kBusy) == 0);
  far.release(words);
  CHECK(home.reclaim(words, 0));
  CHECK(generation() == 1);
}

TEST_CASE_FIXTURE(Block, "a holder is told that the home waits, whenever it let the message go") {
  REQUIRE(home.claim(words));
  other.acquire(words);
  far.acquire(words);
  CHECK(other.own.release(words, other.word, hold::kPointer) == Left::Gone);
  REQUIRE(home.release(words));
  CHECK_FALSE(home.reclaim(words, 0));
  CHECK(other.lock(words, 0));  // it comes after the home has looked, in another word than far's
  CHECK(far.own.release(words, far.word, hold::kPointer) == Left::Wanted);
  CHECK_FALSE(home.reclaim(words, 0));
  CHECK(other.own.release(words, other.word, hold::kPointer) == Left::Wanted);
  CHECK(home.reclaim(words, 0));
  // The next message has nothing of it.
  other.acquire(words);
  far.acquire(words);
  CHECK(other.own.release(words, other.word, hold::kPointer) == Left::Gone);
  CHECK(far.own.acquire_weak(words, far.word, 0) == Left::Gone);
  CHECK(far.own.release(words, far.word, hold::kPointer) == Left::Gone);
}

TEST_CASE_FIXTURE(Block, "a weak lock that fails tells the home that has seen its bit") {
  REQUIRE(home.claim(words));
  REQUIRE(home.release(words));
  REQUIRE(home.reclaim(words, 0));
  lot::test::raw(Ownership::word(words, other.own.self)).fetch_or(lot::refcount::kWanted);
  CHECK(other.own.acquire_weak(words, other.word, 0) == Left::Wanted);
  CHECK(other.word.load() == 0);
}

TEST_CASE_FIXTURE(Block, "a block that we hold ourselves is not reclaimed") {
  REQUIRE(home.claim(words));
  CHECK_FALSE(home.reclaim(words, 0));
  CHECK(hold::pointers(home.word.load()) == 1);
  CHECK(generation() == 0);
}

TEST_CASE_FIXTURE(Block, "the ring's hold is turned into the next message's pointer") {
  REQUIRE(home.claim(words));
  home.acquire(words, hold::kRing);
  REQUIRE_FALSE(home.release(words));
  CHECK(home.reclaim(words, hold::kRing));
  CHECK((home.word.load() & hold::kRingMask) == 0);
  CHECK(hold::pointers(home.word.load()) == 1);
  CHECK(generation() == 1);
}

TEST_CASE_FIXTURE(Block, "the ring's hold is given up though pointers at home keep the message") {
  REQUIRE(home.claim(words));
  home.acquire(words, hold::kRing);
  CHECK_FALSE(home.reclaim(words, hold::kRing));
  CHECK((home.word.load() & hold::kRingMask) == 0);
  CHECK(hold::pointers(home.word.load()) == 1);
  CHECK(generation() == 0);
  CHECK(home.release(words));
  CHECK(home.reclaim(words, 0));
}

TEST_CASE_FIXTURE(Block, "the ring's hold is given up even when others keep the message") {
  REQUIRE(home.claim(words));
  home.acquire(words, hold::kRing);
  REQUIRE_FALSE(home.release(words));
  other.acquire(words);
  CHECK_FALSE(home.reclaim(words, hold::kRing));
  CHECK((home.word.load() & hold::kHolds) == 0);
  CHECK(home.holds(words));
  CHECK(generation() == 0);
  other.release(words);
  CHECK(home.reclaim(words, 0));
}

// ---- weak pointers ------------------------------------------------------------------------------

TEST_CASE_FIXTURE(Block, "a weak lock of a living message holds it, at home and elsewhere") {
  REQUIRE(home.claim(words));
  for (Participant* process : {&home, &other, &far}) {
    const std::uint64_t before = hold::pointers(process->word.load());
    CHECK(process->lock(words, 0));
    CHECK(process->lock(words, 0));
    CHECK(process->holds(words));
    CHECK(hold::pointers(process->word.load()) == before + 2);
  }
  home.release(words);
  home.release(words);
  REQUIRE(home.release(words));
  CHECK_FALSE(home.reclaim(words, 0));
  CHECK(generation() == 0);
}

TEST_CASE_FIXTURE(Block, "a weak lock of a dead message fails and leaves nothing behind") {
  REQUIRE(home.claim(words));
  REQUIRE(home.release(words));
  REQUIRE(home.reclaim(words, 0));
  for (Participant* process : {&other, &far}) {
    CHECK_FALSE(process->lock(words, 0));
    CHECK(process->word.load() == 0);
    CHECK_FALSE(process->holds(words));
  }
  CHECK_FALSE(home.lock(words, 0));
  CHECK(hold::pointers(home.word.load()) == 1);
  CHECK(home.lock(words, 1));
}

TEST_CASE_FIXTURE(Block, "a weak lock fails on a process that holds the block's next message") {
  REQUIRE(home.claim(words));
  REQUIRE(home.release(words));
  REQUIRE(home.reclaim(words, 0));
  other.acquire(words);
  CHECK_FALSE(other.lock(words, 0));
  CHECK(hold::pointers(other.word.load()) == 1);
  CHECK(other.holds(words));
}

TEST_CASE_FIXTURE(Block, "a weak lock fails after the block has gone to another process") {
  REQUIRE(home.claim(words));
  REQUIRE(home.release(words));
  REQUIRE(home.reclaim(words, 0));
  home.give_back(words);
  CHECK_FALSE(other.lock(words, 0));
  CHECK(unheld());
  REQUIRE(far.claim(words));
  for (Participant* process : {&home, &other, &far}) CHECK_FALSE(process->lock(words, 0));
  CHECK_FALSE(home.holds(words));
  CHECK_FALSE(other.holds(words));
  CHECK(far.release(words));
  CHECK(far.reclaim(words, 0));
}

TEST_CASE_FIXTURE(Block, "a weak lock whose generation has the same tag fails at home, too") {
  REQUIRE(home.claim(words));
  const std::uint32_t alias = 1U << 13;
  REQUIRE(hold::tag_of(alias) == hold::tag_of(generation()));
  CHECK_FALSE(home.lock(words, alias));
  CHECK(hold::pointers(home.word.load()) == 1);
}

TEST_CASE_FIXTURE(Block, "a weak lock revives a message between its last release and its reclaim") {
  REQUIRE(home.claim(words));
  REQUIRE(home.release(words));
  CHECK(home.lock(words, 0));
  CHECK_FALSE(home.reclaim(words, 0));
  CHECK(home.release(words));
  CHECK(home.reclaim(words, 0));
}

TEST_CASE_FIXTURE(Block, "a late reclaim leaves a block alone that was given back") {
  REQUIRE(home.claim(words));
  REQUIRE(home.release(words));  // thread A, which stops here
  REQUIRE(home.lock(words, 0));  // thread B
  REQUIRE(home.release(words));
  REQUIRE(home.reclaim(words, 0));
  home.give_back(words);
  SUBCASE("and is free") {}
  SUBCASE("and belongs to another process") { REQUIRE(other.claim(words)); }
  CHECK_FALSE(home.reclaim(words, 0));  // thread A goes on
  CHECK(home.word.load() == 0);
  CHECK_FALSE(home.holds(words));
  CHECK(generation() == 1);
}

// ---- threads of one process ---------------------------------------------------------------------

TEST_CASE("a busy hold word names its thread and leaves home and held readable") {
  const std::uint64_t word = hold::kHome | hold::kHeld | hold::tag_of(0x1fff) | hold::kRing;
  for (const std::uint32_t thread : {1U, 4711U, (1U << 22) - 1}) {
    const std::uint64_t busy = hold::busy_word(word, thread);
    CHECK(hold::busy_thread(busy) == thread);
    CHECK((busy & (hold::kBusy | hold::kHome | hold::kHeld)) ==
          (hold::kBusy | hold::kHome | hold::kHeld));
    CHECK(hold::pointers(busy) == 0);
  }
}

TEST_CASE_FIXTURE(Block, "a thread that waits for a busy hold word lends its owner priority") {
  if (const char* reason = lot::test::LentPriority::lacking()) {
    MESSAGE("skipped: " << std::string(reason));
    return;
  }
  alarm(100);
  REQUIRE(home.claim(words));
  std::uint64_t before = 0;
  const auto enter = [&](Participant& p) {
    before = p.word.load();
    lot::test::raw(p.word) = hold::busy_word(before, HardwareAtomics::this_thread());
  };
  const auto leave = [&](Participant& p) {
    lot::test::raw(p.word).store(before, std::memory_order_release);
    HardwareAtomics::passed();
  };
  const auto turns = [&](Participant& p, const std::function<void()>& want_in) {
    return lot::test::LentPriority::turns_in_between([&] { enter(p); }, [&] { leave(p); }, want_in);
  };
  SUBCASE("to hold the block") {
    CHECK(turns(other, [&] { other.acquire(words); }) == 0);
    CHECK(hold::pointers(other.word.load()) == 1);
  }
  SUBCASE("to lock a weak pointer") {
    bool locked = false;
    CHECK(turns(other, [&] { locked = other.lock(words, 0); }) == 0);
    CHECK(locked);
  }
  SUBCASE("to reclaim the block") {
    REQUIRE(home.release(words));
    bool reclaimed = false;
    CHECK(turns(home, [&] { reclaimed = home.reclaim(words, 0); }) == 0);
    CHECK(reclaimed);
  }
  SUBCASE("to claim the block") {
    home.give_back(words);
    bool claimed = false;
    CHECK(turns(other, [&] { claimed = other.claim(words); }) == 0);
    CHECK(claimed);
  }
  alarm(0);
}

// ---- the ring's hold
// ------------------------------------------------------------------------------

TEST_CASE_FIXTURE(Block, "a loan that is pushed becomes the ring's hold, and no pointer remains") {
  REQUIRE(home.claim(words));
  Ownership::hand_to_ring(home.word);
  CHECK((home.word.load() & hold::kHolds) == hold::kRing);
  CHECK((home.word.load() & hold::kHome) != 0);
  CHECK(home.reclaim(words, hold::kRing));
}

TEST_CASE_FIXTURE(Block, "a ring's hold goes at once if there is another hold, and stays if not") {
  REQUIRE(home.claim(words));
  home.acquire(words, hold::kRing);
  home.acquire(words, hold::kRing);
  CHECK(Ownership::drop_ring_hold_of_several(home.word));
  CHECK((home.word.load() & hold::kRingMask) == hold::kRing);
  home.release(words);
  CHECK_FALSE(Ownership::drop_ring_hold_of_several(home.word));
  CHECK((home.word.load() & hold::kHolds) == hold::kRing);
}

// ---- a message that no other process has seen ---------------------------------------------------

TEST_CASE_FIXTURE(Block, "a message that is unseen dies with its last pointer, as a loan does") {
  REQUIRE(home.claim(words));
  const std::uint32_t before = generation();
  Ownership::keep_unseen(words, home.word);
  CHECK(words.home_points.load() == 1);
  home.word.add_pointer();
  CHECK_FALSE(Ownership::die_unseen(words, home.word));
  CHECK(home.word.drop_pointer_of_several());
  REQUIRE(Ownership::die_unseen(words, home.word));
  CHECK(generation() == before + 1);
  CHECK(words.home_points.load() == 0);
  CHECK(hold::pointers(home.word.load()) == 1);  // the pool's, as of a block that is ready
  CHECK((home.word.load() & hold::kUnseen) == 0);
  CHECK((home.word.load() & hold::kTagMask) == hold::tag_of(before + 1));
  CHECK_FALSE(home.lock(words, before));
}

TEST_CASE_FIXTURE(Block, "the generation of an unseen message wraps") {
  lot::test::raw(words.life) = 0x5'ffffffff;
  REQUIRE(home.claim(words));
  Ownership::keep_unseen(words, home.word);
  REQUIRE(Ownership::die_unseen(words, home.word));
  CHECK(generation() == 0);
  CHECK((home.word.load() & hold::kTagMask) == hold::tag_of(0));
}

TEST_CASE_FIXTURE(Block, "what others may see does not die unseen") {
  REQUIRE(home.claim(words));
  const std::uint32_t before = generation();
  Ownership::keep_unseen(words, home.word);
  SUBCASE("a ring has had it") {
    home.acquire(words, hold::kRing);
    CHECK_FALSE(Ownership::die_unseen(words, home.word));
    other.acquire(words);
    CHECK(Ownership::drop_ring_hold_of_several(home.word));
  }
  SUBCASE("a weak pointer was made") { Ownership::end_unseen(home.word); }
  SUBCASE("it is a loan, or was kept of a block") {
    Ownership::end_unseen(home.word);
    Ownership::end_unseen(home.word);
  }
  CHECK_FALSE(Ownership::die_unseen(words, home.word));
  CHECK(generation() == before);
  CHECK(home.release(words));
}

TEST_CASE_FIXTURE(Block, "a weak pointer to a dead message leaves a busy hold word alone") {
  const std::uint64_t busy = hold::busy_word(hold::kHome | hold::kHeld, 1);
  REQUIRE((busy & hold::kUnseen) != 0);  // there it is a bit of the thread
  Ownership::Hold word{};
  lot::test::raw(word) = busy;
  Ownership::end_unseen(word);
  CHECK(word.load() == busy);
}

// ---- the home's pointers, as other processes count them -----------------------------------------

TEST_CASE_FIXTURE(Block, "use_count() elsewhere counts the home while it has pointers") {
  const auto counted = [this] { return words.home_points.load() != 0; };
  REQUIRE(home.claim(words));
  CHECK_FALSE(counted());  // a loan
  Ownership::note_pointers(words, home.word);
  CHECK(counted());
  home.acquire(words, hold::kRing);
  home.acquire(words);
  home.release(words);
  CHECK(counted());
  home.release(words);
  CHECK_FALSE(counted());
  REQUIRE(home.lock(words, generation()));
  CHECK(counted());
  home.release(words);
  CHECK_FALSE(counted());
}

TEST_CASE_FIXTURE(Block, "use_count() elsewhere does not count pointers of other processes twice") {
  REQUIRE(home.claim(words));
  home.acquire(words, hold::kRing);
  home.release(words);
  other.acquire(words);
  Ownership::note_pointers(words, other.word);
  CHECK(words.home_points.load() == 0);
}

TEST_CASE_FIXTURE(Block, "the orphanage has no pointers") {
  REQUIRE(home.claim(words));
  Ownership::note_pointers(words, home.word);
  Ownership::move_to_orphanage(words);
  CHECK(words.home_points.load() == 0);
}

// ---- the orphanage ------------------------------------------------------------------------------

TEST_CASE_FIXTURE(Block, "an adopted message lives until the orphanage lets it go") {
  REQUIRE(home.claim(words));
  const std::uint64_t before = version();
  Ownership::adopt(words);
  CHECK(version() == before + 1);
  REQUIRE(home.release(words));
  CHECK_FALSE(home.reclaim(words, 0));
  Ownership::let_go(words, lot::refcount::kOrphanage);
  CHECK(home.reclaim(words, 0));
}

TEST_CASE_FIXTURE(Block, "the orphanage frees a message only when no process holds it") {
  REQUIRE(home.claim(words));
  other.acquire(words);
  // Home has died: its reaper clears its bit and takes the block over.
  Ownership::move_to_orphanage(words);
  Ownership::let_go(words, home.own.self);
  CHECK_FALSE(Ownership::die_in_orphanage(words));
  Ownership::adopt(words);
  other.release(words);
  CHECK_FALSE(Ownership::die_in_orphanage(words));
  CHECK_FALSE(far.claim(words));
  Ownership::let_go(words, lot::refcount::kOrphanage);
  CHECK(Ownership::die_in_orphanage(words));
  CHECK_FALSE(other.lock(words, 0));
  Ownership::free_orphan(words);
  CHECK(far.claim(words));
}

TEST_SUITE_END();
