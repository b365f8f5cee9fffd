// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <csignal>
#include <cstdint>
#include <functional>
#include <string>
#include <sys/types.h>
#include <vector>

#include "audit.hpp"
#include "board.hpp"
#include "canary.hpp"
#include "hands.hpp"
#include "namespaces.hpp"
#include "plan.hpp"
#include "settings.hpp"
#include "tally.hpp"

namespace lot::chaos {

/// Starts nodes, ends them, and starts them again, until so many were killed; sees that they make
/// progress, and now and then that nothing is left which the living do not explain.
class Supervisor {
 public:
  Supervisor(const Settings& settings, Board& board, Namespaces& namespaces);
  /// Ends all that it started and removes every file of the segment.
  ~Supervisor();
  Supervisor(const Supervisor&) = delete;
  Supervisor& operator=(const Supervisor&) = delete;

  void run();
  bool interrupted() const { return interrupted_; }
  const Tally& tally() const { return tally_; }

 private:
  using Time = std::chrono::steady_clock::time_point;
  enum class Next : std::uint8_t { Nothing, Kill, Stop, Continue, Leave };
  struct Slot {
    pid_t pid = -1;
    Fate fate{};
    Next next = Next::Nothing;
    Time next_at, born, moved;
    std::uint64_t beats = 0;
    bool stopped = false;
    bool killed = false;
    bool leaving = false;
  };
  void run_epoch(std::uint64_t number);
  void storm(unsigned kills);
  void calm();
  void still();
  void reach(Stage stage);
  void finish(EpochPlan::End end);
  void start_last(bool alone);
  void end_with_last();
  void check_files(const char* when);
  void check_taken(const Living& living);
  void write_off(const Living& living);
  void check_finished(const Living& living, std::uint64_t segment);

  void start(unsigned slot);
  static void send(const Slot& s, int signal);
  static void schedule_end(Slot& s, Time from);
  void act(unsigned slot, Time now);
  void aim(unsigned slot) const;
  void kill(unsigned slot);
  void leave(unsigned slot);
  void resume(Slot& s);
  /// Sleeps until something is due or a node has ended; then collects the ended and looks for nodes
  /// that are stuck.
  void pump(Time until);
  void collect_ended();
  void ended(unsigned slot, int status);
  void look_for_stuck(Time now);
  void stuck(unsigned slot, const char* what);
  bool pump_until(const std::function<bool()>& condition);
  bool all_reached(Stage stage) const;
  bool any_alive() const;
  Living living() const;
  /// True when the run is to end: interrupted, or something was found.
  bool over();
  void print_reports();
  void save_segment();
  void remove_files() const;
  std::string path() const;

  const Settings& settings_;
  Board& board_;
  Namespaces& namespaces_;
  Canary canary_;
  Hands hands_;
  Epoch epoch_;
  EpochPlan plan_{};
  std::vector<Slot> slots_;
  Slot last_;  ///< the one that sees whether anything is left
  int last_status_ = 0;
  bool restart_ = false;  ///< the ended are started again
  bool interrupted_ = false;
  sigset_t signals_{};
  Tally tally_;
  Time looked_{};
  std::uint32_t printed_ = 0;
};

}  // namespace lot::chaos
