// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <thread>

#include "lot/detail/core.hpp"

#include "futex/futex.hpp"
#include "segment/segment.hpp"
#include "transport/ahead.hpp"
#include "transport/eviction.hpp"
#include "transport/neighbours.hpp"
#include "transport/pool.hpp"
#include "transport/reaper.hpp"
#include "transport/stock.hpp"
#include "transport/warden_thread.hpp"
#include "transport/world.hpp"

namespace lot::transport {

/// Finds memory and blocks when they are short: first what is free or idle, in this process and in
/// the others, then what messages have that may go (Eviction), then what readers let go of.
///
/// Threads: all members may be called at once. The caller holds no lock that a warden takes.
/// Crash:   what was freed for a process that is killed is free for the others.
class Memory {
 public:
  /// What it searches.
  struct Parts {
    segment::Segment& segment;
    World& world;
    Holder& holder;
    Ahead& ahead;
    Eviction& eviction;
    Stock& stock;
    Reaper& reaper;
    Neighbours& neighbours;
    const WardenThread& warden;
  };
  explicit Memory(const Parts& parts) noexcept
      : segment_(parts.segment),
        world_(parts.world),
        holder_(parts.holder),
        ahead_(parts.ahead),
        eviction_(parts.eviction),
        stock_(parts.stock),
        reaper_(parts.reaper),
        neighbours_(parts.neighbours),
        warden_(parts.warden) {}

  segment::Segment& segment() noexcept { return segment_; }
  World& world() noexcept { return world_; }
  const Neighbours& neighbours() const noexcept { return neighbours_; }

  /// Claims a run of memory for a block of this process, for the publisher that has the block. The
  /// run gets the block's tag. It comes from the segment, or, when that is full, from what can be
  /// freed. Pool::kNoRun: there is none, and errno says why: 0, ENOSPC (the file system), EDQUOT
  /// (the publisher has all that PusherOptions::max_bytes gives it).
  std::uint32_t claim_run(std::uint32_t granules, std::uint32_t tag) noexcept;
  /// The same. A publisher that waits for readers does so here, if that can make room for the run.
  std::uint32_t await_run(std::uint32_t granules, std::uint32_t tag) noexcept;
  /// Frees what can be freed without giving up a message, for the publisher with this pool.
  void tidy(std::uint32_t asker) noexcept;
  /// Gives all unused memory back to the system at once, also what lies idle in pools of any
  /// process that answers.
  std::uint64_t give_all_back_to_system() noexcept;
  /// The longest run below `granules` that the publisher with this pool could have if all that may
  /// go for it went, to within a 16th. The file system is not asked for memory: it is assumed to
  /// have what is needed, or nothing (`is_full`).
  std::uint32_t longest_run(std::uint32_t asker, std::uint32_t granules, bool is_full) noexcept;

  /// Lets messages go, one after the other, in the order that Eviction gives, until enough() is
  /// true. True when enough() was. Messages of another process are asked for. A stopped process is
  /// waited for once, longer where no other process can make enough() true. It is then passed over
  /// until it answers. `need`: what the asker will have more, in bytes or blocks. `possible`: says
  /// whether these givers can make enough() true. It is asked again when one has refused.
  template <class Enough, class Possible>
  bool evict_until(Enough&& enough, std::uint32_t asker, std::uint64_t need, Shortage shortage,
                   Possible&& possible) noexcept {
    using What = Eviction::Step::What;
    Eviction::Givers givers = likely_givers();
    const auto until = futex::Clock::now() + kGivePatience;
    eviction_.look_at_others(shortage);
    if (!possible(givers)) return false;
    for (;;) {
      const Eviction::Step step = eviction_.evict(asker, need, shortage, givers);
      bool given = true;
      switch (step.what) {
        case What::Nothing:
          return false;
        case What::Given:
        case What::Left:
          break;
        case What::Ask:
          given = givers[step.from] = neighbours_.ask_to_give(step.from, step.request);
          if (given) reaper_.collect();  // the home of what they referred to may be the orphanage
          break;
        case What::TakeOut:
          given = givers[refcount::kOrphanage] = take_out(step.from, step.block);
          break;
      }
      if (given) stock_.trim(asker);  // what messages of others referred to comes home
      if (enough()) return true;
      // Or it lies idle in a third process, which has made it.
      if (given && step.what == What::Ask &&
          neighbours_.gather(enough) == Neighbours::Gathered::Enough) {
        return true;
      }
      if (step.what == What::Given) continue;
      const bool is_late = futex::Clock::now() >= until;
      if (is_late) givers = {};  // messages of this process may still be enough
      eviction_.look_at_others(shortage);
      if ((given && !is_late) || possible(givers)) continue;
      // Without that giver there is no room. If it was silent it may be slow, and not stopped.
      if (is_late || step.what != What::Ask || !neighbours_.is_silent(step.from)) return false;
      givers[step.from] = true;
    }
  }

