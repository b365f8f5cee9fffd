// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"
#include "subscription.hpp"

/// Readers of many rings fall asleep while publishers come, publish, go and die.
namespace lot::model {
namespace {

/// A reader of two rings sleeps until it has the messages of both.
struct TwoRings : Scene<TwoRings, 3> {
  TwoRings() : Scene({.blocks = 4, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    publishers[0].open(start(4), 0, false);
    publishers[1].open(start(5), 1, false);
    subscription.join(start(2));
  }
  void thread(unsigned t) {
    if (t < 2) {
      RL_ASSERT(publishers[t].send());
      return;
    }
    while (subscription.received() < 2) {
      if (!subscription.receive()) subscription.await_change();
    }
  }
  Publisher publishers[2];
  Subscription subscription;
};

/// A publisher appears while the reader of another one, which is silent, falls asleep.
struct AnnouncedWhileFallingAsleep : Scene<AnnouncedWhileFallingAsleep, 2> {
  AnnouncedWhileFallingAsleep() : Scene({.blocks = 2, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    silent.open(start(4), 0, false);
    subscription.join(start(2));
    start(5);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(fresh.advertise(process(5), 1, false) && fresh.send());
      return;
    }
    while (subscription.received() == 0) {
      if (!subscription.receive()) subscription.await_change();
    }
  }
  Publisher silent, fresh;
  Subscription subscription;
};

/// The first publisher of a topic appears while its only reader falls asleep.
struct FirstPublisher : Scene<FirstPublisher, 2> {
  FirstPublisher() : Scene({.blocks = 2, .depth = 1, .readers = 1}) {}
  void prepare() {
    subscription.join(start(2));
    start(4);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(publisher.advertise(process(4), 0, false) && publisher.send());
      return;
    }
    while (subscription.received() == 0) {
      if (!subscription.receive()) subscription.await_change();
    }
  }
  Publisher publisher;
  Subscription subscription;
};

/// One publisher leaves and the next one takes over; the reader gets all of both.
struct PublishersInSuccession : Scene<PublishersInSuccession, 2> {
  PublishersInSuccession() : Scene({.blocks = 3, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    former.open(start(4), 0, false);
    subscription.join(start(2));
    start(5);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(former.send());
      process(4).leave();
      RL_ASSERT(next.advertise(process(5), 1, false) && next.send());
      return;
    }
    while (subscription.received() < 2) {
      if (!subscription.receive()) subscription.await_change();
    }
  }
  Publisher former, next;
  Subscription subscription;
};

/// The same with three readers, one of which comes late.
struct SuccessionWithThreeReaders : Scene<SuccessionWithThreeReaders, 4> {
  SuccessionWithThreeReaders() : Scene({.blocks = 3, .depth = 1, .readers = 3, .channels = 2}) {}
  void prepare() {
    former.open(start(4), 0, false);
    for (unsigned i : {0U, 1U}) subscriptions[i].join(start(1 + i));
    start(3);
    start(5);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(former.send());
      process(4).leave();
      RL_ASSERT(next.advertise(process(5), 1, false) && next.send());
      return;
    }
    Subscription& subscription = subscriptions[t - 1];
    if (t == 3) subscription.join(process(3));
    const unsigned all = t == 3 ? 1 : 2;  // the late one may have missed the first
    while (subscription.received() < all) {
      if (!subscription.receive()) subscription.await_change();
    }
  }
  Publisher former, next;
  Subscription subscriptions[3];
};

/// A publisher is killed anywhere while it announces itself: the reader of another ring still gets
/// what is published there.
struct AnnouncerKilled : Scene<AnnouncerKilled, 2> {
  AnnouncerKilled() : Scene({.blocks = 2, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    old.open(start(4), 0, false);
    subscription.join(start(2));
    start(5);
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(5, 60, [this] { killed.advertise(process(5), 1, false); });
      process(3).see_reaped(5);
      RL_ASSERT(old.send());
      return;
    }
    while (subscription.received() == 0) {
      if (!subscription.receive()) subscription.await_change();
    }
  }
  Publisher old, killed;
  Subscription subscription;
};

/// Two readers of one ring fall asleep while its publisher is reaped: both find the end.
struct TwoSleepersFindTheEnd : Scene<TwoSleepersFindTheEnd, 3> {
  TwoSleepersFindTheEnd() : Scene({.blocks = 1, .depth = 1, .readers = 2}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    for (unsigned i : {0U, 1U}) RL_ASSERT(subscribers[i].join(start(2 + i), 0, 1, 1));
    start(1);
    segment.end_process(4);
  }
  void thread(unsigned t) {
    if (t == 0) {
      process(1).see_reaped(4);
      return;
    }
    Subscriber& subscriber = subscribers[t - 1];
    while (!subscriber.ended()) subscriber.sleep();
  }
  Publisher publisher;
  Subscriber subscribers[2];
};

/// A reader of two rings falls asleep while the publisher of one of them is reaped: it leaves that
/// one, though the other one is silent until it has left. It looks for new rings between the
/// reaper's change of the directory and the end, so that nothing but the end itself tells of it.
struct SleeperLeavesWhatEnded : Scene<SleeperLeavesWhatEnded, 2> {
  SleeperLeavesWhatEnded() : Scene({.blocks = 1, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    ending.open(start(4), 0, false);
    silent.open(start(5), 1, false);
    subscription.join(start(2));
    start(3);
    segment.end_process(4);
  }
  void thread(unsigned t) {
    if (t == 0) {
      process(3).see_reaped(4);
      process(3).await_no_reader(0);
      RL_ASSERT(silent.send());
      return;
    }
    while (subscription.received() == 0) {
      if (!subscription.receive()) subscription.await_change();
    }
  }
  Publisher ending, silent;
  Subscription subscription;
};

/// Two readers of one ring fall asleep while a ring appears that has a message: both get it.
struct TwoSleepersHearOfARing : Scene<TwoSleepersHearOfARing, 3> {
  TwoSleepersHearOfARing() : Scene({.blocks = 1, .depth = 1, .readers = 2, .channels = 2}) {}
  void prepare() {
    silent.open(start(4), 0, false);
    for (unsigned i : {0U, 1U}) subscriptions[i].join(start(2 + i));
    fresh.open(start(5), 1, false);
    RL_ASSERT(fresh.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      while (!process(5).lock_rings()) Policy::pause();
      fresh.announce();
      process(5).unlock_rings();
      return;
    }
    Subscription& subscription = subscriptions[t - 1];
    while (subscription.received() == 0) {
      if (!subscription.receive()) subscription.await_change();
    }
  }
  Publisher silent, fresh;
  Subscription subscriptions[2];
};

/// A publisher has died before it announced its ring. The reader of another one falls asleep while
/// the dead one is reaped: it still gets what was published there.
struct AnnouncedByTheReaper : Scene<AnnouncedByTheReaper, 2> {
  AnnouncedByTheReaper() : Scene({.blocks = 1, .depth = 1, .readers = 1, .channels = 2}) {}
  void prepare() {
    silent.open(start(4), 0, false);
    subscription.join(start(2));
    dead.open(start(5), 1, false);
    RL_ASSERT(dead.send());
    segment.end_process(5);
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      process(3).see_reaped(5);
      return;
    }
    while (subscription.received() == 0) {
      if (!subscription.receive()) subscription.await_change();
    }
  }
  Publisher silent, dead;
  Subscription subscription;
};

const Entered entered{
    {"two_rings", "a reader of two rings gets the messages of both", cast_of<TwoRings>, 2},
    {"announced_while_falling_asleep", "a reader that falls asleep hears of a new ring",
     cast_of<AnnouncedWhileFallingAsleep>, 2},
    {"first_publisher", "a reader without rings hears of the first one", cast_of<FirstPublisher>,
     2},
    {"publishers_in_succession", "the reader of a topic gets all of two that follow each other",
     cast_of<PublishersInSuccession>, 1},
    {"succession_with_three_readers", "the same with three readers",
     cast_of<SuccessionWithThreeReaders>},
    {"announcer_killed", "an announcer's death takes nobody's wake-up", cast_of<AnnouncerKilled>,
     1},
    {"announced_by_the_reaper", "a ring whose publisher died before it told of it is found",
     cast_of<AnnouncedByTheReaper>, 2},
    {"two_sleepers_find_the_end", "two that sleep on one mark both find the end",
     cast_of<TwoSleepersFindTheEnd>, 2},
    {"sleeper_leaves_what_ended", "a reader of two rings leaves the one that ends",
     cast_of<SleeperLeavesWhatEnded>, 2},
    {"two_sleepers_hear_of_a_ring", "two that sleep on one mark both hear of a new ring",
     cast_of<TwoSleepersHearOfARing>, 2},
};

}  // namespace
}  // namespace lot::model
