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

/// The topics of a graph: NpMs, av, av-quiet.
std::vector<Topic> topics(const Conditions& conditions);

/// The floors that a cell of these conditions has here, unless it is to have none.
std::vector<std::string> floors_of(const Conditions& conditions);

}  // namespace ab
