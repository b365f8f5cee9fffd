// SPDX-License-Identifier: Apache-2.0

// Topics and queues against lists, by processes in lockstep: publishers of each policy and engine,
// by blocks and in slots, readers with and without history, observers, readers that look late;
// queues whose items one reader takes; tasks that workers finish, give back or die with. Processes
// are killed between steps, and at random moments of a burst; a board outside of the segment then
// says what the dead one had done, and what it was about to do.
//
// Each channel (a publisher's or a handle's) counts its letters. So a list is a number:
//
//  - a reader gets the next letter of a channel, or a later one, and then as many count as missed
//  as
//    lie in between, and they had left the queue. A push that has said Ok and is neither delivered
//    nor missed is found;
//  - a push finds the queue full exactly where a reader is a whole queue behind;
//  - an item goes to one reader, in the order of its handle. A taker that is killed in a pop takes
//    at most one with it;
//  - a task comes until it is finished, the oldest first, and says how often it came.

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <list>
#include <memory>
#include <optional>
#include <string>
#include <unistd.h>
#include <utility>
#include <vector>

#include "queues_node.hpp"
#include "run.hpp"
#include "support/janitor.hpp"
#include "support/processes.hpp"

namespace lot::outside {
namespace {

constexpr unsigned kNodes = 4;
constexpr unsigned kItems = kTopics;     ///< where a channel is: topics, then
constexpr unsigned kWork = kTopics + 1;  ///< the queue of tasks
constexpr std::uint32_t kBurst = 300;

struct Task {
  enum class State { Waiting, Taken, Done, MaybeDone };
  State state = State::Waiting;
  unsigned node = 0, cell = 0;        ///< Taken: who has it
  bool ghost = false;                 ///< it comes back as soon as its worker is reaped
  std::uint64_t least = 0, most = 0;  ///< deliveries so far
};

struct Channel {
  std::uint32_t id;
  unsigned where;
  How how;
  std::uint32_t count = 0;  ///< letters that were pushed, with Ok
  bool maybe = false;       ///< one more, which a killed process was pushing
  bool ended = false;
  std::uint32_t front = 0;  ///< of items: the next one to be taken
  std::deque<Task> tasks{};
  bool overwrites() const { return how.policy() == Policy::Overwrite; }
  std::uint32_t oldest(std::uint32_t pushed) const {
    return pushed - std::min(pushed, how.depth());
  }
};

struct Source {
  Channel* channel;
  std::uint32_t next;
};

struct Reader {
  bool open = false;
  unsigned topic = 0;
  bool observes = false;
  std::uint64_t skipped = 0;  ///< from before it came, and not told yet
  std::uint64_t gaps = 0;     ///< letters that it was not given
  std::uint64_t told = 0;     ///< an observer: how many it was told that it missed
  std::list<Source> sources{};
  Source* held = nullptr;  ///< whose letter it borrows
};

/// LOT_OUTSIDE_TRACE: prints each command, with its answer.
const bool trace = std::getenv("LOT_OUTSIDE_TRACE") != nullptr;

class Model {
 public:
  explicit Model(Run& run) : random_(run.random()), boards_(Board::make(kNodes)) {
    options_ = testing::fresh(32 << 20);
    options_.processes = 16;
    options_.blocks = 1024;
    options_.topics = 16;
    options_.channels = 128;
    options_.readers = 32;
    for (unsigned k = 0; k < kNodes; ++k) start(k);
  }

  void step(unsigned n) {
    const auto k = static_cast<unsigned>(random_.below(kNodes));
    const std::uint64_t dice = random_.below(100);
    if (dice < 45) {
      on_topics(k);
    } else if (dice < 85) {
      on_queues(k);
    } else if (dice < 97) {
      burst(k);
    } else {
      kill(k);
    }
    if (n % 40 == 39) rest();
  }

