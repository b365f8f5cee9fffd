// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "result.hpp"

/// Runs a cell: starts the nodes of every arm, lets the arms take turns, and gathers what came out.
namespace ab {

/// A stream of a cell, before transports give it names.
struct Topic {
  std::string name;  ///< "" in a cell of one
  std::size_t size = 0;
  double rate_hz = 0;
  unsigned publishers = 1;
  unsigned subscribers = 1;
};

struct CellOptions {
  Conditions conditions;
  std::vector<std::string> transports;
  bool profile = false;    ///< utilisation, and hot spots by SIGPROF
  std::uint64_t seed = 1;  ///< of the order of turns
};

/// Everything that this run leaves in file systems lies under its name, and goes with it. What a
/// run has left that was killed goes when the next one begins.
class Workplace {
 public:
  Workplace();
  ~Workplace();
  Workplace(const Workplace&) = delete;
  Workplace& operator=(const Workplace&) = delete;
  const std::string& name() const { return name_; }
  /// A new directory in memory.
  std::string directory(const std::string& name) const;

 private:
  std::string name_;
  int lock_ = -1;
};

/// Why these conditions cannot be had: empty, or a sentence that names the option to change.
std::string refused(const Conditions& conditions);

bool is_scenario(const std::string& graph);

/// The topics of a graph: NpMs, av, av-quiet.
std::vector<Topic> topics(const Conditions& conditions);

/// The floors that a cell of these conditions has here, unless it is to have none.
std::vector<std::string> floors_of(const Conditions& conditions);

/// `progress` hears a line now and then. `interrupted` is asked often; when it says yes, everything
/// is stopped, and the cell comes back without arms.
Cell run_cell(const CellOptions& options, const Workplace& workplace,
              const std::function<void(const std::string&)>& progress,
              const std::function<bool()>& interrupted);

}  // namespace ab
