// SPDX-License-Identifier: Apache-2.0
#include "resume.hpp"

#include <algorithm>
#include <iterator>
#include <stdexcept>
#include <utility>

#include "report.hpp"

namespace ab {
namespace {

/// Those of `a` that `b` lacks.
std::vector<std::string> lacking(const std::vector<std::string>& a,
                                 const std::vector<std::string>& b) {
  std::vector<std::string> some;
  std::copy_if(a.begin(), a.end(), std::back_inserter(some), [&](const std::string& name) {
    return std::find(b.begin(), b.end(), name) == b.end();
  });
  return some;
}

[[noreturn]] void refuse(const CellArms& saved) {
  std::string names;
  for (const std::string& name : saved.arms) names += (names.empty() ? "" : ", ") + name;
  throw std::invalid_argument(
      "--out has a cell of these conditions already (" + title_of(saved.conditions) +
      "), and this run would delete its " + (names.empty() ? "failed arms" : names) +
      ": choose another --out, --resume to measure only what is not there, or --replace");
}

}  // namespace

std::vector<CellArms> to_measure(const std::vector<CellArms>& wanted,
                                 const std::vector<CellArms>& saved, const SavedPolicy& policy) {
  std::vector<CellArms> cells;
  for (const CellArms& cell : wanted) {
    const auto before = std::find_if(saved.begin(), saved.end(), [&](const CellArms& one) {
      return one.conditions == cell.conditions;
    });
    if (before == saved.end()) {
      cells.push_back(cell);
      continue;
    }
    if (!policy.resume && !policy.replace) refuse(*before);
    if (policy.resume && lacking(cell.arms, before->arms).empty()) continue;
    cells.push_back(cell);
    if (policy.replace) continue;
    for (std::string& name : lacking(before->arms, cell.arms)) {
      cells.back().arms.push_back(std::move(name));
    }
  }
  return cells;
}

}  // namespace ab
