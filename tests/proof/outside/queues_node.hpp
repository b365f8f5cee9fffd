// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <sys/mman.h>
#include <utility>

#include "lot/lot.hpp"

#include "lockstep.hpp"
#include "transport/participant.hpp"

/// A process that publishes, reads, puts, takes and works, one command after the other, or in
/// bursts, of which the board says how far it has come.
namespace lot::outside {

/// Each channel, which is one publisher's or one handle's, counts its letters from 0.
struct Letter {
  std::uint32_t channel;
  std::uint32_t number;
  std::uint64_t check;
  static Letter of(std::uint32_t channel, std::uint32_t number) {
    return {channel, number, seal(channel, number)};
  }
  static std::uint64_t seal(std::uint32_t channel, std::uint32_t number) {
    return Random::mix(std::uint64_t{channel} << 32 | number);
  }
};

inline constexpr unsigned kTopics = 2, kPushers = 2, kPullers = 2, kTasks = 3;
inline constexpr std::array<const char*, kTopics> kTopicNames{"/a", "/b"};

/// Outside of the segment: what a process has done when it is killed.
struct Board {
  static constexpr std::uint32_t kMost = 4096;
  struct Mark {
    Letter letter;
    std::uint32_t deliveries;
    std::uint32_t finish;  ///< 0: not begun, 1: begun, 2: done
  };
  std::atomic<std::uint32_t> begun;  ///< the number that it publishes or puts just now, + 1
  std::atomic<std::uint32_t> done;   ///< so many are published or put
  std::atomic<std::uint32_t> taken;  ///< so many marks count
  Mark marks[kMost];

  static Board* make(unsigned count) {
    void* const at = mmap(nullptr, sizeof(Board) * count, PROT_READ | PROT_WRITE,
                          MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    require(at != MAP_FAILED, "memory for the board");
    return static_cast<Board*>(at);
  }
  void clear(std::uint32_t number) {
    begun = done = number;
    taken = 0;
  }
};

enum class Act : std::uint8_t {
  Advertise,    ///< pusher a on topic b; n: how
  Close,        ///< pusher a
  Subscribe,    ///< puller a on topic b; n: history, bit 31: an observer
  Unsubscribe,  ///< puller a
  Look,         ///< puller a finds its publishers
  Push,         ///< pusher a: letter
  Pull,         ///< puller a
  Borrow,       ///< the same by a borrow that ends at once
  Hold,         ///< puller a borrows, and
  End,          ///< ends it later
  Open,         ///< the handle of queue b (0: items, 1: tasks); n: how
  Shut,         ///< that handle
  Put,          ///< handle b: letter
  Pop,          ///< an item
  Size,         ///< of the queue of items
  Take,         ///< a task into a
  Finish,       ///< a
  GiveBack,     ///< a
  PushMany,     ///< n letters from the one that is given, by pusher a
  PutMany,      ///< n letters, into queue b
  PopMany,      ///< n pops
  WorkMany,     ///< n tasks, taken and mostly finished
  Settle
};

/// How a publisher or handle is: policy 2 bits, mutex engine 1, fast lane 1, from bit 8 depth.
struct How {
  std::uint32_t word;
  Policy policy() const { return static_cast<Policy>(word & 3); }
  QueueEngine engine() const { return (word & 4) != 0 ? QueueEngine::Mutex : QueueEngine::Ring; }
  bool fast_lane() const { return (word & 8) != 0; }
  std::uint32_t depth() const { return word >> 8; }
};
inline constexpr std::uint32_t kObserver = std::uint32_t{1} << 31;
inline constexpr std::uint32_t kHistoryAll = kObserver - 1;

struct QueueCommand {
  Act what;
  std::uint8_t a, b;
  std::uint32_t n;
  Letter letter;
};
struct QueueAnswer {
  Said said;
  Status status = Status::Ok;
  bool has_letter = false;
  Letter letter{};
  std::uint64_t missed = 0;  ///< just before the letter
  std::uint64_t count = 0;   ///< all that the reader has missed; deliveries, a size
};

inline const std::vector<Mistake> kQueueMistakes{
    {"miscount", "a reader is told of one message too few that it missed"},
    {"skip", "a late looker does not get the first message"},
    {"yes", "a publisher that refuses says Ok"},
    {"drop", "a message is not published, and the push says Ok"},
    {"twice", "an item is put a second time when it was taken"},
    {"lose", "an item is taken, and nobody gets it"},
    {"forget", "a task that is given back is gone"},
    {"share", "a task that was finished is delivered again"},
    {"recount", "a worker is told of too few deliveries"},
};
inline std::string queue_plant;
/// One in `several` times in each life of a process.
inline bool errs(std::string_view mistake, unsigned several = 4) {
  static unsigned chances = 0;
  return queue_plant == mistake && ++chances % several == 0;
}

class QueueNode {
 public:
  QueueNode(const EngineOptions& options, Board& board)
      : board_(board), engine_(options), participant_(detail::join(options)) {}

