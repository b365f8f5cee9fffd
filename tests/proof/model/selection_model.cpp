// SPDX-License-Identifier: Apache-2.0
#include <deque>
#include <utility>

#include "scenario.hpp"
#include "selection/selector.hpp"
#include "world.hpp"

/// A publisher that says to each reader which messages are for it, and sends it the others another
/// way: lot::ros (docs/ros.md).
namespace lot::model {
namespace {

using Selector = selection::Selector<Policy>;
using Selection = selection::Selection<Policy>;

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
class SelectingPublisher {
 public:
  void open(Process& process) { publisher_.open(process, 0, false); }
  void send(Link& link, std::uint32_t participant, Atomic<std::uint32_t>& declines) {
    if (!selected_ && !linked_) try_select(participant);
    if (selected_) RL_ASSERT(Selector::is_there(publisher_.writer().ring(), *selected_));
    if (selected_ && declines.load(std::memory_order_acquire) != 0) go_back(link);
    const std::uint64_t number = publisher_.sent();
    if (selected_) unsure_.push_back(number);
    RL_ASSERT(publisher_.send());
    if (!selected_) link.send(number);
  }
  void try_select(std::uint32_t participant) {
    select(participant);
    linked_ = !selected_;
  }
  /// To one that is expected, and may not read yet: it gets what is unsure when it does.
  void send_to_expected(std::uint32_t participant) {
    if (!selected_) select(participant);
    const std::uint64_t number = publisher_.sent();
    if (!selected_) unsure_.push_back(number);
    RL_ASSERT(publisher_.send());
  }
  /// It was expected for long enough.
  void give_up(Link& link, std::uint32_t participant) {
    if (!selected_) select(participant);
    if (selected_) return;
    for (const std::uint64_t number : std::exchange(unsure_, {})) link.send(number);
    linked_ = true;
  }
  /// The link has carried all so far; the ring will, when it has joined that anew.
  void invite(Link& link) {
    invited_ = invited_.value_or(kInvitation) + 1;
    link.send(*invited_);
    linked_ = false;
  }
  void select(std::uint32_t participant) {
    auto& writer = publisher_.writer();
    bool reads = false;
    writer.each_reader([&](std::uint32_t k, std::uint32_t) { reads = reads || k == participant; });
    if (!reads) return;
    Selector selector(writer);
    RL_ASSERT(selector.has_last(unsure_.size()));
    selected_ = selector.select(
        participant, unsure_.size(), [] { return true; },
        garden.omitted.answer ? std::nullopt : invited_);
  }
  /// All that somebody beside the reader may have missed goes by the link, too.
  void go_back(Link& link) {
    Selector(publisher_.writer()).deselect(*selected_, unsure_.size());
    for (const std::uint64_t number : unsure_) link.send(number);
    unsure_.clear();
    selected_.reset();
    linked_ = true;
  }
  void stop() {
    if (selected_) Selector(publisher_.writer()).deselect(*selected_, 0);
    selected_.reset();
    unsure_.clear();
  }
  bool is_selected() const { return selected_.has_value(); }
  /// The reader that it has selected still has its cell.
  bool has_its_reader() {
    return selected_ && Selector::is_there(publisher_.writer().ring(), *selected_);
  }
  std::uint64_t sent() const { return publisher_.sent(); }
  void push() {
    RL_ASSERT(publisher_.send());
    RL_ASSERT(Selector(publisher_.writer()).has_last(1));
  }

 private:
  Publisher publisher_;
  std::optional<Selector::Selected> selected_;
  std::optional<std::uint64_t> invited_;
  bool linked_ = false;
  std::vector<std::uint64_t> unsure_;
};

/// What an inlet does: reads both, and delivers each message once.
class SelectedSubscriber {
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
      const auto is_ours = selection_.is_ours(subscriber_.reader(), sequence);
      if (!is_ours) return;
      if (*is_ours) delivered.push_back(number);
      unclaimed_.pop_front();
    }
  }
  void hear(Link& link) {
    link.each_new([this](std::uint64_t number) {
      if (number >= kInvitation) {
        join_anew(number);
        return true;
      }
      had_ += selection_.resent(subscriber_.reader());
      if (had_ != 0) {
        --had_;
        return true;
      }
      if (Selection::has_remaining(subscriber_.reader())) return false;  // it waits
      delivered.push_back(number);
      return true;
    });
  }
  std::vector<std::uint64_t> delivered;

