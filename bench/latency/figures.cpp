// SPDX-License-Identifier: Apache-2.0
#include "figures.hpp"

#include <algorithm>

#include "figure_kinds.hpp"

namespace ab {

std::vector<std::string> draw(const Run& run, const std::filesystem::path& dir) {
  const std::filesystem::path figures = dir / "figures";
  std::filesystem::create_directories(figures);
  const std::string machine = run.machine.cpu + ", " + std::to_string(run.machine.cores) + " cores";
  std::vector<std::string> lines = draw_box_figures(run, machine, figures);
  for (std::string& line : draw_nagle(run, machine, figures)) lines.push_back(std::move(line));
  lines.push_back(draw_load(run, machine, figures));
  lines.push_back(write_load_table(run, figures));
  std::sort(lines.begin(), lines.end());
  return lines;
}

}  // namespace ab
