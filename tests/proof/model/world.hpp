// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>  // the headers under test name memory orders and include no atomics of their own

#include "lockfree_ring/ear.hpp"
#include "lockfree_ring/sleep.hpp"
#include "policy.hpp"
#include "recovery/recovery.hpp"
#include "refcount/ownership.hpp"
#include "robust_mutex/lock_word.hpp"
#include "selection/bounds.hpp"
#include "support/raw.hpp"

/// One word of ears is enough here, and keeps the search small.
template <>
inline constexpr std::uint32_t lot::ring::kEarWords<lot::model::Policy> = 1;

/// A small world around the headers under test: a segment, processes in it, and what the transport
/// does with them (pool, publisher, subscriber), reduced to its atomic steps.
namespace lot::model {

namespace hold = detail::hold;
using ring::kNoBlock;
using ring::Word;

template <class T>
using Atomic = CheckedAtomic<T>;

/// Indexes of processes are 1 .. kParticipants - 1; 0 is the orphanage.
inline constexpr std::uint32_t kParticipants = Policy::kOwnWords * Policy::kBitsPerWord;
/// Somebody without an index, who only looks after things when all others have gone.
inline constexpr std::uint32_t kJanitor = kParticipants;
/// Whose name the memory has in it that a ring is made in.
inline constexpr std::uint32_t kSoiledBy = 5;
/// The lock of the registry; the byte locks of the participants come before it.
inline constexpr std::uint32_t kRegistryLock = kParticipants;

struct Shape {
  std::uint32_t blocks = 3;
  std::uint32_t depth = 2;
  std::uint32_t readers = 1;
  std::uint32_t channels = 1;
  bool taken = false;     ///< each message is for one reader, which takes it
  bool locked = false;    ///< the mutex engine
  bool finished = false;  ///< what is taken stays in its slot until it is finished
  bool in_slots = false;  ///< messages travel in the slots themselves
  bool has_ear = false;   ///< there is a sleeper that listens to all rings (ear.hpp)
  /// Words of a slot.
  std::size_t slot_words() const { return in_slots ? 8 : 1; }
};

/// A message that travels in a slot: its number, in words that must belong together.
struct Letter {
  static constexpr std::size_t kWords = 2;
  std::uint64_t number = 0;
  std::uint64_t again = 0;
  Word time = 0;

  static Letter of(std::uint64_t number) { return {number, ~number, ~number}; }
  /// Copies the message that the reader has found, if it is in its slot. False: it has gone.
  bool copy(ring::Reader<Policy>& reader, Word block, std::uint64_t& missed) {
    RL_ASSERT(block == kNoBlock || (block == ring::kInSlot) == reader.ring().in_slots());
    if (block != ring::kInSlot) return true;
    const ring::Copy copy = reader.copy(this, kWords, &time, missed);
    RL_ASSERT(copy != ring::Copy::Damaged);
    return copy == ring::Copy::Whole;
  }
  std::uint64_t read() const {
    const Letter whole = of(number);
    RL_ASSERT(again == whole.again && time == whole.time);
    return number;
  }
};

/// One channel's words, and the plain ones that the publisher writes before it goes LIVE.
struct Channel {
  explicit Channel(const Shape& shape);
  /// As the memory is that a new ring gets: somebody's message was in there.
  void soil();

  ring::WriterWord<Policy> writer;
  std::vector<Atomic<Word>> slots;
  std::vector<ring::Cell<Policy>> cells;
  std::vector<Atomic<std::uint32_t>> who;
  Atomic<std::uint32_t> roster;
  Atomic<std::uint32_t> space;
  std::vector<Atomic<Word>> claims;
  Atomic<std::uint32_t> returned;
  Atomic<Word> floor;
  std::vector<selection::Bounds<Policy>> bounds;  ///< the ring's extra memory
  Atomic<std::uint32_t> formed;                   ///< 1: `blocking` is written
  Plain<bool> blocking;
  Plain<bool> used;  ///< written by who makes a ring and who frees it: one after the other
  Atomic<std::uint32_t> arrived;  ///< the mutex engine's condition
  Atomic<std::uint32_t> lock;     ///< its lock
  /// Written by who takes and who leaves a cell: a cell has one reader after the other.
  std::vector<Plain<std::uint32_t>> tenants;
};

/// Everything that is shared, and the kernel's locks.
class Segment {
 public:
  /// So close to the end that every scenario wraps the sequence.
  static constexpr Word kFirst = ring::kSequenceMask - 1;

  explicit Segment(const Shape& shape);

