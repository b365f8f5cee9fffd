// SPDX-License-Identifier: Apache-2.0
#include "supervisor.hpp"

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <sys/wait.h>
#include <system_error>
#include <unistd.h>

#include "node.hpp"
#include "stuck.hpp"
#include "support/processes.hpp"
#include "unfinished.hpp"

namespace lot::chaos {

using namespace std::chrono_literals;

namespace {

using Clock = std::chrono::steady_clock;

constexpr auto kLongestPause = 100ms;

const char* name_of(EpochPlan::End end) {
  switch (end) {
    case EpochPlan::End::KillAll:
      return "all killed";
    case EpochPlan::End::LeaveAll:
      return "all leave";
    case EpochPlan::End::Mixed:
      return "some of each";
    case EpochPlan::End::Witnessed:
      return "some of each, watched";
    default:
      return "killed, go on";
  }
}

}  // namespace

Supervisor::Supervisor(const Settings& settings, Board& board, Namespaces& namespaces)
    : settings_(settings),
      board_(board),
      namespaces_(namespaces),
      canary_(board),
      hands_(board),
      slots_(settings.processes) {
  epoch_.engine.segment = testing::unique_name();
  epoch_.engine.topics = 32;
  epoch_.engine.channels = 256;
  epoch_.engine.readers = 128;
  sigemptyset(&signals_);
  for (const int s : {SIGCHLD, SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction now {};
    sigaction(s, nullptr, &now);
    if (s == SIGCHLD || now.sa_handler != SIG_IGN) sigaddset(&signals_, s);  // nohup
  }
  sigprocmask(SIG_BLOCK, &signals_, nullptr);
}

Supervisor::~Supervisor() {
  slots_.push_back(last_);
  for (const Slot& s : slots_) {
    send(s, SIGKILL);
    if (s.pid > 0) waitpid(s.pid, nullptr, 0);
  }
  remove_files();
}

std::string Supervisor::path() const {
  return epoch_.engine.directory + "/" + epoch_.engine.segment;
}

void Supervisor::run() {
  std::printf("epoch  memory   kills  lives  received    missed  s      end\n");
  for (std::uint64_t e = 0; tally_.kills < settings_.kills && !over(); ++e) {
    if (settings_.at_most.count() != 0 && Clock::now() - tally_.begun > settings_.at_most) break;
    run_epoch(e);
  }
  // The end of the last epoch may have been to go on.
  if (!over() && testing::files_of(epoch_.engine) != 0) end_with_last();
  print_reports();
}

void Supervisor::run_epoch(std::uint64_t number) {
  plan_ = epoch_plan(settings_, number);
  epoch_.roomy = plan_.roomy;
  epoch_.rests = plan_.calms != 0;
  epoch_.engine.size_bytes = plan_.size_bytes;
  epoch_.engine.blocks = plan_.blocks;
  epoch_.engine.processes = plan_.processes;
  if (testing::files_of(epoch_.engine) == 0) {
    board_.forget_publishers();
    hands_.forget();
  }
  const auto begin = Clock::now();
  const std::uint32_t kills = tally_.kills;
  const std::uint32_t lives = tally_.lives;
  const std::uint64_t received = board_.total(Count::Received);
  const std::uint64_t missed = board_.total(Count::Missed);
  ++tally_.epochs;
  restart_ = true;
  for (unsigned n = 0; n < std::max(1U, plan_.calms) && !over(); ++n) {
    storm(plan_.kills / std::max(1U, plan_.calms));
    if (plan_.calms != 0 && !over()) calm();
  }
  if (!over()) finish(plan_.end);
  board_.stage.store(static_cast<std::uint32_t>(Stage::Run), std::memory_order_release);
  std::printf("%5llu  %-6s %7u %6u %9llu %9llu  %5.1f  %s\n",
              static_cast<unsigned long long>(number), plan_.roomy ? "roomy" : "small",
              tally_.kills - kills, tally_.lives - lives,
              static_cast<unsigned long long>(board_.total(Count::Received) - received),
              static_cast<unsigned long long>(board_.total(Count::Missed) - missed),
              seconds(Clock::now() - begin), name_of(plan_.end));
  std::fflush(stdout);
}

/// Fates happen, until so many more were killed.
void Supervisor::storm(unsigned kills) {
  const std::uint32_t target = std::min(tally_.kills + kills, settings_.kills);
  while (tally_.kills < target && !over()) {
    if (settings_.at_most.count() != 0 && Clock::now() - tally_.begun > settings_.at_most) break;
    Time due = Clock::now() + kLongestPause;
    for (unsigned slot = 0; slot < slots_.size(); ++slot) {
      if (slots_[slot].pid == -1) start(slot);
      const auto now = Clock::now();
      if (slots_[slot].next != Next::Nothing && slots_[slot].next_at <= now) act(slot, now);
      if (slots_[slot].next != Next::Nothing) due = std::min(due, slots_[slot].next_at);
    }
    pump(due);
  }
}

/// Everybody lives, nobody publishes, all is read: what is in the segment must be explained.
void Supervisor::calm() {
  still();
  for (const Stage stage : {Stage::Awake, Stage::Quiet, Stage::Settle}) reach(stage);
  if (!over()) {
    segment::Segment segment(path());
    std::string rest;
    const bool clean = pump_until([&] {
      rest = unexplained(segment, living());
      return rest.empty();
    });
    if (!clean && !interrupted_) board_.report(Finding::Leaked, kMostNodes, "at rest: " + rest);
    check_taken(living());
    write_off(living());
    check_finished(living(), segment_file(path()));
    ++tally_.audits;
  }
  board_.stage.store(static_cast<std::uint32_t>(Stage::Run), std::memory_order_release);
  const auto now = Clock::now();
  for (unsigned slot = 0; slot < slots_.size(); ++slot) {
    Slot& s = slots_[slot];
    s.fate.stopped = false;
    schedule_end(s, now);
  }
}

/// No fates: everybody lives, and nobody is stopped or about to leave.
void Supervisor::still() {
  for (Slot& s : slots_) {
    resume(s);
    s.next = Next::Nothing;
  }
  pump_until([this] {
    return std::none_of(slots_.begin(), slots_.end(), [](const Slot& s) { return s.leaving; });
  });
  for (Slot& s : slots_) s.next = Next::Nothing;
}

/// Takes all nodes to a stage of a checkpoint.
void Supervisor::reach(Stage stage) {
  board_.checkpoint.fetch_add(1);
  board_.stage.store(static_cast<std::uint32_t>(stage), std::memory_order_release);
  if (pump_until([&] { return all_reached(stage); }) || over()) return;
  for (unsigned slot = 0; slot < slots_.size(); ++slot) {
    if (board_.nodes[slot].reached.load() != step_of(board_.checkpoint.load(), stage)) {
      stuck(slot, "does not come to rest");
    }
  }
}

void Supervisor::finish(EpochPlan::End end) {
  Random random = Random::of(settings_.seed, tally_.epochs, 4);
  const bool mixed = end == EpochPlan::End::Mixed || end == EpochPlan::End::Witnessed;
  if (mixed || end == EpochPlan::End::LeaveAll) {
    still();
    reach(Stage::Awake);  // who sleeps cannot leave
  }
  restart_ = false;
  if (end == EpochPlan::End::Witnessed) start_last(false);
  for (unsigned slot = 0; slot < slots_.size(); ++slot) {
    if (slots_[slot].pid == -1) continue;
    const bool leaves = end == EpochPlan::End::LeaveAll || (mixed && random.chance(50));
    if (leaves) {
      resume(slots_[slot]);
      leave(slot);
    } else {
      kill(slot);
    }
    if (mixed) pump(Clock::now() + random.between(0ms, 3ms));
  }
  if (!pump_until([this] { return !any_alive(); }) && !over()) {
    for (unsigned slot = 0; slot < slots_.size(); ++slot) {
      if (slots_[slot].pid > 0) stuck(slot, "does not leave");
    }
  }
  if (over()) return;
  check_taken({});
  // Who goes on takes what is left, and sees what was taken before it.
  if (end != EpochPlan::End::KillAndGoOn) write_off({});
  if (end == EpochPlan::End::LeaveAll) {
    check_files("all had left");
  } else if (end != EpochPlan::End::KillAndGoOn) {
    end_with_last();
  }
}

/// One more comes: when all others have ended, or before.
void Supervisor::start_last(bool alone) {
  board_.last_came.store(0);
  board_.last_alone.store(alone ? 1 : 0);
  last_.pid = namespaces_.fork();
  if (last_.pid == 0) {
    sigprocmask(SIG_UNBLOCK, &signals_, nullptr);
    _exit(run_last(board_, settings_, epoch_));
  }
  if (!alone) pump_until([this] { return board_.last_came.load() != 0 || last_.pid == -1; });
}

/// It repairs, finds nothing besides itself, and removes the files.
void Supervisor::end_with_last() {
  const std::uint64_t segment = segment_file(path());
  if (last_.pid == -1) start_last(true);
  board_.last_alone.store(1);
  const auto has_ended = [this] { return last_.pid == -1; };
  // It has its own patience first.
  if (!pump_until(has_ended) && !pump_until(has_ended) && !over()) {
    board_.report(Finding::Wedged, kMostNodes, "the last one:\n" + where_is(last_.pid));
    return;
  }
  if (last_.pid == -1 && last_status_ != 0 && !interrupted_) {
    board_.report(Finding::Crashed, kMostNodes,
                  "the last one ended with status " + std::to_string(last_status_));
  }
  Living last;
  last.pullers.fill(1);
  check_finished(last, segment);
  ++tally_.audits;
  check_files("the last one had left");
}

void Supervisor::check_files(const char* when) {
  const std::size_t n = testing::files_of(epoch_.engine);
  if (n == 0) return;
  std::string names;
  for (const auto& entry : std::filesystem::directory_iterator(epoch_.engine.directory)) {
    const std::string name = entry.path().filename();
    if (name.rfind(epoch_.engine.segment, 0) == 0) names += " " + name;
  }
  board_.report(Finding::Files, kMostNodes, std::string("when ") + when + ":" + names);
  save_segment();
  remove_files();
}

/// Every item that was put for one is taken by somebody.
void Supervisor::check_taken(const Living& living) {
  if (over()) return;
  std::string lost;
  const auto none = [&] {
    lost = hands_.unexplained(living);
    return lost.empty();
  };
  if (!pump_until(none) && !interrupted_ && !lost.empty()) {
    board_.report(Finding::Lost, kMostNodes, lost);
  }
}

/// What is missing has gone with the takers that were killed so far: they explain nothing else.
/// REQUIRES: nobody will see later that more was taken before.
void Supervisor::write_off(const Living& living) {
  if (over()) return;
  tally_.gone_with_takers += hands_.write_off(living);
  tally_.killed_over_a_take = hands_.seen();
}

/// Every task that was put is finished.
void Supervisor::check_finished(const Living& living, std::uint64_t segment) {
  if (over()) return;
  std::string left;
  const auto none = [&] {
    left = unfinished(board_, hands_, living, segment);
    return left.empty();
  };
  if (!pump_until(none) && !interrupted_ && !left.empty()) {
    board_.report(Finding::Lost, kMostNodes, left);
  }
}

bool Supervisor::all_reached(Stage stage) const {
  const std::uint32_t step = step_of(board_.checkpoint.load(), stage);
  return std::all_of(board_.nodes.begin(), board_.nodes.begin() + slots_.size(),
                     [step](const NodeRecord& n) { return n.reached.load() == step; });
}

bool Supervisor::any_alive() const {
  return std::any_of(slots_.begin(), slots_.end(), [](const Slot& s) { return s.pid != -1; });
}

Living Supervisor::living() const {
  Living living;
  living.participants = static_cast<std::uint32_t>(slots_.size());
  for (unsigned slot = 0; slot < slots_.size(); ++slot) {
    for (unsigned t = 0; t < kTopics; ++t) {
      const std::uint32_t pushers = board_.nodes[slot].pushers[t].load();
      living.pushers[t] += pushers;
      living.pushers_of[slot] += pushers;
      const std::uint32_t pullers = board_.nodes[slot].pullers[t].load();
      const std::uint32_t observers = board_.nodes[slot].observers[t].load();
      living.pullers[t] += pullers;
      living.observers[t] += observers;
      living.pullers_of[slot] += pullers + observers;
    }
  }
  return living;
}

bool Supervisor::over() {
  if (board_.reports_begun.load() != printed_) {
    save_segment();
    print_reports();
  }
  return interrupted_ || (board_.findings() != 0 && !settings_.carry_on);
}

void Supervisor::print_reports() {
  const std::uint32_t n = std::min(board_.reports_begun.load(), Board::kReports);
  for (; printed_ < n; ++printed_) {
    const Report& r = board_.reports[printed_];
    // Its writer may be at it, or was killed over it.
    if (!testing::eventually([&r] { return r.written.load() != 0; }, 100ms)) continue;
    std::printf(
        "%s: %s%s\n", kFindingNames[static_cast<std::size_t>(r.finding)],
        r.slot < kMostNodes
            ? ("chaos" + std::to_string(r.slot) + " life " + std::to_string(r.life) + ": ").c_str()
            : "",
        r.text.data());
  }
  std::fflush(stdout);
}

/// Everybody stands still meanwhile.
void Supervisor::save_segment() {
  if (settings_.save_segment.empty()) return;
  for (const Slot& s : slots_) send(s, SIGSTOP);
  std::error_code absent;
  std::filesystem::copy_file(path(), settings_.save_segment,
                             std::filesystem::copy_options::overwrite_existing, absent);
  for (const Slot& s : slots_) send(s, SIGCONT);
}

void Supervisor::remove_files() const {
  std::error_code gone;
  for (const auto& entry : std::filesystem::directory_iterator(epoch_.engine.directory, gone)) {
    const std::string name = entry.path().filename();
    if (name == epoch_.engine.segment || name.rfind(epoch_.engine.segment + ".", 0) == 0) {
      std::filesystem::remove(entry.path(), gone);
    }
  }
}

}  // namespace lot::chaos
