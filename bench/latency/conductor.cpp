// SPDX-License-Identifier: Apache-2.0
#include "conductor.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <random>
#include <sched.h>
#include <set>
#include <stdexcept>
#include <thread>
#include <utility>

#include "board.hpp"
#include "conditions.hpp"
#include "crew.hpp"
#include "machine.hpp"
#include "measures.hpp"
#include "plan.hpp"

namespace ab {
namespace {

using namespace std::chrono_literals;

constexpr std::uint64_t kMostSamples = 200'000;  ///< of one subscriber; beyond, each n-th is kept
constexpr auto kStartsWithin = 60s;
/// In throughput one message of so many is stamped: reading the clock for each was a third of what
/// the fastest transports take.
constexpr std::uint64_t kClockEvery = 16;
constexpr std::uint64_t kWarmUp = 20;  ///< messages; of ping-pong and throughput more

Wait wait_of(const std::string& text) {
  return text == "spin" ? Wait::Spin : text == "adaptive" ? Wait::Adaptive : Wait::Park;
}
Place place_of(const std::string& text) {
  return text == "host" ? Place::Host : text == "container" ? Place::Container : Place::Containers;
}

/// The cores on which a node may run; empty: all.
std::vector<int> cores_for(const std::string& pin, Role role, unsigned index) {
  const std::vector<int> all = usable_cores();
  const auto of_socket = [&](unsigned wanted) {
    std::vector<int> some;
    std::copy_if(all.begin(), all.end(), std::back_inserter(some),
                 [&](int core) { return socket_of(core) == wanted; });
    return some;
  };
  if (pin == "same-core") return {all.front()};
  if (pin == "other-core") {
    if (role == Role::Publish) return {all.front()};
    return {all[1 + index % (all.size() - 1)]};
  }
  const unsigned first = socket_of(all.front());
  if (pin == "socket") return of_socket(first);
  if (pin == "other-socket") {
    if (role == Role::Publish) return of_socket(first);
    for (const int core : all) {
      if (socket_of(core) != first) return of_socket(socket_of(core));
    }
  }
  return {};
}

/// How long the threads of a process have run.
double ran_ns(int pid) {
  double sum = 0;
  std::error_code ignored;
  const std::string tasks = "/proc/" + std::to_string(pid) + "/task";
  for (const auto& task : std::filesystem::directory_iterator(tasks, ignored)) {
    double ran = 0;
    std::ifstream(task.path() / "schedstat") >> ran;
    sum += ran;
  }
  return sum;
}

/// Reads the scheduler's statistics of nodes each 100 ms.
class Watcher {
 public:
  Watcher(const Board& board, std::vector<std::pair<std::string, unsigned>> nodes)
      : thread_([this, &board, nodes = std::move(nodes)] {
          std::map<unsigned, std::pair<std::int64_t, double>> before;
          while (!stops_) {
            for (const auto& [name, node] : nodes) {
              const std::int64_t now = now_ns();
              const double ran = ran_ns(board.node(node).pid);
              if (const auto at = before.find(node); at != before.end()) {
                const double cores =
                    (ran - at->second.second) / static_cast<double>(now - at->second.first);
                readings.push_back({name, now, cores});
              }
              before[node] = {now, ran};
            }
            std::this_thread::sleep_for(100ms);
          }
        }) {}
  ~Watcher() { stop(); }
  Watcher(const Watcher&) = delete;
  Watcher& operator=(const Watcher&) = delete;
  void stop() {
    stops_ = true;
    if (thread_.joinable()) thread_.join();
  }

  std::vector<Utilisation> readings;  ///< after stop()

