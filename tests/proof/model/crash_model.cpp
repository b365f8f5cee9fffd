// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"
#include "subscription.hpp"

/// Deaths anywhere, and what the reaper makes of them.
namespace lot::model {
namespace {

/// The publisher is killed anywhere. A reader that may sleep gets all that was published, then the
/// end.
template <class Derived, bool kBlocking>
struct PublisherKilledScene : Scene<Derived, 3> {
  PublisherKilledScene() : Scene<Derived, 3>({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(this->start(4), 0, kBlocking);
    RL_ASSERT(subscriber.join(this->start(2), 0, 1, 1));
    this->start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      this->die_within(4, 90, [this] {
        for (int i = 0; i < 3; ++i) publisher.send();
      });
    } else if (t == 1) {
      while (true) {
        if (rl::rand(2) != 0 ? subscriber.receive() : subscriber.receive_and_keep()) continue;
        if (subscriber.ended()) break;
        subscriber.sleep();
      }
      subscriber.leave();
      this->process(2).collect();
    } else {
      this->segment.await_end_of(4);
      this->process(3).see_reaped(4);
    }
  }
  void check() {
    // The message in flight may or may not have come out.
    const std::uint64_t seen = subscriber.received() + subscriber.missed();
    RL_ASSERT(seen == publisher.sent() || seen == publisher.sent() + 1);
    if (kBlocking) RL_ASSERT(subscriber.missed() == 0);
  }
  Publisher publisher;
  Subscriber subscriber;
};
struct PublisherKilledOverwrite : PublisherKilledScene<PublisherKilledOverwrite, false> {};
struct PublisherKilledBlocking : PublisherKilledScene<PublisherKilledBlocking, true> {};

/// A lossless publisher is killed while it takes back what was read, or a joiner is that wants the
/// past. The others miss nothing.
template <class Derived, std::uint32_t kVictim>
struct KilledWhileTakenBack : Scene<Derived, 3> {
  KilledWhileTakenBack() : Scene<Derived, 3>({.blocks = 2, .depth = 3, .readers = 2}) {}
  void prepare() {
    publisher.open(this->start(4), 0, true);
    RL_ASSERT(subscriber.join(this->start(2), 0, 1, 1));
    for (int i = 0; i < 2; ++i) RL_ASSERT(publisher.send());
    RL_ASSERT(subscriber.receive());
    this->start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      dies_if(4, 60, [this] {
        for (int i = 0; i < 4; ++i) {
          if (!publisher.send()) publisher.evict();
        }
      });
    } else if (t == 1) {
      subscriber.receive();
      this->segment.await_end_of(kVictim);
      this->process(2).see_reaped(kVictim);
    } else {
      dies_if(3, 40, [this] {
        if (!joiner.join(this->process(3), 0, 1, 2)) return;
        for (int i = 0; i < 2; ++i) joiner.receive();
        has_joined = true;
      });
    }
  }
  void check() {
    for (Subscriber* reader : {&subscriber, &joiner}) {
      if (reader == &joiner && (!has_joined || kVictim == 3)) continue;
      while (reader->receive()) {
      }
      RL_ASSERT(reader->missed() == 0);
      // The message in flight may or may not have come out.
      RL_ASSERT(reader->number() == publisher.sent() || reader->number() == publisher.sent() + 1);
    }
  }
  template <class F>
  void dies_if(std::uint32_t k, unsigned steps, F&& f) {
    k == kVictim ? this->die_within(k, steps, f) : f();
  }
  Publisher publisher;
  Subscriber subscriber, joiner;
  bool has_joined = false;
};
struct KilledWhileItTakesBack : KilledWhileTakenBack<KilledWhileItTakesBack, 4> {};
struct KilledWhileItJoins : KilledWhileTakenBack<KilledWhileItJoins, 3> {};

/// The same in small: it is killed around the exchange, and reaped at once.
template <class Derived, bool kBlocking>
struct KilledAtTheExchangeScene : Scene<Derived, 2> {
  KilledAtTheExchangeScene() : Scene<Derived, 2>({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(this->start(4), 0, kBlocking);
    RL_ASSERT(subscriber.join(this->start(2), 0, 1, 1));
    this->start(3);
    block = this->process(4).loan();
    this->process(4).write(block, 0);
  }
  void thread(unsigned t) {
    if (t == 0) {
      this->die_within(4, 6, [this] { publisher.send_own(block); });
      this->process(3).see_reaped(4);
      return;
    }
    while (!subscriber.ended()) {
      if (!subscriber.receive()) subscriber.sleep();
    }
  }
  void check() {
    const std::uint64_t seen = subscriber.received();
    RL_ASSERT(seen == publisher.sent() || seen == publisher.sent() + 1);
  }
  Publisher publisher;
  Subscriber subscriber;
  Word block = kNoBlock;
};
struct KilledAtTheExchange : KilledAtTheExchangeScene<KilledAtTheExchange, false> {};
struct KilledAtTheExchangeBlocking : KilledAtTheExchangeScene<KilledAtTheExchangeBlocking, true> {};

/// The publisher is killed while it sends its second message into a ring of one: its reader finds
/// the first one there, or the second one.
struct KilledWhileItWritesOver : Scene<KilledWhileItWritesOver, 2> {
  KilledWhileItWritesOver() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(publisher.send());
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(4, 10, [this] { publisher.send(); });
      process(3).see_reaped(4);
      return;
    }
    segment.await_end_of(4);
    while (!subscriber.ended()) {
      if (!subscriber.receive()) subscriber.sleep();
    }
  }
  void check() {
    const std::uint64_t got = subscriber.received();
    RL_ASSERT(got >= 1 && got + subscriber.missed() <= 2);
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// The publisher is killed while it makes its ring; the next one finds the channel free.
struct OpenerKilled : Scene<OpenerKilled, 2> {
  OpenerKilled() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    start(4);
    start(3);
    start(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(4, 20, [this] {
        if (killed.open(process(4), 0, false)) killed.send();
      });
      process(3).see_reaped(4);
      process(3).collect();
      if (next.open(process(3), 0, true)) next.send();
    } else if (subscriber.join(process(2), 0, 1 + rl::rand(2), 1)) {
      subscriber.receive();
      subscriber.leave();
    }
  }
  Publisher killed, next;
  Subscriber subscriber;
};

/// The same, and the next one waits for nothing but a free channel.
struct OpenerKilledAndFollowed : Scene<OpenerKilledAndFollowed, 2> {
  OpenerKilledAndFollowed() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    for (std::uint32_t k : {2U, 3U, 4U}) start(k);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(4, 8, [this] { killed.open(process(4), 0, false); });
      process(3).see_reaped(4);
    } else {
      while (!next.open(process(2), 0, true)) Policy::pause();
      RL_ASSERT(next.send());
    }
  }
  Publisher killed, next;
};

