// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "result.hpp"

/// What the conditions of a cell mean, and which of them can be had here.
namespace ab {

/// A stream of a cell, before transports give it names.
struct Topic {
  std::string name;  ///< "" in a cell of one
  std::size_t size = 0;
  double rate_hz = 0;
  unsigned publishers = 1;
  unsigned subscribers = 1;
};

/// Why these conditions cannot be had: empty, or a sentence that names the option to change.
std::string refused(const Conditions& conditions);

bool is_scenario(const std::string& graph);

/// The topics of a graph: NpMs, av. Blocks are counted in messages of the first, which every arm
/// has.
std::vector<Topic> topics(const Conditions& conditions);

/// A scenario has each transport twice, taking turns: "ring", and beside it "ring quiet", which has
/// not got the topics that are there to disturb the others (the cameras).
std::vector<std::string> arms_of(const Conditions& conditions,
                                 const std::vector<std::string>& transports);
std::vector<Topic> topics_of(const Conditions& conditions, const std::string& arm);

/// The floors that a cell of these conditions has here, unless it is to have none.
std::vector<std::string> floors_of(const Conditions& conditions);

}  // namespace ab
