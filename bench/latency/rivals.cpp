// SPDX-License-Identifier: Apache-2.0
#include "rivals.hpp"

#include <algorithm>
#include <optional>
#include <utility>

#include "measures.hpp"
#include "report.hpp"

namespace ab {
namespace {

constexpr std::size_t kFrame = 16 << 20;

/// Several names are one rival in two shapes, of which the better one counts.
struct Limit {
  std::vector<std::string> names;
  bool (*holds)(const Conditions&);
  const char* floor;  ///< in floors of the same cell; null: in milliseconds
  double most;
};

bool is_paced(const Conditions& c) { return c.mode == "paced" && c.rate_hz == 30 && c.fill; }
bool is_parked(const Conditions& c) {
  return is_paced(c) && c.wait == "park" && c.pin == "none" && c.pool > 0;
}

const std::vector<Limit>& limits() {
  static const std::vector<Limit> all{
      // The paper's stack, with a pool of frames: 35 us where the floor had 33.
      {{"lot2021", "lot2021-direct"}, is_parked, kFloorFutex, 1.15},
      // 7.6 ms and 5.0 ms between two cores of a server.
      {{"tcp"}, [](const Conditions& c) { return is_parked(c) && c.size == kFrame; }, nullptr, 8},
      {{"uds"}, [](const Conditions& c) { return is_parked(c) && c.size == kFrame; }, nullptr, 5.5},
      // 1.6 us, polling, where a line between cores took 0.143 us.
      {{"iceoryx"},
       [](const Conditions& c) {
         return c.mode == "ping-pong" && c.wait == "spin" && c.pin == "other-core" && c.size == 128;
       },
       kFloorSpin,
       12},
  };
  return all;
}

struct Reached {
  double value;
  RivalCheck check;
};

std::optional<Reached> reached(const Cell& cell, const Limit& limit, const std::string& name) {
  const StreamResult* stream = find(cell, name, "");
  if (stream == nullptr) return std::nullopt;
  const Blocks own = compared(*stream, Stamp::Fill);
  if (summarise(own).count == 0) return std::nullopt;
  Reached shape{0, {name, title_of(cell.conditions), "", "", "yes"}};
  if (limit.floor == nullptr) {
    shape.value = summarise(own).median / 1000;
    shape.check.reached = number(shape.value) + " ms";
    shape.check.limit = number(limit.most) + " ms";
    if (shape.value > limit.most) shape.check.verdict = "NO";
    return shape;
  }
  const StreamResult* floor = find(cell, limit.floor, "");
  if (floor == nullptr) return std::nullopt;
  const auto ratio = ratio_of_quantiles(own, compared(*floor, Stamp::Fill), 0.5);
  if (!ratio) return std::nullopt;
  shape.value = ratio->ratio;
  shape.check.reached = ratio_word(*ratio) + " " + limit.floor;
  shape.check.limit = number(limit.most) + " " + limit.floor;
  if (ratio->ratio > limit.most) {
    shape.check.verdict = ratio->known && ratio->low > limit.most ? "NO" : "unclear";
  }
  return shape;
}

void look(const Cell& cell, const Limit& limit, std::vector<RivalCheck>& all) {
  const Conditions& c = cell.conditions;
  if (c.graph != "1p1s" || c.place != "host" || !limit.holds(c)) return;
  if (std::any_of(cell.arms.begin(), cell.arms.end(),
                  [](const Arm& arm) { return !arm.utilisation.empty(); })) {
    return;  // nodes that were interrupted for samples
  }
  std::vector<Reached> shapes;
  for (const std::string& name : limit.names) {
    auto shape = reached(cell, limit, name);
    if (!shape) return;  // the better one may be that which did not run
    shapes.push_back(std::move(*shape));
  }
  const auto best =
      std::min_element(shapes.begin(), shapes.end(),
                       [](const Reached& a, const Reached& b) { return a.value < b.value; });
  all.push_back(std::move(best->check));
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