  void act(const QueueCommand& c, QueueAnswer& answer) {
    switch (c.what) {
      case Act::Advertise:
        return advertise(c);
      case Act::Close:
        return pushers_[c.a].reset();
      case Act::Subscribe:
        return subscribe(c);
      case Act::Unsubscribe:
        borrows_[c.a].end();
        return pullers_[c.a].reset();
      case Act::Look:
        answer.count = pullers_[c.a]->publishers();
        return;
      case Act::Push:
        answer.status = push(*pushers_[c.a], c.letter);
        return;
      case Act::Pull:
      case Act::Borrow:
      case Act::Hold:
        return look(c, answer);
      case Act::End:
        return borrows_[c.a].end();
      case Act::Settle:
        participant_->reaper().reap_dead();
        participant_->reaper().collect();
        return;
      default:
        return act_on_queue(c, answer);
    }
  }

 private:
  using Queue = ShmQueue<Letter>;

  void advertise(const QueueCommand& c) {
    const How how{c.n};
    PusherOptions options;
    options.policy = how.policy();
    options.engine = how.engine();
    options.fast_lane = how.fast_lane();
    options.depth = how.depth();
    pushers_[c.a].emplace(engine_.advertise<Letter>(kTopicNames[c.b], options));
  }
  void subscribe(const QueueCommand& c) {
    PullerOptions options;
    const std::uint32_t history = c.n & ~kObserver;
    options.history = history == kHistoryAll ? ~decltype(options.history){0} : history;
    options.observer = (c.n & kObserver) != 0;
    pullers_[c.a].emplace(engine_.subscribe<Letter>(kTopicNames[c.b], options));
    is_new_[c.a] = true;
  }

  static Status push(ShmPusher<Letter>& pusher, const Letter& letter) {
    if (errs("drop")) return Status::Ok;
    auto message = pusher.loan();
    *message = letter;
    const Status status = pusher.try_push(std::move(message));
    return status == Status::Full && errs("yes") ? Status::Ok : status;
  }

  void look(const QueueCommand& c, QueueAnswer& answer) {
    ShmPuller<Letter>& puller = *pullers_[c.a];
    if (std::exchange(is_new_[c.a], false) && queue_plant == "skip") (void)puller.try_pull();
    if (c.what == Act::Pull) {
      if (const auto seen = puller.try_pull()) note(*seen, answer);
    } else {
      auto borrow = puller.try_borrow();
      if (borrow) note(*borrow, answer);
      if (c.what == Act::Hold) borrows_[c.a] = std::move(borrow);
    }
    answer.status = puller.status();
    answer.count = puller.missed_total();
    if (answer.has_letter) answer.missed = puller.missed();
    if (answer.missed != 0 && errs("miscount", 1)) --answer.missed;
  }
  static void note(const Letter& letter, QueueAnswer& answer) {
    require(letter.check == Letter::seal(letter.channel, letter.number), "a letter is torn");
    answer.has_letter = true;
    answer.letter = letter;
  }

