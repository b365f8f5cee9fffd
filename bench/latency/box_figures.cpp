// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdio>
#include <map>
#include <optional>
#include <set>
#include <sstream>

#include "figure_cells.hpp"
#include "figure_kinds.hpp"
#include "gnuplot.hpp"
#include "measures.hpp"
#include "report.hpp"

namespace ab {
namespace {

namespace fs = std::filesystem;

struct BoxFigure {
  std::string name;
  std::string scale;  ///< figures with the same word share their vertical axis
  std::string title;
  std::string graph;
  bool ordered;
  Series series;
  std::vector<std::string> transports;
  std::string wait = {};  ///< empty: whichever there is
};

const std::vector<std::string> kPeers{"lot2021", "lot2021-direct", "mutex",        "ring",
                                      "iceoryx", "fastdds",        "fastdds-loan", "udp-65507"};

const std::vector<BoxFigure>& box_figures() {
  static const std::vector<BoxFigure> figures{
      {"fig3a", "3", "TCP, 1p1s, by placement", "1p1s", false, Series::Place, {"tcp"}},
      {"fig3b", "3", "LOT, 1p1s, by placement", "1p1s", false, Series::Place, {"ring"}},
      {"fig5a", "5", "TCP, 5p1s, by publisher", "5p1s", false, Series::Publisher, {"tcp"}},
      {"fig5b", "5", "LOT, 5p1s, by publisher", "5p1s", false, Series::Publisher, {"ring"}},
      {"fig5c", "5", "TZC, 5p1s, by publisher", "5p1s", false, Series::Publisher, {"tzc"}},
      {"fig6a",
       "6a",
       "1p1s, transports over size",
       "1p1s",
       false,
       Series::Transport,
       {"udp", "tcp", "uds", "tzc", "ring"}},
      {"fig6b", "6bc", "TCP, 1p1s, by pinning", "1p1s", false, Series::Pin, {"tcp"}},
      {"fig6c", "6bc", "LOT, 1p1s, by pinning", "1p1s", false, Series::Pin, {"ring"}},
      {"fig7a",
       "7",
       "TCP, 1p5s, by subscriber, unordered",
       "1p5s",
       false,
       Series::Subscriber,
       {"tcp"}},
      {"fig7b",
       "7",
       "TCP, 1p5s, by subscriber, in order of arrival",
       "1p5s",
       true,
       Series::Subscriber,
       {"tcp"}},
      {"fig7c", "7", "LOT, 1p5s, by subscriber", "1p5s", false, Series::Subscriber, {"ring"}},
      {"fig7d", "7", "TZC, 1p5s, by subscriber", "1p5s", false, Series::Subscriber, {"tzc"}},
      {"peers", "peers", "1p1s, LOT, its predecessor and its peers over size", "1p1s", false,
       Series::Transport, kPeers, "park"},
      {"peers-spin", "peers-spin", "1p1s, LOT and its peers over size, spinning", "1p1s", false,
       Series::Transport, kPeers, "spin"},
      {"ros3a", "ros3", "TCPROS, 1p1s, by placement", "1p1s", false, Series::Place, {"ros-tcp"}},
      {"ros3b",
       "ros3",
       "LOT in ROS, 1p1s, by placement",
       "1p1s",
       false,
       Series::Place,
       {"ros-lot"}},
      {"ros5a",
       "ros5",
       "TCPROS, 5p1s, by publisher",
       "5p1s",
       false,
       Series::Publisher,
       {"ros-tcp"}},
      {"ros5b",
       "ros5",
       "LOT in ROS, 5p1s, by publisher",
       "5p1s",
       false,
       Series::Publisher,
       {"ros-lot"}},
      {"ros5c",
       "ros5",
       "TZC in ROS, 5p1s, by publisher",
       "5p1s",
       false,
       Series::Publisher,
       {"ros-tzc"}},
      {"ros6a",
       "ros6a",
       "Nodes of ROS, 1p1s, over size",
       "1p1s",
       false,
       Series::Transport,
       {"ros-udp", "ros-tcp", "ros-tzc", "ros-lot-mutex", "ros-lot", "ros-lot-immediate",
        "ros-intra"},
       "park"},
      {"ros6b", "ros6bc", "TCPROS, 1p1s, by pinning", "1p1s", false, Series::Pin, {"ros-tcp"}},
      {"ros6c", "ros6bc", "LOT in ROS, 1p1s, by pinning", "1p1s", false, Series::Pin, {"ros-lot"}},
      {"ros7a",
       "ros7",
       "TCPROS, 1p5s, by subscriber",
       "1p5s",
       false,
       Series::Subscriber,
       {"ros-tcp"}},
      {"ros7b",
       "ros7",
       "TCPROS, 1p5s, by subscriber, in order of arrival",
       "1p5s",
       true,
       Series::Subscriber,
       {"ros-tcp"}},
      {"ros7c",
       "ros7",
       "LOT in ROS, 1p5s, by subscriber",
       "1p5s",
       false,
       Series::Subscriber,
       {"ros-lot"}},
      {"ros7d",
       "ros7",
       "TZC in ROS, 1p5s, by subscriber",
       "1p5s",
       false,
       Series::Subscriber,
       {"ros-tzc"}},
  };
  return figures;
}

struct BoxSeries {
  std::string label;
  std::string colour;
  std::map<std::size_t, Summary> boxes;  // by size
};
struct Boxes {
  std::vector<BoxSeries> series;
  std::map<std::size_t, double> floor;  // medians, by size
  std::string floor_name;
  std::string setting;
  std::vector<std::string> absent;  // transports
};

Summary latencies_from(const StreamResult& stream, unsigned publisher) {
  std::vector<double> values;
  for (const Subscriber& subscriber : stream.subscribers) {
    for (const Sample& sample : subscriber.samples) {
      if (sample.publisher != publisher) continue;
      values.push_back(static_cast<double>(sample.entered_at - sample.filled_at) / 1000);
    }
  }
  return summarise(std::move(values));
}

/// The boxes that a cell gives to a figure: their place among the series, label and numbers.
struct CellBox {
  std::size_t order;
  std::string label;
  Summary summary;
};
std::vector<CellBox> boxes_of(const Cell& cell, const BoxFigure& figure) {
  std::vector<CellBox> boxes;
  for (std::size_t t = 0; t < figure.transports.size(); ++t) {
    const StreamResult* stream = find(cell, figure.transports[t], "");
    if (stream == nullptr) continue;
    const auto all = [&] { return summarise(latencies(*stream, Stamp::Fill)); };
    switch (figure.series) {
      case Series::Transport:
        boxes.push_back({t, label_of(figure.transports[t]), all()});
        break;
      case Series::Place: {
        static const std::vector<std::string> labels{"on the host", "in the same container",
                                                     "in separate containers"};
        const std::size_t order = rank_in(kPlaces, cell.conditions.place);
        boxes.push_back(
            {order, order < labels.size() ? labels[order] : cell.conditions.place, all()});
        break;
      }
      case Series::Pin: {
        const std::string& pin = cell.conditions.pin;
        boxes.push_back({rank_in(kPins, pin), pin == "none" ? "not pinned" : pin, all()});
        break;
      }
      case Series::Subscriber:
        for (const Subscriber& subscriber : stream->subscribers) {
          boxes.push_back({subscriber.index, "subscriber " + std::to_string(subscriber.index),
                           summarise(latencies(subscriber, Stamp::Fill))});
        }
        break;
      case Series::Publisher:
        for (const Publisher& publisher : stream->publishers) {
          boxes.push_back({publisher.index, "publisher " + std::to_string(publisher.index),
                           latencies_from(*stream, publisher.index)});
        }
        break;
    }
  }
  std::erase_if(boxes, [](const CellBox& box) { return box.summary.count == 0; });
  return boxes;
}

/// Its latencies are those of nodes that were interrupted for samples.
bool is_profiled(const Cell& cell) {
  return std::any_of(cell.arms.begin(), cell.arms.end(),
                     [](const Arm& arm) { return !arm.utilisation.empty(); });
}

/// The figure's boxes, or why there are none.
std::optional<Boxes> collect(const Run& run, const BoxFigure& figure, std::string& why_not) {
  CellPointers candidates;
  for (const Cell& cell : run.cells) {
    const Conditions& conditions = cell.conditions;
    if (conditions.mode != "paced" || conditions.graph != figure.graph || conditions.size == 0 ||
        conditions.ordered != figure.ordered ||
        (!figure.wait.empty() && conditions.wait != figure.wait) || is_profiled(cell) ||
        boxes_of(cell, figure).empty()) {
      continue;
    }
    candidates.push_back(&cell);
  }
  const std::string needs = "paced cells of " + figure.graph +
                            (figure.wait.empty() ? "" : ", --wait " + figure.wait + ",") +
                            (figure.ordered ? ", ordered," : "");
  std::string names;
  for (const std::string& name : figure.transports) names += (names.empty() ? "" : ", ") + name;
  if (candidates.empty()) {
    why_not = "needs " + needs + " with " + names;
    return std::nullopt;
  }
  const CellPointers cells = best_setting(candidates, figure.series, [&](const CellPointers& part) {
    std::set<std::pair<std::size_t, std::size_t>> shown;
    for (const Cell* cell : part) {
      for (const CellBox& box : boxes_of(*cell, figure)) {
        shown.emplace(cell->conditions.size, box.order);
      }
    }
    return shown.size();
  });

  Boxes result;
  const Conditions& conditions = cells.front()->conditions;
  result.setting = setting_word(conditions, figure.series);
  result.floor_name = conditions.wait == "spin" ? kFloorSpin : kFloorFutex;
  std::map<std::size_t, BoxSeries> series;
  for (const Cell* cell : cells) {
    const std::size_t size = cell->conditions.size;
    for (CellBox& box : boxes_of(*cell, figure)) {
      BoxSeries& one = series[box.order];
      one.label = box.label;
      Summary& kept = one.boxes[size];
      if (kept.count < box.summary.count) kept = box.summary;
    }
    if (const StreamResult* floor = find(*cell, result.floor_name, "")) {
      const Summary summary = summarise(latencies(*floor, Stamp::Fill));
      // Of the series' cells (pins, places) the best: a bound for all of them.
      if (summary.count != 0) {
        const auto [known, fresh] = result.floor.try_emplace(size, summary.median);
        if (!fresh) known->second = std::min(known->second, summary.median);
      }
    }
  }
  if (series.size() < 2) {
    const char* const kind = figure.series == Series::Place       ? "two placements"
                             : figure.series == Series::Pin       ? "two ways to pin"
                             : figure.series == Series::Transport ? "two of these transports"
                             : figure.series == Series::Publisher ? "two publishers"
                                                                  : "two subscribers";
    why_not = "needs " + needs + " with " + names + ": " + kind + " or more";
    return std::nullopt;
  }
  std::size_t k = 0;
  for (auto& [order, one] : series) {
    one.colour = figure.series == Series::Transport
                     ? colour_of(figure.transports[order])
                     : shade_of(figure.transports.front(), k++, series.size());
    result.series.push_back(std::move(one));
  }
  if (figure.series == Series::Transport) {
    for (std::size_t t = 0; t < figure.transports.size(); ++t) {
      if (!series.contains(t)) result.absent.push_back(figure.transports[t]);
    }
  }
  return result;
}

Range range_of(const Boxes& boxes) {
  Range range;
  for (const BoxSeries& series : boxes.series) {
    for (const auto& [size, summary] : series.boxes) {
      range.add(summary.p1);
      range.add(summary.p99);
    }
  }
  for (const auto& [size, median] : boxes.floor) range.add(median);
  return range;
}

std::string draw_boxes(const BoxFigure& figure, const Boxes& boxes, Range range,
                       const std::string& machine, const fs::path& dir) {
  std::set<std::size_t> sizes;
  for (const BoxSeries& series : boxes.series) {
    for (const auto& [size, summary] : series.boxes) sizes.insert(size);
  }
  const double width = 0.86 / static_cast<double>(boxes.series.size());
  const double box = 0.86 * std::min(width, 0.3);
  std::ostringstream data;
  std::ostringstream plot;
  data << "# " << figure.title << "; " << boxes.setting << "; " << machine << "\n"
       << "# Latency from fill to callback in microseconds.\n";
  for (std::size_t s = 0; s < boxes.series.size(); ++s) {
    const BoxSeries& series = boxes.series[s];
    data << (s == 0 ? "" : "\n\n") << "# " << series.label
         << "\n# x\tsize_bytes\tcount\tmin\tp1\tp25\tmedian\tp75\tp99\tmax\n";
    std::size_t i = 0;
    for (const std::size_t size : sizes) {
      const double x =
          static_cast<double>(i++) +
          (static_cast<double>(s) - static_cast<double>(boxes.series.size() - 1) / 2) * width;
      const auto found = series.boxes.find(size);
      if (found == series.boxes.end()) continue;
      const Summary& it = found->second;
      data << x << '\t' << size << '\t' << it.count;
      for (const double value : {it.min, it.p1, it.p25, it.median, it.p75, it.p99, it.max}) {
        data << '\t' << value;
      }
      data << '\n';
    }
    const std::string from = "'" + figure.name + ".tsv' index " + std::to_string(s);
    plot << (s == 0 ? "plot " : ", \\\n  ") << from
         << " using 1:6:5:9:8 with candlesticks whiskerbars 0.5 fillstyle solid 1 border "
            "linecolor '#303030' fillcolor '"
         << series.colour << "' linecolor '" << series.colour << "' linewidth 1.2 title "
         << quoted(series.label) << ", \\\n  " << from << " using ($1-" << box / 2 << "):7:(" << box
         << "):(0) with vectors nohead linecolor '#101010' linewidth 2.4 notitle";
  }
  if (!boxes.floor.empty()) {
    data << "\n\n# " << boxes.floor_name << ": x\tsize_bytes\tmedian\n";
    std::size_t i = 0;
    for (const std::size_t size : sizes) {
      const auto floor = boxes.floor.find(size);
      if (floor != boxes.floor.end()) {
        data << static_cast<double>(i) - 0.46 << '\t' << size << '\t' << floor->second << '\n';
      }
      ++i;
    }
    plot << ", \\\n  '" << figure.name << ".tsv' index " << boxes.series.size()
         << " using 1:3:(0.92):(0) with vectors nohead linecolor '#707070' linewidth 1.6 "
            "dashtype (4,3) title "
         << quoted(boxes.floor_name);
  }
  std::ostringstream body;
  body << frame(figure.title, boxes.setting + "  ·  " + machine) << time_axis(range)
       << "set ylabel 'latency, fill to callback'\n"
       << "set xlabel 'message size'\n"
       << "set lmargin at screen 0.095\nset rmargin at screen 0.985\n"
       << "set bmargin at screen " << (boxes.series.size() > 6 ? 0.22 : 0.19)  // rows of the key
       << "\nset tmargin at screen 0.86\n"
       << "set xrange [-0.6:" << static_cast<double>(sizes.size()) - 0.4 << "]\n"
       << "set boxwidth " << box << "\nset xtics scale 0 font ',14' (";
  std::size_t i = 0;
  for (const std::size_t size : sizes) {
    body << (i == 0 ? "" : ", ") << quoted(size_word(size)) << ' ' << i;
    ++i;
  }
  body << ")\n" << plot.str() << '\n';
  write_file(dir / (figure.name + ".tsv"), data.str());
  write_file(dir / (figure.name + ".gp"), script_of(figure.name, 1120, 640, body.str()));
  std::string line = drawn_line(dir, figure.name, figure.title);
  const char* before = "; without ";
  for (const std::string& name : boxes.absent) {
    line += before + name;
    before = ", ";
  }
  return line;
}

}  // namespace

std::string setting_word(const Conditions& conditions, Series series) {
  std::string word = conditions.wait;
  if (series != Series::Place) word += ", " + conditions.place;
  if (series != Series::Pin) word += ", pin " + conditions.pin;
  word += conditions.pool == 0 ? ", no pool" : ", pool of " + std::to_string(conditions.pool);
  char rate[32];
  std::snprintf(rate, sizeof rate, ", %g Hz", conditions.rate_hz);
  return word + rate;
}

std::vector<std::string> draw_box_figures(const Run& run, const std::string& machine,
                                          const fs::path& figures) {
  std::vector<std::pair<const BoxFigure*, Boxes>> ready;
  std::map<std::string, Range> ranges;
  std::vector<std::string> lines;
  for (const BoxFigure& figure : box_figures()) {
    std::string why_not;
    std::optional<Boxes> boxes = collect(run, figure, why_not);
    if (!boxes) {
      lines.push_back(left_out(figures, figure.name, why_not));
      continue;
    }
    const Range own = range_of(*boxes);
    ranges[figure.scale].add(own.low);
    ranges[figure.scale].add(own.high);
    ready.emplace_back(&figure, std::move(*boxes));
  }
  for (const auto& [figure, boxes] : ready) {
    lines.push_back(draw_boxes(*figure, boxes, ranges[figure->scale], machine, figures));
  }
  return lines;
}

}  // namespace ab
