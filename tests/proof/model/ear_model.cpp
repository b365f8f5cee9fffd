// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"
#include "world.hpp"

/// One sleeper listens to many rings (docs/ear.md) while publishers send, go and die.
namespace lot::model {
namespace {

/// The sleeper: it looks only at the rings that had news. Ear 0 is its.
class Listening {
 public:
  void begin(Process& process, std::uint32_t channels) {
    segment_ = &process.segment();
    subscribers_.resize(channels);
    is_due_.assign(channels, true);
    for (std::uint32_t c = 0; c < channels; ++c) {
      RL_ASSERT(subscribers_[c].join(process, c, 1, 0));
    }
  }
  /// Receives so many messages, or until all rings have ended.
  void receive(std::uint64_t count) {
    bool sleeps = false;
    while (received() < count && ended_ < subscribers_.size()) {
      if (sleeps) segment_->ear_words.bell.wake_up();
      const std::uint32_t rung = segment_->ear_words.bell.rung();
      segment_->ear().take(segment_->shape.channels,
                           [this](std::uint32_t c) { is_due_[c] = true; });
      sleeps = !look();
      if (sleeps) sleep(rung);
    }
  }
  /// Sleeps until it has seen the directory's new version.
  void await_a_ring() {
    while (segment_->version.load(std::memory_order_relaxed) == 0) {
      const std::uint32_t rung = segment_->ear_words.bell.rung();
      segment_->ear().take(segment_->shape.channels, [](std::uint32_t) {});
      segment_->listeners[0].add(0);
      if (subscribers_[0].leave_mark()) sleep(rung);
      segment_->ear_words.bell.wake_up();
    }
  }
  std::uint64_t received() const {
    std::uint64_t sum = 0;
    for (const Subscriber& s : subscribers_) sum += s.received();
    return sum;
  }
  std::size_t ended() const { return ended_; }

 private:
  void sleep(std::uint32_t rung) {
    Bed bed;
    bed.add(segment_->ear_words.bell.word(), segment_->ear_words.bell.sleep(rung));
    bed.sleep();
  }
  /// Looks at what is due, and arms it. True: it has found something.
  bool look() {
    bool any = false;
    for (std::uint32_t c = 0; c < subscribers_.size(); ++c) {
      if (!is_due_[c]) continue;
      Subscriber& subscriber = subscribers_[c];
      if (subscriber.receive()) {
        any = true;
      } else if (subscriber.ended()) {
        is_due_[c] = false;
        ++ended_;
        any = true;
      } else {
        segment_->listeners[c].add(0);
        is_due_[c] = !subscriber.leave_mark();
        any = any || is_due_[c];
      }
    }
    return any;
  }

  Segment* segment_ = nullptr;
  std::deque<Subscriber> subscribers_;
  std::vector<bool> is_due_;
  std::size_t ended_ = 0;
};

struct HearsTwoRings : Scene<HearsTwoRings, 3> {
  HearsTwoRings()
      : Scene({.blocks = 4, .depth = 1, .readers = 1, .channels = 2, .has_ear = true}) {}
  void prepare() {
    publishers[0].open(start(4), 0, false);
    publishers[1].open(start(5), 1, false);
    listening.begin(start(2), 2);
  }
  void thread(unsigned t) {
    if (t < 2) {
      RL_ASSERT(publishers[t].send());
    } else {
      listening.receive(2);
    }
  }
  Publisher publishers[2];
  Listening listening;
};

/// Messages of one publisher, with back-pressure: none is missed. `kLocked`: the mutex engine,
/// where the mark is on its condition.
template <bool kLocked, std::uint64_t kMessages>
struct HearsOne : Scene<HearsOne<kLocked, kMessages>, 2> {
  HearsOne()
      : Scene<HearsOne, 2>(
            {.blocks = 4, .depth = 2, .readers = 1, .locked = kLocked, .has_ear = true}) {}
  void prepare() {
    publisher.open(this->start(4), 0, true);
    listening.begin(this->start(2), 1);
  }
  void thread(unsigned t) {
    if (t == 1) return listening.receive(kMessages);
    for (std::uint64_t n = 0; n < kMessages; ++n) RL_ASSERT(publisher.send());
  }
  Publisher publisher;
  Listening listening;
};

/// Another reader sleeps on the slot, and may have left the mark that the ear depends on.
struct HearsBesideASleeper : Scene<HearsBesideASleeper, 3> {
  HearsBesideASleeper() : Scene({.blocks = 2, .depth = 1, .readers = 2, .has_ear = true}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    RL_ASSERT(sleeper.join(start(1), 0, 1, 0));
    listening.begin(start(2), 1);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(publisher.send());
    } else if (t == 1) {
      while (!sleeper.receive()) sleeper.sleep();
    } else {
      listening.receive(1);
    }
  }
  Publisher publisher;
  Subscriber sleeper;
  Listening listening;
};

/// A publisher closes its ring.
template <bool kLocked>
struct HearsTheEnd : Scene<HearsTheEnd<kLocked>, 2> {
  using Base = Scene<HearsTheEnd<kLocked>, 2>;
  HearsTheEnd()
      : Base({.blocks = 2, .depth = 1, .readers = 1, .locked = kLocked, .has_ear = true}) {}
  void prepare() {
    publisher.open(this->start(4), 0, false);
    listening.begin(this->start(2), 1);
  }
  void thread(unsigned t) {
    if (t == 0) {
      this->process(4).leave();
    } else {
      listening.receive(1);
      RL_ASSERT(listening.ended() == 1);
    }
  }
  Publisher publisher;
  Listening listening;
};

/// A publisher announces a ring while an ear falls asleep that listens to another one.
template <bool kLocked>
struct HearsOfARing : Scene<HearsOfARing<kLocked>, 2> {
  using Base = Scene<HearsOfARing<kLocked>, 2>;
  HearsOfARing()
      : Base({.blocks = 1,
              .depth = 1,
              .readers = 1,
              .channels = 2,
              .locked = kLocked,
              .has_ear = true}) {}
  void prepare() {
    silent.open(this->start(4), 0, false);
    listening.begin(this->start(2), 1);
    this->start(5);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(fresh.advertise(this->process(5), 1, false));
    } else {
      listening.await_a_ring();
    }
  }
  Publisher silent, fresh;
  Listening listening;
};

