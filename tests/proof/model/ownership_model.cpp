// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"
#include "world.hpp"

/// Blocks in many hands: forwarding, weak locks, threads of one process.
namespace lot::model {
namespace {

using refcount::Left;

/// A message goes through three processes whose bits lie in three words. A forwarder's ring is
/// invisible to the block's home.
struct ForwarderChain : Scene<ForwarderChain, 3> {
  ForwarderChain() : Scene({.blocks = 3, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    first.open(start(5), 0, false);
    second.open(start(3), 1, false);
    RL_ASSERT(middle.join(process(3), 0, 1, 1));
    RL_ASSERT(last.join(start(1), 1, 1, 1));
    first.send();
    forward();
    first.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) first.send();
    } else if (t == 1) {
      for (int i = 0; i < 2; ++i) forward();
    } else {
      for (int i = 0; i < 3; ++i) take();
    }
  }
  void forward() {
    const Word b = middle.borrow();
    if (b == kNoBlock) return;
    const std::uint64_t expected = middle.number();
    process(3).keep(b);
    middle.done();
    RL_ASSERT(process(3).read(b) == expected);
    second.forward(b);
    second.scan();
  }
  void take() {
    const Word b = last.borrow();
    if (b == kNoBlock) return;
    process(1).keep(b);
    last.done();
    const std::uint64_t message = process(1).read(b);
    RL_ASSERT(!seen || message > *seen);
    seen = message;
    RL_ASSERT(process(1).read(b) == message);
    process(1).drop(b);
  }
  Publisher first, second;
  Subscriber middle, last;
  std::optional<std::uint64_t> seen;
};

/// A weak pointer elsewhere locks the message it was made from, or nothing.
struct WeakLockElsewhere : Scene<WeakLockElsewhere, 2> {
  WeakLockElsewhere() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    publisher.send();
    block = subscriber.borrow();
    generation = process(2).generation(block);
    subscriber.done();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 4; ++i) publisher.send();
      return;
    }
    for (int i = 0; i < 2; ++i) {
      if (!process(2).lock_weak(block, generation)) continue;
      RL_ASSERT(process(2).read(block) == 0);
      process(2).drop(block);
    }
  }
  Publisher publisher;
  Subscriber subscriber;
  Word block = kNoBlock;
  std::uint32_t generation = 0;
};

/// The same in the block's own process.
struct WeakLockAtHome : Scene<WeakLockAtHome, 2> {
  WeakLockAtHome() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    block = process(4).loan();
    generation = process(4).generation(block);
    process(4).write(block, 0);
    publisher.send_own(block);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 4; ++i) publisher.send();
      return;
    }
    for (int i = 0; i < 2; ++i) {
      if (!process(4).lock_weak(block, generation)) continue;
      RL_ASSERT(process(4).read(block) == 0);
      process(4).drop(block);
    }
  }
  Publisher publisher;
  Word block = kNoBlock;
  std::uint32_t generation = 0;
};

/// A stale weak pointer against its own process giving the block back and claiming it again, while
/// another process claims as well.
struct WeakLockAgainstClaim : Scene<WeakLockAgainstClaim, 3> {
  WeakLockAgainstClaim() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    block = start(2).loan();
    generation = process(2).generation(block);
    process(2).write(block, 0);
    publisher.open(process(2), 0, false);
    publisher.send_own(block);
    RL_ASSERT(publisher.evict());
    publisher.scan();
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) use(process(2));
    } else if (t == 1) {
      for (int i = 0; i < 2; ++i) RL_ASSERT(!process(2).lock_weak(block, generation));
    } else {
      use(process(3));
    }
  }
  static void use(Process& process) {
    const Word b = process.loan();
    if (b == Process::kNone) return;
    process.write(b, process.index());
    RL_ASSERT(process.read(b) == process.index());
    process.give_back(b);
  }
  Publisher publisher;
  Word block = kNoBlock;
  std::uint32_t generation = 0;
};

/// Two threads of one process keep, lock and drop the same block.
struct ThreadsOfOneProcess : Scene<ThreadsOfOneProcess, 3> {
  ThreadsOfOneProcess() : Scene({.blocks = 3, .depth = 1, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    start(2);
    publisher.send();
    for (Subscriber& subscriber : subscribers) RL_ASSERT(subscriber.join(process(2), 0, 1, 1));
    block = subscribers[0].borrow();
    generation = process(2).generation(block);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 4; ++i) publisher.send();
      return;
    }
    for (int i = 0; i < 2; ++i) {
      subscribers[t - 1].receive_and_keep();
      if (t == 2 && process(2).lock_weak(block, generation)) {
        RL_ASSERT(process(2).read(block) == 0);
        process(2).drop(block);
      }
    }
  }
  Publisher publisher;
  Subscriber subscribers[2];
  Word block = kNoBlock;
  std::uint32_t generation = 0;
};

