// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "result.hpp"

/// How a figure finds its cells: all of one setting, the one with the most to show.
namespace ab {

/// What the boxes of one size differ in.
enum class Series { Transport, Place, Pin, Subscriber, Publisher };

/// In the order in which figures show them; the last placement and way to wait are the paper's.
inline const std::vector<std::string> kPlaces{"host", "container", "containers"};
inline const std::vector<std::string> kPins{"none", "same-core", "other-core", "socket",
                                            "other-socket"};
inline const std::vector<std::string> kWaits{"spin", "adaptive", "park"};

/// The place of a word; the size if it is not there.
inline std::size_t rank_in(const std::vector<std::string>& order, const std::string& word) {
  return static_cast<std::size_t>(std::find(order.begin(), order.end(), word) - order.begin());
}

/// What must be the same in all cells of a figure whose series are those.
inline Conditions setting_of(Conditions conditions, Series series) {
  conditions.size = 0;
  conditions.messages = 0;
  conditions.block = 0;
  if (series == Series::Place) conditions.place.clear();
  if (series == Series::Pin) conditions.pin.clear();
  return conditions;
}

/// Of two settings with as much to show: parked, containers of their own, not pinned, with a pool,
/// as in the paper.
inline auto preference(const Conditions& setting) {
  return std::tuple(rank_in(kWaits, setting.wait), rank_in(kPlaces, setting.place),
                    setting.pin == "none", setting.pool > 0, setting.fill);
}

using CellPointers = std::vector<const Cell*>;

/// Parts cells by their setting and returns the part with the most to show; `worth` counts that.
template <typename Worth>
CellPointers best_setting(const CellPointers& cells, Series series, const Worth& worth) {
  std::vector<std::pair<Conditions, CellPointers>> parts;
  for (const Cell* cell : cells) {
    const Conditions setting = setting_of(cell->conditions, series);
    auto part = std::find_if(parts.begin(), parts.end(),
                             [&](const auto& known) { return known.first == setting; });
    if (part == parts.end()) part = parts.insert(parts.end(), {setting, {}});
    part->second.push_back(cell);
  }
  const CellPointers* best = nullptr;
  std::optional<decltype(std::tuple(std::size_t{}, preference({})))> best_worth;
  for (const auto& [setting, part] : parts) {
    const auto part_worth = std::tuple(worth(part), preference(setting));
    if (best_worth && *best_worth >= part_worth) continue;
    best_worth = part_worth;
    best = &part;
  }
  return best == nullptr ? CellPointers{} : *best;
}

/// What the cells of a figure have in common, for its subtitle.
std::string setting_word(const Conditions&, Series);

}  // namespace ab