 private:
  std::atomic<bool> stops_{false};
  std::thread thread_;  // last: it uses the others
};

/// Copying, or a system call that moves bytes or sleeps.
bool is_no_spinning(const std::string& symbol) {
  static const std::set<std::string> kOthers{"memcpy",
                                             "memset",
                                             "send",
                                             "sendto",
                                             "sendmsg",
                                             "sendmmsg",
                                             "recv",
                                             "recvfrom",
                                             "recvmsg",
                                             "recvmmsg",
                                             "read",
                                             "readv",
                                             "write",
                                             "writev",
                                             "poll",
                                             "ppoll",
                                             "epoll_wait",
                                             "select",
                                             "syscall",
                                             "clock_nanosleep",
                                             "futex_abstimed_wait_common",
                                             "futex_abstimed_wait_cancelable64"};
  // __libc_recv, __send, __GI___writev are the same functions.
  std::size_t begin = 0;
  for (const char* const prefix : {"__libc_", "__GI_", "__"}) {
    if (symbol.compare(begin, std::strlen(prefix), prefix) == 0) begin += std::strlen(prefix);
  }
  return kOthers.count(symbol.substr(begin)) != 0;
}

class Conductor {
 public:
  Conductor(const CellOptions& options, const Workplace& workplace,
            const std::function<void(const std::string&)>& progress,
            const std::function<bool()>& interrupted)
      : options_(options),
        c_(options.conditions),
        workplace_(workplace),
        progress_(progress),
        interrupted_(interrupted),
        first_(topics(c_).front()) {
    cell_.conditions = c_;
    choose_arms();
    make_plan();
  }

  Cell run() {
    try {
      crews_.resize(plan_.arms.size());
      services_.resize(plan_.arms.size());
      for (unsigned a = 0; a < plan_.arms.size(); ++a) serve(a);  // before any node of any arm
      for (unsigned a = 0; a < plan_.arms.size(); ++a) start(a);
      for (unsigned a = 0; a < plan_.arms.size(); ++a) take_turn(a, 0, warm_up());
      take_turns();
      finish();
    } catch (const Interrupted&) {
      board_->head().stop.set(1);
      cell_.arms.clear();
    }
    return std::move(cell_);
  }

 private:
  struct Interrupted {};

  // ---- what is to be done ----

  void choose_arms() {
    std::set<std::string> once;
    for (const std::string& name : options_.transports) {
      if (!once.insert(name).second) continue;
      Arm arm;
      arm.transport = name;
      const Transport* const at = find_transport(transport_of(name));
      if (at == nullptr) throw std::invalid_argument("no transport '" + name + "'");
      arm.is_floor = at->is_floor;
      arm.copies = at->copies;
      arm.refused = Crew::unavailable(place_of(c_.place), at->is_network);
      if (arm.refused.empty() && at->threads && place_of(c_.place) == Place::Containers) {
        arm.refused = "its nodes share one process; set --place host or container";
      }
      for (const Topic& topic : topics_of(c_, name)) {
        if (arm.refused.empty())
          arm.refused = at->refuses(stream_of(topic, "name", "/dev/shm", *at));
      }
      cell_.arms.push_back(arm);
      if (!arm.refused.empty()) continue;
      arm_of_.push_back(cell_.arms.size() - 1);
      transports_.push_back(at);
      topics_.push_back(topics_of(c_, name));
    }
    check_memory();
  }

  /// All arms are there at once. What each may need is estimated: messages that wait, those that
  /// are prepared, and some that are on their way.
  void check_memory() const {
    constexpr std::uint64_t kOnTheirWay = 40;
    std::uint64_t all = 0;
    for (unsigned a = 0; a < transports_.size(); ++a) {
      for (const Topic& topic : topics_[a]) {
        const std::uint64_t messages =
            c_.depth +
            (transports_[a]->is_floor ? 1 : std::max<std::uint64_t>(c_.pool, kOnTheirWay));
        all += topic.publishers * topic.size * messages;
      }
    }
    const std::uint64_t there = free_memory();
    if (all <= there) return;
    const auto gib = [](std::uint64_t bytes) {
      return std::to_string(static_cast<double>(bytes >> 27) / 8).substr(0, 5);
    };
    throw std::invalid_argument(
        "these transports may need " + gib(all) + " GiB at once, and " + gib(there) +
        " are free; set fewer --transports, or a smaller --depth or --pool");
  }

