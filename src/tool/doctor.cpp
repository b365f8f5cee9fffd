// SPDX-License-Identifier: Apache-2.0
#include "tool/doctor.hpp"

#include <algorithm>

#include "tool/report.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

using Verdict = Finding::Verdict;

constexpr std::size_t kMostText = 500;

void print(const Finding& finding, Report& report) {
  const std::string verdict = to_string(finding.verdict);
  const auto cell = [](std::string text, std::size_t width) {
    text.resize(std::max(text.size(), width), ' ');
    return text;
  };
  const std::string indent(9, ' ');
  report.print(cell(verdict, 9) + cell(finding.check, 15) + printable(finding.seen, kMostText) +
               "\n");
  for (const auto& line : {finding.means, finding.advice}) {
    if (!line.empty()) report.print(indent + cell("", 15) + printable(line, kMostText) + "\n");
  }
}

std::string summary(std::size_t problems, std::size_t warnings) {
  if (problems == 0 && warnings == 0) return "all is well";
  std::string text = problems != 0 ? plural(problems, "problem", "problems") : "";
  if (problems != 0 && warnings != 0) text += ", ";
  return text + (warnings != 0 ? plural(warnings, "warning", "warnings") : "");
}

}  // namespace

Exit doctor(const Settings& settings) {
  Report report(settings);
  report.document()["command"] = "doctor";
  report.document()["findings"] = Json::array();
  std::size_t problems = 0;
  std::size_t warnings = 0;
  for (const Finding& finding : diagnose(look_at_machine(settings))) {
    print(finding, report);
    problems += finding.verdict == Verdict::Problem;
    warnings += finding.verdict == Verdict::Warning;
    report.document()["findings"].push_back({{"check", finding.check},
                                             {"verdict", to_string(finding.verdict)},
                                             {"seen", finding.seen},
                                             {"means", finding.means},
                                             {"advice", finding.advice}});
  }
  report.print("\n" + summary(problems, warnings) + "\n");
  if (problems + warnings != 0) report.ends(kWrong);
  return report.finish();
}

}  // namespace lot::tool
