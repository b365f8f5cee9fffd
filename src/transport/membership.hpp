// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string_view>

#include "lot/options.hpp"

#include "futex/futex.hpp"
#include "liveness/presence.hpp"
#include "segment/segment.hpp"

namespace lot::transport {

/// The place of this process in a segment: its mapping, its lock file, its index and its name.
/// What it does with the place is the business of the units above.
///
/// Threads: all members may be called at once, but for what says "warden" or "joiner": these are
///          called by that thread alone.
/// Crash:   the index stays taken (*state*) until a reaper has repaired what its owner has left.
class Membership {
 public:
  /// Maps the segment that the options name. Throws lot::Error. REQUIRES: the gate.
  Membership(const EngineOptions& options, const segment::Trust& trust,
             std::shared_ptr<liveness::LockFile> lock_file);
  Membership(const Membership&) = delete;
  Membership& operator=(const Membership&) = delete;

  /// Repairs what the former owner of our index has left. False: it could not until then.
  using Repair = std::function<bool(futex::Clock::time_point until)>;
  /// Takes an index, a clean one if there is one. The index of a dead process comes with what that
  /// one has left, which is repaired under the name of this process. Joiner. Throws lot::Error.
  void take_index(std::string_view name, const Repair& repair);
  /// The join has failed behind take_index(), before another thread or process knew of it. Joiner.
  void return_index() noexcept;

  std::uint32_t index() const noexcept { return index_; }
  segment::Segment& segment() noexcept { return segment_; }
  const segment::Segment& segment() const noexcept { return segment_; }
  liveness::Presence& presence() noexcept { return presence_; }
  liveness::LockFile& lock_file() noexcept { return *lock_file_; }
  /// Sets the name of this process.
  void rename(std::string_view name) noexcept;

  /// Throws lot::Error in a forked child, where every inherited object is inert, and in a process
  /// that others have taken for dead.
  void check_usable() const {
    // Relaxed: the flag carries nothing, and a thread may see it late.
    if (inert_.load(std::memory_order_relaxed)) [[unlikely]]
      refuse();
  }
  /// Relaxed: as in check_usable().
  bool is_inert() const noexcept { return inert_.load(std::memory_order_relaxed); }
  [[noreturn]] void refuse() const;
  /// This process is a forked child of the one that has joined.
  void abandon() noexcept;
  /// Relaxed: other threads only have to see it soon.
  bool is_expelled() const noexcept { return is_expelled_.load(std::memory_order_relaxed); }
  /// This process was taken for dead. Warden.
  void expel() noexcept;

  /// Removes the segment and its lock file if no other process uses them. Warden. REQUIRES: the
  /// gate.
  void remove_files_if_last() noexcept;
  /// The same for a process that a signal ends, through the gate. Warden.
  void settle_files() noexcept;
  /// This process has done what it can for its files.
  void note_settled() noexcept;
  /// Waits for note_settled().
  void await_settled(futex::Clock::time_point until) noexcept;

 private:
  bool try_take_index(bool of_a_dead_one, futex::Clock::time_point until, const Repair& repair);
  /// Whether participant k lives, as far as its witnesses say. are_locks_held: whether any byte is
  /// locked.
  bool is_there(std::uint32_t k, bool are_locks_held) noexcept;
  std::uint32_t participants() const noexcept { return segment_.capacity().participants; }
  refcount::ParticipantState<segment::Atomics>& participant_state(std::uint32_t k) const noexcept {
    return segment_.participants()[k].state;
  }

  const segment::Trust trust_;
  const std::shared_ptr<liveness::LockFile> lock_file_;
  std::atomic<bool> inert_{false};  ///< true in a forked child, or if is_expelled_
  std::atomic<bool> is_expelled_{false};
  std::uint32_t index_ = 0;
  segment::Segment segment_;
  liveness::Presence presence_;
  /// 1: this process has done what it can for its files. await_settled() sleeps on the word.
  std::atomic<std::uint32_t> files_settled_{0};
};

}  // namespace lot::transport
