// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"
#include "world.hpp"

/// What the orphanage holds for those who live on, and when it lets go.
namespace lot::model {
namespace {

/// A reader borrows what a publisher overwrites before it ends; the reaper frees what it can, and
/// writes there.
struct BorrowOutlivesPublisher : Scene<BorrowOutlivesPublisher, 2> {
  BorrowOutlivesPublisher() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    start(3);
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.send();
      segment.end_process(4);
      process(3).reap(4);
      write_what_is_free();
      process(3).collect();
      write_what_is_free();
    } else {
      subscriber.receive();
    }
  }
  void write_what_is_free() {
    const Word b = process(3).loan();
    if (b != Process::kNone) process(3).write(b, 9);
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// The oldest message of an ended ring goes for memory, while a reader looks at it; what was freed
/// is written.
struct TakenOutOfEndedRing : Scene<TakenOutOfEndedRing, 2> {
  TakenOutOfEndedRing() : Scene({.blocks = 2, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 2));
    for (int i = 0; i < 2; ++i) publisher.send();
    segment.end_process(4);
    RL_ASSERT(start(3).reap(4));
    first = ring::block(segment.channels[0].slots[0].load(std::memory_order_relaxed));
  }
  void thread(unsigned t) {
    if (t == 0) {
      process(3).take_out(0, first);
      const Word b = process(3).loan();
      if (b != Process::kNone) process(3).write(b, 9);
    } else {
      while (subscriber.receive()) {
      }
      RL_ASSERT(subscriber.received() + subscriber.missed() == 2);
    }
  }
  Publisher publisher;
  Subscriber subscriber;
  Word first = kNoBlock;
};

/// A reader borrows a living process's block from the ring of a dead forwarder.
struct BorrowFromDeadForwarder : Scene<BorrowFromDeadForwarder, 2> {
  BorrowFromDeadForwarder() : Scene({.blocks = 2, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    first.open(start(5), 0, false);
    second.open(start(3), 1, false);
    RL_ASSERT(middle.join(process(3), 0, 1, 1));
    RL_ASSERT(last.join(start(1), 1, 1, 1));
    first.send();
    const Word b = middle.borrow();
    process(3).keep(b);
    middle.done();
    second.forward(b);
    segment.end_process(3);
    RL_ASSERT(start(2).reap(3));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) first.send();
    } else {
      const Word b = last.borrow();
      RL_ASSERT(b != kNoBlock && process(1).read(b) == 0);
      last.done();
      last.leave();
      process(2).collect();
    }
  }
  Publisher first, second;
  Subscriber middle, last;
};

/// A forwarder is reaped while the home of what is in its ring looks whether anybody holds it.
struct AdoptedWhileHomeLooks : Scene<AdoptedWhileHomeLooks, 2> {
  AdoptedWhileHomeLooks() : Scene({.blocks = 2, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    first.open(start(5), 0, false);
    second.open(start(3), 1, false);
    RL_ASSERT(middle.join(process(3), 0, 1, 1));
    RL_ASSERT(last.join(start(1), 1, 1, 1));
    first.send();
    const Word b = middle.borrow();
    process(3).keep(b);
    middle.done();
    second.forward(b);
    segment.end_process(3);
    start(2);
    first.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      first.send();
    } else {
      process(2).reap(3);
    }
  }
  void check() {
    const Word b = last.borrow();
    RL_ASSERT(b != kNoBlock && process(1).read(b) == 0);
  }
  Publisher first, second;
  Subscriber middle, last;
};

/// The last holder of an orphaned message that refers to another lets go: the target is not written
/// before it was read.
struct TargetReadThroughOrphan : Scene<TargetReadThroughOrphan, 2> {
  TargetReadThroughOrphan() : Scene({.blocks = 3, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    targets.open(start(4), 0, false);
    messages.open(start(3), 1, false);
    RL_ASSERT(reader_of_targets.join(process(3), 0, 1, 1));
    RL_ASSERT(reader.join(start(2), 1, 1, 1));
    start(1);
    targets.send();
    target = reader_of_targets.borrow();
    const Word b = process(3).loan();
    process(3).refer(b, target);
    reader_of_targets.done();
    process(3).write(b, 0);
    messages.send_own(b);
    message = reader.borrow();
    process(2).keep(message);
    reader.done();
    reader.leave();
    segment.end_process(3);
    RL_ASSERT(process(1).reap(3));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) targets.send();
    } else {
      RL_ASSERT(process(2).read(target) == process(2).read(message));
      process(2).drop(message);
      process(1).collect();
    }
  }
  Publisher targets, messages;
  Subscriber reader_of_targets, reader;
  Word target = kNoBlock;
  Word message = kNoBlock;
};