/// A reader is killed anywhere between joining and leaving; the publisher reaps it and gets every
/// block back.
struct ReaderKilled : Scene<ReaderKilled, 2> {
  ReaderKilled() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    start(2);
  }
  void thread(unsigned t) {
    if (t == 1) {
      die_within(2, 50, [this] {
        if (!subscriber.join(process(2), 0, 1, 1)) return;
        for (int i = 0; i < 2; ++i) subscriber.receive_and_keep();
        subscriber.leave();
      });
      return;
    }
    for (int i = 0; i < 3; ++i) publisher.send();
    segment.await_end_of(2);
    process(4).see_reaped(2);
    for (int i = 0; i < 4; ++i) RL_ASSERT(publisher.send());
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// A sender sleeps for a reader that is killed anywhere: the reaper lets it go on.
struct LaggardKilled : Scene<LaggardKilled, 3> {
  LaggardKilled() : Scene({.blocks = 4, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 0));
    start(3);
    for (int i = 0; i < 2; ++i) publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) publisher.send_and_wait();
    } else if (t == 1) {
      die_within(2, 25, [this] {
        for (int i = 0; i < 3; ++i) subscriber.receive();
      });
    } else {
      segment.await_end_of(2);
      process(3).see_reaped(2);
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// An observer is killed anywhere between joining and leaving. A lossless publisher finds room at
/// once, before the reap and after it, and gets every block back.
struct ObserverKilled : Scene<ObserverKilled, 2> {
  ObserverKilled() : Scene({.blocks = 3, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    start(2);
    RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 1) {
      die_within(2, 30, [this] {
        if (!observer.join(process(2), 0, 1, 1, Subscriber::Manner::Observes)) return;
        for (int i = 0; i < 2; ++i) observer.receive();
        observer.leave();
      });
      return;
    }
    send(2);
    segment.await_end_of(2);
    process(4).see_reaped(2);
    send(3);
  }
  void send(int count) {
    for (int i = 0; i < count; ++i) {
      RL_ASSERT(publisher.send());
      publisher.scan();
    }
  }
  Publisher publisher;
  Subscriber observer;
};

/// A reader is killed while it joins, and reaped while the sender gives it a place.
struct JoinerKilledBesideSender : Scene<JoinerKilledBesideSender, 2> {
  JoinerKilledBesideSender() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    start(2);
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) publisher.send_and_wait();
    } else {
      die_within(2, 12, [this] { subscriber.join(process(2), 0, 1, 1); });
      process(3).see_reaped(2);
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// The sender itself reaps whoever holds it back.
struct SenderReapsLaggard : Scene<SenderReapsLaggard, 2> {
  SenderReapsLaggard() : Scene({.blocks = 3, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    start(2);
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) {
        while (!publisher.send()) {
          publisher.laggards([this](std::uint32_t k) { process(4).reap(k); });
          Policy::pause();
        }
      }
    } else {
      die_within(2, 25, [this] {
        if (subscriber.join(process(2), 0, 1, 1)) subscriber.receive();
      });
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// A reaper is killed anywhere and another one takes over; a sleeping reader gets all, then the
/// end.
struct ReaperKilled : Scene<ReaperKilled, 3> {
  ReaperKilled() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 2));
    for (std::uint32_t k : {1U, 3U}) start(k);
    for (int i = 0; i < 2; ++i) publisher.send();
    segment.end_process(4);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(3, 60, [this] { process(3).reap(4); });
    } else if (t == 1) {
      while (true) {
        if (subscriber.receive()) continue;
        if (subscriber.ended()) break;
        subscriber.sleep();
      }
      RL_ASSERT(subscriber.received() == 2);
      subscriber.leave();
      process(2).collect();
    } else {
      segment.await_end_of(3);
      process(1).see_reaped(4);
      process(1).see_reaped(3);
      process(1).collect();
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// The same in small, for a reader that the reaper has woken and that falls asleep again: it knows
/// the directory's new version.
struct ReaperKilledBesideSleeper : Scene<ReaperKilledBesideSleeper, 2> {
  ReaperKilledBesideSleeper() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    for (std::uint32_t k : {1U, 3U}) start(k);
    segment.end_process(4);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(3, 25, [this] { process(3).reap(4); });
      process(1).see_reaped(4);
      return;
    }
    for (;;) {
      const std::uint32_t version = segment.version.load(std::memory_order_acquire);
      if (subscriber.ended()) break;
      subscriber.sleep(version);
    }
    subscriber.leave();
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// In small, too: the next reaper follows at once, and the reader has read.
struct NextReaper : Scene<NextReaper, 2> {
  NextReaper() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    for (std::uint32_t k : {1U, 3U}) start(k);
    publisher.send();
    RL_ASSERT(subscriber.receive());
    segment.end_process(4);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(3, 45, [this] { process(3).reap(4); });
      process(1).see_reaped(4);
      process(1).see_reaped(3);
    } else {
      while (!subscriber.ended()) subscriber.sleep();
      subscriber.leave();
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// One reap leaves nothing of a publisher that nobody reads: its ring and its block can be had.
struct ReapFreesAll : Scene<ReapFreesAll, 2> {
  ReapFreesAll() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    publisher.send();
    segment.end_process(4);
    start(3);
  }
  void thread(unsigned t) {
    if (t != 0) return;
    RL_ASSERT(process(3).reap(4));
    RL_ASSERT(next.open(process(3), 0, false) && next.send());
  }
  Publisher publisher, next;
};

/// A block that a reap frees is claimed as soon as it is free.
struct FreedAndClaimed : Scene<FreedAndClaimed, 2> {
  FreedAndClaimed() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    publisher.send();
    segment.end_process(4);
    for (std::uint32_t k : {2U, 3U}) start(k);
  }
  void thread(unsigned t) {
    if (t == 0) {
      process(3).see_reaped(4);
      return;
    }
    Word b = process(2).loan();
    for (; b == Process::kNone; b = process(2).loan()) Policy::pause();
    RL_ASSERT(segment.references[b].read() == kNoBlock);
  }
  Publisher publisher;
};

/// A reader is killed anywhere, and a new process takes its index at once.
struct IndexReuse : Scene<IndexReuse, 3> {
  IndexReuse() : Scene({.blocks = 4, .depth = 2, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(killed.join(start(2), 0, 1, 1));
    start(3);
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 4; ++i) publisher.send();
    } else if (t == 1) {
      die_within(2, 30, [this] {
        for (int i = 0; i < 2; ++i) killed.receive_and_keep();
      });
    } else {
      segment.await_end_of(2);
      process(3).see_reaped(2);
      Process& heir = start(2);
      RL_ASSERT(next.join(heir, 0, 1, 1));
      for (int i = 0; i < 2; ++i) next.receive_and_keep();
    }
  }
  Publisher publisher;
  Subscriber killed, next;
};