  bool try_lock(std::uint32_t lock, std::uint32_t holder);
  void unlock(std::uint32_t lock);

  /// False when the last owner has died with the lock.
  bool lock_queue(std::uint32_t channel, std::uint32_t holder);
  void unlock_queue(std::uint32_t channel, std::uint32_t holder);

  /// What the kernel does for a process that has ended, in whatever way.
  void end_process(std::uint32_t participant);
  /// Waits until somebody has ended; 0 < participant < kParticipants.
  void await_end_of(std::uint32_t participant);
  bool has_ended(std::uint32_t participant) const;

  const Shape shape;
  std::vector<refcount::ParticipantState<Policy>> states;
  std::vector<refcount::BlockWords<Policy>> blocks;
  std::deque<Channel> channels;
  /// The directory's.
  ring::DirectoryVersion<Policy> version;
  /// The ears that listen to a channel, and the words of ear 0.
  std::vector<ring::Listeners<Policy>> listeners;
  ring::EarWords<Policy> ear_words;
  std::vector<Atomic<Word>> news;
  ring::Ear<Policy> ear() { return {&ear_words, news.data()}; }
  /// By participant, of the one topic.
  std::vector<Atomic<std::uint32_t>> pullers;
  /// The message of a block: its number. Any access that the protocol does not order is a race.
  std::vector<Plain<std::uint64_t>> payloads;
  /// A block that the message of a block refers to, or kNoBlock.
  std::vector<Plain<Word>> references;

 private:
  std::vector<Atomic<std::uint32_t>> locks_;  ///< holder + 1
  std::vector<Atomic<std::uint32_t>> ended_;
};

class Process;
class Publisher;

/// Has a ring of the mutex engine for itself, while this lives. Who has it from a dead one wakes
/// all.
class Turn {
 public:
  Turn(Process& process, std::uint32_t channel);
  ~Turn() noexcept(false) { unlock(); }  // its owner may be killed there
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;

  void lock();
  void unlock();

 private:
  Process& process_;
  std::uint32_t channel_;
  bool held_ = false;
};

/// One process: its hold words, its blocks, and the World that Recovery sees through its eyes.
class Process {
 public:
  static constexpr Word kNone = kNoBlock;

  /// As participant `index`, or as janitor. Enters the segment with attach().
  Process(Segment& segment, std::uint32_t index);

  bool attach();
  /// A clean exit: reaps itself. Waits for the orphanage's lock.
  void leave();
  /// Repairs what k left. False: nothing to do, k lives, or somebody else is at it.
  bool reap(std::uint32_t k);
  /// The same, until it is done, by whomever.
  void see_reaped(std::uint32_t k);
  void collect();
  /// The oldest message of an ended ring goes, for memory.
  void take_out(std::uint32_t channel, Word block);

  // Blocks. All words are block numbers or kNone.
  Word loan();
  void give_back(Word b);  ///< a loaned block, to everybody
  void unloan(Word b);     ///< a loaned block, to our pool
  void keep(Word b);       ///< takes a pointer hold; the caller protects the block
  /// As another thread sees it that waits for nothing.
  bool holds(Word b) { return (hold(b).load(std::memory_order_relaxed) & hold::kHeld) != 0; }
  bool lock_weak(Word b, std::uint32_t generation);
  void copy(Word b);                ///< copies a pointer
  void drop(Word b);                ///< lets go of a pointer hold
  void hand_to_ring(Word b);        ///< takes a hold for the ring, and drops the pointer
  void hand_own_to_ring(Word b);    ///< the same for a loaned block: nobody else has holds
  void refer(Word b, Word target);  ///< the message in b keeps `target`, which we hold, alive
  void take_from_ring(Word b);      ///< the ring's hold ends; nobody reads the block there
  bool at_home(Word b);
  std::uint32_t generation(Word b);

  std::uint64_t read(Word b, std::source_location where = std::source_location::current());
  void write(Word b, std::uint64_t message,
             std::source_location where = std::source_location::current());

  /// Ends a ring of ours, as a publisher does that goes while its process stays.
  void close_ring(std::uint32_t channel);
  /// True when the ring's blocks are the orphanage's.
  bool ring_closed(std::uint32_t channel);
  /// Sleeps until each reader of a ring has left it.
  void await_no_reader(std::uint32_t channel);

  /// The readers of a ring that we read look again.
  void wake_sleepers(std::uint32_t channel);

  // A reader of ours takes and leaves a cell.
  void move_in(std::uint32_t channel, std::uint32_t cell);
  void move_out(std::uint32_t channel, std::uint32_t cell);