 private:
  /// What was kept is read again.
  void join_anew(std::uint64_t answer) {
    const auto& reader = subscriber_.reader();
    if (Selection::is_selected(reader)) return;
    unclaimed_.clear();
    selection_ = {};
    RL_ASSERT(subscriber_.join_anew(answer));
  }
  Subscriber subscriber_;
  Selection selection_;
  std::deque<std::pair<Word, std::uint64_t>> unclaimed_;
  std::size_t had_ = 0;
};

/// The reader finds out, at any time, that somebody beside it needs the link.
struct SelectedReader : Scene<SelectedReader, 2> {
  SelectedReader() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    declines.store(0, std::memory_order_relaxed);
    link.written.store(0, std::memory_order_relaxed);
    publisher.open(start(4));
    RL_ASSERT(reader.join(start(2), 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 3; ++i) publisher.send(link, 2, declines);
      if (publisher.is_selected() && declines.load(std::memory_order_acquire) != 0) {
        publisher.go_back(link);
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
    RL_ASSERT(reader.delivered.size() == publisher.sent());
    for (std::size_t i = 0; i < reader.delivered.size(); ++i) RL_ASSERT(reader.delivered[i] == i);
    // Who needs the link has got all of them there.
    if (publisher.is_selected()) return;
    RL_ASSERT(link.sent == publisher.sent());
    for (unsigned i = 0; i < link.sent; ++i) RL_ASSERT(link.frames[i].read() == i);
  }
  Link link;
  Atomic<std::uint32_t> declines;
  SelectingPublisher publisher;
  SelectedSubscriber reader;
};

/// Selected, not selected, and selected again when it has read what was for it.
struct SelectedAgain : Scene<SelectedAgain, 2> {
  SelectedAgain() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4));
    RL_ASSERT(reader.join(start(2), 0));
    publisher.try_select(2);
    RL_ASSERT(publisher.is_selected());
    publisher.push();
    publisher.stop();
    ours = {0};
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) {
        if (i == 1) publisher.try_select(2);
        if (publisher.is_selected()) ours.push_back(publisher.sent());
        publisher.push();
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
  SelectingPublisher publisher;
  SelectedSubscriber reader;
  std::vector<std::uint64_t> ours;
};

/// It is expected, and comes to read when the first messages are there; or too late.
struct SelectedLate : Scene<SelectedLate, 2> {
  SelectedLate() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    link.written.store(0, std::memory_order_relaxed);
    publisher.open(start(4));
    start(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.send_to_expected(2);
      publisher.send_to_expected(2);
      publisher.give_up(link, 2);
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
  SelectingPublisher publisher;
  SelectedSubscriber reader;
  bool joined = false;
};

/// Its link has carried a message; then the ring is to do so again, or the link when that takes
/// long, and it is invited once more.
template <int kInvitations>
struct SelectedWhenInvited : Scene<SelectedWhenInvited<kInvitations>, 2> {
  SelectedWhenInvited()
      : Scene<SelectedWhenInvited<kInvitations>, 2>({.blocks = 5, .depth = 4, .readers = 2}) {}
  void prepare() {
    link.written.store(0, std::memory_order_relaxed);
    publisher.open(this->start(4));
    RL_ASSERT(reader.join(this->start(2), 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      link.send(publisher.sent());
      publisher.push();
      for (int i = 0; i < kInvitations; ++i) {
        publisher.invite(link);
        publisher.send_to_expected(2);
        if (i + 1 < kInvitations) publisher.give_up(link, 2);
        if (publisher.is_selected()) break;
      }
      publisher.send_to_expected(2);
      publisher.give_up(link, 2);
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
    RL_ASSERT(reader.delivered.size() == publisher.sent());
    for (std::size_t i = 0; i < reader.delivered.size(); ++i) RL_ASSERT(reader.delivered[i] == i);
  }
  Link link;
  SelectingPublisher publisher;
  SelectedSubscriber reader;
};

/// What is said to a reader is not said to the one that has its cell after it.
struct SelectedCellChangesHands : Scene<SelectedCellChangesHands, 3> {
  SelectedCellChangesHands() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4));
    RL_ASSERT(reader.join(start(2), 0));
    start(3);
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.try_select(2);
      publisher.push();
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
      RL_ASSERT(!selection.is_ours(next.reader(), sequence).value_or(false));
    }
  }
  SelectingPublisher publisher;
  SelectedSubscriber reader;
  Subscriber next;
  Selection selection;
  bool joined = false;
};