/// A reader is killed, and another one waits for nothing but its place.
struct ReaderKilledAndFollowed : Scene<ReaderKilledAndFollowed, 2> {
  ReaderKilledAndFollowed() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    for (std::uint32_t k : {1U, 2U, 3U}) start(k);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(2, 12, [this] { killed.join(process(2), 0, 1, 1); });
      process(1).see_reaped(2);
    } else {
      while (!next.join(process(3), 0, 1, 1)) Policy::pause();
    }
  }
  void check() {
    const auto& cell = process(3).ring(0).cells[next.reader().cell()];
    RL_ASSERT(cell.position.load(std::memory_order_relaxed) != ring::kIdle);
  }
  Publisher publisher;
  Subscriber killed, next;
};

/// The same in small: killed while it keeps, reaped, and followed by the heir, one after the other.
struct HeirAtOnce : Scene<HeirAtOnce, 2> {
  HeirAtOnce() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(killed.join(start(2), 0, 1, 1));
    start(3);
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) publisher.send();
      return;
    }
    die_within(2, 12, [this] { killed.receive_and_keep(); });
    process(3).see_reaped(2);
    RL_ASSERT(next.join(start(2), 0, 1, 1));
    next.receive_and_keep();
  }
  Publisher publisher;
  Subscriber killed, next;
};

