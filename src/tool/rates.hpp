// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <map>
#include <utility>
#include <vector>

#include "tool/pace.hpp"
#include "tool/tempo.hpp"
#include "tool/window.hpp"

namespace lot::tool {

/// By {channel, generation}.
using Rates = std::map<std::pair<std::uint32_t, std::uint32_t>, Rate>;

/// Sees the messages of a segment come, in all queues whose publisher lives. `Told` says what that
/// means for the rate of a queue: Tempo or Pace.
///
/// Threads: one.
template <class Told>
class Meter {
 public:
  /// Watches the queues that are there now.
  explicit Meter(Window& window);

  /// Watches the queues that have come since, too, and forgets those that have gone.
  void find_queues();

  /// Notes what has come since the last look.
  void look();
  /// True when the rate of each queue is known.
  bool has_enough() const;
  Rates rates() const;

 private:
  struct Watched {
    std::uint32_t channel;
    std::uint32_t generation;
    std::uint32_t index;   ///< slot of the newest message
    std::uint64_t newest;  ///< its sequence
    Told told;
  };

  /// How many messages have come; the place goes on to the newest one.
  std::uint64_t arrivals(Watched& queue);

  Window& window_;
  std::vector<Watched> queues_;
  double now_ = 0;  ///< when it looked last
};
using RateMeter = Meter<Tempo>;  ///< for one look of a given length
using PaceMeter = Meter<Pace>;   ///< for a screen that stays

/// Looks at all windows until each rate is known: for 0.3 s at least, but never longer than
/// `at_most`. A null window has no rates.
std::vector<Rates> measure(const std::vector<Window*>& windows, std::chrono::milliseconds at_most);

}  // namespace lot::tool
