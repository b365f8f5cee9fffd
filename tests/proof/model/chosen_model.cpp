// SPDX-License-Identifier: Apache-2.0
#include <deque>
#include <utility>

#include "lockfree_ring/chosen.hpp"
#include "scenario.hpp"
#include "world.hpp"

/// A publisher that says to each reader which messages are for it, and sends it the others another
/// way: lot::ros (docs/ros.md).
namespace lot::model {
namespace {

constexpr unsigned kMost = 8;
/// Frames from this number on say: join my ring anew, and answer by that.
constexpr std::uint64_t kInvitation = 1000;

/// The other way: nothing is lost, and all comes in order.
struct Link {
  void send(std::uint64_t number) {
    frames[sent].write(number);
    written.store(++sent, std::memory_order_release);
  }
  template <class F>
  void each_new(F&& f) {
    for (const unsigned n = written.load(std::memory_order_acquire); heard < n; ++heard) {
      if (!f(frames[heard].read())) return;
    }
  }
  Plain<std::uint64_t> frames[kMost];
  Atomic<std::uint32_t> written;
  unsigned sent = 0;
  unsigned heard = 0;
};

/// What an outlet does for one peer.
class Chooser {
 public:
  void open(Process& process) { publisher_.open(process, 0, false); }
  void send(Link& link, std::uint32_t participant, Atomic<std::uint32_t>& declines) {
    if (!served_ && !linked_) try_serve(participant);
    if (served_) RL_ASSERT(publisher_.writer().serves(*served_));
    if (served_ && declines.load(std::memory_order_acquire) != 0) go_back(link);
    const std::uint64_t number = publisher_.sent();
    if (served_) unsure_.push_back(number);
    RL_ASSERT(publisher_.send());
    if (!served_) link.send(number);
  }
  void try_serve(std::uint32_t participant) {
    serve(participant);
    linked_ = !served_;
  }
  /// To one that is expected, and may not read yet: it gets what is unsure when it does.
  void send_to_expected(std::uint32_t participant) {
    if (!served_) serve(participant);
    const std::uint64_t number = publisher_.sent();
    if (!served_) unsure_.push_back(number);
    RL_ASSERT(publisher_.send());
  }
  /// It was expected for long enough.
  void give_up(Link& link, std::uint32_t participant) {
    if (!served_) serve(participant);
    if (served_) return;
    for (const std::uint64_t number : std::exchange(unsure_, {})) link.send(number);
    linked_ = true;
  }
  /// The link has carried all so far; the ring will, when it has joined that anew.
  void invite(Link& link) {
    invited_ = invited_.value_or(kInvitation) + 1;
    link.send(*invited_);
    linked_ = false;
  }
  void serve(std::uint32_t participant) {
    auto& writer = publisher_.writer();
    bool reads = false;
    writer.each_reader([&](std::uint32_t k) { reads = reads || k == participant; });
    if (!reads) return;
    RL_ASSERT(writer.has_last(unsure_.size()));
    const Word back = ring::kSequenceMask + 1 - unsure_.size();
    served_ = writer.serve(
        participant, ring::advance(writer.next_sequence(), back), [] { return true; },
        garden.omitted.answer ? std::nullopt : invited_);
  }
  /// All that somebody beside the reader may have missed goes by the link, too.
  void go_back(Link& link) {
    publisher_.writer().stop(*served_, unsure_.size());
    for (const std::uint64_t number : unsure_) link.send(number);
    unsure_.clear();
    served_.reset();
    linked_ = true;
  }
  void stop() {
    if (served_) publisher_.writer().stop(*served_, 0);
    served_.reset();
    unsure_.clear();
  }
  bool is_served() const { return served_.has_value(); }
  std::uint64_t sent() const { return publisher_.sent(); }
  void push() {
    RL_ASSERT(publisher_.send());
    RL_ASSERT(publisher_.writer().has_last(1));
  }

