// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>

#include "tool/tempo.hpp"

namespace lot::tool {

/// Tells the rate that a queue has now: Tempo over the arrivals of the last seconds.
///
/// A screen that stays can not use one interval: a topic of 0.1 Hz has nothing in most of them. So
/// Pace keeps what it saw in the last kSpan seconds, and always the last kFewest looks that found
/// something, however long that took. A publisher that halts has no rate any more. What it sent
/// before says nothing about what it sends when it goes on, nor does what it then sends at once:
/// that may have piled up. Only looks that found nothing show a halt: the tool itself may have been
/// stopped between two of them.
///
/// Threads: one.
/// Memory:  an entry for each look of the last kSpan seconds that found messages.
class Pace {
 public:
  static constexpr double kSpan = 5;
  static constexpr std::size_t kFewest = 4;

  /// Seconds, of any clock that does not jump.
  explicit Pace(double begin) : begin_(begin), looked_(begin) {}

  /// At this moment `n` more messages are there than at the last call.
  void see(double at, std::uint64_t n) {
    const double before = std::exchange(looked_, at);
    if (n == 0) return;
    const bool goes_on = has_halted(before);
    if (goes_on) {
      arrivals_.clear();
      begin_ = at;
    }
    arrivals_.push_back({at, goes_on ? 1 : n});
    while (arrivals_.size() > kFewest && at - arrivals_[1].at >= kSpan) {
      begin_ = arrivals_.front().at;
      arrivals_.pop_front();
    }
  }

  Rate rate(double now) const {
    if (has_halted(now)) {
      const double silence = now - arrivals_.back().at;
      return {{}, 1 / silence, 0, silence};
    }
    Tempo tempo(begin_);
    for (const auto& arrival : arrivals_) tempo.see(arrival.at, arrival.n);
    Rate rate = tempo.rate(now);
    // Over a few seconds the mean of an uneven publisher says more than a bound.
    if (!rate.per_second && arrivals_.size() > 1 &&
        arrivals_.back().at - arrivals_.front().at >= kSpan / 2) {
      rate.per_second = tempo.mean();
      if (rate.per_second) rate.below.reset();
    }
    if (now - begin_ < kShortestLook) rate.below.reset();
    return rate;
  }

 private:
  struct Arrival {
    double at;
    std::uint64_t n;
  };
  static constexpr std::size_t kRhythm = 3;  ///< fewer arrivals have none
  static constexpr double kPauses = 3;       ///< so many times the longest pause is a halt
  static constexpr double kShortestHalt = 1;
  static constexpr double kShortestLook = 0.3;  ///< a bound of less says nothing

  bool has_halted(double now) const {
    if (arrivals_.size() < kRhythm || now - arrivals_.back().at <= kShortestHalt) return false;
    double pause = 0;
    for (std::size_t i = 1; i < arrivals_.size(); ++i) {
      pause = std::max(pause, arrivals_[i].at - arrivals_[i - 1].at);
    }
    return now - arrivals_.back().at > kPauses * pause;
  }

  double begin_;
  double looked_;
  std::deque<Arrival> arrivals_;
};

}  // namespace lot::tool
