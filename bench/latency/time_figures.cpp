// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cstdio>
#include <iterator>
#include <map>
#include <sstream>
#include <tuple>

#include "figure_cells.hpp"
#include "figure_kinds.hpp"
#include "gnuplot.hpp"
#include "measures.hpp"
#include "report.hpp"

namespace ab {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kNagleSizes[] = {512, 1024};
/// Message by message: with Nagle's algorithm, without, and LOT.
struct NagleFigure {
  std::string name;
  std::string needed;  ///< cells without this transport are not about it
  std::vector<std::string> transports;
};
const std::vector<NagleFigure> kNagleFigures{
    {"fig6d", "tcp-nagle", {"tcp-nagle", "tcp", "ring"}},
    {"ros6d", "ros-tcp-nodelay", {"ros-tcp", "ros-tcp-nodelay", "ros-lot"}}};
const std::vector<std::string> kLoadGraphs{"1p1s", "1p5s", "5p1s"};
const std::vector<std::string> kLoadTransports{
    "tcp", "ring", "mutex", "lot2021", "lot2021-direct", "ros-tcp", "ros-lot", "ros-lot-immediate"};

/// Cells of the CPU experiment: for each graph the one with the largest messages in which `has`
/// holds for some arm.
template <typename Has>
std::map<std::string, const Cell*> load_cells(const Run& run, const Has& has) {
  std::map<std::string, const Cell*> cells;
  for (const Cell& cell : run.cells) {
    const bool wanted = std::any_of(kLoadTransports.begin(), kLoadTransports.end(),
                                    [&](const std::string& transport) {
                                      const Arm* arm = find(cell, transport);
                                      return arm != nullptr && has(*arm);
                                    });
    if (!wanted) continue;
    const Cell*& known = cells[cell.conditions.graph];
    if (known == nullptr || known->conditions.size < cell.conditions.size) known = &cell;
  }
  return cells;
}

struct LoadPoint {
  double seconds;
  double cores;
};

/// All nodes of an arm together, at the times at which the first of them was read.
std::vector<LoadPoint> load_over_time(const Arm& arm) {
  std::map<std::string, std::vector<const Utilisation*>> nodes;
  for (const Utilisation& reading : arm.utilisation) nodes[reading.node].push_back(&reading);
  if (nodes.empty()) return {};
  for (auto& [node, readings] : nodes) {
    std::sort(readings.begin(), readings.end(),
              [](const Utilisation* a, const Utilisation* b) { return a->at < b->at; });
  }
  const auto& clock = nodes.begin()->second;
  std::vector<std::int64_t> steps;
  for (std::size_t i = 1; i < clock.size(); ++i) steps.push_back(clock[i]->at - clock[i - 1]->at);
  std::sort(steps.begin(), steps.end());
  const std::int64_t usual = steps.empty() ? 0 : steps[steps.size() / 2];
  std::vector<LoadPoint> points;
  std::int64_t elapsed = 0;
  for (std::size_t i = 0; i < clock.size(); ++i) {
    if (i > 0) {
      const std::int64_t step = clock[i]->at - clock[i - 1]->at;
      elapsed += step > 5 * usual ? usual : step;  // another arm's turn is no time of this one
    }
    double sum = 0;
    for (const auto& [node, readings] : nodes) {
      // A reading covers the time before it.
      auto covers = std::lower_bound(
          readings.begin(), readings.end(), clock[i]->at,
          [](const Utilisation* reading, std::int64_t at) { return reading->at < at; });
      if (covers == readings.end()) --covers;
      sum += (*covers)->cores;
    }
    points.push_back({static_cast<double>(elapsed) / 1e9, sum});
  }
  return points;
}

std::string seconds_word(double seconds) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f", seconds);
  return text;
}

std::string draw_nagle_figure(const NagleFigure& figure, const Run& run, const std::string& machine,
                              const fs::path& dir) {
  const std::string& name = figure.name;
  const std::string title = "Nagle's algorithm, message by message";
  CellPointers candidates;
  for (const Cell& cell : run.cells) {
    const Conditions& conditions = cell.conditions;
    const bool small = std::find(std::begin(kNagleSizes), std::end(kNagleSizes), conditions.size) !=
                       std::end(kNagleSizes);
    if (small && conditions.mode == "paced" && conditions.graph == "1p1s" && !conditions.ordered &&
        find(cell, figure.needed, "") != nullptr) {
      candidates.push_back(&cell);
    }
  }
  if (candidates.empty()) {
    return left_out(dir, name, "needs paced cells of 1p1s, 512 B or 1 KiB, with " + figure.needed);
  }
  const CellPointers cells = best_setting(candidates, Series::Transport,
                                          [](const CellPointers& part) { return part.size(); });
  std::map<std::size_t, const Cell*> by_size;
  for (const Cell* cell : cells) by_size[cell->conditions.size] = cell;

  Panels panels(name);
  Range range;
  for (const auto& [size, cell] : by_size) {
    panels.add_panel(size_word(size));
    for (const std::string& transport : figure.transports) {
      const StreamResult* stream = find(*cell, transport, "");
      if (stream == nullptr || stream->subscribers.empty()) continue;
      std::ostringstream rows;
      rows << "# message\tlatency_us\n";
      for (const Sample& sample : stream->subscribers.front().samples) {
        const double latency = static_cast<double>(sample.entered_at - sample.filled_at) / 1000;
        range.add(latency);
        rows << sample.number << '\t' << latency << '\n';
      }
      panels.add_curve(transport, "points pointtype 7 pointsize 0.25", rows.str());
    }
  }
  panels.write_to(
      dir, title, setting_word(cells.front()->conditions, Series::Transport) + "  ·  " + machine,
      time_axis(range) + "set ylabel 'latency, fill to callback'\nset xlabel 'message'\n");
  std::string line = drawn_line(dir, name, title);
  for (const std::size_t size : kNagleSizes) {
    if (!by_size.contains(size)) line += "; without " + size_word(size);
  }
  return line;
}

}  // namespace