/// A message that refers to another one keeps it alive for those who hold only the first.
struct MessageRefersToMessage : Scene<MessageRefersToMessage, 2> {
  MessageRefersToMessage() : Scene({.blocks = 4, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    targets.open(start(4), 0, false);
    messages.open(start(3), 1, false);
    RL_ASSERT(reader_of_targets.join(process(3), 0, 1, 1));
    RL_ASSERT(reader.join(start(2), 1, 1, 1));
    targets.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      publish_reference();
      targets.send();
      targets.send();
      targets.send();
      messages.send();
      messages.send();
    } else if (const Word b = reader.borrow(); b != kNoBlock) {
      if (reader.number() == 0) {
        const Word target = segment.references[b].read();
        RL_ASSERT(process(2).read(target) == 0);
      }
      reader.done();
    }
  }
  void publish_reference() {
    const Word target = reader_of_targets.borrow();
    const Word b = process(3).loan();
    process(3).refer(b, target);
    reader_of_targets.done();
    process(3).write(b, 0);
    messages.send_own(b);
  }
  Publisher targets, messages;
  Subscriber reader_of_targets, reader;
};

/// One thread keeps the next message in a block while another one locks a weak pointer to the last.
struct WeakLockBesideTheNextMessage : Scene<WeakLockBesideTheNextMessage, 3> {
  WeakLockBesideTheNextMessage() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    publisher.send();
    block = subscriber.borrow();
    generation = process(2).generation(block);
    subscriber.done();
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.send();
    } else if (t == 1) {
      for (int i = 0; i < 2; ++i) {
        const Word b = subscriber.borrow();
        if (b == kNoBlock) continue;
        process(2).keep(b);
        subscriber.done();
      }
    } else if (process(2).lock_weak(block, generation)) {
      RL_ASSERT(process(2).read(block) == 0);
      process(2).drop(block);
    }
  }
  Publisher publisher;
  Subscriber subscriber;
  Word block = kNoBlock;
  std::uint32_t generation = 0;
};

/// The same, and the one that keeps has come behind a death that the other has not seen.
struct WeakLockBehindADeath : Scene<WeakLockBehindADeath, 2> {
  WeakLockBehindADeath() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    publisher.send();
    block = subscriber.borrow();
    generation = process(2).generation(block);
    subscriber.done();
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.send();
      RL_ASSERT(subscriber.borrow() == block);
      process(2).keep(block);
      subscriber.done();
      return;
    }
    while (!process(2).holds(block)) Policy::pause();
    if (process(2).lock_weak(block, generation)) {
      RL_ASSERT(process(2).read(block) == 0);
      process(2).drop(block);
    }
  }
  Publisher publisher;
  Subscriber subscriber;
  Word block = kNoBlock;
  std::uint32_t generation = 0;
};

/// Ownership without a pool, whose lock would order its threads: at home one thread gives up the
/// ring's hold and another one a pointer, elsewhere a process lets go. Then the block is written.
/// `kAsked`: the holders were asked before, so that a look in vain changes no word of theirs.
template <bool kAsked>
struct HomeHasThreads : SceneBegins, rl::test_suite<HomeHasThreads<kAsked>, 3> {
  using Own = refcount::Ownership<Policy>;
  void before() {
    for (auto& word : block.own) {
      test::raw(word).watch_bits(Policy::kBitsPerWord);
      if (kAsked) test::raw(word).fetch_or(refcount::kWanted, std::memory_order_relaxed);
    }
    RL_ASSERT(home.claim(block, home_hold));
    payload.write(1);
    home.acquire(block, home_hold, hold::kRing);
    other.acquire(block, other_hold, hold::kPointer);
  }
  void thread(unsigned t) {
    RL_ASSERT(payload.read() == 1);
    bool ours = false;
    if (t == 0) {
      ours = home.reclaim(block, home_hold, hold::kRing);
    } else if (t == 1) {
      ours = home.release(block, home_hold, hold::kPointer) == Left::Home &&
             home.reclaim(block, home_hold, 0);
    } else {
      other.release(block, other_hold, hold::kPointer);
      ours = home.reclaim(block, home_hold, 0);  // a thread of the home's comes by again
    }
    if (ours) payload.write(2);
  }
  Own home{2};
  Own other{5};
  refcount::BlockWords<Policy> block;
  Own::Hold home_hold, other_hold;
  Plain<int> payload;
};

