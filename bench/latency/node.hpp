// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "board.hpp"
#include "plan.hpp"

namespace ab {

/// What one publisher or subscriber does, from its start to the conductor's last order. Errors go
/// to its record on the board. Returns the exit status of its process.
int run_node(Board& board, const Plan& plan, unsigned node);

}  // namespace ab
