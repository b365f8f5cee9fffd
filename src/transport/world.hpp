// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <string_view>
#include <vector>

#include "lot/detail/control.hpp"

#include "futex/futex.hpp"
#include "recovery/recovery.hpp"
#include "registry/registry.hpp"
#include "segment/segment.hpp"
#include "transport/references.hpp"

namespace lot::transport {

/// The segment as Recovery repairs it (recovery/recovery.hpp), and what other units ask of the
/// whole segment. It needs a segment and its registry, and no participant.
///
/// Threads: all members may be called at once. Recovery says which locks its functions need.
/// Crash:   a step that is killed is done again by the next reaper.
class World {
 public:
  World(segment::Segment& segment, registry::Registry& registry) noexcept
      : segment_(segment), registry_(registry) {}

  std::uint32_t participants() const noexcept { return segment_.capacity().participants; }
  refcount::ParticipantState<segment::Atomics>& participant_state(std::uint32_t k) const noexcept {
    return segment_.participants()[k].state;
  }
  /// The name that participant k has given itself, at most kNameBytes - 1 bytes of it.
  std::string_view name_of(std::uint32_t k) const noexcept;
  std::uint32_t blocks() const noexcept { return segment_.capacity().blocks; }
  segment::BlockWords& block(std::uint32_t b) const noexcept { return segment_.block(b); }
  std::uint32_t channels() const noexcept { return segment_.capacity().channels; }
  ring::WriterWord<segment::Atomics>& channel_writer(std::uint32_t c) const noexcept {
    return segment_.channels()[c].writer;
  }
  segment::Ring ring(std::uint32_t c) const noexcept { return segment_.ring(c); }
  template <class F>
  void each_reference(std::uint32_t b, F&& f) const {
    transport::each_reference(segment_, b, f);
  }
  bool lock_rings() noexcept { return registry_.try_lock(); }
  void unlock_rings() noexcept { registry_.unlock(); }
  void recycle_ring(std::uint32_t c) noexcept { registry_.recycle(c); }
  void release_extents(const std::vector<bool>& dead) noexcept;
  void renew_directory() noexcept;
  void unsubscribe(std::uint32_t k) noexcept { registry_.unsubscribe(k); }
  void forget(std::uint32_t k) noexcept;
  void wake(std::atomic<ring::Word>& word) noexcept { futex::wake_all(futex::low_half(word)); }
  void wake(std::atomic<std::uint32_t>& word) noexcept { futex::wake_all(&word); }
  /// Unconditionally: a dead process may have rung them, and not have woken them.
  void ring_ears(std::uint32_t c) noexcept {
    segment_.ring_ears(c, [](const void* bell, bool) { futex::wake_all(bell); });
  }

  std::uint32_t used_channels() noexcept;
  bool has_orphan_rings() noexcept;
  bool has_ending_rings() noexcept;

 private:
  segment::Segment& segment_;
  registry::Registry& registry_;
  std::atomic<std::uint32_t> used_channels_{0};
};

using Recovery = recovery::Recovery<detail::HardwareAtomics, World>;

}  // namespace lot::transport