  Stream stream_of(const Topic& topic, const std::string& name, const std::string& directory,
                   const Transport& transport) const {
    Stream s;
    s.name = name;
    s.directory = directory;
    s.size = topic.size;
    s.publishers = topic.publishers;
    s.subscribers = topic.subscribers;
    s.wait = wait_of(c_.wait);
    s.pool = c_.pool;
    s.depth = c_.depth;
    s.filled = c_.fill;
    s.one_by_one = c_.mode == "ping-pong";
    s.lossless = c_.lossless;
    s.isolated = c_.place != "host";
    if (transport.is_network) {
      s.address.resize(topic.publishers);
      for (unsigned p = 0; p < topic.publishers; ++p) {
        for (unsigned r = 0; r < topic.subscribers; ++r) {
          s.address[p].push_back(Crew::address(place_of(c_.place), p, r));
        }
      }
    }
    return s;
  }

  void make_plan() {
    plan_.mode = c_.mode;
    plan_.fill = c_.fill;
    const Place place = place_of(c_.place);
    std::uint64_t samples = 0;
    static std::atomic<unsigned> cells{0};
    const unsigned number = cells++;
    for (unsigned a = 0; a < transports_.size(); ++a) {
      const std::string name =
          workplace_.name() + "_" + std::to_string(number) + "_" + std::to_string(a);
      directories_.push_back(workplace_.directory(name));
      ArmPlan arm;
      arm.transport = transports_[a]->name;
      for (unsigned t = 0; t < topics_[a].size(); ++t) {
        // A container sees this directory as its /dev/shm.
        Stream stream =
            stream_of(topics_[a][t], name + "_" + std::to_string(t),
                      place == Place::Host ? directories_.back() : "/dev/shm", *transports_[a]);
        add_nodes(arm, a, t, stream, place);
        arm.streams.push_back({stream, topics_[a][t].rate_hz});
      }
      if (c_.mode == "ping-pong") {
        Stream back = arm.streams[0].stream;
        back.name = name + "_1";
        if (!back.address.empty()) back.address = {{Crew::address(place, 0, 0, true)}};
        arm.streams.push_back({back, 0});
      }
      plan_.arms.push_back(std::move(arm));
    }
    for (const NodePlan& node : plan_.nodes) samples += most_samples(node);
    const std::uint64_t total = c_.messages * first_.publishers;
    plan_.keep_every = (total + kMostSamples - 1) / kMostSamples;
    if (c_.mode == "throughput") plan_.keep_every = std::max(plan_.keep_every, kClockEvery);
    const std::string text = nlohmann::json(plan_).dump();
    board_ = std::make_unique<Board>(
        plan_.arms.size(), plan_.nodes.size(),
        text.size() + samples * sizeof(Sample) +
            plan_.nodes.size() * (2 * 4096 + (options_.profile ? kProfileBytes : 0)) + 4096);
    board_->set_plan(text);
    for (unsigned n = 0; n < plan_.nodes.size(); ++n) {
      NodeRecord& record = board_->node(n);
      record.most_samples = most_samples(plan_.nodes[n]);
      record.samples_at = board_->give(record.most_samples * sizeof(Sample));
      if (plan_.nodes[n].profiled) record.profile_at = board_->give(kProfileBytes);
    }
  }

  void add_nodes(ArmPlan& arm, unsigned a, unsigned t, const Stream& stream, Place place) {
    const auto add = [&](Role role, unsigned index, double delay) {
      NodePlan node;
      node.arm = a;
      node.stream = t;
      node.role = role;
      node.index = index;
      node.cores = cores_for(c_.pin, role, index);
      node.delay_s = c_.ordered ? delay : 0;
      node.profiled = options_.profile && !transports_[a]->threads;
      // Threads share a process, and nodes of one container their parent.
      const bool apart = place == Place::Containers;
      if (arm.groups.empty() || apart) arm.groups.emplace_back();
      arm.groups.back().push_back(static_cast<unsigned>(plan_.nodes.size()));
      plan_.nodes.push_back(std::move(node));
    };
    const unsigned publishers = stream.publishers;
    for (unsigned p = 0; p < publishers; ++p) add(Role::Publish, p, 2.0 * p);
    for (unsigned r = 0; r < stream.subscribers; ++r) {
      add(Role::Subscribe, r, 2.0 * (publishers + r));
    }
  }