/// A process that leaves its cell and comes again is not taken for the reader that it was.
struct SelectedComesAgain : Scene<SelectedComesAgain, 2> {
  SelectedComesAgain() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4));
    RL_ASSERT(reader.join(start(2), 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.try_select(2);
      publisher.push();
    } else {
      reader.leave();
      RL_ASSERT(next.join(process(2), 2));
    }
  }
  void check() {
    while (next.read()) {
    }
    next.claim();
    RL_ASSERT(next.delivered.size() == (publisher.has_its_reader() ? 1 : 0));
  }
  SelectingPublisher publisher;
  SelectedSubscriber reader;
  SelectedSubscriber next;
};

/// An observer of a reader's process joins, and is not selected in the place of a reader.
struct ObserverIsNotSelected : Scene<ObserverIsNotSelected, 2> {
  ObserverIsNotSelected() : Scene({.blocks = 3, .depth = 2, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4));
    start(2);
  }
  void thread(unsigned t) {
    if (t == 0) {
      for (int i = 0; i < 2; ++i) {
        publisher.try_select(2);
        publisher.push();
      }
    } else {
      RL_ASSERT(observer.join(process(2), 0, 1, 2, Subscriber::Manner::Observes));
      observer.receive();
    }
  }
  void check() { RL_ASSERT(!publisher.is_selected()); }
  SelectingPublisher publisher;
  Subscriber observer;
};

/// A reader leaves, and an observer of its process takes its cell: it is not taken for the reader.
struct ObserverTakesTheCell : Scene<ObserverTakesTheCell, 2> {
  ObserverTakesTheCell() : Scene({.blocks = 4, .depth = 3, .readers = 1}) {}
  void prepare() {
    publisher.open(start(4));
    RL_ASSERT(reader.join(start(2), 0));
  }
  void thread(unsigned t) {
    if (t == 0) {
      publisher.try_select(2);
      publisher.push();
    } else {
      reader.leave();
      RL_ASSERT(observer.join(process(2), 0, 1, 2, Subscriber::Manner::Observes));
    }
  }
  void check() {
    RL_ASSERT(!publisher.has_its_reader());
    while (observer.receive()) {
    }
    RL_ASSERT(observer.number() == publisher.sent());  // it has read to the end
  }
  SelectingPublisher publisher;
  SelectedSubscriber reader;
  Subscriber observer;
};

const Entered entered{
    {"selected_reader", "each message comes once, by the ring or another way",
     cast_of<SelectedReader>, 2},
    {"selected_again", "who is selected again gets what is for it", cast_of<SelectedAgain>, 3},
    {"selected_late", "who is expected gets what was kept for it", cast_of<SelectedLate>, 2},
    {"selected_when_invited", "who has got all by its link gets the rest by the ring, behind it",
     cast_of<SelectedWhenInvited<1>>, 2},
    {"selected_when_invited_twice", "an answer is one to the invitation that it answers",
     cast_of<SelectedWhenInvited<2>>, 2},
    {"selected_cell_changes_hands", "what is said to a reader is not said to the next one",
     cast_of<SelectedCellChangesHands>, 2},
    {"selected_comes_again", "who comes again is not taken for the reader that it was",
     cast_of<SelectedComesAgain>, 2},
    {"observer_is_not_selected", "an observer that joins is not selected",
     cast_of<ObserverIsNotSelected>, 2},
    {"observer_takes_the_cell", "an observer is not taken for the reader that had its cell",
     cast_of<ObserverTakesTheCell>, 2},
};

}  // namespace
}  // namespace lot::model
