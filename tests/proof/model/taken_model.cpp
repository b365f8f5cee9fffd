// SPDX-License-Identifier: Apache-2.0
#include <set>

#include "scenario.hpp"
#include "subscription.hpp"

/// Rings whose messages are each taken by one reader.
namespace lot::model {
namespace {

/// Who has got which message: a message is one reader's.
class Ledger {
 public:
  auto entry() {
    return [this](std::uint64_t number) { RL_ASSERT(++times_[number] == 1); };
  }
  std::uint64_t total() const { return times_.size(); }
  bool has(std::uint64_t number) const { return times_.count(number) != 0; }

 private:
  std::map<std::uint64_t, unsigned> times_;
};

/// A publisher, and two readers that take what it publishes.
template <class Derived, unsigned kThreads, bool kBlocking, std::uint32_t kDepth>
struct TwoTakers : Scene<Derived, kThreads> {
  explicit TwoTakers(std::uint32_t blocks)
      : Scene<Derived, kThreads>({.blocks = blocks, .depth = kDepth, .readers = 2, .taken = true}) {
  }
  void open() {
    RL_ASSERT(publisher.open(this->start(4), 0, kBlocking));
    for (unsigned i : {0U, 1U}) RL_ASSERT(takers[i].join(this->start(2 + i), 0, 1, 1));
  }
  bool take(unsigned i) { return takers[i].take(ledger.entry()); }
  void take_until_the_end(unsigned i) {
    while (!takers[i].ended()) {
      if (!take(i)) takers[i].sleep();
    }
    takers[i].leave();
  }
  void take_the_rest() {
    while (take(0)) {
    }
  }
  Publisher publisher;
  Subscriber takers[2];
  Ledger ledger;
};

/// Two take while the publisher laps the ring. The memory of what was taken is used again.
template <class Derived, bool kBlocking, std::uint32_t kDepth>
struct TakeWhilePublished : TwoTakers<Derived, 3, kBlocking, kDepth> {
  TakeWhilePublished() : TwoTakers<Derived, 3, kBlocking, kDepth>(kDepth + 1) {}
  void prepare() {
    this->open();
    for (std::uint32_t i = 0; i < kDepth; ++i) RL_ASSERT(this->publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (std::uint32_t i = 0; i <= kDepth; ++i) this->publisher.send();
    } else {
      for (std::uint32_t i = 0; i < 2; ++i) this->take(t - 1);
    }
  }
  void check() {
    this->take_the_rest();
    if (kBlocking) RL_ASSERT(this->ledger.total() == this->publisher.sent());
    RL_ASSERT(this->takers[0].missed() == 0 && this->takers[1].missed() == 0);
  }
};
struct TakenOverOneSlot : TakeWhilePublished<TakenOverOneSlot, true, 1> {};
struct TakenOverTwoSlots : TakeWhilePublished<TakenOverTwoSlots, true, 2> {};
struct TakenOrOverwrittenOneSlot : TakeWhilePublished<TakenOrOverwrittenOneSlot, false, 1> {};
struct TakenOrOverwrittenTwoSlots : TakeWhilePublished<TakenOrOverwrittenTwoSlots, false, 2> {};

/// The same in small: one message that both want, and its block is wanted by the publisher.
struct BothWantOne : TwoTakers<BothWantOne, 3, true, 1> {
  BothWantOne() : TwoTakers(1) {}
  void prepare() {
    open();
    RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.send();
    } else {
      take(t - 1);
    }
  }
  void check() {
    take_the_rest();
    RL_ASSERT(ledger.total() == publisher.sent());
  }
};

/// The publisher overwrites, and has as many blocks as slots: before it can publish, it takes its
/// oldest message back. So none is overwritten: each is taken, evicted, or was both.
template <class Derived, unsigned kThreads, std::uint32_t kDepth>
struct Evicting : TwoTakers<Derived, kThreads, false, kDepth> {
  Evicting() : TwoTakers<Derived, kThreads, false, kDepth>(kDepth) {}
  void fill() {
    this->open();
    for (std::uint32_t i = 0; i < kDepth; ++i) RL_ASSERT(send());
  }
  bool send() {
    const Word b = this->process(4).loan();
    if (b == Process::kNone) return false;
    in_block[b] = this->publisher.sent();
    this->process(4).write(b, this->publisher.sent());
    this->publisher.send_own(b);
    return true;
  }
  /// As the pool does that is dry.
  bool send_or_evict() {
    while (!send()) {
      const auto b = this->publisher.evict();
      if (!b) return false;  // its takers still look at them
      RL_ASSERT(evicted.insert(in_block[*b]).second);
    }
    return true;
  }
  /// Those that nobody has got and that were not evicted.
  std::uint64_t lost() const {
    std::uint64_t n = 0;
    for (std::uint64_t m = 0; m < this->publisher.sent(); ++m) {
      n += !this->ledger.has(m) && evicted.count(m) == 0;
    }
    return n;
  }
  std::map<Word, std::uint64_t> in_block;
  std::set<std::uint64_t> evicted;
};

template <class Derived, std::uint32_t kDepth>
struct EvictedWhileTaken : Evicting<Derived, 3, kDepth> {
  void prepare() { this->fill(); }
  void thread(unsigned t) {
    if (t == 0) {
      for (std::uint32_t i = 0; i < kDepth; ++i) this->send_or_evict();
    } else {
      for (std::uint32_t i = 0; i < kDepth; ++i) this->take(t - 1);
    }
  }
  void check() {
    this->take_the_rest();
    RL_ASSERT(this->lost() == 0);
    RL_ASSERT(this->takers[0].missed() == 0 && this->takers[1].missed() == 0);
    for (int i = 0; i < 3; ++i) RL_ASSERT(this->send_or_evict());
  }
};
struct EvictedWhileTakenOneSlot : EvictedWhileTaken<EvictedWhileTakenOneSlot, 1> {};
struct EvictedWhileTakenTwoSlots : EvictedWhileTaken<EvictedWhileTakenTwoSlots, 2> {};

/// The same, and one taker is killed anywhere and reaped: it costs nobody more than what it took.
struct TakerKilledWhileEvicted : Evicting<TakerKilledWhileEvicted, 3, 2> {
  void prepare() {
    fill();
    start(1);
  }
  void thread(unsigned t) {
    if (t == 0) {
      send_or_evict();
    } else if (t == 1) {
      take(0);
    } else {
      die_within(3, 30, [this] { take(1); });
      process(1).see_reaped(3);
    }
  }
  void check() {
    take_the_rest();
    RL_ASSERT(lost() <= 1);  // taken, and its taker killed before it could say so
    for (int i = 0; i < 3; ++i) {
      RL_ASSERT(send_or_evict());
      RL_ASSERT(take(0));
    }
    RL_ASSERT(lost() <= 1);
  }
};

/// An evicted block comes to the process of a taker that has looked at it: not before that looks
/// away, or two threads there would have the block in two ways.
struct EvictedBlockChangesHands : Scene<EvictedBlockChangesHands, 2> {
  EvictedBlockChangesHands() : Scene({.blocks = 1, .depth = 1, .readers = 1, .taken = true}) {}
  void prepare() {
    RL_ASSERT(publisher.open(start(4), 0, false));
    RL_ASSERT(taker.join(start(2), 0, 1, 1));
    RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      taker.take(ledger.entry());
    } else {
      publisher.evict();
      loan_and_give_back(4);
      loan_and_give_back(2);  // as another thread of the taker's process
    }
  }
  void loan_and_give_back(std::uint32_t who) {
    const Word b = process(who).loan();
    if (b == Process::kNone) return;
    process(who).write(b, 99);
    process(who).give_back(b);
  }
  void check() { loan_and_give_back(2); }  // for ever, if a hold is left over in there
  Publisher publisher;
  Subscriber taker;
  Ledger ledger;
};