  /// All is read, taken and finished; then nothing is left.
  void end() {
    rest();
    for (unsigned k = 0; k < kNodes; ++k) {
      for (unsigned a = 0; a < kPullers; ++a) {
        if (nodes_[k].readers[a].held != nullptr) end_hold(k, a);
        while (nodes_[k].readers[a].open && look(k, a, Act::Pull)) {
        }
      }
    }
    finish_all();
    for (unsigned k = 0; k < kNodes; ++k) {
      for (unsigned a = 0; a < kPullers; ++a) {
        if (nodes_[k].readers[a].open) unsubscribe(k, a);
      }
      for (unsigned a = 0; a < kPushers; ++a) close(k, a);
      for (unsigned b = 0; b < 2; ++b) shut(k, b);
    }
    const std::string left = testing::leak_in(path(), std::chrono::seconds(20));
    require(left.empty(), "what is left in the end: " + left);
    for (Node& n : nodes_) require(n.puppet->leave() == 0, "a process leaves");
    require(testing::files_of(options_) == 0, "no file is left");
  }

 private:
  using Process = Puppet<QueueCommand, QueueAnswer>;
  struct Node {
    std::unique_ptr<Process> puppet;
    std::array<Channel*, kPushers> pushers{};
    std::array<Reader, kPullers> readers{};
    std::array<Channel*, 2> handles{};
    std::array<Task*, kTasks> tasks{};
  };

  std::string path() const { return options_.directory + "/" + options_.segment; }
  void start(unsigned k) {
    Node& node = nodes_[k];
    node = Node();
    node.puppet = std::make_unique<Process>(
        [this, k] { return std::make_unique<QueueNode>(options_, boards_[k]); });
    tell(k, Act::Settle);
  }
  QueueAnswer tell(unsigned k, Act what, unsigned a = 0, unsigned b = 0, std::uint32_t n = 0,
                   const Letter& letter = {}) {
    const QueueAnswer answer = nodes_[k].puppet->act(
        {what, static_cast<std::uint8_t>(a), static_cast<std::uint8_t>(b), n, letter});
    if (trace) {
      std::printf("node %u act %u a %u b %u n %x letter %u %u: %s %d letter %u %u missed %llu\n", k,
                  static_cast<unsigned>(what), a, b, n, letter.channel, letter.number,
                  lot::to_string(answer.status), answer.has_letter, answer.letter.channel,
                  answer.letter.number, static_cast<unsigned long long>(answer.missed));
    }
    return answer;
  }
  unsigned below(std::size_t n) { return static_cast<unsigned>(random_.below(n)); }

  /// What the other processes may need a moment for: they find new rings, and reap the dead.
  template <class Condition>
  static bool soon(Condition&& condition) {
    return testing::eventually(condition, std::chrono::seconds(queue_plant.empty() ? 20 : 2));
  }

  Channel& channel_of(const Letter& letter) {
    for (Channel& c : channels_) {
      if (c.id == letter.channel) return c;
    }
    throw Differs("a letter of a channel that there is not");
  }
  How any_how(bool may_overwrite) {
    const std::uint32_t policy = below(may_overwrite ? 3 : 2) + (may_overwrite ? 0 : 1);
    return {policy | below(4) << 2 | (1 + below(6)) << 8};
  }
  static bool is_empty(const Channel& c) { return c.front == c.count; }

  // ---- topics

  void on_topics(unsigned k) {
    Node& node = nodes_[k];
    const unsigned p = below(kPushers);
    const unsigned r = below(kPullers);
    Reader& reader = node.readers[r];
    switch (below(10)) {
      case 0:
        if (node.pushers[p] == nullptr) return advertise(k, p);
        if (random_.chance(15)) close(k, p);
        return;
      case 1:
        if (!reader.open) return subscribe(k, r);
        if (random_.chance(15)) unsubscribe(k, r);
        return;
      case 2:
      case 3:
      case 4:
      case 5:
        if (node.pushers[p] != nullptr) push(k, p);
        return;
      default:
        if (!reader.open) return;
        if (reader.held != nullptr) return end_hold(k, r);
        const Act acts[] = {Act::Pull, Act::Borrow, Act::Hold};
        (void)look(k, r, acts[below(3)]);
    }
  }

