// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "lot/detail/selection.hpp"
#include "lot/lot.hpp"

#include "segment/layout.hpp"

namespace lot::kill {

/// What the nodes send: small and plain.
struct Number {
  std::uint64_t source;
  std::uint64_t number;
  std::uint64_t check;
};
/// What grows, and refers to others.
struct Frame {
  Number number;
  ShmVector<std::uint64_t> data;
  ShmRef<const Number> reference;
};

Number numbered(std::uint64_t source, std::uint64_t number);
bool intact(const Number& message);
/// Of a subscription that looks on.
PullerOptions observing(std::uint64_t history = 0);

/// What a reader has seen of each publisher: numbers from 0 that follow each other, but for those
/// that it was told it missed.
class Account {
 public:
  /// The reader came after the first message: it begins anywhere.
  void joined_late() { late_ = true; }
  /// A message was received, after `missed` others.
  void enter(const Number& message, std::uint64_t missed);
  void complain(const std::string& what);

  std::uint64_t last(std::uint64_t source) const;   ///< number of the last message + 1
  std::uint64_t missed() const { return missed_; }  ///< messages of all sources
  const std::string& complaint() const { return complaint_; }

 private:
  static constexpr std::size_t kSources = 8;
  std::uint64_t next_[kSources] = {};
  bool seen_[kSources] = {};
  std::uint64_t missed_ = 0;
  bool late_ = false;
  std::string complaint_;
};

/// A process of a scene, and all that it may have.
struct Node {
  Node(const EngineOptions& o, std::uint64_t s) : options(o), source(s) {}
  ~Node() { leave(); }
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  void join();
  /// Everything goes, the engine last.
  void leave();
  /// Everything but the engine.
  void drop_all();

  // Steps that scenes are made of.
  void publish(unsigned count = 1);
  void publish_heard(ShmUniquePtr<Number> message);
  void observe(const char* topic, std::uint64_t history = 0);  ///< `puller` looks on
  void hear(const char* topic);  ///< `ear` hears what this node publishes there
  void enter_halves(std::uint32_t from, std::uint32_t to);  ///< a topic for each of these types
  /// The description of a topic, if there is such a topic and it has one.
  std::optional<Description> look_up(const char* topic) const;
  void publish_watched();  ///< one that `weak` points to; it must die before inspect() ends
  bool receive();          ///< the next message, if there is one, goes into the account
  void receive_all();      ///< those that are there
  void sleep_on_topic();   ///< a thread of its own sleeps for the topic's messages until the end
  void listen();           ///< `set` waits for the puller, by an ear
  void listen_until_the_end();  ///< a thread of its own runs that set
  void sleep_for_room();   ///< a thread of its own publishes one more, for which there is no room
  void hold(bool borrow);  ///< the next message stays borrowed, or is kept
  void reap();             ///< repairs what the dead left, now
  bool reads_now() const;  ///< the puller is free for a read
  bool waits_at_home() const;  ///< for others to let go of a message
  bool home_waits() const;     ///< for us to let go of what we keep first, and that is elsewhere
  void await_sleeper();        ///< until a mark stands in some slot, or on some condition
  void open_queue(const QueueOptions& options);
  void put(unsigned count = 1);  ///< items into the queue
  bool pop();                    ///< the next item, if there is one, goes into `items`
  void contend();                ///< pops an item, or keeps a message and reads the rest
  void take_work();              ///< the next task, which must be there, is ours until the end
  /// The next item, which is finished where it is a task. Nothing: none came in time.
  std::optional<Number> next_item(std::chrono::milliseconds most);
  void sleep_on_queue();  ///< a thread of its own pops until it is told that all is over
  void sleep_to_put();    ///< a thread of its own puts one more, for which there is no room
  void advertise_selecting(const char* topic, const PusherOptions& options);  ///< `selecting`
  void subscribe_selected(const char* topic);                                 ///< `selected`
  void select(const char* name, std::size_t back = 0);  ///< there must be such a reader
  void read_selected();                                 ///< what is there goes into the account
  void arm();                                           ///< makes what the probes use
  void arm_in_slots();
  void disarm();  ///< all of that goes