  void enter(Publisher& publisher) { publishers_.push_back(&publisher); }

  std::uint32_t index() const { return own_.self; }
  Segment& segment() { return *segment_; }

  // What Recovery asks of its World.
  std::uint32_t participants() const { return kParticipants; }
  refcount::ParticipantState<Policy>& participant_state(std::uint32_t k) {
    return segment_->states[k];
  }
  std::uint32_t blocks() const { return segment_->shape.blocks; }
  refcount::BlockWords<Policy>& block(std::uint32_t b) { return segment_->blocks[b]; }
  std::uint32_t channels() const { return segment_->shape.channels; }
  ring::WriterWord<Policy>& channel_writer(std::uint32_t c) { return segment_->channels[c].writer; }
  ring::Ring<Policy> ring(std::uint32_t c);
  ring::Ring<Policy> unformed_ring(std::uint32_t c);
  template <class F>
  void each_reference(std::uint32_t b, F&& f) {
    f(segment_->references[b].read());
  }
  bool lock_rings() { return segment_->try_lock(kRegistryLock, index()); }
  void unlock_rings() { segment_->unlock(kRegistryLock); }
  void recycle_ring(std::uint32_t c) {
    segment_->channels[c].formed.store(0, std::memory_order_release);
    segment_->channels[c].used.write(false);
  }
  void release_extents(const std::vector<bool>& dead);
  void renew_directory() {
    segment_->version.bump();
    segment_->version.word().wake_all();
  }
  void unsubscribe(std::uint32_t k) {
    // Only then, as the registry: Relacy takes the store for a fence.
    auto& pullers = segment_->pullers[k];
    if (pullers.load(std::memory_order_relaxed) != 0) {
      pullers.store(0, std::memory_order_seq_cst);  // R13
    }
  }
  void forget(std::uint32_t) {}
  template <class T>
  void wake(Atomic<T>& word) {
    word.wake_all();
  }
  /// Unconditionally, as it is for a reaper.
  void ring_ears(std::uint32_t c) {
    tell_ears(c, [](const auto& bell, bool) { bell.wake_all(); });
  }
  /// Calls wake(bell, is_asleep) for each ear that listens to the channel.
  template <class Wake>
  void tell_ears(std::uint32_t c, Wake&& wake) {
    if (!segment_->shape.has_ear) return;
    segment_->listeners[c].each([&](std::uint32_t) {
      const bool is_asleep = segment_->ear().tell(c);
      wake(segment_->ear_words.bell.word(), is_asleep);
    });
  }

 private:
  using Recovery = recovery::Recovery<Policy, Process>;

  refcount::BlockWords<Policy>& words(Word b) { return segment_->blocks[b]; }
  refcount::Ownership<Policy>::Hold& hold(Word b) { return holds_[b]; }
  bool reclaim(Word b, std::uint64_t expected);
  void come_home(Word b, std::uint64_t expected);
  void release_reference(Word b);
  Word try_loan();
  // No guard: its destructor would touch the lock while a killed process unwinds.
  void lock_pool();
  void unlock_pool() { pool_lock_.store(0, std::memory_order_release); }

  Segment* segment_;
  refcount::Ownership<Policy> own_;
  std::vector<refcount::Ownership<Policy>::Hold> holds_;
  Atomic<std::uint32_t> pool_lock_;
  std::deque<Word> ready_;  ///< exclusively ours
  std::deque<Word> kept_;   ///< ours, but others held them when we looked
  std::vector<Publisher*> publishers_;
};

/// The sending end of a channel, and the list of blocks that readers may still be looking at.
class Publisher {
 public:
  /// Claims a free channel. False: not free.
  bool open(Process& process, std::uint32_t channel, bool blocking);
  /// The same, and tells the readers of all channels, which are of one topic.
  bool advertise(Process& process, std::uint32_t channel, bool blocking);
  /// Calls f(participant) for each whose reader holds the sender back.
  template <class F>
  void laggards(F&& f) {
    writer_.laggards([&](std::uint32_t cell) {
      const std::uint32_t who = writer_.ring().who[cell].load(std::memory_order_acquire);
      if (who != 0) f(who - 1);
    });
  }
  ring::Writer<Policy>& writer() { return writer_; }

  /// Only tells. REQUIRES: the registry's lock.
  void announce();

