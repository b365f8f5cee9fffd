// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"
#include "subscription.hpp"

/// The mutex engine: readers sleep on one condition, under a lock that survives its holder.
namespace lot::model {
namespace {

constexpr Shape locked(std::uint32_t blocks, std::uint32_t depth, std::uint32_t readers,
                       std::uint32_t channels = 1) {
  return {.blocks = blocks,
          .depth = depth,
          .readers = readers,
          .channels = channels,
          .taken = false,
          .locked = true};
}

/// Two sleep for each message and get all of them, if they are not lapped.
struct SleepersOnACondition : Scene<SleepersOnACondition, 3> {
  SleepersOnACondition() : Scene(locked(4, 2, 2)) {}
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

/// Sender and reader sleep for each other, both engines' way.
struct BothSleepUnderALock : Scene<BothSleepUnderALock, 2> {
  static constexpr unsigned kMessages = 3;
  BothSleepUnderALock() : Scene(locked(2, 1, 1)) {}
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

/// A publisher appears while the reader of another one, which is silent, falls asleep.
struct AnnouncedToACondition : Scene<AnnouncedToACondition, 2> {
  AnnouncedToACondition() : Scene(locked(2, 1, 1, 2)) {}
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

/// A publisher sends its last message and leaves: the reader finds the message before the end. On a
/// condition no mark is taken from the slots meanwhile: Relacy remembers three values of each only.
struct LastBeforeTheEnd : Scene<LastBeforeTheEnd, 2> {
  LastBeforeTheEnd() : Scene(locked(1, 1, 1)) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(subscriber.join(start(2), 0, 1, 1));
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(publisher.send());
      process(4).leave();
      return;
    }
    while (!subscriber.ended()) {
      if (!subscriber.receive()) Policy::pause();
    }
    RL_ASSERT(subscriber.received() == 1);
    subscriber.leave();
    process(2).leave();
  }
  Publisher publisher;
  Subscriber subscriber;
};

/// Two readers of one ring fall asleep while its publisher is reaped: both find the end.
struct EndOnACondition : Scene<EndOnACondition, 3> {
  EndOnACondition() : Scene(locked(1, 1, 2)) {}
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
    while (!subscribers[t - 1].ended()) subscribers[t - 1].sleep();
  }
  Publisher publisher;
  Subscriber subscribers[2];
};

/// A publisher is killed anywhere while it announces itself.
struct AnnouncerToAConditionKilled : Scene<AnnouncerToAConditionKilled, 2> {
  AnnouncerToAConditionKilled() : Scene(locked(2, 1, 1, 2)) {}
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

/// A publisher is killed with the lock, or before its wake. Nobody has reaped it: who gets the lock
/// next tells those who sleep. (Where nothing was published, there is nothing to tell.)
struct NextOwnerRepairs : Scene<NextOwnerRepairs, 3> {
  NextOwnerRepairs() : Scene(locked(1, 1, 2)) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    for (unsigned i : {0U, 1U}) RL_ASSERT(subscribers[i].join(start(2 + i), 0, 1, 1));
    start(1);
    block = process(4).loan();
    process(4).write(block, 0);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(4, 8, [this] { publisher.send_own(block); });
      const bool with_the_lock = segment.channels[0].lock.load(std::memory_order_relaxed) != 0;
      if (!subscribers[1].receive() || !with_the_lock) process(1).see_reaped(4);
      return;
    }
    if (t != 1) return;
    while (subscribers[0].received() == 0 && !subscribers[0].ended()) {
      if (!subscribers[0].receive()) subscribers[0].sleep();
    }
  }
  Publisher publisher;
  Subscriber subscribers[2];
  Word block = kNoBlock;
};

/// A reader is killed anywhere, with the lock or without it, and reaped: nobody waits for it.
struct ReaderKilledWithTheLock : Scene<ReaderKilledWithTheLock, 3> {
  ReaderKilledWithTheLock() : Scene(locked(3, 1, 2)) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    for (unsigned i : {0U, 1U}) RL_ASSERT(subscribers[i].join(start(2 + i), 0, 1, 0));
    start(1);
    RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) publisher.send_and_wait();
    } else if (t == 1) {
      die_within(3, 25, [this] {
        while (subscribers[1].received() < 2) {
          if (!subscribers[1].receive()) subscribers[1].sleep();
        }
      });
      process(1).see_reaped(3);
    } else {
      while (subscribers[0].received() < 3) {
        if (!subscribers[0].receive()) subscribers[0].sleep();
      }
    }
  }
  void check() { RL_ASSERT(subscribers[0].missed() == 0); }
  Publisher publisher;
  Subscriber subscribers[2];
};

/// Two take under the lock; one of them is killed anywhere.
struct TakerKilledWithTheLock : Scene<TakerKilledWithTheLock, 2> {
  TakerKilledWithTheLock()
      : Scene({.blocks = 3, .depth = 2, .readers = 2, .taken = true, .locked = true}) {}
  void prepare() {
    publisher.open(start(4), 0, true);
    for (unsigned i : {0U, 1U}) RL_ASSERT(takers[i].join(start(2 + i), 0, 1, 0));
    start(1);
    for (int i = 0; i < 2; ++i) RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(3, 30, [this] { take(1); });
      process(1).see_reaped(3);
    } else {
      take(0);
    }
  }
  void take(unsigned i) {
    takers[i].take([this](std::uint64_t number) {
      RL_ASSERT(!taken[number]);
      taken[number] = true;
    });
  }
  void check() {
    for (int i = 0; i < 2; ++i) take(0);
    RL_ASSERT(taken[0] || taken[1]);  // one may have gone with its taker
    for (int i = 0; i < 3; ++i) {
      RL_ASSERT(publisher.send());
      RL_ASSERT(takers[0].take([](std::uint64_t) {}));
    }
  }
  Publisher publisher;
  Subscriber takers[2];
  bool taken[2] = {};
};

const Entered entered{
    {"sleepers_on_a_condition", "who sleeps on the condition is woken by each message",
     cast_of<SleepersOnACondition>, 1},
    {"both_sleep_under_a_lock", "sender and reader never both sleep for ever",
     cast_of<BothSleepUnderALock>, 2},
    {"announced_to_a_condition", "who sleeps on a condition hears of a new ring",
     cast_of<AnnouncedToACondition>, 2},
    {"last_before_the_end", "a reader finds the last message before the end",
     cast_of<LastBeforeTheEnd>, 2},
    {"end_on_a_condition", "two that sleep on a condition both find the end",
     cast_of<EndOnACondition>, 2},
    {"announcer_to_a_condition_killed", "an announcer's death takes nobody's wake-up",
     cast_of<AnnouncerToAConditionKilled>, 1},
    {"next_owner_repairs", "who gets a dead one's lock wakes all", cast_of<NextOwnerRepairs>, 1},
    {"reader_killed_with_the_lock", "a reader that dies with the lock holds nobody up",
     cast_of<ReaderKilledWithTheLock>},
    {"taker_killed_with_the_lock", "what the dead has not taken is its neighbour's",
     cast_of<TakerKilledWithTheLock>, 1},

    {"both_sleep_under_a_lock_in_slots", "sender and reader never both sleep for ever",
     cast_of<InSlots<BothSleepUnderALock>>, 2},
    {"last_before_the_end_in_slots", "a reader finds the last message before the end",
     cast_of<InSlots<LastBeforeTheEnd>>, 2},
    {"taker_killed_with_the_lock_in_slots", "what the dead has not taken is its neighbour's",
     cast_of<InSlots<TakerKilledWithTheLock>>, 1},
};

}  // namespace
}  // namespace lot::model