/// Threads of the home copy, drop and lock pointers to one message. When all is done, the word that
/// tells other processes of the home's pointers is right. `kKeeps`: one pointer stays.
template <bool kKeeps>
struct HomeCountsItsPointers : SceneBegins, rl::test_suite<HomeCountsItsPointers<kKeeps>, 3> {
  using Own = refcount::Ownership<Policy>;
  void before() {
    for (auto& word : block.own) test::raw(word).watch_bits(Policy::kBitsPerWord);
    test::raw(block.home_points).watch_bits(1);
    RL_ASSERT(home.claim(block, home_hold));
    home.acquire(block, home_hold, hold::kRing);
    home.note_pointers(block, home_hold);  // the loan becomes a shared pointer
    home_hold.add_pointer();
    generation = refcount::generation_of(block.life.load(std::memory_order_relaxed));
  }
  void thread(unsigned t) {
    if (t < 2) {
      drop();
    } else if (home.acquire_weak(block, home_hold, generation) == Left::Held && !kKeeps) {
      drop();
    }
  }
  void after() {
    RL_ASSERT(hold::pointers(last_value(test::raw(home_hold))) == (kKeeps ? 1 : 0));
    RL_ASSERT(last_value(test::raw(block.home_points)) == (kKeeps ? 1 : 0));
  }
  /// A load may read an older value.
  template <class T>
  static T last_value(Atomic<T>& word) {
    return word.fetch_or(0, std::memory_order_relaxed);
  }
  void drop() {
    if (home_hold.drop_pointer_of_several()) return;
    RL_ASSERT(home.release(block, home_hold, hold::kPointer) == Left::Held);  // the ring's stays
  }
  Own home{2};
  refcount::BlockWords<Policy> block;
  Own::Hold home_hold;
  std::uint32_t generation = 0;
};

/// The ring lets a message go while two threads of its home drop their pointers: the one that lets
/// go last finds it, and may write the block when all have read it.
struct RingAndPointersLetGo : SceneBegins, rl::test_suite<RingAndPointersLetGo, 3> {
  using Own = refcount::Ownership<Policy>;
  void before() {
    for (auto& word : block.own) test::raw(word).watch_bits(Policy::kBitsPerWord);
    test::raw(block.home_points).watch_bits(1);
    RL_ASSERT(home.claim(block, home_hold));
    payload.write(1);
    home.acquire(block, home_hold, hold::kRing);
    home.note_pointers(block, home_hold);
    home_hold.add_pointer();
    deaths = 0;
  }
  void thread(unsigned t) {
    RL_ASSERT(payload.read() == 1);
    const bool ours = t == 0 ? !home.drop_ring_hold_of_several(home_hold) &&
                                   home.reclaim(block, home_hold, hold::kRing)
                             : !home_hold.drop_pointer_of_several() &&
                                   home.release(block, home_hold, hold::kPointer) == Left::Home &&
                                   home.reclaim(block, home_hold, 0);
    if (!ours) return;
    payload.write(2);
    ++deaths;
  }
  void after() { RL_ASSERT(deaths == 1); }
  Own home{2};
  refcount::BlockWords<Policy> block;
  Own::Hold home_hold;
  Plain<int> payload;
  int deaths = 0;  ///< looked at when all is over
};

/// Threads of one process have pointers to a message that no other process has seen. The last one
/// that goes ends it, as a unique pointer does.
struct Unseen : SceneBegins {
  using Own = refcount::Ownership<Policy>;
  void begin() {
    for (auto& word : block.own) test::raw(word).watch_bits(Policy::kBitsPerWord);
    test::raw(block.home_points).watch_bits(1);
    RL_ASSERT(home.claim(block, home_hold));
    generation = refcount::generation_of(block.life.load(std::memory_order_relaxed));
    payload.write(1);
    Own::keep_unseen(block, home_hold);
    home_hold.add_pointer();
    home_hold.add_pointer();
    deaths = 0;
  }
  void has_died_once() {
    RL_ASSERT(deaths == 1);
    RL_ASSERT(refcount::generation_of(block.life.load(std::memory_order_relaxed)) ==
              generation + 1);
  }
  void read_and_drop() {
    RL_ASSERT(payload.read() == 1);
    if (home_hold.drop_pointer_of_several()) return;
    if (!Own::die_unseen(block, home_hold) &&
        (home.release(block, home_hold, hold::kPointer) != Left::Home ||
         !home.reclaim(block, home_hold, 0))) {
      return;
    }
    payload.write(2);
    ++deaths;
  }
  Own home{2};
  refcount::BlockWords<Policy> block;
  Own::Hold home_hold;
  Plain<int> payload;
  std::uint32_t generation = 0;
  int deaths = 0;  ///< looked at when all is over
};
struct UnseenDies : Unseen, rl::test_suite<UnseenDies, 3> {
  void before() { begin(); }
  void thread(unsigned) { read_and_drop(); }
  void after() { has_died_once(); }
};

