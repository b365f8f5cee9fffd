// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <random>
#include <thread>
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

/// Whether something that helps in some waits only is tried: where that has been of use lately.
/// Where it has not, it is tried in a few waits, to find out when things have changed; by chance,
/// since waits may come in a rhythm, and both ends of a ping-pong must try in the same round. One
/// thread at a time.
class Habit {
 public:
  /// Asked once in each wait.
  bool worthwhile() noexcept { return in_vain_ < kPatience || random_() % kWaitsPerTrial == 0; }

  /// What came of it.
  void tried(bool was_of_use) noexcept {
    if (was_of_use) {
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

  static constexpr unsigned kPatience = 4;
  static constexpr unsigned kWaitsPerTrial = 16;

  unsigned in_vain_ = 0;  ///< in succession
  std::minstd_rand random_{seed()};
};

/// Whether one who has to wait spins before it sleeps, and for how long: what `Wait` means.
///
/// Adaptive spins a little longer than what a wake-up across cores costs, and only where that has
/// been of use lately: who waits for the next frame of a camera, or for somebody who needs this
/// very core to go on, would spin in vain each time.
class SpinHabit {
 public:
  explicit SpinHabit(Wait wait)
      : wait_(wait == Wait::Adaptive && !has_several_cores() ? Wait::Park : wait) {}

  /// Asked once in each wait.
  bool worthwhile() noexcept {
    return wait_ == Wait::Adaptive ? habit_.worthwhile() : wait_ == Wait::Spin;
  }

  /// True when it is time to sleep.
  bool enough(futex::Clock::duration spun) const noexcept {
    return wait_ == Wait::Adaptive && spun >= kSpinTime;
  }

  /// How long one has spun until it came to something, or enough. (Held up for longer, somebody
  /// else may have needed the core.)
  void spun(futex::Clock::duration time) noexcept { habit_.tried(!enough(time)); }

 private:
  static constexpr auto kSpinTime = std::chrono::microseconds(50);

  Wait wait_;
  Habit habit_;
};

/// Letting others have the core, before one sleeps: where the other end of a stream needs this very
/// core, that gets on with many messages, and nobody has to be woken for each few. Where somebody
/// else has the core then, for long, it is in vain, as where nobody wants it.
class YieldHabit {
 public:
  /// Asked once in each wait.
  bool worthwhile() noexcept { return habit_.worthwhile(); }

  /// How long the core was away. Touches nothing of the habit: threads of one pusher do this at
  /// once, without the lock that they have for all else.
  static futex::Clock::duration yield() noexcept {
    const auto start = futex::Clock::now();
    std::this_thread::yield();
    return futex::Clock::now() - start;
  }
  /// Whether there was what is waited for, after a yield of so long; hands that back.
  bool found(bool is_there, futex::Clock::duration away) noexcept {
    habit_.tried(is_there && away < kLong);
    return is_there;
  }

 private:
  static constexpr auto kLong = std::chrono::microseconds(500);  ///< others' slices are longer

  Habit habit_;
};

}  // namespace lot::transport