/// One publisher has died; its ring is reaped, freed and opened by the next one while somebody
/// joins the old generation.
struct TwoInSuccession : Scene<TwoInSuccession, 2> {
  TwoInSuccession() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    dead.open(start(4), 0, false);
    dead.send();
    segment.end_process(4);
    start(2);
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      process(3).reap(4);
      for (int i = 0; i < 2; ++i) {
        process(3).collect();
        if (!next.open(process(3), 0, false)) continue;
        for (int n = 0; n < 3; ++n) next.send();
        return;
      }
    } else if (subscriber.join(process(2), 0, 1, 1)) {
      for (int i = 0; i < 2; ++i) subscriber.receive();
      RL_ASSERT(subscriber.received() == 1);
      if (rl::rand(2) == 0) return;
      subscriber.leave();
      process(2).collect();
    }
  }
  Publisher dead, next;
  Subscriber subscriber;
};

/// A publisher ends cleanly, by reaping itself, while a reader borrows, keeps and finds the end.
struct CleanExit : Scene<CleanExit, 2> {
  CleanExit() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) publisher.send();
      process(4).leave();
      return;
    }
    while (true) {
      if (rl::rand(2) != 0 ? subscriber.receive() : subscriber.receive_and_keep()) continue;
      if (subscriber.ended()) break;
      subscriber.sleep();
    }
    RL_ASSERT(subscriber.received() + subscriber.missed() == publisher.sent());
    subscriber.leave();
    process(2).leave();
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// Who keeps a message dies, and a third process reaps it: the reads came before the bit is
/// cleared.
struct KeeperKilled : Scene<KeeperKilled, 2> {
  KeeperKilled() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    start(3);
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) publisher.send();
    } else {
      die_within(2, 20, [this] { subscriber.receive_and_keep(); });
      process(3).reap(2);
    }
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// A reader is reaped while a ring is made in memory that has its name in it.
struct ReapedWhileARingIsMade : Scene<ReapedWhileARingIsMade, 2> {
  ReapedWhileARingIsMade() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    for (std::uint32_t k : {1U, 3U, 4U, kSoiledBy}) start(k);
    segment.end_process(kSoiledBy);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(publisher.open(process(4), 0, true) && subscriber.join(process(3), 0, 1, 1));
      publisher.send();
      RL_ASSERT(!publisher.send());  // the reader holds it back
    } else {
      process(1).reap(kSoiledBy);
    }
  }
  void check() { RL_ASSERT(process(3).ring(0).who[0].load(std::memory_order_relaxed) == 3 + 1); }
  Publisher publisher;
  Subscriber subscriber;
};

