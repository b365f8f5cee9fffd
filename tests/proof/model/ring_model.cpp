// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"
#include "world.hpp"

/// Rings without deaths: who may read what, who sleeps, who joins late.
namespace lot::model {
namespace {

/// Two readers borrow from an overwriting publisher that has hardly any blocks.
struct OverwriteBorrow : Scene<OverwriteBorrow, 3> {
  OverwriteBorrow() : Scene({.blocks = 3, .depth = 2, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    for (int i = 0; i < 3; ++i) publisher.send();
    for (unsigned i : {0U, 1U}) RL_ASSERT(subscribers[i].join(start(2 + i), 0, 1, 2));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) publisher.send();
    } else {
      for (int i = 0; i < 2; ++i) subscribers[t - 1].receive();
    }
  }
  Publisher publisher;
  Subscriber subscribers[2];
};

/// The same, and the readers keep what they borrowed.
struct OverwriteKeep : Scene<OverwriteKeep, 3> {
  OverwriteKeep() : Scene({.blocks = 3, .depth = 2, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    for (int i = 0; i < 3; ++i) publisher.send();
    for (unsigned i : {0U, 1U}) RL_ASSERT(subscribers[i].join(start(2 + i), 0, 1, 2));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) publisher.send();
    } else {
      for (int i = 0; i < 2; ++i) subscribers[t - 1].receive_and_keep();
    }
  }
  Publisher publisher;
  Subscriber subscribers[2];
};

/// The smallest ring: one slot, one reader, one spare block. Small enough for the bounded search.
struct OneSlot : Scene<OneSlot, 2> {
  OneSlot() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) publisher.send();
    } else if (!subscriber.receive()) {
      subscriber.receive_and_keep();
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// Under back-pressure nothing is lost; a publisher without room refuses.
struct BlockingLossless : Scene<BlockingLossless, 3> {
  BlockingLossless() : Scene({.blocks = 3, .depth = 2, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    for (unsigned i : {0U, 1U}) RL_ASSERT(subscribers[i].join(start(2 + i), 0, 1, 1));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 5; ++i) publisher.send();
    } else {
      for (int i = 0; i < 3; ++i) subscribers[t - 1].receive();
    }
  }
  void check() {
    for (Subscriber& subscriber : subscribers) {
      while (subscriber.receive()) {
      }
      RL_ASSERT(subscriber.missed() == 0 && subscriber.received() == publisher.sent());
    }
  }
  Publisher publisher;
  Subscriber subscribers[2];
};

/// An observer of a lossless ring borrows and keeps: what it looks at is never written, and neither
/// the publisher nor the reader waits for it.
struct ObserverBorrows : Scene<ObserverBorrows, 3> {
  ObserverBorrows() : Scene({.blocks = 3, .depth = 2, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(reader.join(start(2), 0, 1, 0));
    RL_ASSERT(observer.join(start(3), 0, 1, 0, Subscriber::Manner::Observes));
    for (int i = 0; i < 2; ++i) RL_ASSERT(publisher.send() && reader.receive());
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 4; ++i) {
        publisher.send();
        publisher.scan();
      }
    } else if (t == 1) {
      for (int i = 0; i < 3; ++i) reader.receive();
    } else {
      observer.receive();
      observer.receive_and_keep();
    }
  }
  void check() {
    while (reader.receive()) {
    }
    RL_ASSERT(reader.missed() == 0 && reader.received() == publisher.sent());
    publisher.scan();
    // The observer stands still behind a message, then at the end.
    for (const std::uint64_t end : {10U, 14U}) {
      while (publisher.sent() < end) {
        RL_ASSERT(publisher.send());
        RL_ASSERT(reader.receive());
        publisher.scan();
      }
      while (observer.receive()) {
      }
      publisher.scan();
    }
  }
  Publisher publisher;
  Subscriber reader, observer;
};