  std::uint64_t most_samples(const NodePlan& node) const {
    if (c_.mode == "ping-pong" && node.role == Role::Subscribe) return 0;
    if (c_.mode != "ping-pong" && node.role == Role::Publish) return 0;
    const Topic& topic = topic_of(node);
    const std::uint64_t blocks = (c_.messages + c_.block - 1) / c_.block;
    const std::uint64_t all =
        blocks * topic.publishers * messages_in_block(first_.rate_hz, topic.rate_hz, c_.block);
    return std::min(all, kMostSamples + 1000);
  }
  const Topic& topic_of(const NodePlan& node) const { return topics_[node.arm][node.stream]; }
  std::uint64_t warm_up() const {
    return c_.mode == "paced" ? kWarmUp : std::max<std::uint64_t>(kWarmUp, c_.block / 2);
  }

  // ---- starting ----

  void say(const std::string& text) const {
    if (progress_) progress_(text);
  }
  void give_up(unsigned a, const std::string& why) {
    Arm& arm = cell_.arms[arm_of_[a]];
    if (!arm.refused.empty()) return;
    arm.refused = "failed: " + why;
    say(arm.transport + " failed: " + why);
    crews_[a].reset();
    services_[a].clear();
  }
  bool has_failed(unsigned a) const { return !cell_.arms[arm_of_[a]].refused.empty(); }

  /// What its nodes said of their ends, or what is known of their parents.
  std::string trouble(unsigned a) {
    const std::string parents = crews_[a]->ended();
    for (unsigned n = 0; n < plan_.nodes.size(); ++n) {
      if (plan_.nodes[n].arm != a || board_->node(n).state.load() != NodeState::Failed) continue;
      return name_of(plan_.nodes[n]) + ": " + board_->node(n).error;
    }
    return parents.empty() ? "" : "a group of nodes: " + parents;
  }
  /// Of nodes that were told to leave.
  std::string how_it_ended(unsigned a) const {
    for (unsigned n = 0; n < plan_.nodes.size(); ++n) {
      const NodeRecord& record = board_->node(n);
      if (plan_.nodes[n].arm != a || record.state.load() == NodeState::Ended) continue;
      return name_of(plan_.nodes[n]) + ": " +
             (record.error[0] != 0 ? record.error : "did not leave");
    }
    return "";
  }
  std::string name_of(const NodePlan& node) const {
    return (topic_of(node).name.empty() ? "" : topic_of(node).name + " ") +
           (node.role == Role::Publish ? "publisher " : "subscriber ") + std::to_string(node.index);
  }

  void serve(unsigned a) {
    if (!transports_[a]->serve) return;
    try {
      for (const StreamPlan& each : plan_.arms[a].streams) {
        Stream of_service = each.stream;
        of_service.directory = directories_[a];
        services_[a].push_back(transports_[a]->serve(of_service));
      }
    } catch (const std::exception& e) {
      give_up(a, e.what());
    }
  }

  void start(unsigned a) {
    if (has_failed(a)) return;
    say("starting " + cell_.arms[arm_of_[a]].transport);
    try {
      crews_[a] = std::make_unique<Crew>(*board_, plan_, a, place_of(c_.place), directories_[a]);
    } catch (const std::exception& e) {
      give_up(a, e.what());
      return;
    }
    double delay = 0;
    for (const NodePlan& node : plan_.nodes) delay = std::max(delay, node.delay_s);
    const auto is_ready = [&] {
      for (unsigned n = 0; n < plan_.nodes.size(); ++n) {
        if (plan_.nodes[n].arm == a && board_->node(n).state.load() != NodeState::Ready)
          return false;
      }
      return true;
    };
    if (const std::string why = wait_until(
            a, is_ready,
            kStartsWithin + std::chrono::nanoseconds(static_cast<std::int64_t>(delay * 1e9)));
        !why.empty()) {
      give_up(a, why);
    }
  }

