// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "result.hpp"
#include "workplace.hpp"

/// Runs a cell: starts the nodes of every arm, lets the arms take turns, and gathers what came out.
namespace ab {

struct CellOptions {
  Conditions conditions;
  std::vector<std::string> transports;
  bool profile = false;    ///< utilisation, and hot spots by SIGPROF
  std::uint64_t seed = 1;  ///< of the order of turns
};

/// `progress` hears a line now and then. `interrupted` is asked often; when it says yes, everything
/// is stopped, and the cell comes back without arms.
Cell run_cell(const CellOptions& options, const Workplace& workplace,
              const std::function<void(const std::string&)>& progress,
              const std::function<bool()>& interrupted);

}  // namespace ab
