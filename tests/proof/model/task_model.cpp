// SPDX-License-Identifier: Apache-2.0
#include <map>

#include "scenario.hpp"
#include "world.hpp"

/// Rings whose messages stay in their slots until a worker has finished them.
namespace lot::model {
namespace {

/// How often each message was done: noted before its worker finishes.
class Done {
 public:
  void note(std::uint64_t number) { ++times_[number]; }
  bool each_once(std::uint64_t sent) const { return times_.size() == sent && at_most_once(); }
  bool each(std::uint64_t sent) const {
    for (std::uint64_t n = 0; n < sent; ++n) {
      if (times_.count(n) == 0) return false;
    }
    return true;
  }

 private:
  bool at_most_once() const {
    for (const auto& [number, times] : times_) {
      if (times != 1) return false;
    }
    return true;
  }
  std::map<std::uint64_t, unsigned> times_;
};

/// A publisher, and two workers.
template <class Derived, unsigned kThreads, std::uint32_t kDepth>
struct TwoWorkers : Scene<Derived, kThreads> {
  explicit TwoWorkers(std::uint32_t blocks = kDepth + 1)
      : Scene<Derived, kThreads>(
            {.blocks = blocks, .depth = kDepth, .readers = 3, .taken = true, .finished = true}) {}
  void open() {
    RL_ASSERT(publisher.open(this->start(4), 0, true));
    for (unsigned i : {0U, 1U}) RL_ASSERT(workers[i].join(this->start(2 + i), 0, 1, 1));
  }
  bool work(unsigned i) { return work_of(workers[i]); }
  bool work_of(Subscriber& worker) {
    if (!worker.start_work()) return false;
    done.note(worker.work());
    worker.finish_work();
    return true;
  }
  void work_until(unsigned i, std::uint64_t messages) {
    for (std::uint64_t n = 0; n < messages;) {
      if (work(i)) {
        ++n;
      } else {
        workers[i].sleep();
      }
    }
  }
  void work_until_the_end(unsigned i) {
    while (!workers[i].over()) {
      if (!work(i)) workers[i].sleep();
    }
    workers[i].leave();
  }
  void do_the_rest() {
    while (work(0)) {
    }
  }
  Publisher publisher;
  Subscriber workers[2];
  Done done;
};

/// Two work while the publisher laps the ring: each message is one worker's, and its memory is used
/// again.
template <class Derived, std::uint32_t kDepth>
struct WorkedByTwo : TwoWorkers<Derived, 3, kDepth> {
  void prepare() {
    this->open();
    for (std::uint32_t i = 0; i < kDepth; ++i) RL_ASSERT(this->publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (std::uint32_t i = 0; i <= kDepth; ++i) this->publisher.send();
    } else {
      for (std::uint32_t i = 0; i < 2; ++i) this->work(t - 1);
    }
  }
  void check() {
    this->do_the_rest();
    RL_ASSERT(this->workers[0].reader().size() == 0);
    RL_ASSERT(this->done.each_once(this->publisher.sent()));
    RL_ASSERT(this->workers[0].missed() == 0 && this->workers[1].missed() == 0);
  }
};
struct WorkedByTwoOverOneSlot : WorkedByTwo<WorkedByTwoOverOneSlot, 1> {};
struct WorkedByTwoOverTwoSlots : WorkedByTwo<WorkedByTwoOverTwoSlots, 2> {};

/// One gives its work back, the other one sleeps until there is some.
struct GivenBackToSleeper : TwoWorkers<GivenBackToSleeper, 2, 1> {
  void prepare() {
    open();
    RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) return work_until(0, 1);
    if (workers[1].start_work()) workers[1].give_work_back();
  }
  void check() { RL_ASSERT(done.each_once(1)); }
};

/// The same beside newer messages: what comes back lies behind who has passed it.
struct GivenBackBehind : TwoWorkers<GivenBackBehind, 2, 2> {
  void prepare() {
    open();
    for (int i = 0; i < 2; ++i) RL_ASSERT(publisher.send());
    RL_ASSERT(workers[1].start_work());
  }
  void thread(unsigned t) {
    if (t == 0) return work_until(0, 2);
    workers[1].give_work_back();
  }
  void check() { RL_ASSERT(done.each_once(2)); }
};

/// What a worker has done before it gives its work back is done for the next one.
struct WorkedOnBefore : TwoWorkers<WorkedOnBefore, 2, 1> {
  void prepare() {
    open();
    RL_ASSERT(publisher.send());
    RL_ASSERT(workers[1].start_work());
    half_done.write(0);
  }
  void thread(unsigned t) {
    if (t == 1) {
      half_done.write(1);
      workers[1].give_work_back();
    } else if (workers[0].start_work()) {
      RL_ASSERT(half_done.read() == 1);
      workers[0].finish_work();
    }
  }
  Plain<std::uint32_t> half_done;
};

/// One dies with its work, the other one sleeps until there is some.
struct KilledBesideSleeper : TwoWorkers<KilledBesideSleeper, 2, 1> {
  void prepare() {
    open();
    start(1);
    RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) return work_until(0, 1);
    die_within(3, 40, [this] {
      if (workers[1].start_work() && rl::rand(2) != 0) workers[1].give_work_back();
    });
    process(1).see_reaped(3);
  }
  void check() { RL_ASSERT(done.each_once(1)); }
};