  /// Publishes the next message in a block of its own. False: no block, or no room.
  bool send();
  /// The same, and sleeps while there is no room. REQUIRES: blocks enough.
  void send_and_wait();
  /// Publishes a block that we have a pointer hold on, which becomes the ring's. REQUIRES: as
  /// send_own(), messages are in blocks.
  void forward(Word b);
  /// Publishes a loaned block. REQUIRES: room.
  void send_own(Word b);
  /// Takes the oldest message back: its block, or nothing when the ring is empty.
  std::optional<Word> evict();
  /// Takes back what all readers have read, but for the newest `keep` messages.
  void take_back(std::uint32_t keep);
  /// Ends the ring, and gives up what is the orphanage's then.
  void close();
  /// Gives up the retired blocks that no reader looks at.
  void scan();

  std::uint64_t sent() const { return sent_; }

 private:
  bool make_ring(Process& process, std::uint32_t channel, bool blocking);
  void publish(Word b, Turn& turn);
  void publish_letter(Turn& turn);
  void tell(const ring::Writer<Policy>::Published& published, Turn& turn);
  void retire(Word b);
  void retire_taken();

  Process* process_ = nullptr;
  std::uint32_t channel_ = 0;
  ring::Writer<Policy> writer_;
  std::vector<Word> retired_;
  std::uint64_t sent_ = 0;
};

/// Falls asleep on many rings, as a puller does that knows of the directory's `version`.
template <class Sources>
void sleep_on(Sources& sources, Segment& segment, std::uint32_t version) {
  Bed bed;
  const ring::Rest rest = ring::prepare_to_sleep(
      sources, segment.version, version,
      [&bed](const auto& word, auto value, bool is_shared) { bed.add(word, value, is_shared); });
  if (rest == ring::Rest::Sleep) {
    bed.sleep();
    bed.pass_on();
  }
  if (rest == ring::Rest::Doze) Policy::pause();
}

/// The receiving end of a channel. For scenarios in which nobody advertises.
class Subscriber {
 public:
  using Manner = ring::Reader<Policy>::Manner;
  /// Joins generation `generation` of a channel under the registry's lock.
  bool join(Process& process, std::uint32_t channel, std::uint32_t generation,
            std::uint64_t history, Manner manner = Manner::Reads);
  void leave();
  /// Joins it once more, with an answer, and leaves then. Without the lock: it was there all along.
  bool join_anew(Word answer);

  /// The next message's block, or kNone; protected until done(). Of a message in its slot: kInSlot.
  Word borrow();
  void done();
  bool ended() const { return reader_.ended(); }
  const ring::Reader<Policy>& reader() const { return reader_; }
  /// Sleeps until there may be something to look at; it knows of the directory's `version`.
  void sleep(std::uint32_t version = 0);
  /// Only leaves its mark. False: there may be something to look at.
  bool leave_mark();

  /// Borrows, reads, and checks that it is the message of this place. False: there is none.
  bool receive();
  /// Borrows, keeps, lets the borrow go, reads and checks, drops. False: there is none.
  bool receive_and_keep();
  /// Takes the next message, checks it and changes it, as its only owner. False: there is none.
  /// `mine(number)` is called as soon as it is ours.
  template <class Mine>
  bool take(Mine&& mine);
  // Where messages are to be finished.

  /// Claims the next message, and checks it. False: there is none.
  bool start_work();
  std::uint64_t work() const { return work_.number; }
  void finish_work();
  void give_work_back();
  /// The publisher has gone, and nothing is left or comes back.
  bool over() const { return reader_.ended() && !reader_.has_returns() && reader_.is_closing(); }

  /// What receive(), receive_and_keep() and take() saw.
  std::uint64_t received() const { return received_; }
  std::uint64_t missed() const { return missed_; }
  /// Number of the message at the cursor: 0 for the first one of the ring.
  std::uint64_t number() const;

 private:
  /// A reader that finds another version of the directory looks at its rings, under the registry's
  /// lock; or it dozes, and tries again.
  void look_at_the_directory();
  struct Work {
    Word block = kNoBlock;
    std::uint64_t number = 0;
    std::uint32_t slot = 0;
    Word claim = 0;
  };

  struct Source {
    ring::Reader<Policy>& reader;
    Process& process;
    std::uint32_t channel;
    struct Turn : model::Turn {
      explicit Turn(const Source& s) : model::Turn(s.process, s.channel) {}
    };
  };

  /// Takes the next message, and holds it: its block, or kNone.
  Word take_one(std::uint64_t& number);
  std::uint64_t read(Word b);
  void keep(Word b);
  void drop(Word b);
  void ring_for_room();

