// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <string>

#include "lot/detail/mutex.hpp"

namespace lot::gateway {

/// What became of a route's messages.
struct Counts {
  std::uint64_t carried = 0;
  std::uint64_t bytes = 0;    ///< of CDR, of those
  std::uint64_t missed = 0;   ///< overwritten before the route looked
  std::uint64_t before = 0;   ///< pushed before the route knew their publisher
  std::uint64_t lost = 0;     ///< DDS, or the segment, had no room; or the network lost them
  std::uint64_t refused = 0;  ///< by a limit, or of another type
  std::uint64_t damaged = 0;  ///< could not be encoded, or decoded
  std::uint64_t looped = 0;   ///< were a gateway's own
  std::uint64_t unheard = 0;  ///< were not encoded, since nobody in the domain read the topic
  bool has_ended = false;     ///< the route does nothing more: its topic has gone, or changed
  std::string error;          ///< the last one
};

/// The counts that are numbers.
inline constexpr std::array<std::uint64_t Counts::*, 9> kNumbers = {
    &Counts::carried, &Counts::bytes,   &Counts::missed, &Counts::before, &Counts::lost,
    &Counts::refused, &Counts::damaged, &Counts::looped, &Counts::unheard};

/// Counts, while the route's thread works and others look.
///
/// Threads: all members may be called at once.
/// Errors:  std::bad_alloc of went_wrong() and told().
class Tally {
 public:
  void add(std::uint64_t Counts::*count, std::uint64_t n = 1) {
    const std::lock_guard guard(mutex_);
    counts_.*count += n;
  }
  void carried(std::uint64_t bytes) {
    const std::lock_guard guard(mutex_);
    ++counts_.carried;
    counts_.bytes += bytes;
  }
  /// carried() was said too early: DDS had no room.
  void was_lost(std::uint64_t bytes) {
    const std::lock_guard guard(mutex_);
    --counts_.carried;
    counts_.bytes -= bytes;
    ++counts_.lost;
  }
  /// Adds to `begin`, as kNumbers.
  std::array<std::uint64_t, kNumbers.size()> numbers(
      std::array<std::uint64_t, kNumbers.size()> begin) const {
    const std::lock_guard guard(mutex_);
    for (std::size_t i = 0; i < kNumbers.size(); ++i) begin[i] += counts_.*kNumbers[i];
    return begin;
  }
  void went_wrong(const char* what) {
    const std::lock_guard guard(mutex_);
    counts_.error = what;
  }
  void ended() {
    const std::lock_guard guard(mutex_);
    counts_.has_ended = true;
  }
  Counts told() const {
    const std::lock_guard guard(mutex_);
    return counts_;
  }

 private:
  mutable detail::Mutex mutex_{detail::Rank::Gateway};
  Counts counts_;
};

}  // namespace lot::gateway