  /// Why it did not come to pass; empty: it did.
  template <class Condition>
  std::string wait_until(unsigned a, Condition&& condition, std::chrono::nanoseconds patience) {
    const std::int64_t until = now_ns() + patience.count();
    for (std::uint32_t seen = board_->head().arrivals.load(); !condition();) {
      if (interrupted_()) throw Interrupted();
      if (const std::string why = trouble(a); !why.empty()) return why;
      if (now_ns() > until) return "hangs: " + who_is_missing(a);
      seen = board_->head().arrivals.wait_while(seen, 50ms);
    }
    return "";
  }
  std::string who_is_missing(unsigned a) const {
    const ArmRecord& arm = board_->arm(a);
    std::string text = std::to_string(arm.listening.load()) + " listen, " +
                       std::to_string(arm.sent_all.load()) + " have sent all, " +
                       std::to_string(arm.finished.load()) + " have finished";
    for (unsigned n = 0; n < plan_.nodes.size(); ++n) {
      if (plan_.nodes[n].arm == a && board_->node(n).state.load() == NodeState::Starting) {
        text += "; " + name_of(plan_.nodes[n]) + " is still starting";
      }
    }
    return text;
  }

  // ---- turns ----

  void take_turns() {
    std::mt19937_64 random(options_.seed);
    std::vector<unsigned> order(plan_.arms.size());
    for (unsigned a = 0; a < order.size(); ++a) order[a] = a;
    std::uint64_t left = c_.messages;
    for (std::uint32_t block = 1; left > 0; ++block) {
      const std::uint64_t n = std::min(left, c_.block);
      shuffle(order, random);
      for (const unsigned a : order) take_turn(a, block, n);
      left -= n;
      say(std::to_string(c_.messages - left) + " of " + std::to_string(c_.messages));
    }
  }

  /// By chance; but a quiet twin stays beside its arm, before or behind it, since they are
  /// compared.
  void shuffle(std::vector<unsigned>& order, std::mt19937_64& random) const {
    std::map<std::string, std::vector<unsigned>> twins;
    std::vector<std::string> transports;
    std::shuffle(order.begin(), order.end(), random);
    for (const unsigned a : order) {
      const std::string name = transport_of(cell_.arms[arm_of_[a]].transport);
      if (twins[name].empty()) transports.push_back(name);
      twins[name].push_back(a);
    }
    order.clear();
    for (const std::string& name : transports) {
      order.insert(order.end(), twins[name].begin(), twins[name].end());
    }
  }

  void take_turn(unsigned a, std::uint32_t block, std::uint64_t messages) {
    if (has_failed(a)) return;
    ArmRecord& arm = board_->arm(a);
    arm.listening.set(0);
    arm.sent_all.set(0);
    arm.finished.set(0);
    arm.rested.set(0);
    arm.start.store(0);
    const std::vector<Totals> before = totals(a);
    const double daemon_before = daemon_cpu_us(a);
    arm.order = {block, messages, block != 0, false};
    std::unique_ptr<Watcher> watcher;
    if (options_.profile && block != 0 && c_.place == "host") watcher = watch(a);
    arm.turn.raise();
    unsigned nodes = 0;
    each_node(a, [&](const NodePlan&, const NodeRecord&) { ++nodes; });
    const double expected = first_.rate_hz > 0 ? static_cast<double>(messages) / first_.rate_hz : 0;
    const std::string why = wait_until(
        a, [&] { return arm.rested.load() >= nodes; },
        std::chrono::nanoseconds(static_cast<std::int64_t>((120 + 4 * expected) * 1e9)));
    if (watcher) {
      watcher->stop();
      Arm& result = cell_.arms[arm_of_[a]];
      result.utilisation.insert(result.utilisation.end(), watcher->readings.begin(),
                                watcher->readings.end());
    }
    if (!why.empty()) {
      give_up(a, why);
      return;
    }
    if (block == 0) return;
    cell_.arms[arm_of_[a]].daemon_cpu_us += std::max(0.0, daemon_cpu_us(a) - daemon_before);
    note_block(a, block, before);
  }

