// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"

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

/// A reaper is killed anywhere and another one takes over; a sleeping reader gets all, then the
/// end.
struct ReaperKilled : Scene<ReaperKilled, 3> {
  ReaperKilled() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 2));
    for (std::uint32_t k : {1U, 3U}) start(k);
    for (int i = 0; i < 2; ++i) publisher.send();
    segment.bury(4);
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

/// One publisher has died; its ring is reaped, freed and opened by the next one while somebody
/// joins the old generation.
struct TwoInSuccession : Scene<TwoInSuccession, 2> {
  TwoInSuccession() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    dead.open(start(4), 0, false);
    dead.send();
    segment.bury(4);
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

/// A forwarder is killed anywhere and reaped while a reader keeps blocks from its ring: that the
/// orphanage adopts them is a hand-over, too.
struct ForwarderKilled : Scene<ForwarderKilled, 3> {
  ForwarderKilled() : Scene({.blocks = 3, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    first.open(start(5), 0, false);
    second.open(start(3), 1, false);
    start(2);
    RL_ASSERT(middle.join(process(3), 0, 1, 1));
    RL_ASSERT(last.join(start(1), 1, 1, 1));
    first.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 4; ++i) first.send();
    } else if (t == 1) {
      die_within(3, 60, [this] {
        for (int i = 0; i < 2; ++i) forward();
      });
      process(2).reap(3);
    } else {
      for (int i = 0; i < 3; ++i) take();
    }
  }
  void forward() {
    const Word b = middle.borrow();
    if (b == kNoBlock) return;
    process(3).keep(b);
    middle.done();
    second.forward(b);
    second.scan();
  }
  void take() {
    const Word b = last.borrow();
    if (b == kNoBlock) return;
    const bool keep = rl::rand(2) != 0;
    if (keep) {
      process(1).keep(b);
      last.done();
    }
    const std::uint64_t message = process(1).read(b);
    RL_ASSERT(!seen || message > *seen);
    seen = message;
    if (keep) {
      process(1).drop(b);
    } else {
      last.done();
    }
  }
  Publisher first, second;
  Subscriber middle, last;
  std::optional<std::uint64_t> seen;
};

/// A dead publisher's block is kept by one process, freed by the orphanage and claimed by another.
struct OrphanTravels : Scene<OrphanTravels, 3> {
  OrphanTravels() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    for (std::uint32_t k : {1U, 3U}) start(k);
    publisher.send();
    block = subscriber.borrow();
    process(2).keep(block);
    subscriber.done();
    segment.bury(4);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(process(2).read(block) == 0);
      subscriber.leave();
      process(2).drop(block);
    } else if (t == 1) {
      process(3).reap(4);
      process(3).collect();
    } else {
      for (int i = 0; i < 3; ++i) {
        const Word b = process(1).loan();
        if (b == Process::kNone) continue;
        process(1).write(b, 9);
        if (rl::rand(2) != 0) process(1).give_back(b);
        return;
      }
    }
  }
  Publisher publisher;
  Subscriber subscriber;
  Word block = kNoBlock;
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

/// Whoever published a message that refers to another is killed anywhere: the target lives on.
struct ReferrerKilled : Scene<ReferrerKilled, 3> {
  ReferrerKilled() : Scene({.blocks = 4, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    targets.open(start(4), 0, false);
    messages.open(start(3), 1, false);
    RL_ASSERT(reader_of_targets.join(process(3), 0, 1, 1));
    RL_ASSERT(reader.join(start(2), 1, 1, 1));
    start(1);
    targets.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) targets.send();
    } else if (t == 1) {
      die_within(3, 50, [this] { publish_reference(); });
      process(1).reap(3);
    } else {
      const Word b = reader.borrow();
      if (b == kNoBlock) return;
      const Word target = segment.references[b].read();
      RL_ASSERT(target != kNoBlock && process(2).read(target) == process(2).read(b));
      process(2).keep(b);
      reader.done();
      RL_ASSERT(process(2).read(target) == process(2).read(b));
      process(2).drop(b);
    }
  }
  void publish_reference() {
    const Word target = reader_of_targets.borrow();
    if (target == kNoBlock) return;
    const Word b = process(3).loan();
    if (b == Process::kNone) return;
    process(3).refer(b, target);
    reader_of_targets.done();
    process(3).write(b, process(3).read(target));
    messages.send_own(b);
  }
  Publisher targets, messages;
  Subscriber reader_of_targets, reader;
};

}  // namespace

std::vector<Scenario> crash_scenarios() {
  return {
      {"publisher_killed_overwrite", "readers get what was published, then the end",
       rl::simulate<PublisherKilledOverwrite>},
      {"publisher_killed_blocking", "the same under back-pressure, and miss nothing",
       rl::simulate<PublisherKilledBlocking>},
      {"opener_killed", "a half-made ring is an empty orphan, and then free",
       rl::simulate<OpenerKilled>, 2},
      {"reader_killed", "a dead reader's holds come back", rl::simulate<ReaderKilled>, 2},
      {"laggard_killed", "a dead reader does not hold the sender back", rl::simulate<LaggardKilled>,
       1},
      {"reaper_killed", "a killed reaper is followed by another", rl::simulate<ReaperKilled>},
      {"index_reuse", "a new process may have a dead one's index at once",
       rl::simulate<IndexReuse>},
      {"two_in_succession", "a ring is not recycled under a joiner", rl::simulate<TwoInSuccession>,
       2},
      {"forwarder_killed", "adopting a block is a hand-over", rl::simulate<ForwarderKilled>},
      {"orphan_travels", "kept by one, freed by the orphanage, claimed by another",
       rl::simulate<OrphanTravels>, 2},
      {"clean_exit", "a clean exit is a reap of oneself", rl::simulate<CleanExit>, 1},
      {"referrer_killed", "the orphanage holds what its messages refer to",
       rl::simulate<ReferrerKilled>},
  };
}

}  // namespace lot::model