/// Two sleep for messages, the publisher for room; it leaves when all are out.
template <class Derived, std::uint32_t kDepth>
struct TakersSleep : TwoTakers<Derived, 3, true, kDepth> {
  static constexpr unsigned kMessages = 3;
  TakersSleep() : TwoTakers<Derived, 3, true, kDepth>(kDepth + 2) {}
  void prepare() { this->open(); }
  void thread(unsigned t) {
    if (t != 0) return this->take_until_the_end(t - 1);
    for (unsigned i = 0; i < kMessages; ++i) this->publisher.send_and_wait();
    this->process(4).leave();
  }
  void check() { RL_ASSERT(this->ledger.total() == kMessages); }
};
struct TakersSleepOverOneSlot : TakersSleep<TakersSleepOverOneSlot, 1> {};
struct TakersSleepOverTwoSlots : TakersSleep<TakersSleepOverTwoSlots, 2> {};

/// One takes, the publisher sleeps for room.
struct TakerMakesRoom : Scene<TakerMakesRoom, 2> {
  static constexpr unsigned kMessages = 3;
  TakerMakesRoom() : Scene({.blocks = 3, .depth = 1, .readers = 1, .taken = true}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(taker.join(start(2), 0, 1, 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (unsigned i = 0; i < kMessages; ++i) publisher.send_and_wait();
      return;
    }
    while (taker.received() < kMessages) {
      if (!taker.take(ledger.entry())) taker.sleep();
    }
  }
  Publisher publisher;
  Subscriber taker;
  Ledger ledger;
};

/// One taker is killed anywhere and reaped: the other one gets all but what the dead had taken, and
/// the publisher all its blocks.
template <class Derived, bool kBlocking>
struct TakerKilledScene : TwoTakers<Derived, 2, kBlocking, 2> {
  TakerKilledScene() : TwoTakers<Derived, 2, kBlocking, 2>(3) {}
  void prepare() {
    this->open();
    this->start(1);
    for (int i = 0; i < 2; ++i) RL_ASSERT(this->publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      this->die_within(3, 30, [this] { this->take(1); });
      this->process(1).see_reaped(3);
    } else {
      for (int i = 0; i < 2; ++i) this->take(0);
    }
  }
  void check() {
    this->take_the_rest();
    const std::uint64_t lost = this->publisher.sent() - this->ledger.total();
    RL_ASSERT(lost <= 1);  // taken, and its taker killed before it could say so
    for (int i = 0; i < 3; ++i) {
      RL_ASSERT(this->publisher.send());
      RL_ASSERT(this->take(0));
    }
  }
};
struct TakerKilled : TakerKilledScene<TakerKilled, true> {};
struct TakerKilledOverwrite : TakerKilledScene<TakerKilledOverwrite, false> {};

/// The publisher sleeps for room that a taker makes which is killed anywhere.
struct TakerKilledForRoom : Scene<TakerKilledForRoom, 3> {
  TakerKilledForRoom() : Scene({.blocks = 3, .depth = 1, .readers = 2, .taken = true}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(killed.join(start(2), 0, 1, 0));
    RL_ASSERT(taker.join(start(3), 0, 1, 0));
    start(1);
    RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.send_and_wait();
    } else if (t == 1) {
      die_within(2, 25, [this] { killed.take(ledger.entry()); });
      process(1).see_reaped(2);
    } else {
      segment.await_end_of(2);
      // Relaxed: it may still see the sender's mark as it was before the reaper came.
      while (process(3).participant_state(2).load(std::memory_order_relaxed) != 0) Policy::pause();
      while (taker.take(ledger.entry())) {
      }
    }
  }
  Publisher publisher;
  Subscriber killed, taker;
  Ledger ledger;
};