  std::unique_ptr<Watcher> watch(unsigned a) {
    std::vector<std::pair<std::string, unsigned>> nodes;
    for (unsigned n = 0; n < plan_.nodes.size(); ++n) {
      if (plan_.nodes[n].arm == a) nodes.emplace_back(name_of(plan_.nodes[n]), n);
    }
    return std::make_unique<Watcher>(*board_, std::move(nodes));
  }

  template <class F>
  void each_node(unsigned a, F&& f) {
    for (unsigned n = 0; n < plan_.nodes.size(); ++n) {
      if (plan_.nodes[n].arm == a) f(plan_.nodes[n], board_->node(n));
    }
  }

  /// What the nodes of a topic have done so far, and when they did their last block.
  struct Totals {
    std::uint64_t sent = 0;
    std::uint64_t received = 0;
    double publishers_us = 0;
    double subscribers_us = 0;
    std::int64_t began = INT64_MAX;
    std::int64_t ended = 0;
  };
  std::vector<Totals> totals(unsigned a) {
    std::vector<Totals> topics(topics_[a].size());
    each_node(a, [&](const NodePlan& node, const NodeRecord& record) {
      Totals& topic = topics[node.stream];
      const bool publishes = node.role == Role::Publish;
      if (publishes) topic.sent += record.sent;  // ping-pong: of round trips
      topic.received += record.received;
      (publishes ? topic.publishers_us : topic.subscribers_us) += record.usage.cpu_us;
      if (publishes) topic.began = std::min(topic.began, record.began);
      if (publishes == (c_.mode == "ping-pong")) topic.ended = std::max(topic.ended, record.ended);
    });
    return topics;
  }

  void note_block(unsigned a, std::uint32_t block, const std::vector<Totals>& before) {
    const std::vector<Totals> now = totals(a);
    noted_[a].resize(now.size());
    for (std::size_t t = 0; t < now.size(); ++t) {
      StreamResult& topic = noted_[a][t];
      topic.block_costs.push_back({block, now[t].sent - before[t].sent,
                                   now[t].publishers_us - before[t].publishers_us,
                                   now[t].subscribers_us - before[t].subscribers_us});
      if (c_.mode == "paced") continue;
      topic.blocks.push_back(
          {block, now[t].received - before[t].received, now[t].ended - now[t].began});
    }
  }

  double daemon_cpu_us(unsigned a) const {
    std::set<int> processes;  // several streams may share one
    for (const auto& service : services_[a]) {
      if (service->pid() > 0) processes.insert(service->pid());
    }
    double us = 0;
    for (const int process : processes) us += ran_ns(process) / 1000;
    return us;
  }

  // ---- gathering ----

  void finish() {
    for (unsigned a = 0; a < plan_.arms.size(); ++a) {
      if (has_failed(a)) continue;
      board_->arm(a).order = {0, 0, false, true};
      board_->arm(a).turn.raise();
      crews_[a]->join();
      gather(a);
      if (const std::string why = how_it_ended(a); !why.empty()) give_up(a, "at its end: " + why);
      services_[a].clear();
      crews_[a].reset();
    }
  }

