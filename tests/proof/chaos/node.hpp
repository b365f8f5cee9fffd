// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include "lot/lot.hpp"

#include "life.hpp"

namespace lot::chaos {

/// One life of a node, in its own process: its exit status.
int run_node(Board& board, const Settings& settings, const Epoch& epoch, unsigned slot);

/// The one that leaves last: repairs what all the others left, sees that nothing is left besides
/// itself, and leaves.
int run_last(Board& board, const Settings& settings, const Epoch& epoch);

void open_engine(Life& life, std::optional<ShmEngine>& engine);

}  // namespace lot::chaos