/// The publisher is killed anywhere while two take: they get what was published, then the end.
template <class Derived, bool kBlocking>
struct PublisherOfTakersKilled : TwoTakers<Derived, 4, kBlocking, 2> {
  PublisherOfTakersKilled() : TwoTakers<Derived, 4, kBlocking, 2>(3) {}
  void prepare() {
    this->open();
    this->start(1);
    RL_ASSERT(this->publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      this->die_within(4, 60, [this] {
        for (int i = 0; i < 2; ++i) this->publisher.send();
      });
    } else if (t == 3) {
      this->segment.await_end_of(4);
      this->process(1).see_reaped(4);
      this->process(1).collect();
    } else {
      this->take_until_the_end(t - 1);
    }
  }
  void check() {
    const std::uint64_t sent = this->publisher.sent();
    const std::uint64_t total = this->ledger.total();
    RL_ASSERT(total <= sent + 1);  // the message in flight may have come out
    if (kBlocking) RL_ASSERT(total >= sent);
  }
};
struct PublisherKilledWhileTaken : PublisherOfTakersKilled<PublisherKilledWhileTaken, true> {};
struct PublisherKilledWhileTakenOverwrite
    : PublisherOfTakersKilled<PublisherKilledWhileTakenOverwrite, false> {};

/// The publisher has died; what is in its ring is taken while it is reaped, collected and, as far
/// as it is free, written.
struct TakenFromAnOrphan : TwoTakers<TakenFromAnOrphan, 3, true, 2> {
  TakenFromAnOrphan() : TwoTakers(2) {}
  void prepare() {
    open();
    start(1);
    for (int i = 0; i < 2; ++i) RL_ASSERT(publisher.send());
    segment.end_process(4);
  }
  void thread(unsigned t) {
    if (t != 0) {
      take(t - 1);
      return;
    }
    process(1).see_reaped(4);
    write_what_is_free();
    process(1).collect();
    write_what_is_free();
  }
  void write_what_is_free() {
    const Word b = process(1).loan();
    if (b != Process::kNone) process(1).write(b, 99);
  }
  void check() {
    take_the_rest();
    RL_ASSERT(ledger.total() == 2);
  }
};