  void gather(unsigned a) {
    Arm& arm = cell_.arms[arm_of_[a]];
    arm.streams = noted_[a];
    arm.streams.resize(topics_[a].size());
    for (std::size_t t = 0; t < topics_[a].size(); ++t) {
      StreamResult& s = arm.streams[t];
      s.name = topics_[a][t].name;
      s.size = topics_[a][t].size;
      s.rate_hz = topics_[a][t].rate_hz;
    }
    std::map<std::string, double> hot;  // us
    each_node(a, [&](const NodePlan& node, const NodeRecord& record) {
      StreamResult& s = arm.streams[node.stream];
      if (node.role == Role::Publish) {
        s.publishers.push_back({node.index, record.sent, record.refused, record.usage});
      }
      if (node.role == Role::Subscribe || c_.mode == "ping-pong") gather(s, node, record);
      if (node.profiled) gather_profile(arm.profile, hot, record);
      if (record.spoilt != 0 && arm.refused.empty()) {
        arm.refused = "failed: " + name_of(node) + " got " + std::to_string(record.spoilt) +
                      " messages that were not what was sent";
      }
    });
    for (StreamResult& s : arm.streams) {
      std::uint64_t sent = 0;
      for (const Publisher& p : s.publishers) sent += p.sent;
      for (Subscriber& r : s.subscribers) {
        // Ping-pong: each end gets what the other one sends.
        const std::uint64_t got = r.received + r.missed;
        r.lost = transports_[a]->delivers && sent > got ? sent - got : 0;
      }
    }
    for (const auto& [symbol, us] : hot) arm.profile.hottest.push_back({symbol, us / 1e6});
    auto& hottest = arm.profile.hottest;
    std::sort(hottest.begin(), hottest.end(),
              [](const HotSpot& x, const HotSpot& y) { return x.seconds > y.seconds; });
    if (hottest.size() > 10) hottest.resize(10);
  }

  void gather(StreamResult& s, const NodePlan& node, const NodeRecord& record) {
    Subscriber r;
    r.index = c_.mode == "ping-pong" && node.role == Role::Publish ? 1 : node.index;
    r.received = record.received;
    r.missed = record.missed;
    r.spoilt = record.spoilt;
    // The publisher of ping-pong receives as well; what it has used is its own.
    if (node.role == Role::Subscribe) r.usage = record.usage;
    const Sample* const samples = board_->samples(record);
    r.samples.assign(samples, samples + record.samples);
    s.subscribers.push_back(std::move(r));
  }

  /// The samples say how a node's processor time is divided; how much it is the kernel knows.
  void gather_profile(Profile& profile, std::map<std::string, double>& hot,
                      const NodeRecord& record) {
    struct Part {
      double samples;
      bool waiting;
      std::string symbol;
    };
    std::vector<Part> parts;
    double samples = 0;
    const std::string text(board_->profile(record), record.profile_size);
    for (std::size_t at = 0; at < text.size();) {
      const auto end = text.find('\n', at);
      if (end == std::string::npos) break;
      const auto first = text.find(' ', at);
      parts.push_back({std::stod(text.substr(at, first - at)), text[first + 1] == '1',
                       text.substr(first + 3, end - first - 3)});
      samples += parts.back().samples;
      at = end + 1;
    }
    for (const Part& part : parts) {
      const double us = record.usage.cpu_us * part.samples / samples;
      hot[part.symbol] += us;
      if (part.waiting && !is_no_spinning(part.symbol)) profile.spin_s += us / 1e6;
    }
    profile.cpu_s += record.usage.cpu_us / 1e6;
    profile.samples += static_cast<std::uint64_t>(samples);
  }

  const CellOptions& options_;
  const Conditions& c_;
  const Workplace& workplace_;
  const std::function<void(const std::string&)>& progress_;
  const std::function<bool()>& interrupted_;
  const Topic first_;  ///< of each arm: blocks are counted in its messages
  Cell cell_;
  // By arm that runs:
  std::vector<std::size_t> arm_of_;  ///< its place in cell_.arms
  std::vector<const Transport*> transports_;
  std::vector<std::vector<Topic>> topics_;
  std::vector<std::string> directories_;
  std::map<unsigned, std::vector<StreamResult>> noted_;  ///< block by block; of each topic
  Plan plan_;
  std::unique_ptr<Board> board_;
  std::vector<std::vector<std::unique_ptr<Service>>> services_;  // of each stream
  std::vector<std::unique_ptr<Crew>> crews_;                     // go first: they use the services
};

}  // namespace

Cell run_cell(const CellOptions& options, const Workplace& workplace,
              const std::function<void(const std::string&)>& progress,
              const std::function<bool()>& interrupted) {
  if (const std::string why = refused(options.conditions); !why.empty()) {
    throw std::invalid_argument(why);
  }
  return Conductor(options, workplace, progress, interrupted).run();
}

}  // namespace ab