/// A publisher is killed anywhere in its push, and reaped: the message or the end is heard.
struct RingerKilled : Scene<RingerKilled, 3> {
  RingerKilled() : Scene({.blocks = 2, .depth = 1, .readers = 1, .has_ear = true}) {}
  void prepare() {
    publisher.open(start(4), 0, false);
    listening.begin(start(2), 1);
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      die_within(4, 30, [this] { publisher.send(); });
    } else if (t == 1) {
      segment.await_end_of(4);
      process(3).see_reaped(4);
    } else {
      listening.receive(2);  // both, at most
      RL_ASSERT(listening.ended() == 1);
    }
  }
  Publisher publisher;
  Listening listening;
};

/// A process gives its ear up while the next one waits for it. The next one's bit stays: the former
/// one's has gone before its name.
struct EarChangesHands : SceneBegins, rl::test_suite<EarChangesHands, 2> {
  static constexpr std::uint32_t kEar = 3;
  void before() {
    RL_ASSERT(words.owner.claim(1));
    RL_ASSERT(words.owner.is(1) && !words.owner.claim(2));
    listeners.add(kEar);
  }
  void thread(unsigned t) {
    if (t == 0) {
      listeners.remove(kEar);
      words.owner.free();
      return;
    }
    while (!words.owner.claim(2)) Policy::pause();
    listeners.add(kEar);
  }
  void after() {
    RL_ASSERT(words.owner.is(2));
    unsigned listen = 0;
    listeners.each([&](std::uint32_t ear) { listen += ear == kEar ? 1 : 100; });
    RL_ASSERT(listen == 1);
  }
  ring::EarWords<Policy> words;
  ring::Listeners<Policy> listeners;
};

const Entered entered{
    {"hears_two_rings", "an ear of two rings gets the messages of both", cast_of<HearsTwoRings>, 2},
    {"hears_twice", "an ear gets all messages of a ring", cast_of<HearsOne<false, 2>>, 2},
    {"hears_the_mutex_engine", "an ear hears of a ring of the mutex engine",
     cast_of<HearsOne<true, 1>>, 2},
    {"hears_beside_a_sleeper", "an ear and a sleeper on one slot both get the message",
     cast_of<HearsBesideASleeper>, 2},
    {"hears_the_end", "an ear hears that a ring has ended", cast_of<HearsTheEnd<false>>, 2},
    {"hears_the_end_mutex_engine", "the same of the mutex engine", cast_of<HearsTheEnd<true>>, 2},
    {"hears_of_a_ring", "an ear hears of a new ring", cast_of<HearsOfARing<false>>, 2},
    {"hears_of_a_ring_mutex_engine", "the same of the mutex engine", cast_of<HearsOfARing<true>>,
     2},
    {"ear_changes_hands", "an ear's next owner keeps its bit", cast_of<EarChangesHands>, 3},
    {"ringer_killed", "an ear hears of a publisher that is killed in its push",
     cast_of<RingerKilled>, 1},
};

}  // namespace
}  // namespace lot::model
