// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <random>
#include <unistd.h>

#include "lot/options.hpp"

#include "futex/futex.hpp"

namespace lot::transport {

/// Whether spinning can help: with one core the other side cannot move meanwhile.
inline bool has_several_cores() noexcept {
  // Not our own affinity: processes that are pinned to a core each have the more reason to spin.
  static const bool several = sysconf(_SC_NPROCESSORS_ONLN) > 1;
  return several;
}

/// Whether one who has to wait spins before it sleeps, and for how long: what `Wait` means.
///
/// Adaptive spins a little longer than what a wake-up across cores costs, and only where that has
/// been of use lately: who waits for the next frame of a camera, or for somebody who needs this
/// very core to go on, would spin in vain each time. Such a one spins in a few waits only, to find
/// out when things have changed; by chance, since waits may come in a rhythm, and both ends of a
/// ping-pong must try in the same round. One thread at a time.
class SpinHabit {
 public:
  explicit SpinHabit(Wait wait)
      : wait_(wait == Wait::Adaptive && !has_several_cores() ? Wait::Park : wait) {}

  /// Asked once in each wait.
  bool worthwhile() noexcept {
    if (wait_ != Wait::Adaptive) return wait_ == Wait::Spin;
    return in_vain_ < kPatience || random_() % kWaitsPerTrial == 0;
  }

  /// True when it is time to sleep.
  bool enough(futex::Clock::duration spun) const noexcept {
    return wait_ == Wait::Adaptive && spun >= kSpinTime;
  }

  /// How long one has spun until it came to something, or enough. (Held up for longer, somebody
  /// else may have needed the core.)
  void spun(futex::Clock::duration time) noexcept {
    if (!enough(time)) {
      in_vain_ = 0;
    } else if (in_vain_ < kPatience) {
      ++in_vain_;
    }
  }

 private:
  /// Not the same in two habits, nor in two processes.
  std::uint32_t seed() const noexcept {
    const auto now = static_cast<std::uintptr_t>(futex::Clock::now().time_since_epoch().count());
    return static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(this) ^ now);
  }

  static constexpr auto kSpinTime = std::chrono::microseconds(50);
  static constexpr unsigned kPatience = 4;
  static constexpr unsigned kWaitsPerTrial = 16;

  Wait wait_;
  unsigned in_vain_ = 0;  ///< spins in succession
  std::minstd_rand random_{seed()};
};

}  // namespace lot::transport