/// The same with one slot and no reader, while the observer joins: small enough for the bounded
/// search.
struct ObserverJoins : Scene<ObserverJoins, 2> {
  ObserverJoins() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    start(2);
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) {
        publisher.send();
        publisher.scan();
      }
    } else {
      RL_ASSERT(observer.join(process(2), 0, 1, 1, Subscriber::Manner::Observes));
      observer.receive();
    }
  }
  Publisher publisher;
  Subscriber observer;
};

/// A lossless publisher takes back what its reader has read, while an observer looks at it.
struct ObserverAgainstTakingBack : Scene<ObserverAgainstTakingBack, 2> {
  ObserverAgainstTakingBack() : Scene({.blocks = 3, .depth = 2, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(observer.join(start(2), 0, 1, 0, Subscriber::Manner::Observes));
    for (int i = 0; i < 2; ++i) publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.take_back(0);
      publisher.scan();
      publisher.send();
    } else {
      for (int i = 0; i < 2; ++i) observer.receive();
    }
  }
  Publisher publisher;
  Subscriber observer;
};

/// Readers that sleep for each message get all of them, if they are not lapped.
struct Sleepers : Scene<Sleepers, 3> {
  Sleepers() : Scene({.blocks = 4, .depth = 2, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    for (unsigned i : {0U, 1U}) RL_ASSERT(subscribers[i].join(start(2 + i), 0, 1, 1));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) RL_ASSERT(publisher.send());
      return;
    }
    Subscriber& subscriber = subscribers[t - 1];
    while (subscriber.received() < 2) {
      if (!subscriber.receive()) subscriber.sleep();
    }
  }
  Publisher publisher;
  Subscriber subscribers[2];
};

/// Sender and reader sleep for each other and neither sleeps for ever.
struct BothSleep : Scene<BothSleep, 2> {
  static constexpr unsigned kMessages = 4;
  BothSleep() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (unsigned i = 0; i < kMessages; ++i) publisher.send_and_wait();
      return;
    }
    while (subscriber.received() < kMessages) {
      if (!subscriber.receive()) subscriber.sleep();
    }
  }
  void check() { RL_ASSERT(subscriber.missed() == 0); }
  Publisher publisher;
  Subscriber subscriber;
};

/// A joiner of a blocking ring finds its place, or gets it from the sender, and then misses
/// nothing.
struct LateJoinerBlocking : Scene<LateJoinerBlocking, 3> {
  LateJoinerBlocking() : Scene({.blocks = 4, .depth = 2, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(first.join(start(2), 0, 1, 0));
    publisher.send();
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 4; ++i) publisher.send();
    } else if (t == 1) {
      for (int i = 0; i < 3; ++i) first.receive();
    } else {
      RL_ASSERT(late.join(process(3), 0, 1, 2));
      for (int i = 0; i < 3; ++i) late.receive();
    }
  }
  void check() { RL_ASSERT(first.missed() == 0 && late.missed() == 0); }
  Publisher publisher;
  Subscriber first, late;
};

/// A sender that sleeps for room while somebody joins gets all its messages out in the end.
struct JoinerWhileSenderSleeps : Scene<JoinerWhileSenderSleeps, 2> {
  static constexpr unsigned kMessages = 3;
  JoinerWhileSenderSleeps() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    publisher.send();
    start(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (unsigned i = 0; i < kMessages; ++i) publisher.send_and_wait();
      return;
    }
    RL_ASSERT(subscriber.join(process(2), 0, 1, 1));
    while (subscriber.number() < 1 + kMessages) {
      if (!subscriber.receive()) subscriber.sleep();
    }
  }
  void check() { RL_ASSERT(subscriber.missed() == 0); }
  Publisher publisher;
  Subscriber subscriber;
};

