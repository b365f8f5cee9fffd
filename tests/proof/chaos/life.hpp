// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <csignal>
#include <cstdint>
#include <string_view>
#include <thread>
#include <unistd.h>

#include "board.hpp"
#include "message.hpp"
#include "random.hpp"
#include "settings.hpp"

namespace lot::chaos {

/// Set by SIGTERM, in the node's process.
extern volatile std::sig_atomic_t leave_requested;

/// How a node ends by itself.
inline constexpr int kLeft = 0;
inline constexpr int kFaulty = 3;    ///< it has reported what it found
inline constexpr int kNoRoom = 11;   ///< the segment is small on purpose, and full
inline constexpr int kStalled = 12;  ///< a deadline has passed while the machine stood still

/// One life of a node: what all parts of it need.
class Life {
 public:
  Life(Board& the_board, const Settings& the_settings, const Epoch& the_epoch, unsigned the_slot)
      : board(the_board),
        settings(the_settings),
        epoch(the_epoch),
        slot(the_slot),
        me(the_board.nodes[the_slot]),
        number(me.life.load()),
        random(Random::of(the_settings.seed, the_slot, number, 1)) {}

  Board& board;
  const Settings& settings;
  const Epoch& epoch;
  const unsigned slot;
  NodeRecord& me;
  const std::uint32_t number;  ///< how many times this name was started before, and this time
  Random random;

  /// Says what is to come; the supervisor sees that there is progress.
  void doing(Doing what, std::uint32_t topic = 0) {
    me.doing.store(static_cast<std::uint32_t>(what) << 16 | topic, std::memory_order_relaxed);
    me.beats.fetch_add(1, std::memory_order_relaxed);
  }
  void count(Count what, std::uint64_t n = 1) {
    me.counts[static_cast<std::size_t>(what)].fetch_add(n, std::memory_order_relaxed);
  }
  static std::int64_t now() {
    return std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
  }
  bool stopping() const { return leave_requested != 0; }
  Stage stage() const { return static_cast<Stage>(board.stage.load(std::memory_order_acquire)); }
  bool has(Plant plant) const { return settings.plant == plant; }
  bool has(Plant plant, unsigned percent) { return has(plant) && random.chance(percent); }

  /// Reports and ends the process at once, so that the segment stays as it was found.
  [[noreturn]] void fail(Finding finding, std::string_view text) {
    board.report(finding, slot, text);
    _exit(kFaulty);
  }
  /// A small segment may be full, a roomy one may not.
  void no_memory(const char* what) {
    count(Count::NoMemory);
    if (epoch.roomy) fail(Finding::Leaked, what);
  }

  std::uint64_t new_serial() { return std::uint64_t{slot} << 56 | me.serial.fetch_add(1); }
  std::uint32_t new_incarnation(std::uint32_t topic, std::uint32_t depth, bool blocking,
                                bool takes_back) {
    const std::uint32_t id = board.incarnations_begun.fetch_add(1);
    if (id >= kIncarnations) fail(Finding::Crashed, "the harness: too many incarnations");
    Incarnation& r = board.incarnations[id];
    r.topic = topic;
    r.slot = slot;
    r.life = number;
    r.depth = depth;
    r.blocking = blocking ? 1 : 0;
    r.takes_back = takes_back ? 1 : 0;
    if (is_put(topic)) r.putter = board.putters_begun.fetch_add(1);
    if (r.putter >= kPutters) fail(Finding::Crashed, "the harness: too many putters");
    auto& newest = board.newest[topic];
    r.before = newest.load();
    while (!newest.compare_exchange_weak(r.before, id)) {
    }
    r.state.store(Incarnation::Advertising, std::memory_order_release);
    return id;
  }
  bool lives(const Incarnation& r) const { return board.lives(r); }
  /// What this life writes beside what it has got.
  std::uint32_t mark() const { return number << 8 | (slot + 1); }
};

}  // namespace lot::chaos