/// The same, and one thread makes a weak pointer, drops its other one, and locks that.
struct UnseenGetsAWeakPointer : Unseen, rl::test_suite<UnseenGetsAWeakPointer, 3> {
  void before() { begin(); }
  void thread(unsigned t) {
    if (t == 0) {
      Own::end_unseen(home_hold);
      read_and_drop();
      if (home.acquire_weak(block, home_hold, generation) == Left::Held) read_and_drop();
    } else {
      read_and_drop();
    }
  }
  void after() { has_died_once(); }
};

/// The same, and one thread publishes the message. A reader in another process keeps it.
struct UnseenIsPublished : Unseen, rl::test_suite<UnseenIsPublished, 3> {
  void before() { begin(); }
  void thread(unsigned t) {
    if (t == 0) {
      home.acquire(block, home_hold, hold::kRing);
      other.acquire(block, other_hold, hold::kPointer);
      is_kept.store(1, std::memory_order_release);
      read_and_drop();
      if (!Own::drop_ring_hold_of_several(home_hold) &&
          home.reclaim(block, home_hold, hold::kRing)) {
        payload.write(2);
        ++deaths;
      }
    } else if (t == 1) {
      read_and_drop();
    } else {
      while (is_kept.load(std::memory_order_acquire) == 0) Policy::pause();
      read_and_drop();
      RL_ASSERT(payload.read() == 1);
      other.release(block, other_hold, hold::kPointer);
    }
  }
  void after() {
    if (deaths == 0 && home.reclaim(block, home_hold, 0)) ++deaths;
    has_died_once();
  }
  Own other{5};
  Own::Hold other_hold;
  Atomic<std::uint32_t> is_kept;
};

/// The same, and another process locks a weak pointer to the message that the block had before.
/// Then the block has a third message, which a third process keeps.
struct UnseenBesideAStaleWeakPointer : Unseen, rl::test_suite<UnseenBesideAStaleWeakPointer, 3> {
  void before() {
    begin();
    RL_ASSERT(home_hold.drop_pointer_of_several() && home_hold.drop_pointer_of_several());
    RL_ASSERT(Own::die_unseen(block, home_hold));
    Own::keep_unseen(block, home_hold);
  }
  void thread(unsigned t) {
    if (t == 0) {
      read_and_drop();
      Own::hand_to_ring(home_hold);
      is_public.store(1, std::memory_order_release);
      while (is_kept.load(std::memory_order_acquire) == 0) Policy::pause();
      if (!home.reclaim(block, home_hold, hold::kRing)) return;
      payload.write(3);
      ++deaths;
    } else if (t == 1) {
      RL_ASSERT(other.acquire_weak(block, other_hold, generation) != Left::Held);
    } else {
      while (is_public.load(std::memory_order_acquire) == 0) Policy::pause();
      third.acquire(block, third_hold, hold::kPointer);
      is_kept.store(1, std::memory_order_release);
      RL_ASSERT(payload.read() == 2);
      third.release(block, third_hold, hold::kPointer);
    }
  }
  void after() {
    if (deaths == 1 && home.reclaim(block, home_hold, 0)) ++deaths;
    RL_ASSERT(deaths == 2);
    RL_ASSERT(refcount::generation_of(block.life.load(std::memory_order_relaxed)) ==
              generation + 3);
  }
  Own other{5};
  Own third{4};
  Own::Hold other_hold, third_hold;
  Atomic<std::uint32_t> is_public;
  Atomic<std::uint32_t> is_kept;
};