  void advertise(unsigned k, unsigned p) {
    const How how = any_how(true);
    const unsigned topic = below(kTopics);
    tell(k, Act::Advertise, p, topic, how.word);
    channels_.push_back({++ids_, topic, how});
    Channel& channel = channels_.back();
    nodes_[k].pushers[p] = &channel;
    each_reader([&](unsigned at, unsigned a, Reader& reader) {
      if (reader.topic != topic) return;
      reader.sources.push_back({&channel, 0});
      // What an observer has not found, it may miss without being told.
      if (reader.observes) find_all(at, a, reader);
    });
  }
  template <class F>
  void each_reader(F&& f) {
    for (unsigned k = 0; k < kNodes; ++k) {
      for (unsigned a = 0; a < kPullers; ++a) {
        if (nodes_[k].readers[a].open) f(k, a, nodes_[k].readers[a]);
      }
    }
  }
  void find_all(unsigned k, unsigned a, const Reader& reader) {
    const auto live = static_cast<std::uint64_t>(
        std::count_if(reader.sources.begin(), reader.sources.end(),
                      [](const Source& s) { return !s.channel->ended; }));
    require(soon([&] { return tell(k, Act::Look, a).count >= live; }), "publishers are found");
  }
  void close(unsigned k, unsigned p) {
    Channel*& channel = nodes_[k].pushers[p];
    if (channel == nullptr) return;
    tell(k, Act::Close, p);
    std::exchange(channel, nullptr)->ended = true;
  }

  void subscribe(unsigned k, unsigned a) {
    if (has_dead_) rest();  // whether a ring of the dead counts as a publisher's is chance
    const std::uint32_t histories[] = {0, 1, 3, kHistoryAll};
    const std::uint32_t history = histories[below(4)];
    Reader& reader = nodes_[k].readers[a];
    reader = Reader();
    reader.open = true;
    reader.topic = below(kTopics);
    reader.observes = random_.chance(25);
    tell(k, Act::Subscribe, a, reader.topic, history | (reader.observes ? kObserver : 0));
    for (Channel& c : channels_) {
      if (c.where != reader.topic || c.ended) continue;
      // A place without loss keeps the writer out of one slot. An observer has no such place.
      const bool counts_later = c.overwrites() || reader.observes;
      std::uint32_t back = counts_later ? c.how.depth() : c.how.depth() - 1;
      if (counts_later && history == kHistoryAll) back = c.count;
      back = std::min({back, history, c.count});
      if (history == kHistoryAll) reader.skipped += c.count - back;
      reader.sources.push_back({&c, c.count - back});
    }
  }
  void unsubscribe(unsigned k, unsigned a) {
    tell(k, Act::Unsubscribe, a);
    nodes_[k].readers[a] = Reader();
  }

  /// A living reader that counts is a whole queue behind.
  bool is_full(const Channel& c) {
    if (c.overwrites()) return false;
    bool full = false;
    each_reader([&](unsigned, unsigned, const Reader& reader) {
      for (const Source& s : reader.sources) {
        full |= s.channel == &c && !reader.observes && c.count - s.next >= c.how.depth();
      }
    });
    return full;
  }
  void push(unsigned k, unsigned p) {
    Channel& c = *nodes_[k].pushers[p];
    const Letter letter = Letter::of(c.id, c.count);
    const bool full = is_full(c);
    const auto goes = [&] { return tell(k, Act::Push, p, 0, 0, letter).status == Status::Ok; };
    if (full) return require(!goes(), "a push into a full queue says Ok");
    require(soon(goes), "a push finds no room, and no living reader is a queue behind");
    ++c.count;
  }

  /// Letters of channels that have ended and that an observer has not seen. No ring is kept for it:
  /// it gets them, or counts them as missed, in any order. `most`: with those that may be.
  static std::uint64_t rest_of_ended(const Reader& reader, bool most) {
    std::uint64_t rest = 0;
    for (const Source& s : reader.sources) {
      if (s.channel->ended) rest += s.channel->count - s.next + (most && s.channel->maybe ? 1 : 0);
    }
    return rest;
  }
  static bool has_mail(const Reader& reader) {
    return std::any_of(reader.sources.begin(), reader.sources.end(),
                       [&](const Source& s) {
                         return s.next < s.channel->count && !(reader.observes && s.channel->ended);
                       }) ||
           (reader.observes && reader.told < reader.gaps + rest_of_ended(reader, false));
  }
  static void check_told(Reader& reader, std::uint64_t missed_in_all) {
    reader.told = missed_in_all;
    if (reader.told >= reader.gaps && reader.told <= reader.gaps + rest_of_ended(reader, true)) {
      return;
    }
    throw Differs("an observer was told of " + std::to_string(reader.told) +
                  " that it missed, of " + std::to_string(reader.gaps) + what_waits(reader));
  }