/// A publisher that comes after the subscription is killed anywhere and reaped; the subscriber
/// looks now and then, and once all is over.
template <class Derived, bool kBlocking>
struct SubscriberLooksLateScene : Scene<Derived, 3> {
  SubscriberLooksLateScene() : Scene<Derived, 3>({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    subscription.join(this->start(2));
    this->start(3);
    this->start(4);
  }
  void thread(unsigned t) {
    if (t == 0) {
      this->die_within(4, 80, [this] {
        publisher.open(this->process(4), 0, kBlocking);
        for (int i = 0; i < 3; ++i) publisher.send();
      });
    } else if (t == 1) {
      for (int i = 0; i < 2; ++i) subscription.receive();
    } else {
      this->segment.await_end_of(4);
      this->process(3).see_reaped(4);
    }
  }
  void check() {
    while (subscription.receive()) {
    }
    // The message in flight may or may not have come out.
    const std::uint64_t seen = subscription.received() + subscription.missed();
    RL_ASSERT(seen == publisher.sent() || seen == publisher.sent() + 1);
    if (kBlocking) RL_ASSERT(subscription.missed() == 0);
  }
  Publisher publisher;
  Subscription subscription;
};
struct SubscriberLooksLate : SubscriberLooksLateScene<SubscriberLooksLate, false> {};
struct SubscriberLooksLateBlocking : SubscriberLooksLateScene<SubscriberLooksLateBlocking, true> {};

/// A subscriber that never looked is reaped while a ring is made for it. Its cell may not stay.
struct SubscriberReapedWhileARingIsMade : Scene<SubscriberReapedWhileARingIsMade, 2> {
  SubscriberReapedWhileARingIsMade() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    for (std::uint32_t k : {1U, 2U, 4U}) start(k);
    subscription.join(process(2));
    segment.end_process(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(publisher.open(process(4), 0, true));
    } else {
      process(1).see_reaped(2);
    }
  }
  void check() {
    RL_ASSERT(process(4).ring(0).who[0].load(std::memory_order_relaxed) == 0);
    RL_ASSERT(publisher.send());
  }
  Publisher publisher;
  Subscription subscription;
};