  /// Frees what can be freed, and then lets messages go, until enough() is true. enough() tries to
  /// claim a run of so many granules for the publisher with this pool. True when enough() was. No
  /// message goes for a run that can never be had.
  ///
  /// REQUIRES: the caller holds no lock that a warden takes.
  template <class Enough>
  bool make_room_for_run(std::uint32_t granules, std::uint32_t asker, Enough&& enough) noexcept {
    if (granules > segment_.granules().count()) return false;
    tidy(asker);
    if (enough()) return true;
    const auto possible = [&](const Eviction::Givers& givers) {
      return eviction_.can_free_run(asker, granules, givers);
    };
    return gather_or_evict(enough, asker, segment::kGranule * granules, Shortage::Memory, possible);
  }

  /// Asks the other processes for what lies idle with them, and then lets messages go, until
  /// enough() is true. True when enough() was. Where neither helps it waits longer for the
  /// processes that have not answered: a busy machine runs their wardens late. The rest is
  /// evict_until()'s.
  template <class Enough, class Possible>
  bool gather_or_evict(Enough&& enough, std::uint32_t asker, std::uint64_t need, Shortage shortage,
                       Possible&& possible) noexcept {
    using Gathered = Neighbours::Gathered;
    const Gathered first = neighbours_.may_gather() ? neighbours_.gather(enough) : Gathered::Some;
    if (first == Gathered::Enough) return true;
    if (evict_until(enough, asker, need, shortage, possible)) return true;
    const auto patience =
        warden_.is_current() ? Neighbours::kAnswerPatience : Neighbours::kGiverPatience;
    return first == Gathered::Some && neighbours_.gather(enough, patience) == Gathered::Enough;
  }

  /// A publisher that waits for room in its queue waits for memory and blocks, too, while readers
  /// have yet to read what has them. It waits until search() says that it is done, or the patience
  /// has ended. look() is a small search, which asks no other process. True when one of them was.
  ///
  /// REQUIRES: may_await_readers().
  template <class Search, class Look>
  bool await_readers(Search&& search, Look&& look, std::uint32_t asker,
                     Shortage shortage) noexcept {
    const auto until = detail::after(eviction_.patience(asker));
    for (;;) {
      // Before the search, so that what they read meanwhile counts.
      eviction_.look_at_others(shortage);
      const bool more = eviction_.has_unread(shortage);
      if (search()) return true;
      auto now = futex::Clock::now();
      if (!more || now >= until) return false;
      const auto again = std::min(until, now + kReaderSearch);
      for (; now < again; now = futex::Clock::now()) {
        std::this_thread::sleep_until(std::min(again, now + kReaderLook));
        tidy(asker);
        if (look()) return true;
        while (eviction_.could_give(asker, shortage) != 0 && eviction_.give_up(asker)) {
          stock_.trim(asker);
          if (look()) return true;
        }
      }
    }
  }
  /// False for the warden, which must not wait: it watches the other processes.
  bool may_await_readers(std::uint32_t asker) noexcept {
    return !warden_.is_current() && eviction_.patience(asker).count() != 0;
  }

 private:
  static constexpr std::chrono::milliseconds kReaderLook{1};
  static constexpr std::chrono::milliseconds kReaderSearch{20};
  /// How long to wait for all givers together. Another process may be faster to take what was
  /// given.
  static constexpr std::chrono::seconds kGivePatience{1};

  bool make_room_in(Pool& pool, std::uint32_t granules) noexcept;
  /// All other participants but the silent ones (Neighbours::is_silent()). The warden has no
  /// givers: it must not wait.
  Eviction::Givers likely_givers() const noexcept;
  /// Takes a message out of the ended ring of a channel, and frees it. False: the message has not
  /// become free.
  bool take_out(std::uint32_t channel, std::uint32_t block) noexcept;

  segment::Segment& segment_;
  World& world_;
  Holder& holder_;
  Ahead& ahead_;
  Eviction& eviction_;
  Stock& stock_;
  Reaper& reaper_;
  Neighbours& neighbours_;
  const WardenThread& warden_;
};

}  // namespace lot::transport
