// SPDX-License-Identifier: Apache-2.0
#include "trial.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <poll.h>
#include <stdexcept>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>
#include <unordered_map>

#include "accounting.hpp"
#include "support/processes.hpp"
#include "transport/participant.hpp"

namespace lot::kill {
namespace {

/// Where the tracer begins and ends to count. Their addresses are the same in all forks.
extern "C" {
[[gnu::noinline]] void lot_kill_begins() { asm volatile(""); }
[[gnu::noinline]] void lot_kill_ends() { asm volatile("nop"); }
/// The operation has thrown.
[[gnu::noinline]] void lot_kill_throws() { asm volatile("nop; nop"); }
}
std::uint64_t address_of(void (*f)()) { return reinterpret_cast<std::uintptr_t>(f); }

constexpr std::uint64_t kRunaway = 5'000'000;  ///< instructions of one operation
/// Far more than any neighbour's operation takes, far less than a loop that waits for somebody.
constexpr std::uint64_t kLockFreeBound = 200'000;
/// Room for a scan of all readers, none for a loop that goes on while others do.
constexpr std::uint64_t kWaitFreeBound = 5'000;
constexpr unsigned kPatienceMs = 5'000;
/// Other threads of a neighbour may get on all the time: then it is the first one's sleep that
/// counts.
constexpr std::chrono::milliseconds kOthersGetOn{1000};
constexpr unsigned kWaitsMs = 20;  ///< a neighbour that sleeps so long waits for somebody
constexpr unsigned kAsks = 25;  ///< and so does one that sleeps so often: it asks again and again

void write_all(int fd, const void* bytes, std::size_t n) {
  if (write(fd, bytes, n) != static_cast<ssize_t>(n)) throw std::runtime_error("pipe");
}
bool read_all(int fd, void* bytes, std::size_t n) {
  auto* p = static_cast<char*>(bytes);
  while (n > 0) {
    const ssize_t got = read(fd, p, n);
    if (got == -1 && errno == EINTR) continue;
    if (got <= 0) return false;
    p += got;
    n -= static_cast<std::size_t>(got);
  }
  return true;
}

constexpr const char* kVictimName = "the victim";

/// Calls f(ring) for each ring of the topic.
template <class F>
void each_ring(segment::Segment& segment, const char* topic, F&& f) {
  for (std::uint32_t c = 0; c < segment.capacity().channels; ++c) {
    const auto& entry = segment.channels()[c];
    const ring::State state = ring::writer_state(entry.writer.load());
    if (state == ring::State::Free || state == ring::State::Init || entry.formed.load() == 0 ||
        std::strcmp(segment.topics()[entry.topic].name, topic) != 0) {
      continue;
    }
    f(segment.ring(c));
  }
}

/// How many messages came into a ring: its slots say so.
std::uint64_t published_in(const segment::Ring& ring) {
  std::uint64_t most = 0;
  for (std::uint32_t i = 0; i < ring.places(); ++i) {
    const ring::Word w = ring.slots[i].load();
    if (ring::block(w) == ring::kNoBlock) continue;
    most = std::max(most,
                    static_cast<std::uint64_t>(ring::distance(ring::sequence(w), ring.first) + 1));
  }
  return most;
}

/// The message in a slot. REQUIRES: messages travel in their slots there.
Number message_in(const segment::Ring& ring, std::uint32_t i) {
  Number message{};
  ring.slots.read(i, 0, ring.places(), &message, sizeof(message) / sizeof(ring::Word), nullptr);
  return message;
}

struct Told {
  Actor::Order order;
  std::uint32_t number;
};

/// Finds out what of a walk is a station.
class Surveyor {
 public:
  void note(const Tracee::Step& step, bool changed, Trial::Path& path) {
    if (step.event == Tracee::Event::AllAsleep) {
      path.push_back({{step.event, 0, 0, 0}, false});
      return;
    }
    auto& times = times_[step.thread];
    ++times[step.place];
    if (!changed && !step.system_call && !step.resumed && step.event == Tracee::Event::Stepped) {
      return;
    }
    path.push_back({{step.event, step.thread, step.place, times[step.place]}, changed});
    times.clear();
  }