/// One thread has let its last hold go, and comes late: another one has locked a weak pointer, let
/// go and given the block back, and another process may have it.
struct LateReclaim : SceneBegins, rl::test_suite<LateReclaim, 3> {
  using Own = refcount::Ownership<Policy>;
  void before() {
    for (auto& word : block.own) test::raw(word).watch_bits(Policy::kBitsPerWord);
    RL_ASSERT(home.claim(block, home_hold));
    generation = refcount::generation_of(block.life.load(std::memory_order_relaxed));
  }
  void thread(unsigned t) {
    if (t == 0) {
      let_go();
    } else if (t == 1) {
      if (home.acquire_weak(block, home_hold, generation) == Left::Held) let_go();
    } else if (other.claim(block, other_hold)) {
      payload.write(1);
      RL_ASSERT(payload.read() == 1);
    }
  }
  void let_go() {
    if (home.release(block, home_hold, hold::kPointer) != Left::Home ||
        !home.reclaim(block, home_hold, 0)) {
      return;
    }
    payload.write(2);
    home.give_back(block, home_hold);
  }
  Own home{2};
  Own other{5};
  refcount::BlockWords<Policy> block;
  Own::Hold home_hold, other_hold;
  Plain<int> payload;
  std::uint32_t generation = 0;
};

/// A queue of another process has a message that its home waits for, and a reader has it, too. Both
/// ask what gives way: each sees the other as long as it holds the message, and what the home has
/// said. The home gets the block, or is told when the last of them has let go.
struct QueueGivesWhatIsAwaited : SceneBegins, rl::test_suite<QueueGivesWhatIsAwaited, 3> {
  using Own = refcount::Ownership<Policy>;
  void before() {
    for (auto& word : block.own) test::raw(word).watch_bits(Policy::kBitsPerWord);
    RL_ASSERT(home.claim(block, home_hold));
    RL_ASSERT(!Own::is_awaited(block));
    queue.acquire(block, queue_hold, hold::kRing);
    RL_ASSERT(!Own::has_holder_besides(block, queue.self, home.self));
    reader.acquire(block, reader_hold, hold::kPointer);
    ours = told = false;
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(home.release(block, home_hold, hold::kPointer) == Left::Home);
      ours = home.reclaim(block, home_hold, 0, [] { return true; });
    } else if (t == 1) {
      while (!Own::is_awaited(block)) Policy::pause();
      RL_ASSERT(Own::has_holder_besides(block, queue.self, home.self));
      let_go(queue, queue_hold, hold::kRing);
    } else {
      while (Own::has_holder_besides(block, reader.self, home.self)) Policy::pause();
      let_go(reader, reader_hold, hold::kPointer);
    }
  }
  void after() {
    RL_ASSERT(ours || told);
    RL_ASSERT(ours || home.reclaim(block, home_hold, 0));
  }
  void let_go(const Own& own, Own::Hold& h, std::uint64_t amount) {
    if (own.release(block, h, amount) == Left::Wanted) told = true;
  }
  Own home{2};
  Own queue{5};
  Own reader{1};
  refcount::BlockWords<Policy> block;
  Own::Hold home_hold, queue_hold, reader_hold;
  bool ours = false;  ///< both are looked at when all is over
  bool told = false;
};

/// A wild write, or a home that was told wrong, frees a block that a process still holds. That one
/// leaves it alone when it looks for a free block, and does not wait for its own hold to go.
struct HeldAndFree : SceneBegins, rl::test_suite<HeldAndFree, 3> {
  using Own = refcount::Ownership<Policy>;
  void before() {
    for (auto& word : block.own) test::raw(word).watch_bits(Policy::kBitsPerWord);
    Policy::does_damage = true;
    RL_ASSERT(home.claim(block, home_hold));
    keeper.acquire(block, keeper_hold, hold::kPointer);
  }
  void thread(unsigned t) {
    if (t == 0) {
      payload.write(1);
      home.give_back(block, home_hold);
    } else if (t == 1) {
      RL_ASSERT(!keeper.claim(block, keeper_hold));
    } else if (other.claim(block, other_hold) || other.claim(block, other_hold)) {
      payload.write(2);
    }
  }
  Own home{2};
  Own keeper{5};
  Own other{7};
  refcount::BlockWords<Policy> block;
  Own::Hold home_hold, keeper_hold, other_hold;
  Plain<int> payload;
};

