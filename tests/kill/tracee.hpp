// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <sys/types.h>
#include <vector>

namespace lot::kill {

/// A process that is run one instruction at a time.
///
/// All its threads stand still but the one that steps. The first thread goes first; when it sleeps
/// in a system call, the next one steps, so that what several threads do together has one order.
///
/// Threads: one tracer thread, the parent of the process.
/// Source:  ptrace(2): PTRACE_SEIZE, PTRACE_INTERRUPT, PTRACE_SINGLESTEP.
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
    bool system_call;     ///< the instruction was one
    bool waits;           ///< a futex call or a sleep: others may be waited for, or are woken
    std::uint64_t place;  ///< address of the instruction
    bool first = false;   ///< by the process's first thread
  };
  /// One instruction of the thread whose turn it is. Waits up to `patience_ms` when all sleep.
  Step step(unsigned patience_ms = 0);

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
    bool stopped;
    bool may_resume_call = true;  ///< it was stopped inside a system call, perhaps
    int signal = 0;               ///< to be delivered with the next step
  };

  /// True when the call was put aside.
  bool fail_if_due(const Thread& thread);
  static std::uint64_t place_of(const Thread& thread);
  static bool is_system_call(const Thread& thread, std::uint64_t place);
  bool asleep(const Thread& thread) const;
  bool trap_is_pending(const Thread& thread) const;
  /// Takes note of a stop or an end that waitpid reported. False: the thread has ended.
  bool note(std::size_t index, int status);
  bool poll(std::size_t index);
  void adopt(pid_t thread, bool may_have_ended);

  pid_t pid_;
  std::vector<Thread> threads_;
  bool dead_ = false;
  std::uint64_t calls_left_ = 0;
  int error_ = 0;
  std::optional<long> failed_call_;
  bool spared_call_ = false;
};

}  // namespace lot::kill