/// The same without any other reader, whom the sender might have waited for.
struct OnlyJoinerBlocking : Scene<OnlyJoinerBlocking, 2> {
  OnlyJoinerBlocking() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    start(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 4; ++i) publisher.send();
    } else {
      RL_ASSERT(subscriber.join(process(2), 0, 1, 2));
      for (int i = 0; i < 2; ++i) subscriber.receive();
    }
  }
  void check() { RL_ASSERT(subscriber.missed() == 0); }
  Publisher publisher;
  Subscriber subscriber;
};

/// A joiner that borrows at once is on the publisher's list, or starts behind what was overwritten.
struct LateJoinerOverwrite : Scene<LateJoinerOverwrite, 2> {
  LateJoinerOverwrite() : Scene({.blocks = 3, .depth = 2, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    start(3);
    for (int i = 0; i < 3; ++i) publisher.send();
    publisher.scan();
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) publisher.send();
    } else {
      RL_ASSERT(subscriber.join(process(3), 0, 1, 2));
      for (int i = 0; i < 2; ++i) subscriber.receive();
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// A reader that joins while the first messages of a ring are sent, and wants the past, is not told
/// that it has missed more than there were.
struct JoinsAtTheFirst : Scene<JoinsAtTheFirst, 2> {
  JoinsAtTheFirst() : Scene({.blocks = 3, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    start(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) publisher.send();
    } else {
      RL_ASSERT(subscriber.join(process(2), 0, 1, 1));
      subscriber.receive();
    }
  }
  void check() {
    while (subscriber.receive()) {
    }
    RL_ASSERT(subscriber.received() + subscriber.missed() <= publisher.sent());
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// A publisher that takes its oldest messages back does not take them from under a borrower, and a
/// reader counts them as missed.
struct EvictAgainstBorrow : Scene<EvictAgainstBorrow, 2> {
  EvictAgainstBorrow() : Scene({.blocks = 2, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 2));
    for (int i = 0; i < 2; ++i) publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) {
        if (!publisher.send()) publisher.evict();
      }
    } else {
      for (int i = 0; i < 2; ++i) {
        if (!(rl::rand(2) != 0 ? subscriber.receive() : subscriber.receive_and_keep())) {
          subscriber.ended();
        }
      }
    }
  }
  void check() {
    while (subscriber.receive()) {
    }
    RL_ASSERT(subscriber.received() + subscriber.missed() == publisher.sent());
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// A lossless publisher that takes back what all have read takes it from under nobody, and nobody
/// misses a message: neither a reader, nor one that joins meanwhile and wants the past.
struct TakesBackWhatWasRead : Scene<TakesBackWhatWasRead, 3> {
  TakesBackWhatWasRead() : Scene({.blocks = 2, .depth = 3, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(first.join(start(2), 0, 1, 1));
    for (int i = 0; i < 2; ++i) RL_ASSERT(publisher.send());
    RL_ASSERT(first.receive());
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) {
        if (!publisher.send()) publisher.evict();
      }
    } else if (t == 1) {
      for (int i = 0; i < 2; ++i) rl::rand(2) != 0 ? first.receive() : first.receive_and_keep();
    } else {
      RL_ASSERT(late.join(process(3), 0, 1, 2));
      for (int i = 0; i < 2; ++i) rl::rand(2) != 0 ? late.receive() : late.receive_and_keep();
    }
  }
  void check() {
    for (Subscriber* subscriber : {&first, &late}) {
      while (subscriber->receive()) {
      }
      RL_ASSERT(subscriber->missed() == 0 && subscriber->number() == publisher.sent());
    }
    RL_ASSERT(first.received() == publisher.sent());
  }
  Publisher publisher;
  Subscriber first, late;
};

/// The same with nobody but the joiner. Small enough for the bounded search.
struct TakesBackFromAJoiner : Scene<TakesBackFromAJoiner, 2> {
  TakesBackFromAJoiner() : Scene({.blocks = 2, .depth = 3, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    for (int i = 0; i < 2; ++i) RL_ASSERT(publisher.send());
    start(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      if (publisher.evict()) RL_ASSERT(publisher.send());
    } else {
      RL_ASSERT(subscriber.join(process(2), 0, 1, 2));
      for (int i = 0; i < 2; ++i) subscriber.receive();
    }
  }
  void check() {
    while (subscriber.receive()) {
    }
    RL_ASSERT(subscriber.missed() == 0 && subscriber.number() == publisher.sent());
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// Each message has room here, so nothing is overwritten: a publisher that takes back what all have
/// read takes nothing that a reader has yet to read, and nothing from under a borrower or a joiner.
template <bool kBlocking>
struct ReadIsReused : Scene<ReadIsReused<kBlocking>, 3> {
  ReadIsReused() : Scene<ReadIsReused, 3>({.blocks = 3, .depth = 4, .readers = 2}) {}
  void prepare() {
    publisher.open(this->start(4), 0, kBlocking);
    RL_ASSERT(first.join(this->start(2), 0, 1, 1));
    RL_ASSERT(publisher.send());
    this->start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (std::uint32_t i = 0; i < 3; ++i) {
        publisher.take_back(i % 2);
        publisher.send();
      }
    } else if (t == 1) {
      for (int i = 0; i < 2; ++i) rl::rand(2) != 0 ? first.receive() : first.receive_and_keep();
    } else {
      RL_ASSERT(late.join(this->process(3), 0, 1, 2));
      for (int i = 0; i < 2; ++i) rl::rand(2) != 0 ? late.receive() : late.receive_and_keep();
    }
  }
  void check() {
    for (Subscriber* subscriber : {&first, &late}) {
      while (subscriber->receive()) {
      }
    }
    RL_ASSERT(first.missed() == 0 && first.received() == publisher.sent());
    publisher.take_back(0);
    RL_ASSERT(!publisher.evict());
  }
  Publisher publisher;
  Subscriber first, late;
};

/// The same with one reader. Small enough for the bounded search.
struct ReadIsReusedByOne : Scene<ReadIsReusedByOne, 2> {
  ReadIsReusedByOne() : Scene({.blocks = 2, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 0));
    RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.take_back(0);
      RL_ASSERT(publisher.send());
    } else {
      subscriber.receive();
    }
  }
  void check() {
    while (subscriber.receive()) {
    }
    RL_ASSERT(subscriber.missed() == 0 && subscriber.received() == publisher.sent());
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// A reader leaves in the middle of a borrow, and another one joins.
struct LeavesInABorrow : Scene<LeavesInABorrow, 3> {
  LeavesInABorrow() : Scene({.blocks = 2, .depth = 1, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(leaver.join(start(2), 0, 1, 1));
    publisher.send();
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) publisher.send();
    } else if (t == 1) {
      if (const Word b = leaver.borrow(); b != kNoBlock) {
        RL_ASSERT(process(2).read(b) == leaver.number());
      }
      leaver.leave();
    } else {
      RL_ASSERT(joiner.join(process(3), 0, 1, 1));
    }
  }
  Publisher publisher;
  Subscriber leaver, joiner;
};

/// What is only for prefetching may be wrong, but no more than that.
struct Hints : Scene<Hints, 2> {
  Hints() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.writer().upcoming(1);
      publisher.send();
      publisher.writer().upcoming(0);
    } else {
      RL_ASSERT(subscriber.reader().ready());
      const Word soon = subscriber.reader().peek(0);
      RL_ASSERT(soon == kNoBlock || soon < segment.shape.blocks);
      subscriber.reader().peek(1);
      RL_ASSERT(subscriber.reader().size() <= 2);
      RL_ASSERT(subscriber.receive());
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// Somebody joins a ring as soon as it sees it, without the lock under which rings are made.
struct JoinsWhatIsLive : Scene<JoinsWhatIsLive, 2> {
  JoinsWhatIsLive() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    start(4);
    start(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.open(process(4), 0, false);
      return;
    }
    const ring::Ring<Policy> ring = process(2).ring(0);
    bool full = false;
    if (ring.depth == 0) return;
    const auto reader = ring::Reader<Policy>::join(ring, 1, 2, 1, full);
    RL_ASSERT(!reader || reader->cursor() == Segment::kFirst);
  }
  Publisher publisher;
};

/// A puller that was counted before finds its cell as soon as it sees the ring. Its view of the
/// ring is older, and it takes no lock: only the writer word tells it what was made (R7).
struct AdoptsWhatIsLive : Scene<AdoptsWhatIsLive, 2> {
  AdoptsWhatIsLive() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    start(4);
    view = start(2).unformed_ring(0);
    segment.pullers[2].fetch_add(1, std::memory_order_relaxed);
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.open(process(4), 0, false);
      return;
    }
    const Word writer = view.writer->load(std::memory_order_relaxed);
    if (ring::writer_state(writer) != ring::State::Live) return;
    const auto reader = ring::Reader<Policy>::take_awaited(view, 2);
    RL_ASSERT(reader && reader->cursor() == Segment::kFirst);
  }
  Publisher publisher;
  ring::Ring<Policy> view;
};

/// A cell has one reader after the other, and the second one is not taken for the first.
struct CellChangesHands : Scene<CellChangesHands, 3> {
  CellChangesHands() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(leaver.join(start(2), 0, 1, 1));
    publisher.send();
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.send();
    } else if (t == 1) {
      leaver.receive();
      leaver.leave();
    } else if (joiner.join(process(3), 0, 1, 1)) {
      joiner.receive();
    }
  }
  Publisher publisher;
  Subscriber leaver, joiner;
};