/// The same in small: one message, one taker.
struct OneTakenFromAnOrphan : Scene<OneTakenFromAnOrphan, 2> {
  OneTakenFromAnOrphan() : Scene({.blocks = 1, .depth = 1, .readers = 1, .taken = true}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(taker.join(start(2), 0, 1, 1));
    start(1);
    RL_ASSERT(publisher.send());
    segment.end_process(4);
  }
  void thread(unsigned t) {
    if (t != 0) {
      RL_ASSERT(taker.take(ledger.entry()));
      return;
    }
    process(1).see_reaped(4);
    const Word b = process(1).loan();
    if (b != Process::kNone) process(1).write(b, 99);
  }
  Publisher publisher;
  Subscriber taker;
  Ledger ledger;
};

/// A publisher closes its ring while two take from it: what is left is theirs.
struct TakenRingIsClosed : TwoTakers<TakenRingIsClosed, 3, true, 2> {
  TakenRingIsClosed() : TwoTakers(2) {}
  void prepare() {
    open();
    for (int i = 0; i < 2; ++i) RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t != 0) {
      take(t - 1);
      return;
    }
    publisher.close();
    const Word b = process(4).loan();
    if (b != Process::kNone) process(4).write(b, 99);
  }
  void check() {
    take_the_rest();
    RL_ASSERT(ledger.total() == 2);
  }
};

/// A queue ends from which all was taken: it goes, although one of its subscribers, which lives,
/// has not looked.
struct EndedWithNothingToTake : Scene<EndedWithNothingToTake, 2> {
  EndedWithNothingToTake() : Scene({.blocks = 2, .depth = 1, .readers = 2, .taken = true}) {}
  void prepare() {
    idle.join(start(3));
    publisher.open(start(4), 0, true);
    RL_ASSERT(taker.join(start(2), 0, 1, 1));
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(publisher.send());
      process(4).leave();
      return;
    }
    while (taker.received() == 0) {
      if (!taker.take([](std::uint64_t) {})) Policy::pause();
    }
    taker.leave();
    process(2).leave();
  }
  void check() {
    RL_ASSERT(process(3).segment().channels[0].who[0].load(std::memory_order_seq_cst) == 3 + 1);
    process(3).collect();
    const Word writer = segment.channels[0].writer.load(std::memory_order_seq_cst);
    RL_ASSERT(ring::writer_state(writer) == ring::State::Free);
  }
  Publisher publisher;
  Subscription idle;
  Subscriber taker;
};

