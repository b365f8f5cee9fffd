// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <random>
#include <unistd.h>

#include "lot/options.hpp"

#include "futex/futex.hpp"

namespace lot::waiting {

/// True when spinning can help: with one core the other side cannot move meanwhile.
inline bool has_several_cores() noexcept {
  // The affinity of this process does not count: processes that are each pinned to a core have the
  // more reason to spin.
  static const bool several = sysconf(_SC_NPROCESSORS_ONLN) > 1;
  return several;
}

/// Decides whether to try something that helps in some waits only. It is tried as long as it has
/// been of use lately. After that it is tried in a few waits only, to find out when things have
/// changed. Chance picks those waits: waits may come in a rhythm, and both ends of a ping-pong must
/// try in the same round.
///
/// Threads: one at a time.
class Habit {
 public:
  /// True: try it. Asked once in each wait.
  bool worthwhile() noexcept { return in_vain_ < kPatience || random_() % kWaitsPerTrial == 0; }

  /// Tells the habit what came of it.
  void tried(bool was_of_use) noexcept {
    if (was_of_use) {
      in_vain_ = 0;
    } else if (in_vain_ < kPatience) {
      ++in_vain_;
    }
  }

 private:
  /// A number that differs between two habits and between two processes.
  std::uint32_t seed() const noexcept {
    const auto now = static_cast<std::uintptr_t>(futex::Clock::now().time_since_epoch().count());
    return static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(this) ^ now);
  }

  static constexpr unsigned kPatience = 4;
  static constexpr unsigned kWaitsPerTrial = 16;

  unsigned in_vain_ = 0;  ///< how often in succession it was of no use
  std::minstd_rand random_{seed()};
};

/// Decides whether a thread that has to wait spins before it sleeps, and for how long: what `Wait`
/// means.
///
/// Adaptive spins a little longer than a wake-up across cores takes, and only where that has been
/// of use lately. A thread that waits for the next frame of a camera would spin for nothing each
/// time. So would a thread that waits for another one on the same core.
class SpinHabit {
 public:
  explicit SpinHabit(Wait wait)
      : wait_(wait == Wait::Adaptive && !has_several_cores() ? Wait::Park : wait) {}

  /// True: spin. Asked once in each wait.
  bool worthwhile() noexcept {
    return wait_ == Wait::Adaptive ? habit_.worthwhile() : wait_ == Wait::Spin;
  }

  /// True when it is time to sleep.
  bool enough(futex::Clock::duration spun) const noexcept {
    return wait_ == Wait::Adaptive && spun >= kSpinTime;
  }

  /// Tells the habit how long the thread has spun, with or without a result. A spin longer than
  /// enough() counts as useless, even with a result: another thread may have needed the core.
  void spun(futex::Clock::duration time) noexcept { habit_.tried(!enough(time)); }

 private:
  static constexpr auto kSpinTime = std::chrono::microseconds(50);

  Wait wait_;
  Habit habit_;
};

/// Decides whether a thread yields once before it sleeps, so that a peer on the same core can
/// process a batch, and needs fewer wake-ups. The thread stops yielding when it found nothing, or
/// when another task kept the core for 500 us.
class YieldHabit {
 public:
  /// True: yield. Asked once in each wait.
  bool worthwhile() noexcept { return habit_.worthwhile(); }

  /// Tells the habit whether the yield, which took the core `away` for so long, has brought what
  /// was waited for. Returns `is_there`.
  bool found(bool is_there, futex::Clock::duration away) noexcept {
    habit_.tried(is_there && away < kLong);
    return is_there;
  }

 private:
  /// Shorter than the time slices of other tasks.
  static constexpr auto kLong = std::chrono::microseconds(500);

  Habit habit_;
};

}  // namespace lot::waiting