/// The same, and a living reader has the cell as soon as the maker of the ring has freed it: it
/// keeps the cell, and holds the sender back. Its view of the ring is older: else the look at
/// `formed`, which Relacy takes for a fence, would tell the reaper of what was before.
struct SubscriberReapedAndFollowed : Scene<SubscriberReapedAndFollowed, 3> {
  SubscriberReapedAndFollowed() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    for (std::uint32_t k : {1U, 2U, 3U, 4U}) start(k);
    subscription.join(process(2));
    segment.end_process(2);
    view = process(3).unformed_ring(0);
    view.blocking = true;
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(publisher.open(process(4), 0, view.blocking));
    } else if (t == 1) {
      RL_ASSERT(process(1).reap(2));
    } else {
      while (!join()) Policy::pause();
    }
  }
  bool join() {
    if (!process(3).lock_rings()) return false;
    bool full = false;
    const Word writer = view.writer->load(std::memory_order_relaxed);
    if (ring::writer_state(writer) == ring::State::Live) {
      next = ring::Reader<Policy>::join(view, ring::writer_generation(writer), 3, 1, full);
    }
    process(3).unlock_rings();
    return next.has_value();
  }
  void check() {
    RL_ASSERT(view.who[0].load(std::memory_order_relaxed) == 3 + 1);
    RL_ASSERT(publisher.send() && !publisher.writer().room());
    std::uint64_t missed = 0;
    RL_ASSERT(next->poll(missed) != kNoBlock && missed == 0);
    next->done();
    RL_ASSERT(publisher.writer().room());
  }
  Publisher publisher;
  Subscription subscription;
  ring::Ring<Policy> view;
  std::optional<ring::Reader<Policy>> next;
};

/// A subscriber goes without having looked, while a sender sleeps for room because of it.
struct SubscriberGoesUnseen : Scene<SubscriberGoesUnseen, 2> {
  SubscriberGoesUnseen() : Scene({.blocks = 3, .depth = 1, .readers = 1}) {}
  void prepare() {
    subscription.join(start(2));
    start(4);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(publisher.open(process(4), 0, true));
      for (int i = 0; i < 2; ++i) publisher.send_and_wait();
    } else {
      subscription.end();
    }
  }
  void check() { RL_ASSERT(process(4).ring(0).deserted()); }
  Publisher publisher;
  Subscription subscription;
};

