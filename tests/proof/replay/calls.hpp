// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <sys/user.h>
#include <vector>

#include "sleepers.hpp"

namespace lot::replay {

/// What becomes of a system call.
struct Verdict {
  enum class What {
    Answered,  ///< `result`
    Sleeps,
    Kernel,   ///< the kernel does it: it says the same in each run
    Ends,     ///< the thread ends
    EndsAll,  ///< its process ends
    Tells,    ///< the worker tells something (tells.hpp)
    Unknown,  ///< nothing is known of such a call: the run cannot go on
  };
  What what;
  long result = 0;
};

/// Answers the calls whose result would be another one in each run: clocks, sleeps and wakes,
/// random numbers. A virtual clock stands still until the conductor moves it.
class Calls {
 public:
  explicit Calls(std::uint64_t seed) : random_(seed) {}

  Verdict handle(Thread& thread, const user_regs_struct& call, const std::vector<Thread*>& threads);

  std::uint64_t now() const { return now_; }
  void pass(std::uint64_t ns) { now_ += ns; }
  Sleepers& sleepers() { return sleepers_; }

 private:
  Verdict futex(Thread& thread, const user_regs_struct& call, const std::vector<Thread*>& threads);
  Verdict wait(Thread& thread, const user_regs_struct& call, bool until_a_time);
  Verdict wait_for_many(Thread& thread, const user_regs_struct& call);
  Verdict nap(Thread& thread, std::uint64_t request, bool until_a_time, bool on_wall_clock);
  Verdict tell_time(const Thread& thread, std::uint64_t clock, std::uint64_t into) const;
  Verdict make_random(const Thread& thread, std::uint64_t into, std::uint64_t bytes);
  static std::uint64_t read_time(const Thread& thread, std::uint64_t address);

  std::uint64_t random_;
  std::uint64_t now_ = 1'000'000'000'000;  ///< of CLOCK_MONOTONIC
  Sleepers sleepers_;
};

}  // namespace lot::replay