/// A publisher closes its ring; another thread of its process gives the blocks up when the ring is
/// the orphanage's. What is borrowed there is not written.
struct RingIsClosed : Scene<RingIsClosed, 3> {
  RingIsClosed() : Scene({.blocks = 1, .depth = 1, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
    publisher.send();
  }
  void thread(unsigned t) {
    if (t == 0) {
      process(4).close_ring(0);
    } else if (t == 1) {
      while (!process(4).ring_closed(0)) Policy::pause();
      process(4).take_from_ring(0);
      if (process(4).loan() == 0) process(4).write(0, 9);
    } else {
      subscriber.receive();
    }
  }
  Publisher publisher;
  Subscriber subscriber;
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
    segment.end_process(4);
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

/// Whoever published a message that refers to another is dead, its reaper is killed anywhere, and
/// somebody collects before it is reaped again: the target lives on.
struct ReferrersReaperKilled : Scene<ReferrersReaperKilled, 2> {
  ReferrersReaperKilled() : Scene({.blocks = 3, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    targets.open(start(4), 0, false);
    messages.open(start(3), 1, false);
    RL_ASSERT(reader_of_targets.join(process(3), 0, 1, 1));
    RL_ASSERT(reader.join(start(2), 1, 1, 1));
    start(1);
    targets.send();
    target = reader_of_targets.borrow();
    const Word b = process(3).loan();
    process(3).refer(b, target);
    reader_of_targets.done();
    process(3).write(b, 0);
    messages.send_own(b);
    message = reader.borrow();
    process(2).keep(message);
    reader.done();
    segment.end_process(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(1, 110, [this] { process(1).reap(3); });
      start(5).collect();
      for (int i = 0; i < 2; ++i) targets.send();
    } else {
      RL_ASSERT(process(2).read(target) == process(2).read(message));
      process(2).drop(message);
    }
  }
  Publisher targets, messages;
  Subscriber reader_of_targets, reader;
  Word target = kNoBlock;
  Word message = kNoBlock;
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

/// The same in small: it is killed while it hands on, reaped, and its reader comes later.
struct KilledWhileHandingOn : Scene<KilledWhileHandingOn, 2> {
  KilledWhileHandingOn() : Scene({.blocks = 2, .depth = 1, .readers = 1, .channels = 2}) {}
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
      for (int i = 0; i < 2; ++i) first.send();
      return;
    }
    die_within(3, 14, [this] {
      const Word b = middle.borrow();
      if (b == kNoBlock) return;
      message = segment.payloads[b].read();
      process(3).keep(b);
      middle.done();
      second.forward(b);
    });
    process(2).reap(3);
  }
  void check() {
    const Word b = last.borrow();
    RL_ASSERT(b == kNoBlock || process(1).read(b) == message);
  }
  Publisher first, second;
  Subscriber middle, last;
  std::uint64_t message = 0;
};

/// Whoever refers to a message is killed while it does, and reaped; a reader comes later.
struct KilledWhileReferring : Scene<KilledWhileReferring, 2> {
  KilledWhileReferring() : Scene({.blocks = 3, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    targets.open(start(4), 0, false);
    messages.open(start(3), 1, false);
    RL_ASSERT(reader_of_targets.join(process(3), 0, 1, 1));
    RL_ASSERT(reader.join(start(2), 1, 1, 1));
    start(1);
    targets.send();
    message = process(3).loan();
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) targets.send();
      return;
    }
    die_within(3, 14, [this] {
      const Word target = reader_of_targets.borrow();
      if (target == kNoBlock) return;
      process(3).refer(message, target);
      reader_of_targets.done();
      process(3).write(message, process(3).read(target));
      messages.send_own(message);
    });
    process(1).reap(3);
  }
  void check() {
    const Word b = reader.borrow();
    if (b == kNoBlock) return;
    const Word target = segment.references[b].read();
    RL_ASSERT(target != kNoBlock && process(2).read(target) == process(2).read(b));
  }
  Publisher targets, messages;
  Subscriber reader_of_targets, reader;
  Word message = kNoBlock;
};

const Entered entered{
    {"borrow_outlives_publisher", "what is borrowed is not freed with its publisher",
     cast_of<BorrowOutlivesPublisher>, 2},
    {"taken_out_of_ended_ring", "what is borrowed from an ended ring is not freed for memory",
     cast_of<TakenOutOfEndedRing>, 2},
    {"borrow_from_dead_forwarder", "the orphanage holds a foreign block until it was read",
     cast_of<BorrowFromDeadForwarder>, 2},
    {"adopted_while_home_looks", "what is adopted is not taken for free by its home",
     cast_of<AdoptedWhileHomeLooks>, 2},
    {"target_read_through_orphan", "a target is held until the orphan that refers to it has died",
     cast_of<TargetReadThroughOrphan>, 2},
    {"ring_is_closed", "the orphanage holds a closed ring's blocks before its publisher lets go",
     cast_of<RingIsClosed>, 2},
    {"orphan_travels", "kept by one, freed by the orphanage, claimed by another",
     cast_of<OrphanTravels>, 2},
    {"referrer_killed", "the orphanage holds what its messages refer to", cast_of<ReferrerKilled>},
    {"referrers_reaper_killed", "the same when the reaper is killed and others collect",
     cast_of<ReferrersReaperKilled>, 1},
    {"killed_while_handing_on", "what was handed on is held until it was read",
     cast_of<KilledWhileHandingOn>, 2},
    {"killed_while_referring", "a reference is whole, or its message is not published",
     cast_of<KilledWhileReferring>, 1},
    {"forwarder_killed", "adopting a block is a hand-over", cast_of<ForwarderKilled>},
};

}  // namespace
}  // namespace lot::model
