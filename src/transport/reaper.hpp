// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <chrono>
#include <cstdint>
#include <mutex>
#include <thread>

#include "lot/detail/mutex.hpp"
#include "lot/error.hpp"

#include "futex/futex.hpp"
#include "transport/membership.hpp"
#include "transport/pool.hpp"
#include "transport/world.hpp"

namespace lot::transport {

/// For so long another process may be reaping.
inline constexpr std::chrono::milliseconds kAnotherReaper{20};

/// Acts for the orphanage in the name of this process: reaps the dead and what this process leaves,
/// frees what the orphanage has and no process needs, takes over rings that this process has
/// closed.
///
/// Threads: all members may be called at once, but for what says "warden" or "joiner".
/// Crash:   each step may be repeated (Recovery). Memory that is too short for a step ends it as a
///          kill would: the next look does it all again.
class Reaper {
 public:
  Reaper(Membership& membership, World& world, const Holder& holder) noexcept
      : membership_(membership),
        lock_file_(membership.lock_file()),
        presence_(membership.presence()),
        segment_(membership.segment()),
        world_(world),
        holder_(holder) {}

  /// Membership::Repair for an index that this process has just taken. Joiner.
  bool repair_index(futex::Clock::time_point until) noexcept;
  /// What has become of the reap of this process.
  enum class Own { Reaped, Left, Lost };
  /// Reaps this process, which leaves. Left: another process has acted for the orphanage all the
  /// time, and will find this one dead. Lost: this process has been taken for dead, and nothing of
  /// its index is its own. Warden.
  Own reap_own(bool in_gate) noexcept;

  /// Reaps participant k if it is dead. False: it lives, or another thread or process is reaping.
  bool reap_if_dead(std::uint32_t k) noexcept;
  /// Reaps all dead participants. True when it has reaped one.
  bool reap_dead() noexcept;
  /// The same, for a process that has just joined: what died before is not in the way of its first
  /// calls. Waits a moment where another thread or process is reaping.
  void reap_all_dead() noexcept;
  /// Frees what the orphanage has and no process needs any more: rings without readers, dead
  /// messages. False when the orphanage had nothing.
  bool collect() noexcept;
  bool has_deserted_ring() noexcept;
  /// Takes a message out of the ended ring of a channel, and frees it where it is at home in no
  /// other process. Waits until then for its turn. False: it is not out.
  bool take_out(std::uint32_t channel, std::uint32_t block,
                futex::Clock::time_point until) noexcept;

  /// Marks a ring of this process as ended. Its readers get what is in it and then the end.
  void end_ring(const registry::ChannelName& name) noexcept;
  /// Gives the ended rings of this process to the orphanage. False: it could not just now.
  bool give_up_rings() noexcept;
  /// True when a ring of this process has ended, and the orphanage has it not yet.
  bool has_closing_rings() noexcept;
  /// True when the orphanage holds the ring's blocks, so that the holds of this process on them may
  /// go.
  bool ring_closed(const registry::ChannelName& name) const noexcept;

  /// Takes the own byte lock again after closefrom() or the like has dropped it. Other processes do
  /// not reap this one meanwhile, because its notice stands. With the byte back, they need not look
  /// at the notice. False: the next look tries again. Held while the lock file is opened: no_fork.
  /// Warden.
  bool keep_own_lock(detail::Mutex& no_fork) noexcept;

 private:
  std::uint32_t index() const noexcept { return membership_.index(); }
  bool looks_dead(std::uint32_t k) noexcept;
  bool has_dead() noexcept;
  bool is_closing(std::uint32_t channel) noexcept;
  bool enter_orphanage() noexcept;
  void leave_orphanage() noexcept;
  void tell_homes() noexcept;

  Membership& membership_;
  liveness::LockFile& lock_file_;
  liveness::Presence& presence_;
  segment::Segment& segment_;
  World& world_;
  const Holder& holder_;
  /// byte locks do not exclude threads of one process
  detail::Mutex reap_mutex_{detail::Rank::Reap};
  bool lock_lost_ = false;  ///< this process must lock its byte again; the warden's
};

/// Calls f. If f finds all places taken, it is called again after the dead have lost theirs.
template <class F>
void after_reaping(Reaper& reaper, F&& f) {
  const auto until = futex::Clock::now() + kAnotherReaper;
  for (;;) {
    try {
      f();
      return;
    } catch (const Error& e) {
      const bool full = e.error_number() == EUSERS || e.error_number() == ENOSPC;
      if (!full || futex::Clock::now() >= until) throw;
    }
    if (!reaper.reap_dead()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

}  // namespace lot::transport