  // After a death.
  void inspect_queue();
  void inspect_selected();
  void inspect_names();
  void inspect_other_type();
  void inspect_room();
  bool is_superseded();
  void enter_item(const Number& item);
  void inspect();  ///< repairs, reads and publishes all it can, looks at what it holds
  ShmSharedPtr<const Frame> inspect_frames();
  void live_again();  ///< what a node does that was started again
  void meet();        ///< asks what topics carry, and receives what the second life published
  void start();       ///< joins, publishes to itself and reads it
  void await(const std::function<bool(const segment::Ring&)>& mark) const;

  EngineOptions options;
  std::uint64_t source;
  std::uint64_t published = 0;
  Account account;

  std::optional<ShmEngine> engine;
  std::optional<ShmPusher<Number>> pusher, second;
  std::optional<ShmPuller<Number>> puller;
  /// The only reader of what this node publishes that others wait for: it reads each message at
  /// once.
  std::optional<ShmPuller<Number>> ear;
  /// An end of kTopic that knows no names, or other ones.
  std::unique_ptr<detail::PullerCore> nameless;
  std::unique_ptr<detail::PusherCore> other;
  std::vector<std::uint32_t> fillers;  ///< topics with descriptions that fill their table
  std::optional<ShmPusher<Frame>> frames;
  std::optional<ShmPuller<Frame>> frame_puller;
  std::optional<ShmQueue<Number>> queue;
  ShmTask<Number> work;                                 ///< of the queue, where its items are tasks
  bool redelivers = false;                              ///< they are
  std::optional<ShmQueue<ShmUniquePtr<Number>>> tasks;  ///< the same queue, without a copy
  std::atomic<std::uint64_t> items{0};  ///< a bit for each item of the queue that was popped
  std::uint64_t put_items = 0;
  std::atomic<bool> over{false};  ///< for who sleeps on the queue
  /// Says to each reader which messages are for it; and such a reader.
  std::unique_ptr<detail::SelectingPusher> selecting;
  std::unique_ptr<detail::SelectingPuller> selected;
  std::optional<detail::SelectedReader> reader;  ///< that `selecting` has selected
  /// What has come to such a reader, and whether it was its own, if that was said.
  struct Letter {
    Number number;
    detail::Origin origin;
    std::optional<bool> ours;
  };
  std::vector<Letter> letters;
  std::size_t resent = 0;                      ///< how many letters were
  std::uint64_t due_from = 0, due_to = 0;      ///< the numbers of letters that must be its own
  std::uint64_t may_from = 0, may_to = ~0ULL;  ///< of those that may be
  /// Of a set: more words than it sleeps on, in pullers that no publisher is there for.
  std::vector<std::unique_ptr<ShmPuller<Number>>> quiet;
  std::optional<WaitSet> set;
  ShmBorrow<Number> borrow;
  std::vector<ShmUniquePtr<Number>> loans;
  std::vector<ShmUniquePtr<Frame>> frame_loans;
  std::vector<ShmSharedPtr<const Number>> kept;
  ShmSharedPtr<Number> own;
  ShmWeakPtr<const Number> weak;
  bool watched = false;      ///< it points to a message that nobody holds in the end
  bool reads_topic = false;  ///< the puller is the topic's
  bool blocking = false;     ///< the pusher's policy is Block
  bool locked = false;       ///< the scene's queue has the mutex engine
  bool retypes = false;      ///< only observers have kTopic in the end: it gets another type
  std::uint64_t frames_seen = 0;
  std::optional<Number> held;  ///< what was borrowed or kept first must stay like this
  std::thread sleeper;

