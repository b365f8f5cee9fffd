// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "result.hpp"

/// What a run need not measure again, and what it must not replace unasked.
namespace ab {

/// A cell by what it is: its conditions, and the names of its arms.
struct CellArms {
  Conditions conditions;
  std::vector<std::string> arms;
  bool operator==(const CellArms&) const = default;
};

/// What becomes of cells that are wanted and saved already.
struct SavedPolicy {
  bool resume = false;   ///< those that have all wanted arms are left out, others completed
  bool replace = false;  ///< what a cell has may go
};

/// The cells of `wanted` that are to be measured, in their order. Arms of a cell are measured
/// together or not at all, so one that is resumed has those that were saved once more, after those
/// that are wanted; unless they may go. With neither policy a saved cell that is wanted throws
/// std::invalid_argument, with the ways out.
std::vector<CellArms> to_measure(const std::vector<CellArms>& wanted,
                                 const std::vector<CellArms>& saved, const SavedPolicy& policy);

}  // namespace ab