  /// False: nothing came.
  bool look(unsigned k, unsigned a, Act how) {
    Reader& reader = nodes_[k].readers[a];
    QueueAnswer answer;
    const auto looks = [&] {
      answer = tell(k, how, a);
      if (answer.has_letter) return true;
      if (reader.observes) {
        check_told(reader, answer.count);
      } else if (answer.count > reader.gaps + reader.skipped) {
        throw Differs("a reader is told that it missed " + std::to_string(answer.count) +
                      " in all, and nothing came" + what_waits(reader));
      }
      return !has_mail(reader);
    };
    if (!soon(looks)) {
      throw Differs("a push said Ok, and its letter is neither delivered nor missed" +
                    what_waits(reader));
    }
    if (!answer.has_letter) {
      found_nothing(reader, answer.status);
      return false;
    }
    for (Source& s : reader.sources) {
      if (s.channel->id != answer.letter.channel) continue;
      delivered(reader, s, answer);
      if (how == Act::Hold) {
        reader.held = &s;
      } else {
        ++s.next;
      }
      return true;
    }
    throw Differs("a letter of a channel that the reader does not read");
  }
  static std::string what_waits(const Reader& reader) {
    std::string text;
    for (const Source& s : reader.sources) {
      const Channel& c = *s.channel;
      text += "\n  channel " + std::to_string(c.id) + " from " + std::to_string(s.next) + " to " +
              std::to_string(c.count) + (c.maybe ? " or one more" : "") +
              (c.ended ? ", ended" : "") + ", policy " + std::to_string(c.how.word & 3) +
              (c.how.fast_lane() ? ", in slots" : "") + ", depth " + std::to_string(c.how.depth());
    }
    return text;
  }
  /// It is the next one that is still in the queue; those before it count as missed.
  void delivered(Reader& reader, Source& s, const QueueAnswer& answer) {
    Channel& c = *s.channel;
    const std::uint32_t number = answer.letter.number;
    const bool next = number == std::max(s.next, c.oldest(c.count)) ||
                      (c.maybe && number == std::max(s.next, c.oldest(c.count + 1))) ||
                      (reader.observes && c.ended && number >= std::max(s.next, c.oldest(c.count)));
    require(next && number < c.count + (c.maybe ? 1 : 0),
            "letter " + std::to_string(number) + " of channel " + std::to_string(c.id) +
                " came, not " + std::to_string(std::max(s.next, c.oldest(c.count))));
    if (number == c.count) {
      ++c.count;
      c.maybe = false;
    }
    if (reader.observes) {
      reader.gaps += number - s.next;
      s.next = number;
      return check_told(reader, answer.count);
    }
    require(answer.missed == reader.skipped + (number - s.next),
            "missed() says " + std::to_string(answer.missed) + ", not " +
                std::to_string(reader.skipped + (number - s.next)));
    reader.gaps += answer.missed;
    require(answer.count == reader.gaps, "missed_total()");
    reader.skipped = 0;
    s.next = number;
  }
  void found_nothing(Reader& reader, Status status) {
    if (reader.observes) {
      reader.gaps = reader.told;
    } else {  // else it would have come
      for (Source& s : reader.sources) s.channel->maybe = false;
    }
    std::erase_if(reader.sources, [](const Source& s) { return s.channel->ended; });
    require(status == Status::Empty || (status == Status::PublisherGone && reader.sources.empty()),
            std::string("a reader of living publishers is told ") + lot::to_string(status));
  }
  void end_hold(unsigned k, unsigned a) {
    tell(k, Act::End, a);
    ++std::exchange(nodes_[k].readers[a].held, nullptr)->next;
  }

  // ---- items and tasks

  void on_queues(unsigned k) {
    Node& node = nodes_[k];
    const unsigned b = below(2);
    Channel*& handle = node.handles[b];
    if (handle == nullptr) return open(k, b);
    switch (below(12)) {
      case 0:
        if (random_.chance(30)) shut(k, b);
        return;
      case 1:
      case 2:
      case 3:
      case 4:
        return b == 0 ? put_item(k) : put_task(k);
      case 5:
      case 6:
      case 7:
        if (b == 0) return (void)pop(k);
        return (void)take(k, below(kTasks));
      default:
        if (b == 0) return (void)pop(k);
        return end_task(k, below(kTasks));
    }
  }