/// One is killed anywhere, also while it finishes, beside the other one and the publisher: what it
/// has not done is done by others.
template <class Derived, std::uint32_t kDepth>
struct WorkerKilledScene : TwoWorkers<Derived, 3, kDepth> {
  void prepare() {
    this->open();
    this->start(1);
    for (std::uint32_t i = 0; i < kDepth; ++i) RL_ASSERT(this->publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      this->publisher.send();
    } else if (t == 1) {
      for (int i = 0; i < 2; ++i) this->work(0);
    } else {
      this->die_within(3, 50, [this] { this->work(1); });
      this->process(1).see_reaped(3);
    }
  }
  void check() {
    this->do_the_rest();
    RL_ASSERT(this->done.each(this->publisher.sent()));
    for (std::uint32_t i = 0; i < 2 * kDepth; ++i) {
      RL_ASSERT(this->publisher.send());
      RL_ASSERT(this->work(0));
    }
  }
};
struct WorkerKilled : WorkerKilledScene<WorkerKilled, 1> {};
struct WorkerKilledOverTwoSlots : WorkerKilledScene<WorkerKilledOverTwoSlots, 2> {};

/// Three workers at one slot: one may have looked at a message that another one finishes before it
/// claims it.
template <class Derived, unsigned kThreads>
struct LateWorkers : TwoWorkers<Derived, kThreads, 1> {
  LateWorkers() : TwoWorkers<Derived, kThreads, 1>(2) {}
  void prepare() {
    this->open();
    this->start(1);
    RL_ASSERT(third.join(this->process(1), 0, 1, 1));
    RL_ASSERT(this->publisher.send());
  }
  void check() {
    this->do_the_rest();
    RL_ASSERT(this->done.each_once(this->publisher.sent()));
  }
  Subscriber third;
};

/// A worker has finished, and was killed before anybody could see more; one that has looked at the
/// message before does not get it, nor disturbs who works on the next one in that slot.
struct FinishedAndKilled : LateWorkers<FinishedAndKilled, 3> {
  void thread(unsigned t) {
    if (t == 0) {
      if (workers[1].start_work()) {
        done.note(workers[1].work());
        ring::empty(segment.channels[0].slots[0], Segment::kFirst);
        segment.end_process(3);
        process(4).see_reaped(3);
      }
      publisher.send();
    } else {
      work_of(t == 1 ? workers[0] : third);
    }
  }
};

/// The next message in the slot, and who works on it, are not the business of who is late.
struct LateForAMessage : LateWorkers<LateForAMessage, 2> {
  void thread(unsigned t) {
    if (t == 1) {
      work(0);
    } else {
      work(1);
      publisher.send();
      work_of(third);
    }
  }
};

/// The publisher goes while one works and another one sleeps: both leave when all is done, also
/// when the first gives its work back or is killed with it.
template <class Derived, bool kKilled>
struct WorkOutlivesPublisherScene : TwoWorkers<Derived, 3, 1> {
  void prepare() {
    this->open();
    this->start(1);
    RL_ASSERT(this->publisher.send());
    RL_ASSERT(this->workers[1].start_work());
  }
  void thread(unsigned t) {
    if (t == 0) {
      this->process(4).leave();
    } else if (t == 1) {
      this->work_until_the_end(0);
    } else if (kKilled) {
      this->segment.end_process(3);
      this->process(1).see_reaped(3);
    } else {
      this->workers[1].give_work_back();
      this->work_until_the_end(1);
    }
  }
  void check() {
    RL_ASSERT(this->done.each_once(1));
    this->process(1).collect();
    const Word writer = this->segment.channels[0].writer.load(std::memory_order_seq_cst);
    RL_ASSERT(ring::writer_state(writer) == ring::State::Free);
  }
};
struct WorkOutlivesPublisher : WorkOutlivesPublisherScene<WorkOutlivesPublisher, false> {};
struct KilledWorkOutlivesPublisher : WorkOutlivesPublisherScene<KilledWorkOutlivesPublisher, true> {
};