  // What the probes use.
  std::optional<ShmPusher<Number>> probe_pusher, probe_again, probe_block, probe_slots;
  std::optional<ShmPuller<Number>> probe_puller, probe_block_puller, probe_observer,
      probe_slots_puller;
  std::optional<ShmQueue<Number>> probe_queue, probe_slots_queue;
  std::optional<ShmPusher<Frame>> probe_frames;
  ShmBorrow<Number> probe_borrow;
  ShmUniquePtr<Number> probe_loan;
  std::vector<ShmUniquePtr<Number>> probe_loans;
  ShmSharedPtr<const Number> probe_kept, probe_copy;
  ShmWeakPtr<const Number> probe_weak;
  bool probe_ready = false;
  void drop_probes();
};

/// What a scene does before its operation, and who does it.
enum class Who : std::uint8_t {
  Victim,
  Witness,    ///< lives on and sees to it that nothing is lost
  Bystander,  ///< lives on as well, and reads what it had subscribed to
  Dead,       ///< is killed before the operation
  Rival       ///< wants the same item as the victim
};
struct Act {
  Who who;
  std::function<void(Node&)> act;
};

/// How far others can hold the operation up.
enum class Promise : std::uint8_t {
  WaitFree,  ///< a bounded number of its own instructions, whatever others do
  LockFree,  ///< the same when others stand still
  Blocking   ///< waits for others: with a patience, and not for the dead
};
const char* name_of(Promise promise);

/// The promise of an operation, and the probe that shows it: what does not wait must name one.
struct Pledge {
  Pledge(Promise p, const char* probe = nullptr) : promise(p), shown_by(probe) {}
  Promise promise;
  const char* shown_by;
};

/// A process that is in the middle of a pop when the victim operates: it holds an item, and has not
/// taken it out of the queue. Where messages travel in their slots, it has copied one. It may read
/// the topic there, too.
enum class Rival : std::uint8_t {
  None,
  Stopped,  ///< it goes on when the victim is dead
  Halfway,  ///< the same, but the last word of its copy is missing
  Killed
};

/// One operation of the public interface in one situation.
struct Operation {
  std::string name;
  Pledge pledge;
  std::vector<Act> before;
  std::function<void(Node&)> run;            ///< the operation itself
  std::function<void(Node&)> when_asleep{};  ///< the witness does this when the victim sleeps in it
  bool alone = false;                        ///< there is no witness while it runs
  Rival rival = Rival::None;
  unsigned every = 1;  ///< its points are alike (each granule's tag): one of so many is enough
  bool ends = false;   ///< the process does nothing behind it
  std::uint32_t topics = 10;  ///< that the segment can have
  /// False: the victim has all blocks, so there are none for what a neighbour does (--stop).
  bool leaves_blocks = true;
};

std::vector<Operation> all_operations();
// Parts of them.
struct Way;
void observers(std::vector<Operation>& all, const Way& way);
/// What only messages in slots have.
void slots(std::vector<Operation>& all);
void ears(std::vector<Operation>& all, QueueEngine engine);
void types(std::vector<Operation>& all);

/// What a neighbour does while the victim stands still in the middle of its operation.
struct Probe {
  const char* name;
  Promise promise;
  std::function<void(Node&)> run;
  std::function<bool(Node&)> ready{};  ///< before it is counted; false: not in this scene
  const char* found_as = nullptr;      ///< it breaks its promise, and this must be said of it
  bool waits_for_registry = false;     ///< for its lock, and for nothing else
};
/// Those that are planted come last.
const std::vector<Probe>& all_probes();
/// The probe that does the same with messages in slots; null: none need be named.
const char* shown_in_slots(const char* probe);

/// An operation that breaks a promise, and what must be said of it.
struct Plant {
  Operation operation;
  const char* found_as;
};
std::vector<Plant> planted_operations();
/// The same, where observers are, and descriptions.
std::vector<Plant> planted_beside_observers();
/// The same, where messages travel in their slots.
std::vector<Plant> planted_in_slots();
/// To be found when its system calls fail.
Plant planted_failure();
/// Its calls are fewer from its second run on: most of its points are never reached.
Plant planted_shrinking();
/// Harm that is undone before the operation ends: only a kill on the way finds it.
Plant planted_on_the_way();
/// They change something in the first run only, or in all others only: those must have strayed.
std::vector<Operation> planted_changes();
/// What names no probe, or one that promises less.
std::vector<Operation> planted_pledges();

inline constexpr const char* kTopic = "/numbers";  ///< the victim publishes here
inline constexpr const char* kOther = "/others";   ///< the witness publishes here
inline constexpr const char* kFrames = "/frames";
inline constexpr const char* kQuiet = "/quiet";  ///< no process publishes here
inline constexpr const char* kItems = "/items";  ///< each is taken by one
inline constexpr const char* kLeft = "/left";    ///< the same, of the victim for itself
inline constexpr std::uint64_t kVictim = 1, kWitness = 2, kDead = 3, kSecondLife = 4, kRival = 5,
                               kBystander = 6;

}  // namespace lot::kill