const Entered entered{
    {"publisher_killed_overwrite", "readers get what was published, then the end",
     cast_of<PublisherKilledOverwrite>},
    {"publisher_killed_blocking", "the same under back-pressure, and miss nothing",
     cast_of<PublisherKilledBlocking>},
    {"killed_while_it_takes_back",
     "what a dead publisher has taken back is free, nothing is missed",
     cast_of<KilledWhileItTakesBack>},
    {"killed_while_it_joins", "a dead joiner does not keep what was read from coming back",
     cast_of<KilledWhileItJoins>},
    {"killed_at_the_exchange", "published or not, and never half", cast_of<KilledAtTheExchange>, 2},
    {"killed_at_the_exchange_blocking", "the same under back-pressure",
     cast_of<KilledAtTheExchangeBlocking>, 2},
    {"opener_killed", "a half-made ring is an empty orphan, and then free", cast_of<OpenerKilled>,
     2},
    {"opener_killed_and_followed", "a half-made ring can be had as soon as it is free",
     cast_of<OpenerKilledAndFollowed>, 1},
    {"reader_killed", "a dead reader's holds come back", cast_of<ReaderKilled>, 2},
    {"reader_killed_and_followed", "a dead reader's place can be had as soon as it is free",
     cast_of<ReaderKilledAndFollowed>, 2},
    {"laggard_killed", "a dead reader does not hold the sender back", cast_of<LaggardKilled>, 1},
    {"observer_killed", "a dead observer holds no lossless publisher up", cast_of<ObserverKilled>,
     2},
    {"joiner_killed_beside_sender", "a dead joiner does not, even if it gets a place meanwhile",
     cast_of<JoinerKilledBesideSender>, 2},
    {"sender_reaps_laggard", "a sender gets rid of whoever holds it back",
     cast_of<SenderReapsLaggard>, 1},
    {"reaper_killed", "a killed reaper is followed by another", cast_of<ReaperKilled>},
    {"reaper_killed_beside_sleeper", "a reader that sleeps again is woken by the next reaper",
     cast_of<ReaperKilledBesideSleeper>, 1},
    {"next_reaper", "the next reaper finds what the killed one has left", cast_of<NextReaper>, 1},
    {"reap_frees_all", "one reap leaves nothing of the dead", cast_of<ReapFreesAll>, 1},
    {"freed_and_claimed", "what a reap frees is free with its memory", cast_of<FreedAndClaimed>, 1},
    {"index_reuse", "a new process may have a dead one's index at once", cast_of<IndexReuse>},
    {"heir_at_once", "a dead reader's index is clean for the next", cast_of<HeirAtOnce>, 1},
    {"two_in_succession", "a ring is not recycled under a joiner", cast_of<TwoInSuccession>, 2},
    {"clean_exit", "a clean exit is a reap of oneself", cast_of<CleanExit>, 1},
    {"keeper_killed", "a dead keeper has read before its bit is cleared", cast_of<KeeperKilled>, 1},
    {"reaped_while_a_ring_is_made", "a reaper does not read what a ring's memory held before",
     cast_of<ReapedWhileARingIsMade>, 2},
    {"subscriber_looks_late", "what a dead publisher sent waits for who had subscribed",
     cast_of<SubscriberLooksLate>},
    {"subscriber_looks_late_blocking", "the same under back-pressure, and misses nothing",
     cast_of<SubscriberLooksLateBlocking>},
    {"subscriber_goes_unseen", "who never looked and goes holds no sender back",
     cast_of<SubscriberGoesUnseen>, 2},
    {"subscriber_reaped_while_a_ring_is_made", "no cell awaits a dead subscriber",
     cast_of<SubscriberReapedWhileARingIsMade>, 2},
    {"subscriber_reaped_and_followed", "the cell of a dead subscriber is not taken from the next",
     cast_of<SubscriberReapedAndFollowed>, 2},

    {"publisher_killed_overwrite_in_slots", "readers get whole copies, then the end",
     cast_of<InSlots<PublisherKilledOverwrite>>},
    {"publisher_killed_blocking_in_slots", "the same under back-pressure, and miss nothing",
     cast_of<InSlots<PublisherKilledBlocking>>},
    {"killed_while_it_writes_over",
     "a publisher that dies in the middle of a message takes none away",
     cast_of<InSlots<KilledWhileItWritesOver>>, 2},
    {"reader_killed_in_slots", "a dead reader's place comes back", cast_of<InSlots<ReaderKilled>>,
     2},
    {"laggard_killed_in_slots", "a dead reader does not hold the sender back",
     cast_of<InSlots<LaggardKilled>>, 1},
    {"observer_killed_in_slots", "a dead observer holds no lossless publisher up",
     cast_of<InSlots<ObserverKilled>>, 2},
    {"subscriber_looks_late_in_slots",
     "what a dead publisher sent waits for a reader that had subscribed",
     cast_of<InSlots<SubscriberLooksLate>>},
    {"subscriber_looks_late_blocking_in_slots", "the same under back-pressure, and misses nothing",
     cast_of<InSlots<SubscriberLooksLateBlocking>>},
};

}  // namespace
}  // namespace lot::model
