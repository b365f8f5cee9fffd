// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "result.hpp"

/// Runs a cell: starts the nodes of every arm, lets the arms take turns, and gathers what came out.
namespace ab {

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

/// `progress` hears a line now and then. `interrupted` is asked often; when it says yes, everything
/// is stopped, and the cell comes back without arms.
Cell run_cell(const CellOptions& options, const Workplace& workplace,
              const std::function<void(const std::string&)>& progress,
              const std::function<bool()>& interrupted);

}  // namespace ab
