// SPDX-License-Identifier: Apache-2.0
#include "resume.hpp"

#include <algorithm>
#include <iterator>
#include <stdexcept>

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

[[noreturn]] void refuse(const CellArms& cell, const std::vector<std::string>& lost,
                         const char* ways_out) {
  std::string names;
  for (const std::string& name : lost) names += (names.empty() ? "" : ", ") + name;
  throw std::invalid_argument("--out has a cell of these conditions already (" +
                              title_of(cell.conditions) + "), and this run would delete its " +
                              (names.empty() ? "failed arms" : names) + ": " + ways_out);
}

}  // namespace

std::vector<CellArms> to_measure(const std::vector<CellArms>& wanted,
                                 const std::vector<CellArms>& saved, const SavedPolicy& policy) {
  std::vector<CellArms> cells;
  for (const CellArms& cell : wanted) {
    const auto before = std::find_if(saved.begin(), saved.end(), [&](const CellArms& one) {
      return one.conditions == cell.conditions;
    });
    if (before != saved.end()) {
      if (policy.resume && lacking(cell.arms, before->arms).empty()) continue;
      const auto lost = policy.resume ? lacking(before->arms, cell.arms) : before->arms;
      if (!policy.replace && !policy.resume) {
        refuse(cell, lost, "choose another --out, --resume to leave out what it has, or --replace");
      }
      if (!policy.replace && !lost.empty()) {
        refuse(cell, lost, "name them, too (--transports), choose another --out, or --replace");
      }
    }
    cells.push_back(cell);
  }
  return cells;
}

}  // namespace ab
