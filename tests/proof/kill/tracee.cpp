// SPDX-License-Identifier: Apache-2.0
#include "tracee.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <linux/futex.h>
#include <sched.h>
#include <stdexcept>
#include <sys/syscall.h>
#include <sys/user.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <utility>

#include "support/ptrace.hpp"

namespace lot::kill {
namespace {

constexpr long kOptions = PTRACE_O_TRACECLONE | PTRACE_O_EXITKILL;
/// A system call that takes longer may be asleep. By the clock: on a core that others want, too,
/// each yield may take milliseconds.
constexpr std::chrono::microseconds kYields{100};
constexpr long kFutexWaitv = 449;
/// Who has not come to its next station by then has gone another way.
constexpr std::chrono::milliseconds kStrays{5000};

using testing::trace;

bool is_clone_event(int status) { return testing::is_event(status, PTRACE_EVENT_CLONE); }
bool is_stop_event(int status) { return status >> 16 == PTRACE_EVENT_STOP; }

}  // namespace

Tracee::Tracee(pid_t pid) : pid_(pid) {
  const std::string tasks = "/proc/" + std::to_string(pid) + "/task";
  std::vector<pid_t> ids{pid};
  for (const auto& entry : std::filesystem::directory_iterator(tasks)) {
    const pid_t id = std::stoi(entry.path().filename());
    if (id != pid) ids.push_back(id);
  }
  try {
    for (const pid_t id : ids) {
      if (trace(PTRACE_SEIZE, id, 0, kOptions) == -1 || trace(PTRACE_INTERRUPT, id) == -1) {
        // A thread that has ended since we listed it is not there to be stepped.
        if (errno == ESRCH && id != pid) {
          waitpid(id, nullptr, __WALL | WNOHANG);
          continue;
        }
        throw std::runtime_error(std::string("ptrace: ") + std::strerror(errno));
      }
      adopt(id, id != pid);
    }
  } catch (...) {
    detach();  // a thread that stays traced only we can wait for
    throw;
  }
}

Tracee::~Tracee() {
  if (!dead_) detach();
}

void Tracee::adopt(pid_t thread, bool may_have_ended) {
  int status = 0;
  if (waitpid(thread, &status, __WALL) != thread || !WIFSTOPPED(status)) {
    if (may_have_ended && (WIFEXITED(status) || WIFSIGNALED(status))) return;
    throw std::runtime_error("a traced thread did not stop");
  }
  threads_.push_back({thread, came_++, true});
}

std::uint64_t Tracee::place_of(const Thread& thread) {
  return static_cast<std::uint64_t>(
      trace(PTRACE_PEEKUSER, thread.id, offsetof(user_regs_struct, rip)));
}

bool Tracee::is_system_call(const Thread& thread, std::uint64_t place) {
  errno = 0;
  const long word = trace(PTRACE_PEEKTEXT, thread.id, place);
  return errno == 0 && (word & 0xffff) == 0x050f;  // syscall
}

bool Tracee::fail_if_due(const Thread& thread) {
  if (error_ == 0 || failed_call_ || spared_call_ || calls_left_-- != 0) return false;
  user_regs_struct registers{};
  trace(PTRACE_GETREGS, thread.id, 0, reinterpret_cast<std::uintptr_t>(&registers));
  const auto number = static_cast<long>(registers.rax);
  const bool futex = number == SYS_futex || number == kFutexWaitv;
  if (number == SYS_exit || number == SYS_exit_group || number == SYS_rt_sigreturn ||
      number == SYS_rseq || (futex && error_ != EINTR) ||
      (number == SYS_futex && (static_cast<long>(registers.rsi) & FUTEX_CMD_MASK) == FUTEX_WAKE)) {
    spared_call_ = true;
    return false;
  }
  failed_call_ = number;
  registers.rip += 2;  // over the instruction
  registers.rax = static_cast<unsigned long long>(-static_cast<long long>(error_));
  registers.rcx = registers.rip;  // what the instruction would have overwritten
  registers.r11 = registers.eflags;
  trace(PTRACE_SETREGS, thread.id, 0, reinterpret_cast<std::uintptr_t>(&registers));
  return true;
}

char Tracee::state_of(pid_t thread) const {
  const std::string name =
      "/proc/" + std::to_string(pid_) + "/task/" + std::to_string(thread) + "/stat";
  std::FILE* file = std::fopen(name.c_str(), "r");
  if (file == nullptr) return '\0';
  char text[512] = {};
  const std::size_t n = std::fread(text, 1, sizeof(text) - 1, file);
  std::fclose(file);
  text[n] = '\0';
  const char* end = std::strrchr(text, ')');
  return end != nullptr && end[1] == ' ' ? end[2] : '\0';
}

void Tracee::poll_others(pid_t thread) {
  for (std::size_t i = threads_.size(); i-- > 0;) {
    if (threads_[i].id != thread) poll(i);
  }
}

bool Tracee::note(std::size_t index, int status) {
  Thread& thread = threads_[index];
  if (!WIFSTOPPED(status)) {
    if (thread.id == pid_) dead_ = true;
    threads_.erase(threads_.begin() + static_cast<std::ptrdiff_t>(index));
    return false;
  }
  thread.stopped = true;
  if (is_clone_event(status)) {
    thread.in_clone = true;
    unsigned long id = 0;
    trace(PTRACE_GETEVENTMSG, thread.id, 0, reinterpret_cast<std::uintptr_t>(&id));
    adopt(static_cast<pid_t>(id), false);
  } else if (!is_stop_event(status) && WSTOPSIG(status) != SIGTRAP) {
    thread.signal = WSTOPSIG(status);
  }
  return true;
}

std::size_t Tracee::index_of(pid_t thread) const {
  std::size_t i = 0;
  while (threads_[i].id != thread) ++i;
  return i;
}

/// Has the thread come back from its system call?
bool Tracee::poll(std::size_t index) {
  int status = 0;
  return waitpid(threads_[index].id, &status, __WALL | WNOHANG) == threads_[index].id &&
         note(index, status) && threads_[index].stopped;
}

Tracee::Step Tracee::step(unsigned patience_ms, std::optional<unsigned> number) {
  const auto until = std::chrono::steady_clock::now() + std::chrono::milliseconds(patience_ms);
  std::size_t turn = threads_.size();
  for (;;) {
    for (std::size_t i = 0; i < threads_.size() && turn == threads_.size(); ++i) {
      if (number && threads_[i].number != *number) continue;
      if (threads_[i].stopped || poll(i)) turn = i;
      if (dead_) return {Event::Ended};
    }
    if (turn < threads_.size()) break;
    turn = threads_.size();
    if (std::chrono::steady_clock::now() >= until) return {Event::AllAsleep};
    std::this_thread::sleep_for(std::chrono::microseconds(50));
  }

  Thread& thread = threads_[turn];
  const pid_t id = thread.id;
  Step done{Event::Stepped};
  done.place = place_of(thread);
  done.thread = thread.number;
  done.system_call = is_system_call(thread, done.place);
  done.resumed = std::exchange(thread.may_resume_call, false);
  thread.in_clone = false;
  const long call =
      done.system_call ? trace(PTRACE_PEEKUSER, id, offsetof(user_regs_struct, rax)) : -1;
  done.waits = call == SYS_futex || call == kFutexWaitv || call == SYS_clock_nanosleep;
  if (done.system_call && fail_if_due(thread)) return done;
  // A signal may end the process.
  const bool may_sleep = done.resumed || done.system_call || thread.signal != 0;
  thread.stopped = false;
  trace(PTRACE_SINGLESTEP, id, 0, static_cast<std::uintptr_t>(std::exchange(thread.signal, 0)));
  const auto yields_until = std::chrono::steady_clock::now() + kYields;
  unsigned sleeps = 0;
  for (;;) {
    int status = 0;
    if (waitpid(id, &status, __WALL | (may_sleep ? WNOHANG : 0)) == id) {
      note(index_of(id), status);
      if (dead_) done.event = Event::Ended;
      return done;
    }
    if (std::chrono::steady_clock::now() < yields_until) {
      sched_yield();
    } else {
      const char state = state_of(id);
      // The end of the first thread is reported when the others have been waited for.
      if (state == 'Z') poll_others(id);
      sleeps = state == 'S' ? sleeps + 1 : 0;
      if (sleeps == 3) {
        done.event = Event::Asleep;
        return done;
      }
      std::this_thread::sleep_for(std::chrono::microseconds(20));
    }
  }
}

bool Tracee::run_to(const Station& station) {
  if (station.event == Event::AllAsleep) return true;
  const auto until = std::chrono::steady_clock::now() + kStrays;
  std::size_t index = 0;
  for (;;) {
    for (index = 0; index < threads_.size() && threads_[index].number != station.thread;) ++index;
    if (index == threads_.size()) return false;
    if (threads_[index].stopped || poll(index)) break;
    if (dead_ || std::chrono::steady_clock::now() > until) return false;
    std::this_thread::sleep_for(std::chrono::microseconds(20));
  }
  for (std::uint64_t times = 1;; ++times) {
    if (place_of(threads_[index]) != station.place &&
        !run(index, PTRACE_SYSCALL, station.place, kStrays)) {
      return false;
    }
    if (times == station.times) return true;
    if (is_system_call(threads_[index], station.place)) return false;  // each is a station
    threads_[index].stopped = false;
    trace(PTRACE_SINGLESTEP, threads_[index].id);
    if (!stops(index, kStrays)) return false;
  }
}

bool Tracee::run_first_to(std::uint64_t place, unsigned patience_ms) {
  if (place_of(threads_.front()) == place) return true;
  const bool there = run(0, PTRACE_CONT, place, std::chrono::milliseconds(patience_ms));
  if (dead_ || !threads_.front().stopped) throw std::runtime_error("a traced thread does not stop");
  return there;
}

bool Tracee::run(std::size_t index, int how, std::uint64_t place,
                 std::chrono::milliseconds patience) {
  constexpr std::uint64_t kBreakpoint = 0xcc;  // int3
  const pid_t id = threads_[index].id;
  const auto go = [&](int request) {
    threads_[index].stopped = false;
    trace(request, id, 0, static_cast<std::uintptr_t>(std::exchange(threads_[index].signal, 0)));
  };
  if (std::exchange(threads_[index].in_clone, false)) {
    go(PTRACE_SINGLESTEP);  // to the end of the call
    if (!stops(index, kStrays)) return false;
    if (place_of(threads_[index]) == place) return true;
  }
  const auto text = static_cast<std::uint64_t>(trace(PTRACE_PEEKTEXT, id, place));
  trace(PTRACE_POKETEXT, id, place, (text & ~std::uint64_t{0xff}) | kBreakpoint);
  threads_[index].may_resume_call = false;
  go(how);
  if (!stops(index, patience)) {
    if (dead_ || index >= threads_.size() || threads_[index].id != id) return false;
    trace(PTRACE_INTERRUPT, id);
    if (!stops(index, kStrays)) return false;
    threads_[index].may_resume_call = true;
    if (trap_is_pending(threads_[index])) {  // it is at the breakpoint just now
      go(PTRACE_CONT);
      if (!stops(index, kStrays)) return false;
    }
  }
  trace(PTRACE_POKETEXT, id, place, text);
  if (place_of(threads_[index]) != place + 1) return false;
  trace(PTRACE_POKEUSER, id, offsetof(user_regs_struct, rip), place);
  return true;
}

std::uint64_t Tracee::switches() const {
  return std::stoull(status_of(threads_.front(), "voluntary_ctxt_switches:"));
}

bool Tracee::stops(std::size_t index, std::chrono::milliseconds patience) {
  const auto until = std::chrono::steady_clock::now() + patience;
  for (;;) {
    int status = 0;
    if (waitpid(threads_[index].id, &status, __WALL | WNOHANG) == threads_[index].id) {
      return note(index, status);
    }
    const auto now = std::chrono::steady_clock::now();
    if (now > until) return false;
    sched_yield();
  }
}

void Tracee::kill() {
  if (dead_) return;
  ::kill(pid_, SIGKILL);
  // The first thread's end is reported when the others have been waited for.
  while (threads_.size() > 1 || !dead_) {
    const std::size_t last = threads_.size() - 1;
    int status = 0;
    if (waitpid(threads_[last].id, &status, __WALL) == -1) {
      if (errno == EINTR) continue;
      if (last == 0) break;
      threads_.pop_back();
      continue;
    }
    if (WIFSTOPPED(status)) continue;  // it was on its way into a stop
    if (threads_[last].id == pid_) dead_ = true;
    threads_.pop_back();
    if (threads_.empty()) break;
  }
  dead_ = true;
}

void Tracee::detach() {
  // The first thread at last: if the process has died, its end is reported behind those of the
  // others.
  for (std::size_t i = threads_.size(); i-- > 0;) {
    Thread& thread = threads_[i];
    int status = 0;
    const auto stops = [&] {
      return waitpid(thread.id, &status, __WALL) == thread.id && WIFSTOPPED(status);
    };
    if (!thread.stopped) {
      trace(PTRACE_INTERRUPT, thread.id);
      if (!stops()) continue;
      // The trap of a stepped call that was interrupted would kill a thread that nobody traces.
      if (is_stop_event(status) && trap_is_pending(thread)) {
        trace(PTRACE_CONT, thread.id);
        if (!stops()) continue;
      }
      if (!is_stop_event(status) && WSTOPSIG(status) != SIGTRAP) thread.signal = WSTOPSIG(status);
    }
    if (trace(PTRACE_DETACH, thread.id, 0, static_cast<std::uintptr_t>(thread.signal)) == -1 &&
        thread.id != pid_) {
      waitpid(thread.id, &status, __WALL);  // it is dying: only its tracer can wait for it
    }
  }
  threads_.clear();
  dead_ = true;
}

/// What the kernel says of a thread under that title.
std::string Tracee::status_of(const Thread& thread, const std::string& title) const {
  std::ifstream file("/proc/" + std::to_string(pid_) + "/task/" + std::to_string(thread.id) +
                     "/status");
  for (std::string line; std::getline(file, line);) {
    if (line.rfind(title, 0) == 0) return line.substr(title.size());
  }
  return "0";
}

bool Tracee::trap_is_pending(const Thread& thread) const {
  return (std::stoull(status_of(thread, "SigPnd:"), nullptr, 16) >> (SIGTRAP - 1) & 1) != 0;
}

}  // namespace lot::kill