  void open(unsigned k, unsigned b) {
    const How how = any_how(b == 0);
    tell(k, Act::Open, 0, b, how.word);
    channels_.push_back({++ids_, b == 0 ? kItems : kWork, how});
    nodes_[k].handles[b] = &channels_.back();
  }
  void shut(unsigned k, unsigned b) {
    Channel*& handle = nodes_[k].handles[b];
    if (handle == nullptr) return;
    tell(k, Act::Shut, 0, b);
    std::exchange(handle, nullptr)->ended = true;
  }

  void put_item(unsigned k) {
    Channel& c = *nodes_[k].handles[0];
    const Letter letter = Letter::of(c.id, c.count);
    const auto goes = [&] { return tell(k, Act::Put, 0, 0, 0, letter).status == Status::Ok; };
    if (!c.overwrites() && c.count - c.front == c.how.depth()) {
      if (!goes()) return;
      // Then a killed taker has had the oldest one in hand.
      require(lost_ != 0, "an item is put into a full queue");
      --lost_;
      ++c.front;
    } else {
      require(soon(goes), "a put finds no room where there is some");
    }
    ++c.count;
    if (c.overwrites()) c.front = std::max(c.front, c.oldest(c.count));
  }

  /// False: nothing came.
  bool pop(unsigned k) {
    QueueAnswer answer;
    const auto waiting = [&] {
      std::uint64_t n = 0;
      for (const Channel& c : channels_) n += c.where == kItems ? c.count - c.front : 0;
      return n;
    };
    const auto pops = [&] {
      answer = tell(k, Act::Pop);
      return answer.has_letter || waiting() == 0;
    };
    const bool came = waiting() <= lost_ && lost_ != 0
                          ? testing::eventually(pops, std::chrono::milliseconds(200))
                          : soon(pops);
    if (answer.has_letter) {
      popped(answer.letter);
      return true;
    }
    require(came || waiting() <= lost_, "an item that waits is not delivered");
    lost_ = 0;  // what waits no more, killed takers had in hand
    for (Channel& c : channels_) {
      if (c.where != kItems) continue;
      c.front = c.count;
      c.maybe = false;
    }
    return false;
  }
  void popped(const Letter& letter) {
    Channel& c = channel_of(letter);
    require(c.where == kItems, "a letter is no item");
    if (c.maybe && letter.number == c.count) {
      ++c.count;
      c.maybe = false;
      if (c.overwrites()) c.front = std::max(c.front, c.oldest(c.count));
    }
    // What a killed putter was putting may have gone over the oldest one.
    if (c.maybe && c.overwrites() && letter.number == c.front + 1 &&
        c.count - c.front == c.how.depth()) {
      ++c.front;
    }
    while (letter.number > c.front && letter.number < c.count && lost_ != 0) {
      ++c.front;  // a killed taker had it in hand
      --lost_;
    }
    require(letter.number == c.front && letter.number < c.count,
            "item " + std::to_string(letter.number) + " of channel " + std::to_string(c.id) +
                " came, not " + std::to_string(c.front) + " of " + std::to_string(c.count));
    ++c.front;
  }

  void put_task(unsigned k) {
    Channel& c = *nodes_[k].handles[1];
    const Letter letter = Letter::of(c.id, c.count);
    const auto goes = [&] { return tell(k, Act::Put, 0, 1, 0, letter).status == Status::Ok; };
    Task* const before = c.count >= c.how.depth() ? &c.tasks[c.count - c.how.depth()] : nullptr;
    if (before != nullptr && before->state != Task::State::Done) {
      if (!goes()) return;
      require(before->state == Task::State::MaybeDone, "a task is put over one that is unfinished");
      before->state = Task::State::Done;
    } else {
      require(soon(goes), "a put finds no room for a task where there is some");
    }
    add_task(c);
  }
  static void add_task(Channel& c) {
    ++c.count;
    c.tasks.emplace_back();
  }

  static Task* oldest_waiting(Channel& c, bool with_ghosts) {
    for (Task& t : c.tasks) {
      if (t.state == Task::State::Waiting && (with_ghosts || !t.ghost)) return &t;
    }
    return nullptr;
  }
  bool any_waits() {
    return std::any_of(channels_.begin(), channels_.end(),
                       [](Channel& c) { return oldest_waiting(c, true) != nullptr; });
  }

