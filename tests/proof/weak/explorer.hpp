// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <ucontext.h>
#include <vector>

#include "memory.hpp"

/// Runs the threads of a scenario one step after the other, again and again: each execution answers
/// the search's questions in another way.
namespace lot::weak {

/// Where a step stands in the source.
struct Place {
  const char* function = "";
  const char* file = "";
  unsigned line = 0;
};

/// What is explored. Each execution calls before(), then thread(i) for each thread side by side,
/// then after().
struct Suite {
  unsigned threads = 0;
  std::function<void()> make;     ///< first of all
  std::function<void()> destroy;  ///< last of all; not after a failure
  std::function<void()> before;
  std::function<void(unsigned)> thread;
  std::function<void()> after;
};

struct Outcome {
  std::uint64_t executions = 0;
  bool complete = false;  ///< the search has come to its end
  std::string failure;    ///< what kind of one; empty: it holds
  std::string where;      ///< of the failure
  Trace trace;            ///< of the failure
  std::string history;    ///< of the failure, if asked for
};

class Explorer {
 public:
  struct Limits {
    std::uint64_t executions = ~std::uint64_t{0};
    unsigned steps = 10000;  ///< of one execution; more are a livelock
    bool history = false;    ///< tells each step
  };

  Explorer(const Suite& suite, Search& search, const Limits& limits);
  ~Explorer();
  Explorer(const Explorer&) = delete;
  Explorer& operator=(const Explorer&) = delete;

  Outcome run();

  // What the threads call. The one that is at work now, if any:
  static Explorer* current() { return current_; }

  unsigned thread_index() const { return running_; }
  unsigned threads() const { return suite_.threads; }
  /// Another thread may run first.
  void step();
  /// This thread waits for what others do.
  void pause();
  /// Sleeps until another thread calls wake() with this bed.
  void sleep(const void* bed);
  void wake(const void* bed);
  void disable_preemption(int by) { undisturbed_ += by; }
  unsigned random(unsigned count) { return choose(Kind::Free, count); }
  /// Ends the execution. The rest of the search is not done.
  [[noreturn]] void fail(const char* what, const std::string& where = {});

  Memory& memory() { return memory_; }
  Thread& thread() { return fibers_[running_].state; }
  /// What membarrier(2) does: each thread of the process has passed a full barrier.
  void process_barrier();

  bool tells() const { return limits_.history; }
  void tell(const char* what, const void* word, Value value, const char* order, const Place& place);

 private:
  enum class State { Ready, Asleep, Ended };
  struct Fiber {
    Explorer* explorer = nullptr;
    unsigned index = 0;
    State state_of_run = State::Ended;
    const void* bed = nullptr;
    std::uint64_t last_ran = 0;
    Thread state;
    std::unique_ptr<char[]> stack;
    ucontext_t context;
  };

  static void enter(unsigned low, unsigned high);
  [[noreturn]] void live(Fiber& me);
  unsigned choose(Kind kind, unsigned count);
  void execute();
  void begin();
  void play_alone(const std::function<void()>& part);
  void play();
  void run_next(Kind kind, bool may_stay);
  void switch_to(unsigned next);
  void leave(ucontext_t& from);
  void count_step();

  static inline Explorer* current_ = nullptr;

  const Suite& suite_;
  Search& search_;
  Limits limits_;
  Memory memory_;
  std::array<Fiber, kMostThreads> fibers_;
  ucontext_t driver_;
  const std::function<void()>* alone_part_ = nullptr;
  unsigned running_ = 0;
  int undisturbed_ = 0;
  unsigned steps_ = 0;
  std::uint64_t ran_ = 0;
  std::uint32_t questions_ = 0;
  Outcome outcome_;
  std::vector<unsigned> others_;
  unsigned alone_for_ = 0;  ///< steps since another thread has run
};

}  // namespace lot::weak
