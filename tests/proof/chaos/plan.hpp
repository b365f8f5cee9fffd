// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <vector>

#include "lot/options.hpp"

#include "board.hpp"
#include "random.hpp"
#include "settings.hpp"
#include "topics.hpp"

/// What the seed decides.
namespace lot::chaos {

/// What a name does, in all its lives. Parameters differ from life to life.
enum class Role : std::uint8_t {
  Publish,
  Read,
  Observe,
  Sleep,
  Relay,
  Annotate,
  Juggle,
  Put,
  Take,
  Finish,
  Retype
};

struct Part {
  Role role;
  std::uint32_t from;
  std::uint32_t to;
};
Part part_of(unsigned slot);

/// How a life ends.
struct Fate {
  enum class End : std::uint8_t { Kill, Leave, Spared };
  End end;
  std::chrono::nanoseconds at;
  /// Killed when it is seen to do this, or a little later than `at`, whichever comes first.
  std::optional<Doing> aim;
  bool killed_while_leaving;  ///< so long after it was told to leave:
  std::chrono::nanoseconds leave_for;
  bool stopped;  ///< SIGSTOP at `stop_at`; then SIGCONT after `stop_for`, or SIGKILL while stopped
  bool killed_while_stopped;
  std::chrono::nanoseconds stop_at;
  std::chrono::nanoseconds stop_for;
};
inline constexpr std::chrono::milliseconds kFirstMoments{12};
Fate fate_of(std::uint64_t seed, unsigned slot, std::uint32_t life, bool spared);

/// A time between two audits of what is left.
struct EpochPlan {
  enum class End : std::uint8_t {
    KillAll,     ///< then one more comes, repairs, and leaves
    LeaveAll,    ///< the last one removes the files
    Mixed,       ///< some are killed while others leave; then one more comes and leaves
    Witnessed,   ///< the same, but that one is there before
    KillAndGoOn  ///< all are killed, and the next epoch begins in what they left
  };
  unsigned kills;
  unsigned calms;                ///< checkpoints with everybody alive, evenly spread
  std::vector<unsigned> spared;  ///< these live as long as the epoch
  End end;
  std::uint64_t size_bytes;
  std::uint32_t blocks;
  std::uint32_t processes;
  bool roomy;
};
EpochPlan epoch_plan(const Settings& settings, std::uint64_t epoch);

/// How a publisher of a topic behaves in this life.
struct Publishing {
  QueueEngine engine;
  Policy policy;
  std::uint32_t depth;
  std::uint32_t history;  ///< where memory runs out
  std::chrono::nanoseconds block_for;
  bool refuses;             ///< never waits, whether its policy is Refuse or it tries
  std::size_t reserved;     ///< messages of kReserved bytes
  std::uint64_t max_bytes;  ///< 0: as the library chooses
  bool in_slots;            ///< its messages travel in their slots, if they are plain
  bool is_lossless() const { return policy != Policy::Overwrite; }
};
Publishing publishing(Random& random, std::uint32_t topic);
inline constexpr std::size_t kReserved = 16 << 10;
PusherOptions pusher_options(const Publishing& plan);

/// How a subscription behaves in this life.
struct Reading {
  enum class Style : std::uint8_t { Borrow, TryBorrow, Pull, TryPull };
  Style style;
  PullerOptions options;
  std::chrono::nanoseconds patience;  ///< of a waiting look
  bool sleeps_long;                   ///< waits until something comes: a wake-up must not be lost
  unsigned keep_percent;
  unsigned most_kept;
  unsigned weak_percent;
  unsigned linger_percent;  ///< of borrows that are held for a while
  std::chrono::nanoseconds longest_linger;
  unsigned rejoin_percent;  ///< of turns that subscribe anew
};
Reading reading(Random& random, Role role);

/// How long a look waits that is not to end by itself, and when its message is much too late.
inline constexpr std::chrono::seconds kLongSleep{5};
inline constexpr std::chrono::seconds kMuchTooLate{4};

/// Words of payload of the next frame: mostly small, big ones now and then.
std::uint64_t frame_words(Random& random);

}  // namespace lot::chaos
