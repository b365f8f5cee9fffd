// SPDX-License-Identifier: Apache-2.0
#include "node.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <memory>
#include <sched.h>
#include <stdexcept>
#include <sys/resource.h>
#include <thread>
#include <unistd.h>

#include "message.hpp"
#include "sampler.hpp"
#include "throw_errno.hpp"
#include "transport.hpp"

namespace ab {
namespace {

using namespace std::chrono_literals;

constexpr auto kSlice = 100ms;  ///< of waiting, after which a subscriber looks whether all is sent
constexpr std::int64_t kQuiet = 500'000'000;  ///< then no message comes any more: ns
constexpr unsigned kMostSilent = 50;          ///< slices, after which a ball is lost

void sleep_until(std::int64_t at) {
  const timespec until{at / 1'000'000'000, at % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
}

const Transport& transport_named(const std::string& name) {
  const Transport* const at = find_transport(name);
  if (at == nullptr) throw std::runtime_error("no transport '" + name + "'");
  return *at;
}

class Node {
 public:
  Node(Board& board, const Plan& plan, unsigned node)
      : board_(board),
        plan_(plan),
        me_(plan.nodes[node]),
        record_(board.node(node)),
        arm_plan_(plan.arms[me_.arm]),
        arm_(board.arm(me_.arm)),
        stream_plan_(arm_plan_.streams[me_.stream]),
        stream_(stream_plan_.stream),
        transport_(transport_named(arm_plan_.transport)),
        size_(stream_.size) {
    for (const ArmPlan& each : plan.arms) {
      if (&each != &arm_plan_) continue;
      // Ping-pong has two streams and two nodes; the gates count the first one's.
      const std::size_t counted = is_ping_pong() ? 1 : each.streams.size();
      for (std::size_t s = 0; s < counted; ++s) {
        publishers_ += each.streams[s].stream.publishers;
        subscribers_ += each.streams[s].stream.subscribers;
      }
    }
    if (is_ping_pong() && !publishes()) {  // no clock between two hops
      handler_ = [this](std::span<const std::byte> message) { accept(message, 0); };
    } else if (is_throughput()) {
      handler_ = [this](std::span<const std::byte> message) {
        if (me_.profiled) sampler_waiting(false);
        accept(message, is_clocked(message) ? now_ns() : 0);
      };
    } else {
      handler_ = [this](std::span<const std::byte> message) {
        const std::int64_t now = now_ns();
        if (me_.profiled) sampler_waiting(false);
        accept(message, now);
      };
    }
  }

  void run() {
    settle_down();
    open();
    record_.state.store(NodeState::Ready, std::memory_order_release);
    board_.head().arrivals.raise();
    for (std::uint32_t turn = 0;;) {
      // Until the first turn: a subscriber may have to look before it has joined its publishers.
      const bool joins = turn == 0 && receiver_;
      if (joins) receiver_->receive([](std::span<const std::byte>) {}, 10ms);
      const auto seen = arm_.turn.wait_while(turn, joins ? 1ms : 1s);
      if (!goes_on()) break;
      if (seen == turn) continue;
      turn = seen;
      if (arm_.order.ends) break;
      take_turn(arm_.order);
      arm_.rested.raise();
      board_.head().arrivals.raise();
    }
    if (me_.profiled) {
      const std::string text = sampled();
      record_.profile_size = std::min(text.size(), kProfileBytes);
      std::memcpy(board_.profile(record_), text.data(), record_.profile_size);
    }
    sender_.reset();
    receiver_.reset();
  }

 private:
  bool goes_on() const { return board_.head().stop.load() == 0; }
  bool is_ping_pong() const { return plan_.mode == "ping-pong"; }
  bool is_throughput() const { return plan_.mode == "throughput"; }
  bool publishes() const { return me_.role == Role::Publish; }

  void settle_down() {
    record_.pid = getpid();
    if (!me_.cores.empty()) {
      cpu_set_t set;
      CPU_ZERO(&set);
      for (const int core : me_.cores) CPU_SET(core, &set);
      if (sched_setaffinity(0, sizeof set, &set) != 0) {
        throw_errno("sched_setaffinity");
      }
    }
    for (const std::int64_t until = now_ns() + static_cast<std::int64_t>(me_.delay_s * 1e9);
         goes_on() && now_ns() < until;) {
      std::this_thread::sleep_for(10ms);
    }
    samples_ = board_.samples(record_);
    for (std::uint64_t i = 0; i < record_.most_samples; ++i) samples_[i] = {};  // touched
  }

  void open() {
    if (publishes()) {
      sender_ = transport_.sender(stream_, me_.index);
      if (is_ping_pong()) receiver_ = transport_.receiver(back(), 0);
    } else {
      receiver_ = transport_.receiver(stream_, me_.index);
      if (is_ping_pong()) sender_ = transport_.sender(back(), 0);
    }
    if (sender_) {
      const unsigned n = publishes() ? stream_.subscribers : 1;
      while (!sender_->wait_for_subscribers(n, 20ms)) {
        if (receiver_) receiver_->receive([](std::span<const std::byte>) {}, 1ms);
        if (!goes_on()) throw std::runtime_error("stopped while it waited for its subscribers");
      }
    }
  }
  const Stream& back() const { return arm_plan_.streams[1].stream; }

  void take_turn(const Order& order) {
    order_ = order;
    if (is_ping_pong()) {
      publishes() ? ping() : pong();
    } else {
      publishes() ? publish() : subscribe();
    }
  }

  // ---- counting ----

  Usage usage() const {
    rusage r{};
    getrusage(transport_.threads ? RUSAGE_THREAD : RUSAGE_SELF, &r);
    Usage u;
    const auto us = [](const timeval& t) {
      return static_cast<double>(t.tv_sec) * 1e6 + static_cast<double>(t.tv_usec);
    };
    u.cpu_us = us(r.ru_utime) + us(r.ru_stime);
    u.voluntary_switches = static_cast<std::uint64_t>(r.ru_nvcsw);
    u.involuntary_switches = static_cast<std::uint64_t>(r.ru_nivcsw);
    u.minor_faults = static_cast<std::uint64_t>(r.ru_minflt);
    u.major_faults = static_cast<std::uint64_t>(r.ru_majflt);
    u.copied_bytes = (sender_ ? sender_->copied() : 0) + (receiver_ ? receiver_->copied() : 0);
    return u;
  }

  void begin() {
    if (me_.profiled && order_.recorded) start_sampler();
    before_ = usage();
    missed_before_ = receiver_ ? receiver_->missed() : 0;
  }
  void end() {
    const Usage after = usage();
    if (me_.profiled) stop_sampler();
    const std::uint64_t missed = receiver_ ? receiver_->missed() - missed_before_ : 0;
    if (!order_.recorded) {
      // What is lost while warming up may be told as missed later.
      const std::uint64_t due = messages() * stream_.publishers;
      untold_ = due - std::min(due, received_ + missed);
      return;
    }
    const std::uint64_t late = std::min(untold_, missed);
    untold_ -= late;
    record_.missed += missed - late;
    Usage& u = record_.usage;
    u.cpu_us += after.cpu_us - before_.cpu_us;
    u.voluntary_switches += after.voluntary_switches - before_.voluntary_switches;
    u.involuntary_switches += after.involuntary_switches - before_.involuntary_switches;
    u.minor_faults += after.minor_faults - before_.minor_faults;
    u.major_faults += after.major_faults - before_.major_faults;
    u.copied_bytes += after.copied_bytes - before_.copied_bytes;
  }

  bool is_kept(std::uint64_t number) const { return number % plan_.keep_every == 0; }
  /// Of the messages of a throughput only those that are kept, and the last ones, are worth a
  /// clock.
  bool is_clocked(std::span<const std::byte> message) const {
    MessageHead head;
    std::memcpy(&head, message.data(), sizeof head);
    return head.is_last != 0 || is_kept(head.number);
  }
  void keep(const Sample& sample) {
    if (!order_.recorded || !is_kept(sample.number)) return;
    if (record_.samples < record_.most_samples) samples_[record_.samples++] = sample;
  }

  // ---- sending ----

  /// Makes a message and publishes it; the stamps where it is worth their time.
  bool send(bool is_last, bool stamped) {
    MessageHead head{};
    if (stamped) head.loaned_at = now_ns();
    std::byte* const message = sender_->loan();
    head.number = number_++;
    head.block = order_.block;
    head.publisher = static_cast<std::uint16_t>(me_.index);
    head.is_last = is_last;
    head.word = payload_word(head.number, me_.index);
    fill(message, size_, head.word, plan_.fill);
    if (stamped) {
      head.filled_at = now_ns();
      head.pushed_at = now_ns();
    }
    std::memcpy(message, &head, sizeof head);
    return sender_->push();
  }

  std::uint64_t messages() const {
    return messages_in_block(arm_plan_.streams[0].rate_hz, stream_plan_.rate_hz, order_.messages);
  }

  void publish() {
    if (!arm_.listening.wait_for(subscribers_, [this] { return goes_on(); })) return;
    begin();
    std::int64_t start = 0;
    if (const std::int64_t soon = now_ns() + 2'000'000;
        arm_.start.compare_exchange_strong(start, soon)) {
      start = soon;
    }
    const bool paced = stream_plan_.rate_hz > 0;
    auto period = static_cast<std::int64_t>(paced ? 1e9 / stream_plan_.rate_hz : 0);
    if (!order_.recorded) period = std::min<std::int64_t>(period, 5'000'000);
    // Publishers of one stream take turns; streams begin a little apart, as sensors do.
    std::int64_t at = start + period * me_.index / stream_.publishers + me_.stream * 300'000;
    sleep_until(at);
    record_.began = now_ns();
    std::uint64_t sent = 0;
    std::uint64_t refused = 0;
    const std::uint64_t n = messages();
    for (std::uint64_t i = 0; i < n && goes_on(); ++i) {
      if (paced && i != 0) {
        at = std::max(at + period, now_ns() - period);  // who is late does not hurry for ever
        sleep_until(at);
      }
      ++(send(i + 1 == n, !is_throughput() || is_kept(number_)) ? sent : refused);
    }
    record_.ended = now_ns();
    if (order_.recorded) {
      record_.sent += sent;
      record_.refused += refused;
    }
    arm_.sent_all.raise();
    arm_.finished.wait_for(subscribers_, [this] { return goes_on(); });
    end();
  }

  // ---- receiving ----

  void accept(std::span<const std::byte> message, std::int64_t now) {
    MessageHead head;
    std::memcpy(&head, message.data(), sizeof head);
    if (now != 0) heard_at_ = now;
    if (head.block == order_.block) {
      ++received_;
      ended_ += head.is_last;
    } else if (head.block != 0) {
      ++received_;  // late, of a block that was given up
    }
    const bool whole = head.word == payload_word(head.number, head.publisher) &&
                       (transport_.is_floor ||
                        (message.size() == size_ && is_whole(message, head.word, plan_.fill)));
    if (!whole) ++record_.spoilt;
    number_heard_ = head.number;
    if (!is_ping_pong() && now != 0) {
      keep({head.number, head.publisher, head.block, head.loaned_at, head.filled_at, head.pushed_at,
            now});
    }
  }

  bool receive() {
    if (me_.profiled) sampler_waiting(true);
    const bool got = receiver_->receive(handler_, kSlice);
    if (me_.profiled) sampler_waiting(false);
    return got;
  }

  void subscribe() {
    received_ = 0;
    ended_ = 0;
    begin();
    arm_.listening.raise();
    if (!transport_.delivers) {
      // Not each 50 ms: what looking costs would be taken for the cost of pacing.
      while (goes_on() && arm_.sent_all.load() < publishers_) {
        arm_.sent_all.wait_while(arm_.sent_all.load(), 5s);
      }
    }
    heard_at_ = now_ns();
    std::int64_t quiet_since = 0;  // 0: it is not quiet
    while (transport_.delivers && ended_ < stream_.publishers && goes_on()) {
      if (receive() || arm_.sent_all.load() < publishers_) {
        quiet_since = 0;
      } else if (quiet_since == 0) {
        quiet_since = now_ns();
      } else if (now_ns() - quiet_since > kQuiet) {
        break;  // the last ones are lost
      }
    }
    record_.ended = heard_at_;
    end();
    if (order_.recorded) record_.received += received_;
    arm_.finished.raise();
  }

  // ---- ping-pong ----

  void ping() {
    if (!arm_.listening.wait_for(1, [this] { return goes_on(); })) return;
    begin_game();
    std::this_thread::sleep_for(2ms);  // all that the conductor has woken sleep again
    std::int64_t at = now_ns();
    record_.began = at;
    std::uint64_t n = 0;
    while (n < order_.messages && goes_on()) {
      const std::uint64_t number = number_;
      send(++n == order_.messages, false);
      if (!hear(number)) break;
      const std::int64_t back = heard_at_;
      keep({number, 0, order_.block, at, at, at, at + (back - at) / 2});
      at = back;
    }
    record_.ended = heard_at_;
    arm_.sent_all.raise();
    arm_.finished.wait_for(1, [this] { return goes_on(); });
    end_game(n);
  }

  void pong() {
    begin_game();
    arm_.listening.raise();
    std::uint64_t n = 0;
    while (n < order_.messages && goes_on() && hear(number_)) {
      send(++n == order_.messages, false);
    }
    end_game(n);
    arm_.finished.raise();
  }

  void begin_game() {
    received_ = 0;
    number_ = std::uint64_t{order_.block} << 32;  // also where the last game ended early
    begin();
  }
  void end_game(std::uint64_t sent) {
    end();
    if (!order_.recorded) return;
    record_.sent += sent;
    record_.received += received_;
  }

  /// The ball of this number. False: it was lost, and the game is over.
  bool hear(std::uint64_t number) {
    number_heard_ = ~number;
    while (number_heard_ != number) {
      if (receive()) continue;
      if (!goes_on() || ++silent_ > kMostSilent) return false;
    }
    silent_ = 0;
    return true;
  }

  Board& board_;
  const Plan& plan_;
  const NodePlan& me_;
  NodeRecord& record_;
  const ArmPlan& arm_plan_;
  ArmRecord& arm_;
  const StreamPlan& stream_plan_;
  const Stream& stream_;
  const Transport& transport_;
  const std::size_t size_;
  unsigned publishers_ = 0;  ///< of the arm
  unsigned subscribers_ = 0;
  std::unique_ptr<Sender> sender_;
  std::unique_ptr<Receiver> receiver_;
  Receiver::Handler handler_;
  Order order_{};
  Sample* samples_ = nullptr;
  std::uint64_t number_ = 0;        ///< of the next message
  std::uint64_t number_heard_ = 0;  ///< of the last one
  std::uint64_t received_ = 0;      ///< in this block
  unsigned ended_ = 0;              ///< publishers whose last message of this block has come
  std::int64_t heard_at_ = 0;       ///< when the last one came that was clocked
  unsigned silent_ = 0;             ///< slices without the ball
  Usage before_;
  std::uint64_t missed_before_ = 0;
  std::uint64_t untold_ = 0;  ///< lost, and not told as missed so far
};

}  // namespace

int run_node(Board& board, const Plan& plan, unsigned node) {
  NodeRecord& record = board.node(node);
  int status = 1;
  try {
    Node(board, plan, node).run();
    record.state.store(NodeState::Ended, std::memory_order_release);
    status = 0;
  } catch (const std::exception& e) {
    std::snprintf(record.error, sizeof record.error, "%s", e.what());
    record.state.store(NodeState::Failed, std::memory_order_release);
  }
  board.head().arrivals.raise();
  return status;
}

}  // namespace ab