 private:
  Publisher publisher_;
  std::optional<ring::Writer<Policy>::Served> served_;
  std::optional<std::uint64_t> invited_;
  bool linked_ = false;
  std::vector<std::uint64_t> unsure_;
};

/// What an inlet does: reads both, and delivers each message once.
class Chooses {
 public:
  bool join(Process& process, std::uint64_t history) {
    return subscriber_.join(process, 0, 1, history);
  }
  void leave() { subscriber_.leave(); }
  /// The next message of the ring. False: there is none.
  bool read() {
    if (subscriber_.borrow() == kNoBlock) return false;
    unclaimed_.push_back({subscriber_.reader().cursor(), subscriber_.number()});
    claim();
    subscriber_.done();
    return true;
  }
  /// Delivers what is known to be for it.
  void claim() {
    while (!unclaimed_.empty()) {
      const auto [sequence, number] = unclaimed_.front();
      const auto is_ours = chosen_.is_ours(subscriber_.reader(), sequence);
      if (!is_ours) return;
      if (*is_ours) delivered.push_back(number);
      unclaimed_.pop_front();
    }
  }
  void hear(Link& link) {
    link.each_new([this](std::uint64_t number) {
      if (number >= kInvitation) {
        rejoin(number);
        return true;
      }
      had_ += chosen_.taken_back(subscriber_.reader());
      if (had_ != 0) {
        --had_;
        return true;
      }
      if (chosen_.has_last_ones(subscriber_.reader())) return false;  // it waits
      delivered.push_back(number);
      return true;
    });
  }
  std::vector<std::uint64_t> delivered;

 private:
  /// What was kept is read again.
  void rejoin(std::uint64_t answer) {
    const auto& reader = subscriber_.reader();
    if (ring::is_set(reader.from()) && !ring::is_set(reader.to())) return;
    unclaimed_.clear();
    chosen_ = {};
    RL_ASSERT(subscriber_.rejoin(answer));
  }
  Subscriber subscriber_;
  ring::Chosen<Policy> chosen_;
  std::deque<std::pair<Word, std::uint64_t>> unclaimed_;
  std::size_t had_ = 0;
};

/// The reader finds out, at any time, that somebody beside it needs the link.
struct ChosenReader : Scene<ChosenReader, 2> {
  ChosenReader() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    declines.store(0, std::memory_order_relaxed);
    link.written.store(0, std::memory_order_relaxed);
    chooser.open(start(4));
    RL_ASSERT(reader.join(start(2), 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) chooser.send(link, 2, declines);
      if (chooser.is_served() && declines.load(std::memory_order_acquire) != 0) {
        chooser.go_back(link);
      }
      return;
    }
    reader.read();
    declines.fetch_or(1, std::memory_order_release);
    reader.hear(link);
    reader.read();
    reader.hear(link);
  }
  void check() {
    while (reader.read()) {
    }
    reader.hear(link);
    RL_ASSERT(reader.delivered.size() == chooser.sent());
    for (std::size_t i = 0; i < reader.delivered.size(); ++i) RL_ASSERT(reader.delivered[i] == i);
    // Who needs the link has got all of them there.
    if (chooser.is_served()) return;
    RL_ASSERT(link.sent == chooser.sent());
    for (unsigned i = 0; i < link.sent; ++i) RL_ASSERT(link.frames[i].read() == i);
  }
  Link link;
  Atomic<std::uint32_t> declines;
  Chooser chooser;
  Chooses reader;
};

/// Served, not served, and served again when it has read what was for it.
struct ChosenAgain : Scene<ChosenAgain, 2> {
  ChosenAgain() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    chooser.open(start(4));
    RL_ASSERT(reader.join(start(2), 0));
    chooser.try_serve(2);
    RL_ASSERT(chooser.is_served());
    chooser.push();
    chooser.stop();
    ours = {0};
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) {
        if (i == 1) chooser.try_serve(2);
        if (chooser.is_served()) ours.push_back(chooser.sent());
        chooser.push();
      }
    } else {
      for (int i = 0; i < 3; ++i) reader.read();
    }
  }
  void check() {
    while (reader.read()) {
    }
    RL_ASSERT(reader.delivered == ours);
  }
  Chooser chooser;
  Chooses reader;
  std::vector<std::uint64_t> ours;
};

