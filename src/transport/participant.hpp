// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

#include "lot/detail/core.hpp"
#include "lot/detail/mutex.hpp"
#include "lot/options.hpp"

#include "registry/registry.hpp"
#include "transport/ahead.hpp"
#include "transport/control_blocks.hpp"
#include "transport/eviction.hpp"
#include "transport/gate.hpp"
#include "transport/lifetime.hpp"
#include "transport/membership.hpp"
#include "transport/memory.hpp"
#include "transport/neighbours.hpp"
#include "transport/pointer_hub.hpp"
#include "transport/pool.hpp"
#include "transport/reaper.hpp"
#include "transport/rings.hpp"
#include "transport/rouser.hpp"
#include "transport/stock.hpp"
#include "transport/topics.hpp"
#include "transport/warden.hpp"
#include "transport/warden_thread.hpp"
#include "transport/world.hpp"
#include "waiting/hearing.hpp"
#include "waiting/notifier.hpp"

namespace lot::transport {

/// What one process (and one copy of the library) is in one segment: the units below, held together
/// for as long as a handle or a pointer needs them. Engines, pushers and pullers share it.
///
/// It runs two threads. The witness thread does nothing but end with the process
/// (liveness/death_notice.hpp). The other one is the Warden's. Ahead, the Rouser and Descriptors
/// each start one when they first need it.
///
/// Threads: all members may be called at once.
/// Crash:   what a participant leaves is found by its index and repaired by a reaper
///          (Recovery::reap()).
class Participant final : private Lifetime::Owner, public waiting::EarOwner {
 public:
  /// Joins the segment that the options name, or the environment. Where there is none, it is made;
  /// or ENOENT is thrown: then the caller is a visitor, whose options come before the environment.
  /// Throws lot::Error.
  static std::shared_ptr<Participant> join(EngineOptions options,
                                           IfAbsent if_absent = IfAbsent::Make);
  /// The participant that has mapped this address, or null.
  static Participant* at(const void* address) noexcept;
  /// The process is about to end, in the midst of its work. If it is the last one on a segment, the
  /// segment's files go. Nothing else is touched: other processes reap this one when it is dead.
  /// From then on no engine comes or goes, and fork() waits for the end. REQUIRES: watch_forks()
  /// before.
  static void remove_files() noexcept;
  /// From now on fork() leaves the child no held lock and no descriptor of this library.
  static void watch_forks() noexcept;

  Participant(const Participant&) = delete;
  Participant& operator=(const Participant&) = delete;

  std::uint32_t index() const noexcept { return holder_.own.self; }
  segment::Segment& segment() noexcept { return membership_.segment(); }
  std::uint32_t blocks() const noexcept { return world_.blocks(); }
  /// Throws lot::Error where the objects of this segment are inert (Membership::check_usable()).
  void check_usable() const { membership_.check_usable(); }
  bool inert() const noexcept { return membership_.is_inert(); }
  mutex_engine::QueueLock queue_lock(std::uint32_t channel) noexcept {
    return segment().queue_lock(channel, membership_.presence());
  }
  bool same_segment(const detail::ControlBlock& control) const noexcept {
    return hub_.same_segment(control);
  }
  bool was_received(const detail::ControlBlock& control) const noexcept {
    return holder_.was_received(control);
  }

  // The units.
  Membership& membership() noexcept { return membership_; }
  registry::Registry& registry() noexcept { return registry_; }
  World& world() noexcept { return world_; }
  const detail::Hub* hub() const noexcept { return &hub_; }
  Holder& holder() noexcept { return holder_; }
  Ahead& ahead() noexcept { return ahead_; }
  Rouser& rouser() noexcept { return rouser_; }
  waiting::Descriptors& descriptors() noexcept { return descriptors_; }
  Eviction& eviction() noexcept { return eviction_; }
  Stock& stock() noexcept { return stock_; }
  Reaper& reaper() noexcept { return reaper_; }
  Neighbours& neighbours() noexcept { return neighbours_; }
  Memory& memory() noexcept { return memory_; }
  Topics& topics() noexcept { return topics_; }
  Rings& rings() noexcept { return rings_; }

  /// Makes the blocks into which pullers copy what they keep of slots: one for all pullers of the
  /// process, as long as one needs it. make() makes it; what that throws is thrown.
  template <class Make>
  std::shared_ptr<detail::PusherCore> keeper(Make&& make) {
    const std::lock_guard guard(keeper_mutex_);
    auto keeper = keeper_.lock();
    if (!keeper) keeper_ = keeper = make();
    return keeper;
  }

 private:
  Participant(const EngineOptions& options, const segment::Trust& trust,
              std::shared_ptr<liveness::LockFile> lock_file);
  ~Participant() override = default;

  segment::Segment& ear_segment() noexcept override { return membership_.segment(); }
  std::uint32_t ear_index() const noexcept override { return index(); }
  bool has_lost_ears() const noexcept override { return inert(); }

  static std::shared_ptr<Participant> joined(const EngineOptions& options, const std::string& path,
                                             const segment::Trust& trust);
  static std::shared_ptr<Participant> admit(const EngineOptions& options, const std::string& path,
                                            const segment::Trust& trust,
                                            const std::shared_ptr<liveness::LockFile>& file);
  void take_index(std::string_view name);
  /// Called when the last handle has gone. The participant leaves now, or when the last pointer
  /// goes.
  static void handle_gone(Participant* p) noexcept;
  bool holds_pointers() noexcept override;
  void leave() noexcept override;
  void end() noexcept override;

  static void prepare_fork() noexcept;
  static void after_fork_in_parent() noexcept;
  static void after_fork_in_child() noexcept;

  Lifetime lifetime_{*this};
  Membership membership_;
  registry::Registry registry_;
  World world_;
  PointerHub hub_;
  ControlBlocks control_blocks_;
  alignas(64) Holder holder_;
  WardenThread warden_thread_;
  Ahead ahead_;
  Rouser rouser_;
  waiting::Descriptors descriptors_{*this};
  Eviction eviction_;
  Stock stock_;
  Reaper reaper_;
  Neighbours neighbours_;
  Memory memory_;
  Topics topics_;
  Rings rings_;
  Warden warden_;
  detail::Mutex keeper_mutex_{detail::Rank::Keeper};
  std::weak_ptr<detail::PusherCore> keeper_;  ///< it keeps this participant
};

}  // namespace lot::transport