  bool take(unsigned k, unsigned cell) {
    if (nodes_[k].tasks[cell] != nullptr) return false;
    QueueAnswer answer;
    require(soon([&] {
              answer = tell(k, Act::Take, cell);
              return answer.has_letter || !any_waits();
            }),
            "a task that waits is not delivered");
    if (!answer.has_letter) {
      for (Channel& c : channels_) {
        if (c.where == kWork) c.maybe = false;
      }
      return false;
    }
    Task& task = taken(answer.letter, answer.count);
    task.state = Task::State::Taken;
    task.node = k;
    task.cell = cell;
    nodes_[k].tasks[cell] = &task;
    return true;
  }
  /// A worker has got it: it was the oldest of its channel, or one comes back that was.
  Task& taken(const Letter& letter, std::uint64_t deliveries) {
    Channel& c = channel_of(letter);
    require(c.where == kWork, "a letter is no task");
    if (c.maybe && letter.number == c.count) {
      add_task(c);
      c.maybe = false;
    }
    require(letter.number < c.count, "a task that was not put");
    Task& task = c.tasks[letter.number];
    const bool may_be_here =
        task.state == Task::State::MaybeDone || (task.state == Task::State::Waiting && task.ghost);
    require(may_be_here || &task == oldest_waiting(c, false),
            "task " + std::to_string(letter.number) + " of channel " + std::to_string(c.id) +
                " came, which is " + state_of(task));
    require(deliveries > task.least && deliveries <= task.most + 1,
            "deliveries() says " + std::to_string(deliveries) + ", and it came " +
                std::to_string(task.most) + " times before");
    task.least = task.most = deliveries;
    task.ghost = false;
    return task;
  }
  static std::string state_of(const Task& task) {
    switch (task.state) {
      case Task::State::Waiting:
        return "not the oldest one that waits";
      case Task::State::Taken:
        return "taken";
      default:
        return "finished";
    }
  }

  void end_task(unsigned k, unsigned cell) {
    Task*& task = nodes_[k].tasks[cell];
    if (task == nullptr) return;
    const bool finishes = random_.chance(70);
    tell(k, finishes ? Act::Finish : Act::GiveBack, cell);
    task->state = finishes ? Task::State::Done : Task::State::Waiting;
    task = nullptr;
  }

  void finish_all() {
    for (unsigned k = 0; k < kNodes; ++k) {
      for (unsigned cell = 0; cell < kTasks; ++cell) {
        if (nodes_[k].tasks[cell] == nullptr) continue;
        tell(k, Act::Finish, cell);
        std::exchange(nodes_[k].tasks[cell], nullptr)->state = Task::State::Done;
      }
    }
    for (unsigned b = 0; b < 2; ++b) {
      if (nodes_[0].handles[b] == nullptr) open(0, b);
    }
    while (pop(0)) {
    }
    while (take(0, 0)) {
      tell(0, Act::Finish, 0);
      std::exchange(nodes_[0].tasks[0], nullptr)->state = Task::State::Done;
    }
  }

  // ---- bursts, and deaths