  void act_on_queue(const QueueCommand& c, QueueAnswer& answer) {
    switch (c.what) {
      case Act::Open:
        return open(c);
      case Act::Shut:
        return queues_[c.b].reset();
      case Act::Put:
        answer.status = put(*queues_[c.b], c.letter);
        return;
      case Act::Pop:
        if (const auto item = pop()) note(*item, answer);
        return;
      case Act::Size:
        answer.count = queues_[0]->size();
        return;
      case Act::Take:
        return take(c.a, answer);
      case Act::Finish:
        return errs("share", 1) ? tasks_[c.a].give_back() : tasks_[c.a].finish();
      case Act::GiveBack:
        return errs("forget", 1) ? tasks_[c.a].finish() : tasks_[c.a].give_back();
      default:
        return burst(c);
    }
  }

  void open(const QueueCommand& c) {
    const How how{c.n};
    QueueOptions options;
    options.policy = how.policy();
    options.engine = how.engine();
    options.fast_lane = how.fast_lane();
    options.depth = how.depth();
    options.redeliver = c.b == 1;
    queues_[c.b].emplace(engine_.queue<Letter>(c.b == 0 ? "/items" : "/tasks", options));
  }
  static Status put(Queue& queue, const Letter& letter) {
    const Status status = queue.try_put(letter);
    return status == Status::Full && errs("yes") ? Status::Ok : status;
  }
  std::optional<Letter> pop() {
    auto item = queues_[0]->try_pop();
    if (item && errs("twice")) (void)queues_[0]->try_put(*item);
    if (item && errs("lose")) item = queues_[0]->try_pop();
    return item;
  }
  void take(unsigned a, QueueAnswer& answer) {
    tasks_[a] = queues_[1]->try_take();
    if (!tasks_[a]) return;
    note(*tasks_[a], answer);
    answer.count = tasks_[a].deliveries();
    if (answer.count > 1 && errs("recount", 1)) --answer.count;
  }

  // ---- bursts: the board says at each moment what is done, and what may be

  void burst(const QueueCommand& c) {
    std::uint32_t number = c.letter.number;
    for (std::uint32_t n = 0; n < c.n; ++n) {
      switch (c.what) {
        case Act::PushMany:
        case Act::PutMany: {
          const Letter letter = Letter::of(c.letter.channel, number);
          board_.begun = number + 1;
          const Status status =
              c.what == Act::PushMany ? push(*pushers_[c.a], letter) : put(*queues_[c.b], letter);
          if (status == Status::Ok) ++number;
          board_.done = number;
          board_.begun = number;
          break;
        }
        case Act::PopMany:
          if (const auto item = pop()) mark(*item, 0);
          break;
        default:
          work();
      }
    }
  }
  Board::Mark& mark(const Letter& letter, std::uint32_t deliveries) {
    require(letter.check == Letter::seal(letter.channel, letter.number), "a letter is torn");
    Board::Mark& mark = board_.marks[board_.taken];
    mark = {letter, deliveries, 0};
    ++board_.taken;
    return mark;
  }
  void work() {
    auto task = queues_[1]->try_take();
    if (!task) return;
    Board::Mark& its = mark(*task, task.deliveries());
    if (task->number % 8 == 7 && task.deliveries() == 1) return;  // it is given back
    its.finish = 1;
    std::atomic_signal_fence(std::memory_order_seq_cst);  // the marks are in this order
    task.finish();
    std::atomic_signal_fence(std::memory_order_seq_cst);
    its.finish = 2;
  }

  Board& board_;
  ShmEngine engine_;
  std::shared_ptr<transport::Participant> participant_;
  std::array<std::optional<ShmPusher<Letter>>, kPushers> pushers_;
  std::array<std::optional<ShmPuller<Letter>>, kPullers> pullers_;
  std::array<ShmBorrow<Letter>, kPullers> borrows_;
  std::array<bool, kPullers> is_new_{};
  std::array<std::optional<Queue>, 2> queues_;
  std::array<ShmTask<Letter>, kTasks> tasks_;
};

}  // namespace lot::outside
