// SPDX-License-Identifier: Apache-2.0
#include "conductor.hpp"

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <sys/syscall.h>
#include <sys/wait.h>

#include "kill/accounting.hpp"
#include "segment/segment.hpp"
#include "support/processes.hpp"
#include "tells.hpp"

namespace lot::replay {
namespace {

using chaos::Random;

constexpr std::uint64_t kStepNs = 20, kCallNs = 1000;  ///< of the virtual clock
constexpr std::uint64_t kMs = 1'000'000, kSecond = 1000 * kMs;
/// Reaping may take that long: until then a sleeper may wait for what a dead process had.
constexpr std::uint64_t kReaped = 5 * kSecond;
/// What all have let go may stay that long in the segment.
constexpr std::uint64_t kCleaned = 20 * kSecond;
constexpr std::uint64_t kMostSteps = 40'000'000;
const char* const kSegment = "/dev/shm/replay";

std::string hex(std::uint64_t n) {
  char text[20];
  std::snprintf(text, sizeof(text), "0x%llx", static_cast<unsigned long long>(n));
  return text;
}

}  // namespace

Plan Plan::of(std::uint64_t seed) {
  Random random = Random::of(seed, 1);
  Plan plan{};
  plan.seed = seed;
  plan.workers = 2 + random.pick(2);
  plan.operations = 60;
  plan.kills = random.pick(4);
  return plan;
}

Plan Plan::of_letters(std::uint64_t seed) {
  Plan plan = of(seed);
  plan.workers = 2;
  plan.kills = 0;
  plan.only_letters = true;
  return plan;
}

Conductor::Conductor(const Plan& plan, const std::string& program, Record& record)
    : plan_(plan),
      program_(program),
      record_(record),
      random_(Random::of(plan.seed, 2)),
      calls_(plan.seed),
      lives_(plan.workers, 0) {}

Conductor::~Conductor() = default;

void Conductor::run() {
  for (unsigned w = 0; w < plan_.workers; ++w) start(w);
  while (books_.text().empty() && turn()) {
    if (record_.steps > kMostSteps) books_.wrong("the run does not end");
  }
  if (books_.text().empty()) {
    for (const auto& file : std::filesystem::directory_iterator("/dev/shm")) {
      books_.wrong("the last worker has left " + file.path().string());
    }
  }
  record_.operations = books_.operations();
  record_.messages = books_.messages();
  record_.virtual_ns = calls_.now();
  record_.finish(books_.text().empty() ? Record::End::Passed : Record::End::Violation,
                 books_.text());
}

void Conductor::start(unsigned worker) {
  const unsigned life = lives_[worker]++;
  std::vector<std::string> arguments{"lot_replay",
                                     "--worker",
                                     std::to_string(worker),
                                     "--life",
                                     std::to_string(life),
                                     "--seed",
                                     std::to_string(plan_.seed),
                                     "--operations",
                                     std::to_string(plan_.operations)};
  if (plan_.only_letters) arguments.push_back("--letters");
  const pid_t pid = start_program(program_, arguments, plan_.seed);
  processes_.push_back(std::make_unique<Process>(pid, worker, life));
  adopt(pid, *processes_.back());
}

void Conductor::adopt(pid_t id, Process& process) {
  owned_.push_back(std::make_unique<Thread>(Thread{id, came_++, &process}));
  threads_.push_back(owned_.back().get());
}

/// The fingerprint is of each step: which thread, where it stands, what a call returned.
void Conductor::note(std::uint64_t a, std::uint64_t b) {
  record_.fingerprint = Random::mix(record_.fingerprint ^ Random::mix(a + 0x9e37 * b));
}

void Conductor::note_turn(const Thread& thread) {
  if (record_.count == Record::kMostTurns) return;
  record_.turns[record_.count++] = {record_.steps, record_.fingerprint, place(thread.id),
                                    thread.number, last_call_};
}

bool Conductor::turn() {
  calls_.sleepers().wake_late(threads_, calls_.now());
  Thread* const thread = choose();
  if (thread == nullptr) return let_stage_begin() || leap();
  last_call_ = 0;
  last_ = thread;
  run_thread(*thread);
  if (std::find(threads_.begin(), threads_.end(), thread) != threads_.end()) note_turn(*thread);
  maybe_kill();
  return !threads_.empty();
}

/// A thread goes on for a few turns, often; now and then one thread is slow: it stands still for
/// many turns, wherever it is.
Thread* Conductor::choose() {
  std::vector<Thread*> ready;
  for (Thread* t : threads_) {
    if (!t->sleeps) ready.push_back(t);
  }
  if (ready.empty()) return nullptr;
  if (slow_turns_ == 0 && random_.chance(4)) {
    slow_ = ready[below(ready.size())];
    slow_turns_ = 20 + below(200);
  }
  if (slow_turns_ > 0) {
    --slow_turns_;
    if (ready.size() > 1) ready.erase(std::remove(ready.begin(), ready.end(), slow_), ready.end());
  }
  const bool goes_on = std::find(ready.begin(), ready.end(), last_) != ready.end();
  if (goes_on && random_.chance(25)) return last_;
  return ready[below(ready.size())];
}

/// For how long: a few instructions, some hundred, or up to a system call. A worker that only just
/// starts is not stepped.
void Conductor::run_thread(Thread& thread) {
  const unsigned dice = thread.process->is_at_work ? below(100) : 99;
  unsigned steps = 0;
  if (dice < 55) {
    steps = 1 + below(dice < 40 ? 24 : 300);
  }
  unsigned calls = 1 + below(dice < 80 ? 2 : 12);
  const bool is_stepped = steps != 0;
  while (is_stepped ? steps-- != 0 : calls-- != 0) {
    const Stop stop = is_stepped ? step(thread.id) : run_to_call(thread.id);
    if (stop.why == Stop::Why::Ended) return books_.wrong("a worker was ended from outside");
    if (stop.why == Stop::Why::Signal) {
      return books_.wrong("signal " + std::to_string(stop.signal) + " for a worker, at " +
                          hex(place(thread.id)));
    }
    ++record_.steps;
    calls_.pass(kStepNs);
    note(thread.number, place(thread.id));
    if (stop.why == Stop::Why::Call && !call(thread)) return;
  }
}

bool Conductor::call(Thread& thread) {
  const user_regs_struct registers = replay::registers(thread.id);
  last_call_ = static_cast<unsigned>(registers.orig_rax) + 1;
  ++record_.calls;
  calls_.pass(kCallNs);
  const Verdict verdict = calls_.handle(thread, registers, threads_);
  switch (verdict.what) {
    case Verdict::What::Answered:
      answer(thread.id, verdict.result);
      note(registers.orig_rax, static_cast<std::uint64_t>(verdict.result));
      return registers.orig_rax != SYS_sched_yield;
    case Verdict::What::Sleeps:
      look_at_sleeper(thread);
      return false;
    case Verdict::What::Kernel:
      return go_to_kernel(thread, registers);
    case Verdict::What::Ends:
      end_thread(thread);
      return false;
    case Verdict::What::EndsAll:
      end_process(*thread.process, &thread);
      return false;
    case Verdict::What::Tells:
      return hear(thread, registers);
    case Verdict::What::Unknown:
      throw std::runtime_error("a worker does system call " + std::to_string(registers.orig_rax) +
                               ", of which the conductor knows nothing");
  }
  return false;
}

/// A worker's first thread does its operations. Called when it falls asleep, and when a reader has
/// made room.
void Conductor::look_at_sleeper(const Thread& thread) {
  const bool is_first = thread.id == thread.process->pid;
  if (is_first && thread.sleeps && is_settled() && thread.words.size() == 1 &&
      thread.words.front().is_shared()) {
    books_.sleeps(thread.process->worker);
  }
}

/// No death has happened lately: until it is reaped, a worker may wait for what a dead one had.
bool Conductor::is_settled() const { return !last_death_ || calls_.now() - *last_death_ > kReaped; }

bool Conductor::go_to_kernel(Thread& thread, const user_regs_struct& registers) {
  const auto number = static_cast<long>(registers.orig_rax);
  Process& process = *thread.process;
  pid_t child = 0;
  const Stop stop = do_call(thread.id, registers, child);
  if (child != 0) {
    adopt(child, process);
    // struct clone_args: flags, pidfd, child_tid. The kernel clears that word at the thread's end.
    threads_.back()->at_end = number == SYS_clone
                                  ? registers.r10
                                  : read_word<std::uint64_t>(thread.id, registers.rdi + 16);
  }
  if (number == SYS_mmap || number == SYS_munmap || number == SYS_mremap) {
    process.forget_mappings();
  }
  if (stop.why != Stop::Why::Stepped) {
    books_.wrong("a worker ended in system call " + std::to_string(number));
    return false;
  }
  const long result =
      correct(thread, registers, static_cast<long>(replay::registers(thread.id).rax));
  note(registers.orig_rax, static_cast<std::uint64_t>(result));
  return true;
}

/// Sees to what the kernel has put into a worker's memory. Returns the result of the call.
long Conductor::correct(const Thread& thread, const user_regs_struct& call, long result) {
  const pid_t process = thread.process->pid;
  const auto fd = static_cast<int>(call.rdi);
  if (call.orig_rax == SYS_openat && result >= 0) {
    proc_files_.opened(process, static_cast<int>(result), read_text(thread.id, call.rsi, 200));
  } else if (call.orig_rax == SYS_close) {
    proc_files_.closed(process, fd);
  } else if (call.orig_rax == SYS_read && result > 0 && proc_files_.has(process, fd)) {
    std::string text(static_cast<std::size_t>(result), '\0');
    read_memory(thread.id, call.rsi, text.data(), text.size());
    text = proc_files_.instead(process, fd, text);
    write_memory(thread.id, call.rsi, text.data(), text.size());
    result = static_cast<long>(text.size());
    answer(thread.id, result);
  }
  return result;
}

bool Conductor::hear(Thread& thread, const user_regs_struct& r) {
  const auto what = static_cast<Tell>(r.rdi);
  thread.process->is_at_work = true;
  if (what == Tell::Wrong) {
    books_.wrong("worker " + std::to_string(thread.process->worker) + ": " +
                 read_text(thread.id, r.rsi, r.rdx));
    return false;
  }
  if (what == Tell::Stage) {
    come_to_stage(thread, static_cast<Stage>(r.rsi));
    return false;
  }
  answer(thread.id, books_.hear(thread.process->worker, what, {r.rsi, r.rdx, r.r10, r.r8, r.r9}));
  if (what == Tell::Got) {
    for (const Thread* t : threads_) look_at_sleeper(*t);
  }
  return true;
}

void Conductor::come_to_stage(Thread& thread, Stage stage) {
  calls_.sleepers().sleep(thread, {}, std::nullopt);
  at_stage_.push_back(&thread);
  if (stage == Stage::Leave && leave_by_ == 0) leave_by_ = calls_.now() + kCleaned;
}

/// When all workers wait for a stage, it begins. False: not yet.
bool Conductor::let_stage_begin() {
  if (at_stage_.size() != plan_.workers) return false;
  const Stage next = static_cast<Stage>(static_cast<unsigned>(stage_) + 1);
  if (next == Stage::Let_go) books_.drained();
  if (next == Stage::Leave && !is_clean()) return false;
  segment_.reset();
  stage_ = next;
  for (Thread* t : at_stage_) {
    t->sleeps = false;
    answer(t->id, 0);
  }
  at_stage_.clear();
  return true;
}

/// True when the segment holds nothing; it takes wardens a moment.
bool Conductor::is_clean() {
  if (!segment_) segment_ = std::make_unique<segment::Segment>(kSegment);
  const testing::Audit audit(*segment_);
  std::vector<std::uint32_t> living;
  const auto entries = segment_->participants();
  for (std::uint32_t k = 1; k < entries.size(); ++k) {
    if (entries[k].state.load() != 0) living.push_back(k);
  }
  if (audit.nothing() && living.size() == plan_.workers) {
    const std::string left = kill::unaccounted(*segment_, living);
    if (left.empty()) return true;
  }
  if (calls_.now() > leave_by_) {
    books_.wrong("in the end the segment holds " + audit.text() + "; " +
                 kill::unaccounted(*segment_, living));
  }
  return false;
}

/// Nothing runs: the clock goes on to the next time at which something does.
bool Conductor::leap() {
  const auto next = Sleepers::next(threads_);
  if (threads_.empty()) return false;
  if (!next) {
    books_.wrong("all sleep for ever");
    return false;
  }
  const bool naps = std::any_of(threads_.begin(), threads_.end(),
                                [](const Thread* t) { return t->sleeps && t->naps; });
  if (!naps && is_settled() && stage_ == Stage::Work) books_.all_asleep();
  if (*next > calls_.now()) calls_.pass(*next - calls_.now());
  note(0, *next);
  return true;
}

void Conductor::maybe_kill() {
  if (stage_ != Stage::Work || record_.kills >= plan_.kills || threads_.empty()) return;
  if (below(4000) != 0) return;
  Process& process = *threads_[below(threads_.size())]->process;
  const unsigned worker = process.worker;
  ++record_.kills;
  note(worker, record_.kills);
  end_process(process, nullptr);
  start(worker);
}

void Conductor::end_thread(Thread& thread) {
  const Place word = thread.process->place_of(thread.at_end);
  const auto marked = words_of_the_dead(thread);
  run_to_end(thread.id);
  int status = 0;
  waitpid(thread.id, &status, __WALL);
  forget(thread);
  if (thread.at_end != 0) calls_.sleepers().wake(threads_, word, 1);
  for (const Place& place : marked) calls_.sleepers().wake(threads_, place, 1);
}

/// By the call before which `caller` stands, or by SIGKILL.
void Conductor::end_process(Process& process, const Thread* caller) {
  std::vector<Thread*> its;
  std::vector<Place> marked;
  for (Thread* t : threads_) {
    if (t->process != &process) continue;
    its.push_back(t);
    for (const Place& place : words_of_the_dead(*t)) marked.push_back(place);
  }
  if (caller != nullptr) {
    run_to_end(caller->id);
  } else {
    ::kill(process.pid, SIGKILL);
  }
  for (auto t = its.rbegin(); t != its.rend();
       ++t) {  // the first thread's end is the last to be told
    int status = 0;
    while (waitpid((*t)->id, &status, __WALL) == (*t)->id && WIFSTOPPED(status)) {
    }
    forget(**t);
  }
  if (caller == nullptr) {
    books_.died(process.worker);
    last_death_ = calls_.now();
  } else if (stage_ != Stage::Leave) {
    books_.wrong("worker " + std::to_string(process.worker) + " has ended by itself");
  }
  for (const Place& place : marked) calls_.sleepers().wake(threads_, place, 1);
}

void Conductor::forget(const Thread& thread) {
  threads_.erase(std::remove(threads_.begin(), threads_.end(), &thread), threads_.end());
  at_stage_.erase(std::remove(at_stage_.begin(), at_stage_.end(), &thread), at_stage_.end());
  if (last_ == &thread) last_ = nullptr;
  if (slow_ == &thread) slow_ = nullptr;
}

}  // namespace lot::replay