/// It is expected, and comes to read when the first messages are there; or too late.
struct ChosenLate : Scene<ChosenLate, 2> {
  ChosenLate() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    link.written.store(0, std::memory_order_relaxed);
    chooser.open(start(4));
    start(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      chooser.send_to_expected(2);
      chooser.send_to_expected(2);
      chooser.give_up(link, 2);
    } else {
      joined = reader.join(process(2), 3);
      if (!joined) return;
      reader.read();
      reader.read();
      reader.claim();
    }
  }
  void check() {
    if (!joined) return;
    while (reader.read()) {
    }
    reader.claim();
    reader.hear(link);
    RL_ASSERT(reader.delivered == (std::vector<std::uint64_t>{0, 1}));
  }
  Link link;
  Chooser chooser;
  Chooses reader;
  bool joined = false;
};

/// Its link has carried a message; then the ring is to do so again, or the link when that takes
/// long, and it is invited once more.
template <int kInvitations>
struct ChosenInvited : Scene<ChosenInvited<kInvitations>, 2> {
  ChosenInvited()
      : Scene<ChosenInvited<kInvitations>, 2>({.blocks = 5, .depth = 4, .readers = 2}) {}
  void prepare() {
    link.written.store(0, std::memory_order_relaxed);
    chooser.open(this->start(4));
    RL_ASSERT(reader.join(this->start(2), 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      link.send(chooser.sent());
      chooser.push();
      for (int i = 0; i < kInvitations; ++i) {
        chooser.invite(link);
        chooser.send_to_expected(2);
        if (i + 1 < kInvitations) chooser.give_up(link, 2);
        if (chooser.is_served()) break;
      }
      chooser.send_to_expected(2);
      chooser.give_up(link, 2);
    } else {
      reader.read();
      reader.hear(link);
      reader.read();
      reader.hear(link);
      reader.read();
    }
  }
  void check() {
    for (int i = 0; i < 2; ++i) {
      reader.claim();
      while (reader.read()) {
      }
      reader.hear(link);
    }
    while (reader.read()) {
    }
    reader.claim();
    RL_ASSERT(reader.delivered.size() == chooser.sent());
    for (std::size_t i = 0; i < reader.delivered.size(); ++i) RL_ASSERT(reader.delivered[i] == i);
  }
  Link link;
  Chooser chooser;
  Chooses reader;
};

/// What is said to a reader is not said to the one that has its cell after it.
struct ChosenCellChangesHands : Scene<ChosenCellChangesHands, 3> {
  ChosenCellChangesHands() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    chooser.open(start(4));
    RL_ASSERT(reader.join(start(2), 0));
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      chooser.try_serve(2);
      chooser.push();
    } else if (t == 1) {
      reader.leave();
    } else {
      joined = next.join(process(3), 0, 1, 2);
    }
  }
  void check() {
    if (!joined) return;
    for (Word sequence = next.reader().cursor(); next.receive();
         sequence = next.reader().cursor()) {
      RL_ASSERT(!chosen.is_ours(next.reader(), sequence).value_or(false));
    }
  }
  Chooser chooser;
  Chooses reader;
  Subscriber next;
  ring::Chosen<Policy> chosen;
  bool joined = false;
};

const Entered entered{
    {"chosen_reader", "each message comes once, by the ring or another way", cast_of<ChosenReader>,
     2},
    {"chosen_again", "who is served again gets what is for it", cast_of<ChosenAgain>, 3},
    {"chosen_late", "who is expected gets what was kept for it", cast_of<ChosenLate>, 2},
    {"chosen_invited", "who has got all by its link gets the rest by the ring, behind it",
     cast_of<ChosenInvited<1>>, 2},
    {"chosen_invited_twice", "an answer is one to the invitation that it answers",
     cast_of<ChosenInvited<2>>, 2},
    {"chosen_cell_changes_hands", "what is said to a reader is not said to the next one",
     cast_of<ChosenCellChangesHands>, 2},
};

}  // namespace
}  // namespace lot::model