 private:
  /// By thread and place: how often it has been there since its last station.
  std::map<unsigned, std::unordered_map<std::uint64_t, std::uint64_t>> times_;
};

}  // namespace

// ---- Actor --------------------------------------------------------------------------------------

Actor::Actor(const Operation& operation, const EngineOptions& options, std::uint64_t source,
             std::string name) {
  if (pipe(orders_) != 0 || pipe(replies_) != 0) throw std::runtime_error("pipe");
  std::fflush(nullptr);
  const pid_t parent = getpid();
  pid_ = fork();
  if (pid_ == -1) throw std::runtime_error("fork");
  if (pid_ != 0) return;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(3);
  for (const int s : {SIGTERM, SIGINT, SIGHUP}) signal(s, SIG_DFL);
  EngineOptions own = options;
  own.name = std::move(name);
  Node node(own, source);
  serve(operation, node);
}

Actor::~Actor() {
  kill();
  for (const int fd : {orders_[0], orders_[1], replies_[0], replies_[1]}) close(fd);
}

void Actor::kill() {
  if (pid_ <= 0) return;
  ::kill(pid_, SIGKILL);
  while (waitpid(pid_, nullptr, 0) == -1 && errno == EINTR) {
  }
  pid_ = -1;
}

void Actor::send(int signal) const {
  if (pid_ > 0) ::kill(pid_, signal);
}

void Actor::stop() {
  if (pid_ <= 0) return;
  send(SIGSTOP);
  int status = 0;
  while (waitpid(pid_, &status, WUNTRACED) == -1 && errno == EINTR) {
  }
  if (WIFSTOPPED(status)) return;
  pid_ = -1;
  throw std::runtime_error("it did not stop, but ended");
}

void Actor::tell(Order order, std::uint32_t number) {
  const Told told{order, number};
  write_all(orders_[1], &told, sizeof(told));
}

std::optional<Actor::Reply> Actor::answer(unsigned seconds) {
  pollfd ready{replies_[0], POLLIN, 0};
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(seconds);
  while (std::chrono::steady_clock::now() < until) {
    if (poll(&ready, 1, 200) == 1) {
      Reply reply{};
      if (!read_all(replies_[0], &reply, sizeof(reply))) return std::nullopt;
      return reply;
    }
    if (pid_ > 0) {
      siginfo_t info{};
      if (waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
          info.si_pid == pid_) {
        return std::nullopt;
      }
    }
  }
  return std::nullopt;
}

std::string Actor::whereabouts() const {
  std::string text;
  for (const char* name : {"stat", "wchan"}) {
    std::ifstream file("/proc/" + std::to_string(pid_) + "/" + name);
    std::string line;
    std::getline(file, line);
    text += (text.empty() ? "" : " / ") + line.substr(0, 60);
  }
  return text;
}

void Actor::serve(const Operation& operation, Node& node) {
  Told told{};
  while (read_all(orders_[0], &told, sizeof(told))) {
    Reply reply{};
    reply.ok = true;
    try {
      obey(told.order, told.number, operation, node);
    } catch (const std::exception& e) {
      reply.ok = false;
      std::snprintf(reply.complaint, sizeof(reply.complaint), "%s", e.what());
    }
    if (node.engine && !(told.order == Order::Operate && operation.ends))
      reply.index = transport::Participant::join(node.options)->index();
    for (std::uint64_t s = 0; s < std::size(reply.last); ++s) reply.last[s] = node.account.last(s);
    reply.missed = node.account.missed();
    reply.reads_topic = node.reads_topic;
    reply.reads_frames = node.frame_puller.has_value();
    reply.frames = node.frames_seen;
    reply.reads_items = node.queue.has_value();
    reply.items = node.items;
    reply.put = node.put_items;
    reply.probe_ready = node.probe_ready;
    write_all(replies_[1], &reply, sizeof(reply));
  }
  _exit(0);
}

void Actor::obey(Order order, std::uint32_t number, const Operation& operation, Node& node) {
  switch (order) {
    case Order::Act:
      operation.before[number].act(node);
      break;
    case Order::Operate:
      lot_kill_begins();
      try {
        operation.run(node);
      } catch (...) {
        lot_kill_throws();
        throw;
      }
      lot_kill_ends();
      break;
    case Order::Contend:
      lot_kill_begins();
      node.contend();
      testing::must(node.account.complaint().empty(), node.account.complaint().c_str());
      break;
    case Order::WhenAsleep:
      operation.when_asleep(node);
      break;
    case Order::Arm:
      node.arm();
      break;
    case Order::Ready: {
      const Probe& probe = all_probes()[number];
      node.probe_ready = false;
      node.drop_probes();
      try {
        node.probe_ready = !probe.ready || probe.ready(node);
      } catch (const OutOfMemory&) {
      }
      break;
    }
    case Order::Probe:
      lot_kill_begins();
      try {
        all_probes()[number].run(node);
      } catch (const OutOfMemory&) {  // the victim has all of it: that is an answer, too
      } catch (const Error& e) {
        // It has a lock, and is named: on a busy machine before the trial's patience has ended.
        const bool is_named = e.error_number() == EBUSY;
        if (!is_named || all_probes()[number].promise != Promise::Blocking) throw;
      }
      lot_kill_ends();
      break;
    case Order::Inspect:
      node.inspect();
      break;
    case Order::NewLife:
      node.live_again();
      break;
    case Order::Meet:
      node.meet();
      break;
    case Order::Start:
      node.start();
      break;
    case Order::Drop:
      node.drop_all();
      node.reap();
      transport::Participant::join(node.options)
          ->stock()
          .trim(transport::Stock::kNobody);  // what the engine's maker has ready
      break;
    case Order::Leave:
      node.leave();
      break;
  }
}

// ---- Trial --------------------------------------------------------------------------------------

Trial::Trial(const Operation& operation, std::string segment, bool probes) : operation_(operation) {
  options_.segment = std::move(segment);
  options_.size_bytes = 6 << 20;
  options_.processes = 7;
  options_.blocks = 64;
  options_.topics = operation.topics;
  options_.channels = 14;
  options_.readers = 4;
  try {
    set_up();
    if (probes && witness_) {
      witness_->tell(Actor::Order::Arm);
      must_answer(*witness_, "the probes are made ready");
    }
  } catch (...) {
    clean_up();
    throw;
  }
}

Trial::~Trial() { clean_up(); }

/// The processes and the files go.
void Trial::clean_up() {
  if (traced_) {
    traced_->kill();
    victim_->was_killed();
  }
  if (stopped_) {
    stopped_->kill();
    rival_->was_killed();
  }
  for (auto* actor : {&victim_, &rival_, &dead_, &bystander_, &witness_}) actor->reset();
  const std::string path = options_.directory + "/" + options_.segment;
  for (const char* suffix : {"", ".lock", ".new", ".left"}) unlink((path + suffix).c_str());
}

void Trial::violation(const std::string& what) { violations_.push_back(what); }

Actor::Reply Trial::must_answer(Actor& actor, const char* what) {
  const auto reply = actor.answer();
  if (!reply) throw std::runtime_error(std::string(what) + ": no answer, " + actor.whereabouts());
  if (!reply->ok) throw std::runtime_error(std::string(what) + ": " + reply->complaint);
  if (witness_ && &actor == &*witness_) {
    popped_ = reply->items;
    put_ = reply->put;
  }
  return *reply;
}

void Trial::set_up() {
  const auto& acts = operation_.before;
  if (!operation_.alone) witness_.emplace(operation_, options_, kWitness, "the witness");
  const auto acts_in_it = [&acts](Who who) {
    return std::any_of(acts.begin(), acts.end(), [who](const Act& a) { return a.who == who; });
  };
  if (acts_in_it(Who::Bystander)) {
    bystander_.emplace(operation_, options_, kBystander, "the bystander");
  }
  if (acts_in_it(Who::Dead)) dead_.emplace(operation_, options_, kDead, "another dead one");
  if (operation_.rival != Rival::None) rival_.emplace(operation_, options_, kRival, "the rival");
  victim_.emplace(operation_, options_, kVictim, kVictimName);
  for (std::uint32_t i = 0; i < acts.size(); ++i) {
    Actor& actor = acts[i].who == Who::Victim      ? *victim_
                   : acts[i].who == Who::Witness   ? *witness_
                   : acts[i].who == Who::Bystander ? *bystander_
                   : acts[i].who == Who::Rival     ? *rival_
                                                   : *dead_;
    actor.tell(Actor::Order::Act, i);
    const Actor::Reply reply = must_answer(actor, "before");
    if (acts[i].who == Who::Rival) {
      rival_index_ = reply.index;
      rival_reads_ = reply.reads_topic;
    }
  }
  if (rival_) stop_rival();
}

/// Brings the rival to where it holds an item that it has not taken yet.
void Trial::stop_rival() {
  segment::Segment segment(options_.directory + "/" + options_.segment);
  const std::uint64_t before = untaken();
  std::vector<std::uint64_t> lives;
  for (std::uint32_t b = 0; b < segment.capacity().blocks; ++b) {
    lives.push_back(segment.block(b).life.load());
  }
  stopped_.emplace(rival_->pid());
  rival_->tell(Actor::Order::Contend);
  if (!stopped_->run_first_to(address_of(&lot_kill_begins), kPatienceMs)) {
    throw std::runtime_error("the rival does not begin");
  }
  for (std::uint64_t instructions = 0; !rival_holds(segment, lives);) {
    if (stopped_->step(kPatienceMs).event == Tracee::Event::Ended || ++instructions > kRunaway) {
      throw std::runtime_error("the rival never held an item");
    }
  }
  if (untaken() != before) throw std::runtime_error("the rival was too fast");
}

/// True when the rival's bit stands in the block of an item that is in the queue, and its home can
/// see that. Where items travel in their slots: when the rival has copied one.
bool Trial::rival_holds(segment::Segment& segment, const std::vector<std::uint64_t>& lives) const {
  using Own = refcount::Ownership<segment::Atomics>;
  bool holds = false;
  each_ring(segment, rival_reads_ ? kTopic : kItems, [&](const segment::Ring& ring) {
    for (std::uint32_t i = 0; i < ring.places(); ++i) {
      const ring::Word b = ring::block(ring.slots[i].load());
      if (b == ring::kNoBlock) continue;
      if (b == ring::kInSlot) {
        holds = holds || rival_has_copied(segment, message_in(ring, i));
        continue;
      }
      auto& words = segment.block(static_cast<std::uint32_t>(b));
      holds = holds || ((Own::word(words, rival_index_).load() & Own::bit(rival_index_)) != 0 &&
                        words.life.load() != lives[static_cast<std::size_t>(b)]);
    }
  });
  return holds;
}

/// True when a block of the rival has all words of this message, or where it is to be halfway, all
/// but the last one.
bool Trial::rival_has_copied(segment::Segment& segment, const Number& message) const {
  const bool halfway = operation_.rival == Rival::Halfway;
  for (std::uint32_t b = 0; b < segment.capacity().blocks; ++b) {
    if (segment.block(b).home.load() != rival_index_ + 1) continue;
    Number copy{};
    std::memcpy(&copy, segment.small(b), sizeof(copy));
    if (copy.source == message.source && copy.number == message.number &&
        (copy.check == message.check) != halfway) {
      return true;
    }
  }
  return false;
}

/// It takes what the victim has left of the queue, or nothing, or reads what the victim has
/// published, and leaves.
void Trial::let_rival_go_on() {
  stopped_.reset();
  const Actor::Reply seen = must_answer(*rival_, "the rival");
  rivals_ = seen.items;
  if (seen.reads_topic) look_at_reader(seen, "the rival");
  rival_->tell(Actor::Order::Leave);
  must_answer(*rival_, "the rival leaves");
  rival_.reset();
}

/// Brings the victim to the first instruction of its operation.
void Trial::begin() {
  // A death wakes wardens: the others' must not do the victim's work, nor the victim's own begin.
  if (witness_) witness_->stop();
  if (bystander_) bystander_->stop();
  traced_.emplace(victim_->pid());
  if (dead_) dead_->kill();
  if (operation_.rival == Rival::Killed) {
    stopped_->kill();
    stopped_.reset();
    rival_->was_killed();
    rival_.reset();
  }
  victim_->tell(Actor::Order::Operate);
  if (!traced_->run_first_to(address_of(&lot_kill_begins), kPatienceMs)) {
    throw std::runtime_error("the victim does not begin");
  }
  note_published();
}

void Trial::let_go_on() const {
  witness_->send(SIGCONT);
  if (bystander_) bystander_->send(SIGCONT);
}

/// The victim waits for others: now they may go on.
void Trial::help_sleeper() {
  if (!witness_) return;
  let_go_on();
  if (operation_.when_asleep) {
    witness_->tell(Actor::Order::WhenAsleep);
    must_answer(*witness_, "when the victim sleeps");
  }
}

/// One instruction, or with a path all up to its next station and that one. Nothing: it has
/// strayed.
std::optional<Tracee::Step> Trial::next(const Path* path, std::size_t done, bool helped) {
  const unsigned patience_ms = helped ? kPatienceMs : 2;
  if (path == nullptr) {
    const Tracee::Step step = traced_->step(patience_ms);
    if (step.event == Tracee::Event::Ended) throw std::runtime_error("the victim died by itself");
    if (step.event == Tracee::Event::AllAsleep && helped) {
      throw std::runtime_error("the victim hangs in its operation");
    }
    return step;
  }
  if (done == path->size()) return std::nullopt;
  const Tracee::Station& at = (*path)[done].at;
  if (!traced_->run_to(at) || (shadow_ && shadow_->changed())) return std::nullopt;
  const bool waits = at.event == Tracee::Event::AllAsleep;
  const Tracee::Step step =
      traced_->step(patience_ms, waits ? std::nullopt : std::optional(at.thread));
  const bool same = step.event == at.event && step.thread == at.thread && step.place == at.place;
  return same ? std::optional(step) : std::nullopt;
}

/// Is the victim behind the last instruction of its operation? An operation whose system calls all
/// go well must not throw. One that does would never come there, while its warden gets on.
bool Trial::has_ended() {
  const std::uint64_t place = traced_->place();
  if (place == address_of(&lot_kill_throws)) {
    traced_.reset();
    const auto reply = victim_->answer();
    throw std::runtime_error(std::string("the operation throws: ") +
                             (reply ? reply->complaint : "no answer"));
  }
  return place == address_of(&lot_kill_ends);
}

Trial::Walk Trial::walk(std::uint64_t points, const Path* path) {
  begin();
  shadow_.emplace(options_);
  Walk walk;
  Surveyor surveyor;
  bool helped = false;
  for (std::size_t done = 0; walk.points < points; ++done) {
    const auto step = next(path, done, helped);
    if (!step) {
      walk.strayed = true;
      return walk;
    }
    const bool sleeps = step->event == Tracee::Event::AllAsleep;
    bool changed = false;
    if (!sleeps) {
      if (++walk.instructions > kRunaway) throw std::runtime_error("the operation does not end");
      walk.calls += step->system_call;
      if (step->system_call) shadow_->look_for_file();
      changed = shadow_->changed();
      if (changed || step->system_call) ++walk.points;
    }
    if (path == nullptr) {
      surveyor.note(*step, changed, walk.path);
    } else if ((*path)[done].changes != changed) {
      walk.strayed = true;
      return walk;
    }
    if (!sleeps && has_ended()) {
      walk.finished = true;
      break;
    }
    if (!helped && walk.points < points && (sleeps || (step->waits && operation_.when_asleep))) {
      helped = true;
      help_sleeper();
      shadow_->changed();  // by the witness, not by the victim
    }
  }
  if (walk.finished && shadow_->stray() != 0) {
    violation("the operation wrote into memory that nobody owns");
  }
  return walk;
}

Trial::Failure Trial::fail_call(std::uint64_t nth, int error, const Path* path) {
  Failure failure;
  try {
    begin();
    traced_->fail_call(nth, error);
    bool helped = false;
    for (std::size_t done = 0; !has_ended(); ++done) {
      const auto step = next(path, done, helped);
      if (traced_->failed_call() || traced_->spared_call()) break;
      if (!step) {
        failure.strayed = true;
        return failure;
      }
      const bool sleeps = step->event == Tracee::Event::AllAsleep;
      if (!helped && (sleeps || (step->waits && operation_.when_asleep))) {
        helped = true;
        help_sleeper();
      }
    }
    failure.call = traced_->failed_call();
    failure.spared = traced_->spared_call();
    if (!failure.call) return failure;
    if (!helped && witness_) may_come_early_ = untaken();
    traced_.reset();
    if (!helped) help_sleeper();
    const auto reply = victim_->answer();
    if (!reply) throw std::runtime_error("no answer, " + victim_->whereabouts());
    if (reply->reads_items) may_come_early_ |= (std::uint64_t{1} << reply->put) - 1;
    failure.error = reply->complaint;
    note_published();
    if (!operation_.ends) {
      victim_->tell(Actor::Order::Leave);
      must_answer(*victim_, "the victim leaves");
    }
    victim_->kill();
    inspect();
  } catch (const std::exception& e) {
    violation(e.what());
  }
  failure.violations = std::exchange(violations_, {});
  return failure;
}

std::uint64_t Trial::bound_of(Promise promise) {
  return promise == Promise::WaitFree ? kWaitFreeBound : kLockFreeBound;
}

std::vector<Trial::Probed> Trial::probe(const std::vector<Asked>& which) {
  std::vector<Probed> results(all_probes().size());
  if (!witness_ || which.empty()) return results;
  note_published();
  let_go_on();
  for (const auto& [i, stepped] : which) {
    const Probe& p = all_probes()[i];
    witness_->tell(Actor::Order::Ready, i);
    if (!must_answer(*witness_, p.name).probe_ready) continue;
    const bool registry_is_free = p.waits_for_registry && is_registry_free();
    {
      Tracee neighbour(witness_->pid());
      witness_->tell(Actor::Order::Probe, i);
      if (!neighbour.run_first_to(address_of(&lot_kill_begins), kPatienceMs)) {
        throw std::runtime_error(std::string(p.name) + ": does not begin");
      }
      const std::uint64_t before = neighbour.switches();
      if (stepped) {
        results[i] = step(neighbour, p);
      } else if (neighbour.run_first_to(address_of(&lot_kill_ends), kWaitsMs)) {
        // One is its stop.
        if (p.promise == Promise::WaitFree && neighbour.switches() > before + 1) {
          violation(std::string(p.name) + ": sleeps");
        }
      } else {
        results[i] = step(neighbour, p);
        results[i].instructions = 0;  // of all but the beginning
      }
      results[i].ran = true;
    }
    if (results[i].waited && registry_is_free) {
      violation(std::string(p.name) + ": waits, and the registry's lock is free");
    }
    if (results[i].waited) {  // now the one that stood still dies
      note_published();
      traced_->kill();
      victim_->was_killed();
    }
    must_answer(*witness_, p.name);
    if (results[i].waited) break;
  }
  return results;
}

/// While the victim stands still. Others have the lock for a moment only.
bool Trial::is_registry_free() const {
  segment::Segment segment(options_.directory + "/" + options_.segment);
  const auto& word = segment.directory().lock.word;
  return testing::eventually([&word] { return word.load() == 0; }, std::chrono::milliseconds(50));
}

/// Steps a probe to its end, unless it waits.
Trial::Probed Trial::step(Tracee& neighbour, const Probe& probe) {
  const std::string name = probe.name;
  const bool blocking = probe.promise == Promise::Blocking;
  Probed probed;
  unsigned sleeps = 0;
  auto awake = std::chrono::steady_clock::now();
  for (;;) {
    const Tracee::Step step = neighbour.step(kWaitsMs);
    const auto now = std::chrono::steady_clock::now();
    if (step.event == Tracee::Event::Ended) throw std::runtime_error("the neighbour died");
    const bool first = step.event != Tracee::Event::AllAsleep && step.thread == 0;
    const bool sleeps_now = first && step.event == Tracee::Event::Asleep;
    sleeps += sleeps_now;
    if (first && !sleeps_now) awake = now;
    if (step.event == Tracee::Event::AllAsleep || now - awake > kOthersGetOn || sleeps > kAsks) {
      if (!blocking) violation(name + ": waits for a process that stands still");
      probed.waited = true;
      return probed;
    }
    if (sleeps_now && probe.promise == Promise::WaitFree) violation(name + ": sleeps");
    probed.instructions += first;
    if (neighbour.place() == address_of(&lot_kill_ends)) return probed;
    if (probed.instructions > bound_of(probe.promise)) {
      if (!blocking) {
        violation(name + ": more than " + std::to_string(bound_of(probe.promise)) +
                  " instructions beside a process that stands still");
      }
      probed.waited = true;
      return probed;
    }
  }
}

std::vector<std::string> Trial::kill_and_inspect() {
  try {
    note_published();
    traced_->kill();
    victim_->was_killed();
    traced_.reset();
    inspect();
  } catch (const std::exception& e) {
    violation(e.what());
  }
  return std::exchange(violations_, {});
}

void Trial::inspect() {
  if (witness_) {
    let_go_on();
    inspect_with_witness();
  } else {
    inspect_alone();
  }
  if (files() != 0) violation("files are left");
}

std::size_t Trial::files() const { return testing::files_of(options_); }

/// Before the witness goes on, or the victim dies: then rings may be reaped and used again.
void Trial::note_published() {
  if (!witness_) return;
  published_ = std::max(published_, published_on(kTopic));
  may_miss_ = std::max(may_miss_, overwritten_on(kTopic));
  frames_ = std::max(frames_, published_on(kFrames));
  untaken_ = untaken();
}

/// The items of the queue that nobody has taken, of the only one who puts: a bit each.
std::uint64_t Trial::untaken() const {
  segment::Segment segment(options_.directory + "/" + options_.segment);
  std::uint64_t items = 0;
  each_ring(segment, kItems, [&](const segment::Ring& ring) {
    for (std::uint32_t i = 0; i < ring.places(); ++i) {
      const ring::Word w = ring.slots[i].load();
      if (ring::block(w) == ring::kNoBlock) continue;
      items |= std::uint64_t{1} << ring::distance(ring::sequence(w), ring.first);
    }
  });
  return items;
}

/// How many messages the only publisher of a topic got out: the ring itself says so.
std::uint64_t Trial::published_on(const char* topic) const {
  segment::Segment segment(options_.directory + "/" + options_.segment);
  std::uint64_t most = 0;
  each_ring(segment, topic,
            [&](const segment::Ring& ring) { most = std::max(most, published_in(ring)); });
  return most;
}

/// A reader of the topic has got all that was published, but for what was overwritten.
void Trial::look_at_reader(const Actor::Reply& seen, const char* reader) {
  const std::uint64_t read = seen.last[kVictim] + seen.last[kDead];
  if (read != published_) {
    violation("published " + std::to_string(published_) + ", seen by " + reader + " " +
              std::to_string(read));
  }
  if (seen.missed > may_miss_) {
    violation(std::string(reader) + " missed " + std::to_string(seen.missed) + ", and " +
              std::to_string(may_miss_) + " were overwritten");
  }
}

/// How many messages of a topic are in no slot any more. Where they travel in blocks, an eviction
/// may have taken more of them.
std::uint64_t Trial::overwritten_on(const char* topic) const {
  segment::Segment segment(options_.directory + "/" + options_.segment);
  std::uint64_t count = 0;
  each_ring(segment, topic, [&](const segment::Ring& ring) {
    if (!ring.in_slots()) count = kMost / 2;
    const std::uint64_t published = published_in(ring);
    count += published > ring.depth ? published - ring.depth : 0;
  });
  return count;
}

/// It has got all that was published, and leaves.
void Trial::inspect_with_bystander() {
  bystander_->tell(Actor::Order::Inspect);
  const Actor::Reply seen = must_answer(*bystander_, "the bystander");
  if (seen.reads_topic) look_at_reader(seen, "the bystander");
  bystander_->tell(Actor::Order::Leave);
  must_answer(*bystander_, "the bystander leaves");
  bystander_.reset();
}

void Trial::inspect_with_witness() {
  const std::string path = options_.directory + "/" + options_.segment;
  const std::uint64_t before = put_;
  if (rival_) let_rival_go_on();
  if (bystander_) inspect_with_bystander();
  if ((rivals_ & ~untaken_) != 0) violation("the rival got an item that was not in the queue");
  std::uint64_t expected = popped_ | (untaken_ & ~rivals_);
  witness_->tell(Actor::Order::Inspect);
  const Actor::Reply seen = must_answer(*witness_, "the witness");
  for (std::uint64_t i = before; i < seen.put; ++i) expected |= std::uint64_t{1} << i;
  const bool all_came = (expected & ~seen.items) == 0;
  const bool none_else = (seen.items & ~expected & ~may_come_early_) == 0;
  if (seen.reads_items && !(all_came && none_else)) {
    violation("items that nobody had taken, or the witness: " + std::to_string(expected) +
              ", that it got: " + std::to_string(seen.items) + " (a bit each)");
  }
  if (seen.reads_topic) look_at_reader(seen, "the witness");
  if (seen.reads_frames && seen.frames != frames_) {
    violation("published " + std::to_string(frames_) + " frames, seen " +
              std::to_string(seen.frames));
  }
  {
    segment::Segment segment(path);
    const auto books = [&] { return unaccounted(segment, {seen.index}); };
    if (!testing::eventually([&] { return books().empty(); }, std::chrono::seconds(3))) {
      violation(books());
    }
  }
  {
    Actor second(operation_, options_, kSecondLife, kVictimName);
    second.tell(Actor::Order::NewLife);
    const Actor::Reply lives = must_answer(second, "the second life");
    witness_->tell(Actor::Order::Meet);
    must_answer(*witness_, "the witness meets the second life");
    segment::Segment segment(path);
    if (std::strcmp(segment.participants()[lives.index].name, kVictimName) != 0) {
      violation("the second life has another name");
    }
    const auto books = [&] { return unaccounted(segment, {seen.index, lives.index}); };
    if (!testing::eventually([&] { return books().empty(); }, std::chrono::seconds(3))) {
      violation(books());
    }
    second.tell(Actor::Order::Leave);
    must_answer(second, "the second life leaves");
  }
  witness_->tell(Actor::Order::Drop);
  const Actor::Reply dropped = must_answer(*witness_, "the witness lets go");
  {
    segment::Segment segment(path);
    const auto clean = [&] {
      const testing::Audit audit(segment);
      return audit.nothing() && audit.participants == 1;
    };
    if (!testing::eventually(clean, std::chrono::seconds(5))) {
      violation("left: " + testing::Audit(segment).text());
    }
    if (const auto books = unaccounted(segment, {dropped.index}); !books.empty()) violation(books);
  }
  witness_->tell(Actor::Order::Leave);
  must_answer(*witness_, "the witness leaves");
}

void Trial::inspect_alone() {
  Actor next(operation_, options_, kSecondLife, kVictimName);
  next.tell(Actor::Order::Start);
  const Actor::Reply started = must_answer(next, "the next one");
  {
    segment::Segment segment(options_.directory + "/" + options_.segment);
    // Its warden reaps those whose index it did not need.
    const auto books = [&] { return unaccounted(segment, {started.index}); };
    if (!testing::eventually([&] { return books().empty(); }, std::chrono::seconds(3))) {
      violation(books());
    }
  }
  next.tell(Actor::Order::Leave);
  must_answer(next, "the next one leaves");
}

}  // namespace lot::kill
