// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <bitset>
#include <cstdint>
#include <functional>
#include <iosfwd>
#include <memory>
#include <string_view>
#include <utility>
#include <vector>

#include "choices.hpp"

/// The memory of C++20 as a machine that does one step after the other.
///
/// Each word has its values in modification order. A load may read each one that coherence and
/// happens-before leave to it; a store may go before stores that were done earlier. A
/// read-modify-write reads some value and stands directly behind it, and is no fence. Steps that
/// are seq_cst are ordered by a graph, which is grown as the standard says and must stay without a
/// cycle.
///
/// Steps are done in an order in which each thread's own steps stand as they are written. So no
/// load sees what is stored later: of the behaviours of C++20 those are left out in which such
/// loads close a circle (load buffering). A seq_cst fence stands behind all seq_cst steps that were
/// done before it.
namespace lot::weak {

using Value = std::uint64_t;
using Clock = std::uint32_t;
using Order = std::memory_order;

/// Four threads of a scenario, and the one that prepares and looks at what is left.
inline constexpr unsigned kMostThreads = 5;

/// How far a thread knows what each thread has done.
struct Clocks {
  std::array<Clock, kMostThreads> of{};

  void join(const Clocks& other) {
    for (unsigned t = 0; t < kMostThreads; ++t) of[t] = std::max(of[t], other.of[t]);
  }
};

/// What happens before something, and what happens strongly before it: only the latter orders
/// seq_cst steps.
struct View {
  Clocks happens;
  Clocks strongly;

  void join(const View& other) {
    happens.join(other.happens);
    strongly.join(other.strongly);
  }
};

/// What the memory knows of a thread.
struct Thread {
  unsigned index = 0;
  Clock clock = 0;
  View now;
  View read;    ///< by relaxed loads: an acquire fence takes it
  View fenced;  ///< at the last release fence: relaxed stores carry it
};

/// A place in the modification order of a word.
using Stamp = std::uint64_t;

struct Message {
  Value value = 0;
  Stamp stamp = 0;
  /// It was made of the message before it: nothing comes in between.
  bool follows = false;
  View view;  ///< what a thread gets that acquires it
};

/// Which seq_cst steps come before which.
class SeqCst {
 public:
  static constexpr std::size_t kMost = 512;
  using Set = std::bitset<kMost>;
  using Id = std::uint16_t;

  void clear();
  bool is_full() const { return before_.size() == kMost; }
  /// All that comes before a step of this thread which is done now.
  Set before(const Thread& thread) const;
  void add_with_before(Set& set, Id id) const { (set |= before_[id]).set(id); }
  Id enter(const Thread& thread, const Set& before, const std::vector<Id>& after);
  Id enter_fence(const Thread& thread);

 private:
  std::vector<Set> before_;
  std::array<std::vector<std::pair<Clock, Id>>, kMostThreads> of_thread_;
  int fence_ = -1;
};

/// One word.
class Location {
 public:
  void clear();
  bool is_empty() const { return messages_.empty(); }
  /// Its first value.
  void begin(Value value);
  Value newest() const { return messages_.back().value; }
  const Message& message(std::size_t i) const { return messages_[i]; }
  std::size_t count() const { return messages_.size(); }

 private:
  friend class Memory;

  struct Seen {
    Clock clock;
    Stamp stamp;
  };
  /// A seq_cst step. Of two that differ in place, the smaller one is ordered before the other.
  struct Strict {
    std::pair<Stamp, bool> place;  ///< and whether it only reads
    SeqCst::Id id;
  };

  /// A thread reads this, or what is newer; and stores behind it.
  Stamp bound(const Thread& thread) const;
  void note(const Thread& thread, Stamp stamp);
  std::size_t first_at(Stamp stamp) const;
  bool is_last(std::size_t i) const { return i + 1 == messages_.size(); }
  /// True when another message may come directly behind it.
  bool is_open(std::size_t i) const;
  Stamp behind(std::size_t i) const;

  std::vector<Message> messages_;
  std::array<std::vector<Seen>, kMostThreads> seen_;
  std::vector<Strict> strict_;  ///< by place
  Stamp fenced_ = 0;            ///< what threads knew of it at their seq_cst fences
};

/// All words of an execution, and what the threads do with them.
class Memory {
 public:
  using Choose = std::function<unsigned(Kind, unsigned)>;
  /// What a read-modify-write makes of a value.
  using Change = std::function<Value(Value)>;

  explicit Memory(Choose choose) : choose_(std::move(choose)) {}

  void clear();
  Location& make();
  /// The location may be made once more.
  void give_back(Location& location);

  /// All that the other thread has done, or knows, happens before what the first one does next.
  static void follow(Thread& thread, const Thread& other) {
    thread.now.join(other.now);
    thread.now.happens.of[other.index] = other.clock + 1;  // with what is behind its last step
  }

  Value load(Thread& thread, Location& at, Order order);
  void store(Thread& thread, Location& at, Value value, Order order);
  Value change(Thread& thread, Location& at, const Change& change, Order order);
  bool compare_exchange(Thread& thread, Location& at, Value& expected, Value desired, Order success,
                        Order failure);
  void fence(Thread& thread, Order order);

  /// While it is true, seq_cst orders nothing that happens-before does not: there is one thread.
  void set_alone(bool alone) { alone_ = alone; }
  /// From now on all memories have this mistake, which the litmus tests must find. False: there is
  /// no mistake of that name.
  static bool make_mistake(std::string_view name);
  static void list_mistakes(std::ostream& out);

  /// How many newer values the last step left aside.
  std::size_t lateness() const { return lateness_; }

 private:
  /// What a step could do: read this message, store behind it, or both.
  struct Option {
    std::size_t message;
    bool reads;
    bool writes;
    Order order;
  };

  template <class Judge>
  Option choose(Thread& thread, Location& at, Judge&& judge);
  bool fits(const Thread& thread, const Location& at, const Option& option) const;
  void enter_strict(const Thread& thread, Location& at, std::pair<Stamp, bool> place);
  void read(Thread& thread, Location& at, std::size_t message, Order order);
  void write(Thread& thread, Location& at, const Option& option, Value value);
  static void tick(Thread& thread);

  /// What could be wrong with such a machine.
  struct Mistakes {
    bool fences = false;      ///< a read-modify-write is a full fence
    bool newest = false;      ///< loads read the newest value
    bool row = false;         ///< stores stand in the order in which they are done
    bool incoherent = false;  ///< what a thread has read binds it to nothing
    bool unordered = false;   ///< seq_cst steps are not ordered
    bool in_turn = false;     ///< seq_cst steps are ordered as they are done
    bool broken = false;      ///< a read-modify-write does not go on with a release sequence
    bool split = false;       ///< two read-modify-writes may begin with the same value
    bool silent = false;      ///< relaxed stores do not carry what a release fence says
  };
  static Mistakes mistakes_;
  static const std::pair<const char*, bool Mistakes::*> kMistakes[];

  Choose choose_;
  SeqCst strict_;
  std::vector<Location*> all_;
  std::vector<Location*> free_;
  std::vector<std::unique_ptr<Location>> owned_;
  std::vector<Option> options_;
  std::size_t lateness_ = 0;
  bool alone_ = true;
};

}  // namespace lot::weak