/// A worker sleeps beside a task that somebody else works on, whose publisher has gone. It hears of
/// a publisher that comes.
struct AnnouncedBesideWork : Scene<AnnouncedBesideWork, 2> {
  AnnouncedBesideWork()
      : Scene({.blocks = 2,
               .depth = 1,
               .readers = 2,
               .channels = 2,
               .taken = true,
               .finished = true}) {}
  void prepare() {
    RL_ASSERT(publisher.open(start(4), 0, true));
    RL_ASSERT(busy.join(start(3), 0, 1, 1));
    RL_ASSERT(idle.join(start(2), 0, 1, 1));
    RL_ASSERT(publisher.send());
    RL_ASSERT(busy.start_work());
    RL_ASSERT(!idle.start_work());  // it has passed what the other one works on
    process(4).leave();             // which renews the directory
    version = segment.version.load(std::memory_order_relaxed);
    start(5);
  }
  void thread(unsigned t) {
    if (t == 0) {
      RL_ASSERT(next.advertise(process(5), 1, true));
    } else {
      while (segment.version.load(std::memory_order_acquire) == version) idle.sleep(version);
    }
  }
  void check() { busy.finish_work(); }
  Publisher publisher, next;
  Subscriber busy, idle;
  std::uint32_t version = 0;
};

/// The publisher goes, or is killed, before anybody reads: who comes later gets what waits there.
template <class Derived, bool kFinished>
struct WaitsForTakerScene : Scene<Derived, 3> {
  WaitsForTakerScene()
      : Scene<Derived, 3>(
            {.blocks = 1, .depth = 1, .readers = 1, .taken = true, .finished = kFinished}) {}
  void prepare() {
    RL_ASSERT(publisher.open(this->start(4), 0, true));
    this->start(1);
    this->start(2);
    RL_ASSERT(publisher.send());
  }
  void thread(unsigned t) {
    if (t == 0) {
      this->process(4).leave();
    } else if (t == 1) {
      this->process(1).collect();
    } else {
      RL_ASSERT(late.join(this->process(2), 0, 1, ring::Reader<Policy>::kFromTheStart));
      if (kFinished) {
        RL_ASSERT(late.start_work());
        late.finish_work();
      } else {
        RL_ASSERT(late.take([](std::uint64_t number) { RL_ASSERT(number == 0); }));
      }
    }
  }
  Publisher publisher;
  Subscriber late;
};
struct ItemWaitsForTaker : WaitsForTakerScene<ItemWaitsForTaker, false> {};
struct TaskWaitsForWorker : WaitsForTakerScene<TaskWaitsForWorker, true> {};

const Entered entered{
    {"worked_by_two_over_one_slot", "each task is done once, and its memory is used again",
     cast_of<WorkedByTwoOverOneSlot>, 2},
    {"worked_by_two_over_two_slots", "the same over two slots", cast_of<WorkedByTwoOverTwoSlots>,
     1},
    {"given_back_to_sleeper", "who sleeps hears of a task that has come back",
     cast_of<GivenBackToSleeper>},
    {"given_back_behind", "who has passed a task looks again when it has come back",
     cast_of<GivenBackBehind>},
    {"worked_on_before", "what a worker has done is done for the next one", cast_of<WorkedOnBefore>,
     3},
    {"killed_beside_sleeper", "who sleeps hears of a dead one's task",
     cast_of<KilledBesideSleeper>},
    {"worker_killed", "what the dead has not done is done", cast_of<WorkerKilled>},
    {"worker_killed_over_two_slots", "the same over two slots", cast_of<WorkerKilledOverTwoSlots>},
    {"finished_and_killed", "what a dead one has finished is done once", cast_of<FinishedAndKilled>,
     1},
    {"late_for_a_message", "who is late for a message leaves the next one in its slot alone",
     cast_of<LateForAMessage>, 2},
    {"work_outlives_publisher", "workers stay until nothing comes back",
     cast_of<WorkOutlivesPublisher>},
    {"killed_work_outlives_publisher", "the same where a worker dies",
     cast_of<KilledWorkOutlivesPublisher>},
    {"announced_beside_work", "who sleeps beside another's task hears of a new queue",
     cast_of<AnnouncedBesideWork>, 2},
    {"item_waits_for_taker", "an item waits when its publisher has gone",
     cast_of<ItemWaitsForTaker>, 1},
    {"task_waits_for_worker", "so does a task", cast_of<TaskWaitsForWorker>, 1},

    {"worked_by_two_over_one_slot_in_slots", "each task is done once, and its copy is whole",
     cast_of<InSlots<WorkedByTwoOverOneSlot>>, 2},
    {"worked_by_two_over_two_slots_in_slots", "the same over two slots",
     cast_of<InSlots<WorkedByTwoOverTwoSlots>>, 1},
    {"given_back_to_sleeper_in_slots", "a sleeper hears of a task that has come back",
     cast_of<InSlots<GivenBackToSleeper>>},
    {"worker_killed_in_slots", "what the dead has not done is done",
     cast_of<InSlots<WorkerKilled>>},
    {"finished_and_killed_in_slots", "what a dead one has finished is done once",
     cast_of<InSlots<FinishedAndKilled>>, 1},
    {"late_for_a_message_in_slots",
     "a worker that is late for a message leaves the next one in its slot alone",
     cast_of<InSlots<LateForAMessage>>, 2},
    {"task_waits_for_worker_in_slots", "a task waits when its publisher has gone",
     cast_of<InSlots<TaskWaitsForWorker>>, 1},
};

}  // namespace
}  // namespace lot::model
