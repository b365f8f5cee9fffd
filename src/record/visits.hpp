// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>

namespace lot::record {

/// Decides how the observer hears of a topic's messages. Either it sleeps on the topic's queues:
/// then each push wakes it, and its publisher pays for that. Or it visits them by a timer, and
/// publishers pay nothing. It visits a topic that is steady and slow for its queues, so that a
/// visit comes long before they are full (docs/record.md).
///
/// Threads: one.
class Visits {
 public:
  static constexpr std::chrono::milliseconds kEvery{2};   ///< between two visits
  static constexpr std::chrono::milliseconds kSpan{100};  ///< between two decisions
  static constexpr std::chrono::seconds kQuiet{2};        ///< without a message: it sleeps again
  static constexpr std::chrono::seconds kWary{60};        ///< it only sleeps after a sudden burst
  static constexpr std::uint64_t kShare = 8;  ///< a visit finds at most that part of a queue

  /// A look has taken so many messages, and so many were missed before them.
  void took(std::uint64_t messages, std::uint64_t missed) noexcept {
    seen_ += messages;
    most_ = std::max(most_, messages + missed);
  }

  /// Once in each kSpan. `depth`: of the topic's smallest queue.
  void decide(std::uint32_t depth) noexcept {
    const bool was_sudden = visits_ && most_ > depth / 2;
    wary_ = was_sudden ? kWary / kSpan : wary_ - std::min<std::uint64_t>(wary_, 1);
    quiet_ = seen_ != 0 ? 0 : quiet_ + 1;
    const std::uint64_t most_in_a_span = depth * std::uint64_t{kSpan / kEvery} / kShare;
    const bool is_steady = seen_ != 0 || (visits_ && quiet_ < kQuiet / kSpan);
    visits_ = wary_ == 0 && is_steady && seen_ <= most_in_a_span;
    seen_ = 0;
    most_ = 0;
  }

  /// As it was decided last.
  bool by_timer() const noexcept { return visits_; }

 private:
  std::uint64_t seen_ = 0;   ///< messages since the last decision
  std::uint64_t most_ = 0;   ///< of one look since then
  std::uint64_t quiet_ = 0;  ///< decisions since the last message
  std::uint64_t wary_ = 0;   ///< decisions until it may visit again
  bool visits_ = false;
};

}  // namespace lot::record
