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
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/user.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <utility>

namespace lot::kill {
namespace {

constexpr long kOptions = PTRACE_O_TRACECLONE | PTRACE_O_EXITKILL;
/// A system call that takes longer may be asleep. By the clock: on a core that others want, too,
/// each yield may take milliseconds.
constexpr std::chrono::microseconds kYields{100};
constexpr long kFutexWaitv = 449;

long trace(__ptrace_request request, pid_t thread, std::uintptr_t address = 0,
           std::uintptr_t data = 0) {
  return ptrace(request, thread, reinterpret_cast<void*>(address), reinterpret_cast<void*>(data));
}

bool is_clone_event(int status) { return status >> 8 == (SIGTRAP | (PTRACE_EVENT_CLONE << 8)); }
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
    detach();  // a thread that stays traced can only be buried by us
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
  threads_.push_back({thread, true});
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

bool Tracee::asleep(const Thread& thread) const {
  const std::string name =
      "/proc/" + std::to_string(pid_) + "/task/" + std::to_string(thread.id) + "/stat";
  std::FILE* file = std::fopen(name.c_str(), "r");
  if (file == nullptr) return false;
  char text[512] = {};
  const std::size_t n = std::fread(text, 1, sizeof(text) - 1, file);
  std::fclose(file);
  text[n] = '\0';
  const char* end = std::strrchr(text, ')');
  return end != nullptr && end[1] == ' ' && end[2] == 'S';
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
    unsigned long id = 0;
    trace(PTRACE_GETEVENTMSG, thread.id, 0, reinterpret_cast<std::uintptr_t>(&id));
    adopt(static_cast<pid_t>(id), false);
  } else if (!is_stop_event(status) && WSTOPSIG(status) != SIGTRAP) {
    thread.signal = WSTOPSIG(status);
  }
  return true;
}

/// Has the thread come back from its system call?
bool Tracee::poll(std::size_t index) {
  int status = 0;
  return waitpid(threads_[index].id, &status, __WALL | WNOHANG) == threads_[index].id &&
         note(index, status) && threads_[index].stopped;
}

Tracee::Step Tracee::step(unsigned patience_ms) {
  const auto until = std::chrono::steady_clock::now() + std::chrono::milliseconds(patience_ms);
  std::size_t turn = threads_.size();
  for (;;) {
    for (std::size_t i = 0; i < threads_.size() && turn == threads_.size(); ++i) {
      if (threads_[i].stopped || poll(i)) turn = i;
      if (dead_) return {Event::Ended, false, false, 0};
    }
    if (turn < threads_.size()) break;
    turn = threads_.size();
    if (std::chrono::steady_clock::now() >= until) return {Event::AllAsleep, false, false, 0};
    std::this_thread::sleep_for(std::chrono::microseconds(50));
  }

  Thread& thread = threads_[turn];
  const pid_t id = thread.id;
  const std::uint64_t place = place_of(thread);
  const bool call = is_system_call(thread, place);
  const long number = call ? trace(PTRACE_PEEKUSER, id, offsetof(user_regs_struct, rax)) : -1;
  const bool waits = number == SYS_futex || number == kFutexWaitv || number == SYS_clock_nanosleep;
  if (call && fail_if_due(thread)) return {Event::Stepped, true, waits, place, turn == 0};
  const bool may_sleep = std::exchange(thread.may_resume_call, false) || call;
  thread.stopped = false;
  trace(PTRACE_SINGLESTEP, id, 0, static_cast<std::uintptr_t>(std::exchange(thread.signal, 0)));
  const auto yields_until = std::chrono::steady_clock::now() + kYields;
  unsigned sleeps = 0;
  for (;;) {
    int status = 0;
    if (waitpid(id, &status, __WALL | (may_sleep ? WNOHANG : 0)) == id) {
      note(turn, status);
      return {dead_ ? Event::Ended : Event::Stepped, call, waits, place, turn == 0};
    }
    if (std::chrono::steady_clock::now() < yields_until) {
      sched_yield();
    } else {
      sleeps = asleep(thread) ? sleeps + 1 : 0;
      if (sleeps == 3) return {Event::Asleep, call, waits, place, turn == 0};
      std::this_thread::sleep_for(std::chrono::microseconds(20));
    }
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
  for (Thread& thread : threads_) {
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
      waitpid(thread.id, &status, __WALL | WNOHANG);  // it has died: only its tracer can bury it
    }
  }
  threads_.clear();
  dead_ = true;
}

bool Tracee::trap_is_pending(const Thread& thread) const {
  std::ifstream file("/proc/" + std::to_string(pid_) + "/task/" + std::to_string(thread.id) +
                     "/status");
  for (std::string line; std::getline(file, line);) {
    if (line.rfind("SigPnd:", 0) == 0) {
      return (std::stoull(line.substr(7), nullptr, 16) >> (SIGTRAP - 1) & 1) != 0;
    }
  }
  return false;
}

}  // namespace lot::kill
