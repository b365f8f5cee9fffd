// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include "audit.hpp"
#include "board.hpp"
#include "hands.hpp"

namespace lot::chaos {

/// The file that a segment is in: another number when it was removed and made again.
std::uint64_t segment_file(const std::string& path);

/// What is wrong with the tasks in this segment when no node puts any more and the living have
/// looked for them, or "":
///  - each one whose put() said Ok, or that was delivered, is finished. Of one that was killed
///    around finish() that is not known; it may have been;
///  - deliveries that no worker has noted are of workers that were killed over a take.
/// With their putter or their worker no task is gone; the last process of a segment removes it with
/// all that waits there.
std::string unfinished(Board& board, const Hands& hands, const Living& living,
                       std::uint64_t segment);

}  // namespace lot::chaos