  void burst(unsigned k) {
    Node& node = nodes_[k];
    Board& board = boards_[k];
    const unsigned p = below(kPushers);
    const unsigned kind = below(5);
    const unsigned b = kind == 2 || kind == 4 ? 1 : 0;
    Channel* const c = kind == 0 ? node.pushers[p] : node.handles[b];
    if (c == nullptr) return;
    const Act acts[] = {Act::PushMany, Act::PutMany, Act::PutMany, Act::PopMany, Act::WorkMany};
    board.clear(c->count);
    const std::uint32_t burst = 1 + below(kBurst);
    if (trace) std::printf("node %u burst %u of %u on channel %u\n", k, kind, burst, c->id);
    node.puppet->begin({acts[kind], static_cast<std::uint8_t>(p), static_cast<std::uint8_t>(b),
                        burst, Letter::of(c->id, c->count)});
    const bool dies = random_.chance(70);
    if (dies) {
      usleep(below(1500));
      node.puppet->kill9();
    } else {
      QueueAnswer answer;
      node.puppet->end(answer);
    }
    if (kind < 3) {
      wrote(*c, board, dies);
    } else if (kind == 3) {
      for (std::uint32_t i = 0; i < board.taken; ++i) popped(board.marks[i].letter);
      if (dies) ++lost_;
    } else {
      worked(board, dies);
    }
    if (dies) has_died(k);
  }
  void wrote(Channel& c, const Board& board, bool dies) {
    if (c.where == kWork) {
      while (c.count < board.done) add_task(c);
    }
    c.count = board.done;
    c.maybe = dies && board.begun > board.done;
    if (c.where == kItems && c.overwrites()) c.front = std::max(c.front, c.oldest(c.count));
    if (c.where == kItems && !c.overwrites()) {
      require(c.count - c.front <= c.how.depth() + lost_, "items are put into a full queue");
    }
    each_reader([&](unsigned, unsigned, const Reader& reader) {
      for (const Source& s : reader.sources) {
        if (s.channel != &c || reader.observes || c.overwrites()) continue;
        require(c.count - s.next <= c.how.depth(), "a reader without loss was overtaken");
      }
    });
  }
  void worked(const Board& board, bool dies) {
    for (std::uint32_t i = 0; i < board.taken; ++i) {
      const Board::Mark& mark = board.marks[i];
      Task& task = taken(mark.letter, mark.deliveries);
      const bool last = dies && i + 1 == board.taken;
      task.state = mark.finish == 2   ? Task::State::Done
                   : mark.finish == 1 ? Task::State::MaybeDone
                                      : Task::State::Waiting;
      task.ghost = last && mark.finish == 0;
      require(mark.finish != 1 || last, "a task is finished by halves");
    }
    if (!dies) return;
    // One more may have been delivered, and its worker killed before it could mark that.
    for (Channel& c : channels_) {
      for (Task* t : {oldest_waiting(c, true), oldest_waiting(c, false)}) {
        if (t == nullptr || t->most > t->least) continue;
        ++t->most;
        t->ghost = true;
      }
    }
  }

  void kill(unsigned k) {
    nodes_[k].puppet->kill9();
    has_died(k);
  }
  /// What a dead process has had.
  void has_died(unsigned k) {
    if (trace) std::printf("node %u has died\n", k);
    has_dead_ = true;
    Node& node = nodes_[k];
    for (Channel* c : node.pushers) {
      if (c != nullptr) c->ended = true;
    }
    for (Channel* c : node.handles) {
      if (c != nullptr) c->ended = true;
    }
    for (Task* t : node.tasks) {
      if (t == nullptr) continue;
      t->state = Task::State::Waiting;
      t->ghost = true;
    }
    start(k);
    if (random_.chance(50)) rest();
  }

  /// All dead are reaped.
  void rest() {
    const segment::Segment s(path());
    require(soon([&] {
              for (unsigned k = 0; k < kNodes; ++k) tell(k, Act::Settle);
              const auto taken =
                  std::count_if(s.participants().begin(), s.participants().end(),
                                [](const auto& entry) { return entry.state.load() != 0; });
              return taken == static_cast<long>(kNodes);
            }),
            "the dead are reaped");
    has_dead_ = false;
    for (Channel& c : channels_) {
      for (Task& t : c.tasks) t.ghost = false;
    }
    check_size();
  }
  /// As many items wait as the model has.
  void check_size() {
    std::uint64_t waiting = 0;
    bool certain = lost_ == 0;
    for (const Channel& c : channels_) {
      if (c.where != kItems) continue;
      waiting += c.count - c.front;
      certain = certain && !c.maybe;
    }
    for (unsigned k = 0; certain && k < kNodes; ++k) {
      if (nodes_[k].handles[0] == nullptr) continue;
      std::uint64_t said = 0;
      require(
          soon([&] { return (said = tell(k, Act::Size).count) == waiting; }),
          "size() of the queue says " + std::to_string(said) + ", not " + std::to_string(waiting));
    }
  }

  Random& random_;
  Board* boards_;
  EngineOptions options_;
  std::array<Node, kNodes> nodes_;
  std::list<Channel> channels_;
  std::uint32_t ids_ = 0;
  std::uint64_t lost_ = 0;  ///< items that killed takers may have had in hand
  bool has_dead_ = false;   ///< processes that may not have been reaped yet
};

int main(int argc, char** argv) {
  Run run(argc, argv, 2000, kQueueMistakes);
  testing::prefix();
  require(testing::start_janitor(), "a janitor");
  for (const Mistake& m : kQueueMistakes) {
    if (run.planted(m.name)) queue_plant = m.name;
  }
  return run_model<Model>(run);
}

}  // namespace
}  // namespace lot::outside

int main(int argc, char** argv) { return lot::outside::main(argc, argv); }