  Process* process_ = nullptr;
  std::uint32_t channel_ = 0;
  std::uint32_t generation_ = 0;
  ring::Reader<Policy> reader_;
  std::uint32_t version_ = 0;  ///< of the directory, as it last looked there
  std::uint64_t missed_ = 0;
  std::uint64_t received_ = 0;
  Work work_;
  Letter letter_;  ///< the message that was copied last
};

template <class Mine>
bool Subscriber::take(Mine&& mine) {
  std::uint64_t number = 0;
  const Word b = take_one(number);
  if (b == kNoBlock) return false;
  mine(number);
  RL_ASSERT(read(b) == number);
  if (b != ring::kInSlot) process_->write(b, ~number);
  drop(b);
  ++received_;
  return true;
}

/// While this lives, the rings of new scenes have their messages in their slots.
class Letters {
 public:
  Letters() { on_ = true; }
  ~Letters() { on_ = false; }
  Letters(const Letters&) = delete;
  Letters& operator=(const Letters&) = delete;

  static Shape in(Shape shape) {
    shape.in_slots = shape.in_slots || on_;
    return shape;
  }

 private:
  static inline bool on_ = false;
};
/// A scene whose messages travel in the slots instead of in blocks.
template <class Scene>
struct InSlots : private Letters, public Scene {};

/// First in every scene, before anything allocates.
struct SceneBegins {
  SceneBegins() {
    OrdinaryHeap::use();
    killer.aim_at_nobody();
    garden.forget();
    Policy::does_damage = false;
  }
};

/// What scenarios share: a segment, its processes, and the look at what is left in the end.
template <class Derived, unsigned kThreads>
class Scene : SceneBegins, public rl::test_suite<Derived, kThreads> {
 public:
  void before() { static_cast<Derived*>(this)->prepare(); }
  void after() {
    killer.aim_at_nobody();
    static_cast<Derived*>(this)->check();
    quiesce();
  }
  void check() {}

 protected:
  explicit Scene(const Shape& shape = {}) : segment(Letters::in(shape)) {}

  /// Starts a process; in the place of one that has ended, if need be.
  Process& start(std::uint32_t index) {
    processes_[index].emplace(segment, index);
    RL_ASSERT(processes_[index]->attach());
    return *processes_[index];
  }
  Process& process(std::uint32_t index) { return *processes_[index]; }

  /// Runs f as a process that is killed at one of its first `steps` atomic steps, or ends by itself
  /// without any cleaning up after f.
  template <class F>
  void die_within(std::uint32_t index, unsigned steps, F&& f) {
    killer.aim(1 + rl::rand(steps));
    try {
      f();
    } catch (const Killed&) {  // nothing here: Relacy may not switch threads inside a handler
    }
    killer.aim(0);
    segment.end_process(index);
  }

  Segment segment;

 private:
  /// Everybody has gone, one way or the other: nothing may be left.
  void quiesce() {
    for (std::uint32_t k = 1; k < kParticipants; ++k) segment.end_process(k);
    Process janitor(segment, kJanitor);
    for (std::uint32_t k = 1; k < kParticipants; ++k) janitor.reap(k);
    if (segment.shape.taken) take_what_waits();
    segment.end_process(kTaker);
    janitor.reap(kTaker);
    janitor.collect();
    constexpr auto kOrder = std::memory_order_seq_cst;
    for (auto& state : segment.states) RL_ASSERT(state.load(kOrder) == 0);
    for (auto& count : segment.pullers) RL_ASSERT(count.load(kOrder) == 0);
    for (auto& block : segment.blocks) {
      RL_ASSERT(block.home.load(kOrder) == refcount::kHomeFree);
      for (auto& word : block.own) RL_ASSERT(word.load(kOrder) == 0);
    }
    for (auto& channel : segment.channels) {
      RL_ASSERT(ring::writer_state(channel.writer.load(kOrder)) == ring::State::Free);
    }
  }

  /// What is to be taken waits in rings that have ended, for who comes.
  void take_what_waits() {
    Process& taker = start(kTaker);
    for (std::uint32_t c = 0; c < segment.shape.channels; ++c) {
      const Word w = segment.channels[c].writer.load(std::memory_order_seq_cst);
      if (ring::writer_state(w) != ring::State::Orphan) continue;
      Subscriber last;
      RL_ASSERT(
          last.join(taker, c, ring::writer_generation(w), ring::Reader<Policy>::kFromTheStart));
      if (segment.shape.finished) {
        while (last.start_work()) last.finish_work();
      } else {
        while (last.take([](std::uint64_t) {})) {
        }
      }
      last.leave();
    }
  }

  static constexpr std::uint32_t kTaker = 1;
  std::array<std::optional<Process>, kParticipants> processes_;
};

}  // namespace lot::model
