// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "audit.hpp"
#include "board.hpp"

namespace lot::chaos {

/// Items that are neither in their queue nor taken, and which takers may have been killed with them
/// in hand.
///
/// A taker that is killed between the take and its mark takes one item along. So each item without
/// a mark needs a killed taker of its own, that was over a take of this queue at a moment when the
/// item may have been in it: after its put began, and before room was made for the item that takes
/// its slot. More missing items than that are lost.
class Hands {
 public:
  explicit Hands(Board& board) : board_(board) {}

  /// A node's process is gone, however it ended.
  void ended(unsigned slot);
  /// When no node puts and no living one is over a take: a missing item that no killed taker is
  /// left for, or "". The living takers must take what a living putter has put.
  std::string unexplained(const Living& living) const;
  /// What is missing now stays missing; returns how many that are.
  std::uint32_t write_off(const Living& living);
  std::uint32_t seen() const { return seen_; }
  /// Takers that were killed over a take of this queue, since its segment was made.
  std::uint32_t seen_in_segment(std::uint32_t topic) const { return seen_in_segment_[topic]; }
  /// A new segment.
  void forget() { seen_in_segment_ = {}; }

 private:
  struct Time {
    std::int64_t from, to;
  };
  struct Hand {
    std::uint32_t topic;
    Time time;
  };
  struct Missing {
    std::uint32_t incarnation;
    std::uint64_t number;
    Time time;  ///< within which it was taken
  };
  std::vector<Missing> missing(const Living& living) const;
  /// Gives the item a hand, if need be one that another item can do without.
  bool explain(const std::vector<Missing>& missing, std::size_t item,
               std::vector<std::optional<std::size_t>>& item_of, std::vector<bool>& tried) const;
  std::string describe(const Missing& m) const;

  Board& board_;
  std::vector<Hand> hands_;
  std::uint32_t seen_ = 0;
  std::array<std::uint32_t, kTopics> seen_in_segment_{};
};

}  // namespace lot::chaos
