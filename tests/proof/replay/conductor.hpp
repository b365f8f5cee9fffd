// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "books.hpp"
#include "calls.hpp"
#include "chaos/random.hpp"
#include "proc_files.hpp"
#include "record.hpp"
#include "sleepers.hpp"
#include "tracing.hpp"

namespace lot::segment {
class Segment;
}

namespace lot::replay {

/// What a run is made of. All of it follows from the seed.
struct Plan {
  std::uint64_t seed;
  unsigned workers;
  unsigned operations;  ///< of each worker
  unsigned kills;       ///< so many at most
  bool only_letters;    ///< workers do nothing but push and pull letters

  static Plan of(std::uint64_t seed);
  /// Two workers that only push and pull letters, and no kill: the shortest way to a mistake
  /// between a publisher and its reader.
  static Plan of_letters(std::uint64_t seed);
};

/// Runs workers, one thread of all their threads at a time, as the seed says.
///
/// REQUIRES: process 1 of a PID namespace, on one core, with an empty /dev/shm and a /proc of that
///           namespace.
class Conductor {
 public:
  Conductor(const Plan& plan, const std::string& program, Record& record);
  ~Conductor();

  /// The whole run. What came of it is in the record. Throws std::exception.
  void run();

 private:
  void start(unsigned worker);
  void adopt(pid_t id, Process& process);
  /// One turn. False: the run is over.
  bool turn();
  Thread* choose();
  void run_thread(Thread& thread);
  /// False: the thread does not go on in this turn.
  bool call(Thread& thread);
  void look_at_sleeper(const Thread& thread);
  bool is_settled() const;
  bool go_to_kernel(Thread& thread, const user_regs_struct& registers);
  long correct(const Thread& thread, const user_regs_struct& call, long result);
  bool hear(Thread& thread, const user_regs_struct& registers);
  void come_to_stage(Thread& thread, Stage stage);
  bool let_stage_begin();
  bool is_clean();
  bool leap();
  void maybe_kill();
  void end_thread(Thread& thread);
  void end_process(Process& process, const Thread* caller);
  void forget(const Thread& thread);
  void note(std::uint64_t a, std::uint64_t b);
  void note_turn(const Thread& thread);
  unsigned below(std::uint64_t n) { return random_.pick(n); }

  const Plan plan_;
  const std::string program_;
  Record& record_;
  chaos::Random random_;
  Calls calls_;
  Books books_;
  ProcFiles proc_files_;
  std::vector<std::unique_ptr<Process>> processes_;
  std::vector<std::unique_ptr<Thread>> owned_;
  std::vector<Thread*> threads_;  ///< those that live, in the order of their coming
  unsigned came_ = 0;
  std::vector<unsigned> lives_;
  Thread* last_ = nullptr;  ///< that ran in the turn before
  Thread* slow_ = nullptr;  ///< does not run while others can
  unsigned slow_turns_ = 0;
  unsigned last_call_ = 0;
  Stage stage_ = Stage::Work;
  std::vector<Thread*> at_stage_;
  std::optional<std::uint64_t> last_death_{};  ///< ns of the virtual clock
  std::uint64_t leave_by_ = 0;
  std::unique_ptr<segment::Segment> segment_;
};

}  // namespace lot::replay
