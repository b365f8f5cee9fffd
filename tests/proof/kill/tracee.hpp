// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <sys/types.h>
#include <vector>

namespace lot::kill {

/// A process that is run one instruction at a time, or up to a place.
///
/// All its threads stand still but the one that steps. The first thread goes first; when it sleeps
/// in a system call, the next one steps, so that what several threads do together has one order.
///
/// Threads: one tracer thread, the parent of the process.
/// Source:  ptrace(2): PTRACE_SEIZE, PTRACE_INTERRUPT, PTRACE_SINGLESTEP; PTRACE_SYSCALL and
///          PTRACE_CONT up to a breakpoint.
class Tracee {
 public:
  /// Stops all threads of a child. Throws std::runtime_error.
  explicit Tracee(pid_t pid);
  /// Lets go of it, running or dead.
  ~Tracee();
  Tracee(const Tracee&) = delete;
  Tracee& operator=(const Tracee&) = delete;

  enum class Event {
    Stepped,  ///< one instruction was done
    Asleep,   ///< the thread sleeps in a system call; the next step is another thread's
    AllAsleep,
    Ended,  ///< the process is dead
  };
  struct Step {
    Event event;
    bool system_call = false;  ///< the instruction was one
    bool waits = false;        ///< a futex call or a sleep: others may be waited for, or are woken
    bool resumed = false;      ///< perhaps a call in which it was when it was stopped
    std::uint64_t place = 0;   ///< address of the instruction
    unsigned thread = 0;       ///< 0: the first, which was there when the process was stopped
  };
  /// One instruction of the thread whose turn it is, or of `thread`. Waits up to `patience_ms` when
  /// all sleep.
  Step step(unsigned patience_ms = 0, std::optional<unsigned> thread = std::nullopt);

  /// A step that can be found again in another run of the same code.
  struct Station {
    Event event;
    unsigned thread;
    std::uint64_t place;
    /// That instruction was begun so often by its thread since the thread's last station.
    std::uint64_t times;
  };
  /// Lets a thread run from its last station to this one, which it then stands before. That takes a
  /// few stops where stepping takes one for each instruction.
  ///
  /// False: it has gone another way; then the process can only be killed (a breakpoint may be
  /// left).
  bool run_to(const Station& station);
  /// Lets the first thread run up to a place, through system calls. False: it did not come there in
  /// that time; it stands still where it is. Throws std::runtime_error when it has died.
  bool run_first_to(std::uint64_t place, unsigned patience_ms);

  /// How often the first thread has given its core away: at its stops, and when it slept.
  std::uint64_t switches() const;

  /// Where the first thread stands.
  std::uint64_t place() const { return place_of(threads_.front()); }

  /// SIGKILL, and waits until nothing of the process is left.
  void kill();
  /// Lets all threads run on by themselves.
  void detach();

  /// The system call `calls` calls from now is not done; it returns `error` instead.
  void fail_call(std::uint64_t calls, int error) {
    calls_left_ = calls;
    error_ = error;
  }
  /// The number of the call that was failed; nothing as long as none was, or it must not be failed
  /// with that error: an exit, or a futex call, whose failures are all spelt out in futex(2).
  std::optional<long> failed_call() const { return failed_call_; }
  bool spared_call() const { return spared_call_; }

 private:
  struct Thread {
    pid_t id;
    unsigned number;  ///< in the order of their coming
    bool stopped;
    bool may_resume_call = true;  ///< it was stopped inside a system call, perhaps
    bool in_clone = false;        ///< stopped there; the next stop is at the end of that call
    int signal = 0;               ///< to be delivered with the next step
  };

  /// True when the call was put aside.
  bool fail_if_due(const Thread& thread);
  static std::uint64_t place_of(const Thread& thread);
  static bool is_system_call(const Thread& thread, std::uint64_t place);
  /// Lets a thread run until it stands before `place`: by PTRACE_SYSCALL up to the next system call
  /// at most, or by PTRACE_CONT through system calls. False: it stands elsewhere, or has ended, or
  /// does not stop.
  bool run(std::size_t index, int how, std::uint64_t place, std::chrono::milliseconds patience);
  /// Waits for a stop of a thread that runs.
  bool stops(std::size_t index, std::chrono::milliseconds patience);
  /// The state of a thread as /proc has it ('S': asleep, 'Z': ended); '\0': there is none.
  char state_of(pid_t thread) const;
  std::string status_of(const Thread& thread, const std::string& title) const;
  bool trap_is_pending(const Thread& thread) const;
  /// Takes note of a stop or an end that waitpid reported. False: the thread has ended.
  bool note(std::size_t index, int status);
  bool poll(std::size_t index);
  /// Takes note of the stops and ends of all threads but this one.
  void poll_others(pid_t thread);
  std::size_t index_of(pid_t thread) const;
  void adopt(pid_t thread, bool may_have_ended);

  pid_t pid_;
  std::vector<Thread> threads_;
  unsigned came_ = 0;  ///< threads so far
  bool dead_ = false;
  std::uint64_t calls_left_ = 0;
  int error_ = 0;
  std::optional<long> failed_call_;
  bool spared_call_ = false;
};

}  // namespace lot::kill