/// The home looks for the last time while another process lets go, and a third one tries a weak
/// pointer to a message that has died: then either the home has got the block, or it is told.
struct HomeIsTold : SceneBegins, rl::test_suite<HomeIsTold, 3> {
  using Own = refcount::Ownership<Policy>;
  void before() {
    for (auto& word : block.own) test::raw(word).watch_bits(Policy::kBitsPerWord);
    RL_ASSERT(home.claim(block, home_hold));
    RL_ASSERT(home.release(block, home_hold, hold::kPointer) == Left::Home);
    RL_ASSERT(home.reclaim(block, home_hold, 0));  // so that there is one that has died
    other.acquire(block, other_hold, hold::kPointer);
    note.write(0);
    ours = told = false;
  }
  void thread(unsigned t) {
    if (t == 0) {
      ours = home.release(block, home_hold, hold::kPointer) == Left::Home &&
             home.reclaim(block, home_hold, 0, [this] {
               note.write(1);
               return true;
             });
    } else if (t == 1) {
      tell_if_wanted(other.release(block, other_hold, hold::kPointer));
    } else {
      tell_if_wanted(third.acquire_weak(block, third_hold, 0));
    }
  }
  void after() { RL_ASSERT(ours || told); }
  void tell_if_wanted(Left left) {
    RL_ASSERT(left == Left::Gone || left == Left::Wanted);
    if (left != Left::Wanted) return;
    told = true;
    RL_ASSERT(note.read() == 1);  // the warden that is told finds it
  }
  Own home{2};
  Own other{5};
  Own third{4};
  refcount::BlockWords<Policy> block;
  Own::Hold home_hold, other_hold, third_hold;
  Plain<int> note;
  bool ours = false;  ///< both are looked at when all is over
  bool told = false;
};

const Entered entered{
    {"forwarder_chain", "a forwarded block lives as long as the last ring that has it",
     cast_of<ForwarderChain>, 1},
    {"weak_lock_elsewhere", "a weak lock gets its message or nothing", cast_of<WeakLockElsewhere>,
     2},
    {"weak_lock_at_home", "the same in the block's own process", cast_of<WeakLockAtHome>, 2},
    {"weak_lock_against_claim", "a stale weak lock never disturbs a new owner",
     cast_of<WeakLockAgainstClaim>, 2},
    {"weak_lock_beside_the_next", "a weak lock never gets the next message in the block",
     cast_of<WeakLockBesideTheNextMessage>, 2},
    {"weak_lock_behind_a_death", "the same, and it has not seen the last one die",
     cast_of<WeakLockBehindADeath>, 2},
    {"home_has_threads", "threads at home give up their holds in any order",
     cast_of<HomeHasThreads<false>>, 3},
    {"home_has_threads_and_has_asked", "the same, when it waits already",
     cast_of<HomeHasThreads<true>>, 3},
    {"home_counts_its_pointers", "at rest the home's pointers are counted right: none",
     cast_of<HomeCountsItsPointers<false>>, 3},
    {"home_counts_a_pointer_that_stays", "the same, and one pointer stays",
     cast_of<HomeCountsItsPointers<true>>, 3},
    {"ring_and_pointers_let_go", "a message dies once, whichever of its holds goes last",
     cast_of<RingAndPointersLetGo>, 3},
    {"unseen_dies", "what no other process has seen dies with its last pointer",
     cast_of<UnseenDies>, 3},
    {"unseen_gets_a_weak_pointer", "the same, and a weak pointer gets it alive or not at all",
     cast_of<UnseenGetsAWeakPointer>, 2},
    {"unseen_is_published", "the same, and it lives until its last reader lets go",
     cast_of<UnseenIsPublished>, 2},
    {"unseen_beside_a_stale_weak_pointer", "the same beside a weak pointer to an earlier message",
     cast_of<UnseenBesideAStaleWeakPointer>, 2},
    {"late_reclaim", "who comes late does not touch a block that was given back",
     cast_of<LateReclaim>, 2},
    {"home_is_told", "a home that has looked in vain is told when the last holder goes",
     cast_of<HomeIsTold>, 2},
    {"queue_gives_what_is_awaited",
     "a queue sees the other holders of a message, and that its home waits",
     cast_of<QueueGivesWhatIsAwaited>, 2},
    {"held_and_free", "who holds a block that is said to be free does not claim it",
     cast_of<HeldAndFree>, 3},
    {"threads_of_one_process", "threads share one ownership bit", cast_of<ThreadsOfOneProcess>, 1},
    {"message_refers_to_message", "a referred message lives as long as the referring one",
     cast_of<MessageRefersToMessage>, 2},
};

}  // namespace
}  // namespace lot::model