/// Sender and reader sleep for each other over one slot.
struct BothSleepOverOneSlot : Scene<BothSleepOverOneSlot, 2> {
  static constexpr unsigned kMessages = 2;
  BothSleepOverOneSlot() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (unsigned i = 0; i < kMessages; ++i) publisher.send_and_wait();
      return;
    }
    while (subscriber.received() < kMessages) {
      if (!subscriber.receive()) subscriber.sleep();
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// A reader that leaves lets a sleeping sender go on.
struct LeaverFreesSender : Scene<LeaverFreesSender, 2> {
  LeaverFreesSender() : Scene({.blocks = 3, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) publisher.send_and_wait();
    } else {
      subscriber.receive();
      subscriber.leave();
      process(2).leave();
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

const Entered entered{
    {"overwrite_borrow", "a borrowed block is never written", cast_of<OverwriteBorrow>, 1},
    {"overwrite_keep", "a kept block is never written", cast_of<OverwriteKeep>, 1},
    {"one_slot", "the same on the smallest ring", cast_of<OneSlot>, 2},
    {"blocking_lossless", "under back-pressure nobody misses a message", cast_of<BlockingLossless>,
     1},
    {"observer_borrows", "an observer of a lossless ring holds nobody up, and reads whole messages",
     cast_of<ObserverBorrows>, 1},
    {"observer_joins", "the same while it joins", cast_of<ObserverJoins>, 2},
    {"observer_against_taking_back", "the same while the publisher takes messages back",
     cast_of<ObserverAgainstTakingBack>, 2},
    {"sleepers", "a sleeping reader is woken by each message", cast_of<Sleepers>, 2},
    {"both_sleep", "sender and reader never both sleep for ever", cast_of<BothSleep>, 2},
    {"late_joiner_blocking", "a late joiner misses nothing from its start on",
     cast_of<LateJoinerBlocking>, 1},
    {"joiner_while_sender_sleeps", "a joiner does not put the sender to sleep for ever",
     cast_of<JoinerWhileSenderSleeps>, 2},
    {"only_joiner_blocking", "the same when the sender need not wait for others",
     cast_of<OnlyJoinerBlocking>, 3},
    {"late_joiner_overwrite", "what a late joiner borrows is never written",
     cast_of<LateJoinerOverwrite>, 2},
    {"joins_at_the_first", "a joiner misses no more than there were", cast_of<JoinsAtTheFirst>, 2},
    {"evict_against_borrow", "an evicted block is not taken from a borrower",
     cast_of<EvictAgainstBorrow>, 2},
    {"takes_back_what_was_read", "a lossless ring gives up what was read, and readers miss nothing",
     cast_of<TakesBackWhatWasRead>, 1},
    {"takes_back_from_a_joiner", "the same while somebody joins who wants the past",
     cast_of<TakesBackFromAJoiner>, 3},
    {"read_is_reused", "what all have read is taken back, and no reader misses a message",
     cast_of<ReadIsReused<false>>, 1},
    {"read_is_reused_lossless", "the same without loss", cast_of<ReadIsReused<true>>, 1},
    {"read_is_reused_by_one", "the same with one reader", cast_of<ReadIsReusedByOne>, 3},
    {"leaves_in_a_borrow", "what a leaver has borrowed is not written before it has read",
     cast_of<LeavesInABorrow>, 2},
    {"hints", "a hint that is wrong does no harm", cast_of<Hints>, 2},
    {"joins_what_is_live", "a live ring is a complete ring", cast_of<JoinsWhatIsLive>, 3},
    {"adopts_what_is_live", "a cell that awaits its reader is there as soon as the ring is live",
     cast_of<AdoptsWhatIsLive>, 3},
    {"cell_changes_hands", "a cell has one reader after the other", cast_of<CellChangesHands>, 2},
    {"both_sleep_over_one_slot", "sender and reader take turns", cast_of<BothSleepOverOneSlot>, 3},
    {"leaver_frees_sender", "a reader that leaves lets a sleeping sender go on",
     cast_of<LeaverFreesSender>, 2},

    {"overwrite_borrow_in_slots", "a copy of a message is whole, or the message counts as missed",
     cast_of<InSlots<OverwriteBorrow>>, 1},
    {"one_slot_in_slots", "the same on the smallest ring", cast_of<InSlots<OneSlot>>, 2},
    {"blocking_lossless_in_slots", "without loss each copy is whole",
     cast_of<InSlots<BlockingLossless>>, 1},
    {"observer_borrows_in_slots", "an observer's copy is whole, or it has missed the message",
     cast_of<InSlots<ObserverBorrows>>, 1},
    {"observer_joins_in_slots", "the same while it joins", cast_of<InSlots<ObserverJoins>>, 2},
    {"sleepers_in_slots", "a sleeping reader is woken by each message", cast_of<InSlots<Sleepers>>,
     2},
    {"both_sleep_in_slots", "sender and reader never both sleep for ever",
     cast_of<InSlots<BothSleep>>, 2},
    {"both_sleep_over_one_slot_in_slots", "sender and reader take turns",
     cast_of<InSlots<BothSleepOverOneSlot>>, 3},
    {"late_joiner_blocking_in_slots", "a late joiner misses nothing from its start on",
     cast_of<InSlots<LateJoinerBlocking>>, 1},
    {"late_joiner_overwrite_in_slots", "what a late joiner copies is whole",
     cast_of<InSlots<LateJoinerOverwrite>>, 2},
    {"joins_at_the_first_in_slots", "a joiner misses no more than there were",
     cast_of<InSlots<JoinsAtTheFirst>>, 2},
    {"only_joiner_blocking_in_slots", "a joiner does not lose what the sender sends meanwhile",
     cast_of<InSlots<OnlyJoinerBlocking>>, 3},
    {"read_is_reused_in_slots", "what all have read is taken back, and no reader misses a message",
     cast_of<InSlots<ReadIsReused<false>>>, 1},
    {"read_is_reused_lossless_in_slots", "the same without loss",
     cast_of<InSlots<ReadIsReused<true>>>, 1},
    {"joins_what_is_live_in_slots", "a live ring is a complete ring",
     cast_of<InSlots<JoinsWhatIsLive>>, 3},
};

}  // namespace
}  // namespace lot::model
