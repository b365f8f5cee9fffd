// SPDX-License-Identifier: Apache-2.0
#include "rivals.hpp"

#include <algorithm>
#include <functional>
#include <utility>

#include "measures.hpp"
#include "report.hpp"

namespace ab {
namespace {

constexpr std::size_t kFrame = 16 << 20;

/// Of one publisher and one subscriber on the host. Several names are one rival in two shapes, of
/// which the better one counts.
struct Limit {
  std::vector<std::string> names;
  std::function<bool(const Conditions&)> holds;
  const char* floor;  ///< in floors of the same cell; null: in milliseconds
  double most;
};

const std::vector<Limit>& limits() {
  const auto parked = [](const Conditions& c) { return c.mode == "paced" && c.wait == "park"; };
  static const std::vector<Limit> all{
      // The stack that the paper describes, run by its authors' rules: 35 us where the floor had 33.
      {{"lot2021", "lot2021-direct"},
       [=](const Conditions& c) { return parked(c) && c.pool > 0 && c.pin == "none"; },
       kFloorFutex,
       1.15},
      // 7.6 ms and 5.0 ms on two cores of a machine like those that robots have.
      {{"tcp"}, [=](const Conditions& c) { return parked(c) && c.size == kFrame; }, nullptr, 8},
      {{"uds"}, [=](const Conditions& c) { return parked(c) && c.size == kFrame; }, nullptr, 5.5},
      // 1.6 us where a line took 0.143 us.
      {{"iceoryx"}, [](const Conditions& c) { return c.wait == "spin"; }, kFloorSpin, 12},
  };
  return all;
}

struct Reached {
  double value;
  RivalCheck check;
};

void look(const Cell& cell, const Limit& limit, std::vector<RivalCheck>& all) {
  const Conditions& c = cell.conditions;
  if (c.graph != "1p1s" || c.place != "host" || c.mode == "throughput" || !limit.holds(c)) return;
  std::vector<Reached> shapes;
  for (const std::string& name : limit.names) {
    const StreamResult* stream = find(cell, name, "");
    if (stream == nullptr) continue;
    const Blocks own = compared(*stream, Stamp::Fill);
    Reached shape{0, {name, title_of(c), "", "", false}};
    if (limit.floor != nullptr) {
      const StreamResult* floor = find(cell, limit.floor, "");
      if (floor == nullptr) continue;
      const auto ratio = ratio_of_quantiles(own, compared(*floor, Stamp::Fill), 0.5);
      if (!ratio) continue;
      shape.value = ratio->ratio;
      shape.check.reached = ratio_word(*ratio) + " " + limit.floor;
      shape.check.limit = number(limit.most) + " " + limit.floor;
    } else {
      const Summary summary = summarise(own);
      if (summary.count == 0) continue;
      shape.value = summary.median / 1000;
      shape.check.reached = number(shape.value) + " ms";
      shape.check.limit = number(limit.most) + " ms";
    }
    shape.check.good = shape.value <= limit.most;
    shapes.push_back(std::move(shape));
  }
  const auto best =
      std::min_element(shapes.begin(), shapes.end(),
                       [](const Reached& a, const Reached& b) { return a.value < b.value; });
  if (best != shapes.end()) all.push_back(std::move(best->check));
}

}  // namespace

std::vector<RivalCheck> check_rivals(const Run& run) {
  std::vector<RivalCheck> all;
  for (const Limit& limit : limits()) {
    for (const Cell& cell : run.cells) look(cell, limit, all);
  }
  return all;
}

}  // namespace ab