const Entered entered{
    {"ended_with_nothing_to_take", "an empty queue that has ended awaits no subscriber",
     cast_of<EndedWithNothingToTake>, 1},
    {"both_want_one", "one of two gets a message, and then it may be overwritten",
     cast_of<BothWantOne>, 2},
    {"taken_over_one_slot", "each message is taken once, and is its taker's alone",
     cast_of<TakenOverOneSlot>, 1},
    {"taken_over_two_slots", "the same over two slots", cast_of<TakenOverTwoSlots>, 1},
    {"taken_or_overwritten_one_slot", "the same where what nobody takes in time is lost",
     cast_of<TakenOrOverwrittenOneSlot>, 1},
    {"taken_or_overwritten_two_slots", "the same over two slots",
     cast_of<TakenOrOverwrittenTwoSlots>, 1},
    {"evicted_while_taken_one_slot", "a message is taken or evicted, and its block is one's alone",
     cast_of<EvictedWhileTakenOneSlot>, 1},
    {"evicted_while_taken_two_slots", "the same over two slots", cast_of<EvictedWhileTakenTwoSlots>,
     1},
    {"taker_killed_while_evicted", "what the dead has not taken is taken or evicted",
     cast_of<TakerKilledWhileEvicted>, 1},
    {"evicted_block_changes_hands", "nobody gets an evicted block while a taker looks at it",
     cast_of<EvictedBlockChangesHands>, 4},
    {"takers_sleep_over_one_slot", "takers and sender never all sleep",
     cast_of<TakersSleepOverOneSlot>},
    {"takers_sleep_over_two_slots", "the same over two slots", cast_of<TakersSleepOverTwoSlots>},
    {"taker_makes_room", "a taker rings the sender that sleeps", cast_of<TakerMakesRoom>, 2},
    {"taker_killed", "what the dead has not taken is its neighbour's", cast_of<TakerKilled>, 1},
    {"taker_killed_overwrite", "the same where the sender overwrites",
     cast_of<TakerKilledOverwrite>, 1},
    {"taker_killed_for_room", "a sender hears of the room that a dead taker has made",
     cast_of<TakerKilledForRoom>},
    {"publisher_killed_while_taken", "takers get what was published, each once, then the end",
     cast_of<PublisherKilledWhileTaken>},
    {"publisher_killed_while_taken_overwrite", "the same, or it is overwritten",
     cast_of<PublisherKilledWhileTakenOverwrite>},
    {"taken_from_an_orphan", "what is taken from an orphan is not freed",
     cast_of<TakenFromAnOrphan>, 1},
    {"one_taken_from_an_orphan", "the same with one message", cast_of<OneTakenFromAnOrphan>, 2},
    {"taken_ring_is_closed", "what is left in a closed ring is taken, each once",
     cast_of<TakenRingIsClosed>, 1},

    {"both_want_one_in_slots", "one of two gets a message, and its copy is whole",
     cast_of<InSlots<BothWantOne>>, 2},
    {"taken_over_one_slot_in_slots", "each message is taken once, and whole",
     cast_of<InSlots<TakenOverOneSlot>>, 1},
    {"taken_over_two_slots_in_slots", "the same over two slots",
     cast_of<InSlots<TakenOverTwoSlots>>, 1},
    {"taken_or_overwritten_one_slot_in_slots", "the same where what no taker takes in time is lost",
     cast_of<InSlots<TakenOrOverwrittenOneSlot>>, 1},
    {"taken_or_overwritten_two_slots_in_slots", "the same over two slots",
     cast_of<InSlots<TakenOrOverwrittenTwoSlots>>, 1},
    {"takers_sleep_over_one_slot_in_slots", "takers and sender never all sleep",
     cast_of<InSlots<TakersSleepOverOneSlot>>},
    {"taker_makes_room_in_slots", "a taker rings the sender that sleeps",
     cast_of<InSlots<TakerMakesRoom>>, 2},
    {"taker_killed_in_slots", "what the dead has not taken is its neighbour's",
     cast_of<InSlots<TakerKilled>>, 1},
    {"taker_killed_overwrite_in_slots", "the same where the sender overwrites",
     cast_of<InSlots<TakerKilledOverwrite>>, 1},
    {"taker_killed_for_room_in_slots", "a sender hears of the room that a dead taker has made",
     cast_of<InSlots<TakerKilledForRoom>>},
    {"publisher_killed_while_taken_in_slots",
     "takers get what was published, each once, then the end",
     cast_of<InSlots<PublisherKilledWhileTaken>>},
    {"publisher_killed_while_taken_overwrite_in_slots", "the same, or it is overwritten",
     cast_of<InSlots<PublisherKilledWhileTakenOverwrite>>},
    {"taken_from_an_orphan_in_slots", "what is left in an ended ring is taken, and whole",
     cast_of<InSlots<TakenFromAnOrphan>>, 1},
    {"taken_ring_is_closed_in_slots", "what is left in a closed ring is taken, each once",
     cast_of<InSlots<TakenRingIsClosed>>, 1},
};

}  // namespace
}  // namespace lot::model