std::vector<std::string> draw_nagle(const Run& run, const std::string& machine,
                                    const fs::path& dir) {
  std::vector<std::string> lines;
  for (const NagleFigure& figure : kNagleFigures) {
    lines.push_back(draw_nagle_figure(figure, run, machine, dir));
  }
  return lines;
}

std::string draw_load(const Run& run, const std::string& machine, const fs::path& dir) {
  const std::string name = "fig8";
  const std::string title = "CPU use over time, all nodes together";
  const auto cells = load_cells(run, [](const Arm& arm) { return !arm.utilisation.empty(); });
  Panels panels(name);
  double most = 0;
  for (const std::string& graph : kLoadGraphs) {
    const auto found = cells.find(graph);
    if (found == cells.end()) continue;
    const Cell& cell = *found->second;
    panels.add_panel(graph + ", " + size_word(cell.conditions.size));
    for (const std::string& transport : kLoadTransports) {
      const Arm* arm = find(cell, transport);
      if (arm == nullptr || arm->utilisation.empty()) continue;
      std::ostringstream rows;
      rows << "# seconds\tcores\n";
      for (const LoadPoint& point : load_over_time(*arm)) {
        most = std::max(most, point.cores);
        rows << point.seconds << '\t' << point.cores << '\n';
      }
      panels.add_curve(transport, "lines linewidth 1.6", rows.str());
    }
  }
  if (panels.empty()) {
    return left_out(dir, name, "needs cells of 1p1s, 1p5s or 5p1s whose utilisation was recorded");
  }
  std::ostringstream axes;
  axes << "set yrange [0:" << most * 1.08 + 0.01 << "]\nset ylabel 'cores'\nset xlabel 's'\n";
  panels.write_to(dir, title, machine, axes.str());
  return drawn_line(dir, name, title);
}

std::string write_load_table(const Run& run, const fs::path& dir) {
  const auto profiled = [](const Arm& arm) { return arm.profile.cpu_s > 0; };
  const auto cells = load_cells(run, profiled);
  std::vector<std::array<std::string, 6>> rows{
      {"", "size", "CPU s", "spin s", "samples", "hottest functions (s)"}};
  for (const std::string& transport : kLoadTransports) {
    for (const std::string& graph : kLoadGraphs) {
      const auto found = cells.find(graph);
      const Arm* arm = found == cells.end() ? nullptr : find(*found->second, transport);
      if (arm == nullptr || !profiled(*arm)) continue;
      std::vector<HotSpot> spots = arm->profile.hottest;
      std::sort(spots.begin(), spots.end(), [](const HotSpot& a, const HotSpot& b) {
        return std::tie(b.seconds, a.symbol) < std::tie(a.seconds, b.symbol);
      });
      std::string hottest;
      for (std::size_t i = 0; i < std::min<std::size_t>(3, spots.size()); ++i) {
        hottest += (i == 0 ? "" : ", ") + spots[i].symbol + " " + seconds_word(spots[i].seconds);
      }
      std::string bars;  // a bar would end the table's cell
      for (const char c : hottest) bars += c == '|' ? std::string("\\|") : std::string(1, c);
      rows.push_back({label_of(transport) + " " + graph, size_word(found->second->conditions.size),
                      seconds_word(arm->profile.cpu_s), seconds_word(arm->profile.spin_s),
                      std::to_string(arm->profile.samples), bars});
    }
  }
  if (rows.size() == 1) {
    return left_out(dir, "table1", "needs cells of 1p1s, 1p5s or 5p1s that were profiled");
  }
  std::array<std::size_t, 6> widths{};
  for (const auto& row : rows) {
    for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
  }
  std::ostringstream text;
  for (std::size_t r = 0; r < rows.size(); ++r) {
    for (std::size_t i = 0; i < widths.size(); ++i) {
      const std::string gap(widths[i] - rows[r][i].size(), ' ');
      const bool left = i == 0 || i + 1 == widths.size();
      text << (i == 0 ? "| " : " | ") << (left ? rows[r][i] + gap : gap + rows[r][i]);
    }
    text << " |\n";
    if (r != 0) continue;
    for (std::size_t i = 0; i < widths.size(); ++i) {
      const bool left = i == 0 || i + 1 == widths.size();
      text << '|' << std::string(widths[i] + (left ? 2 : 1), '-') << (left ? "" : ":");
    }
    text << "|\n";
  }
  write_file(dir / "table1.md", text.str());
  return "table1: CPU seconds and hot spots: " + (dir / "table1.md").string();
}

}  // namespace ab
