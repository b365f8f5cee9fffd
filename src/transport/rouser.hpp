// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <thread>

#include "transport/warden_thread.hpp"

namespace lot::transport {

/// Wakes the sleepers that a push has left asleep (docs/waiting.md, "How a push wakes many"). A
/// thread of its own does it, since the kernel takes long for many. The thread starts with the
/// first request.
///
/// A request is a word in one of kPlaces places. So a push allocates nothing, and one that finds no
/// place wakes all by itself.
///
/// Edges
///   N1  a word noted in a place, then `state_` (seq_cst)
///       <-> `state_` = asleep, absent or ending, then the places (seq_cst)
///       the thread, or the one that could not start it, sees the word; or the caller of rouse()
///       sees what the thread does.
///
/// Threads: rouse() from all at once. stop() when no thread calls it any more.
/// Crash:   what is left undone is for the reaper, which wakes all sleepers of the rings of a dead
///          publisher.
class Rouser {
 public:
  static constexpr std::size_t kPlaces = 64;

  /// Its thread runs on the warden's cores, as the thread that makes the first request is
  /// scheduled.
  explicit Rouser(WardenThread& warden) noexcept : warden_(warden) {}
  ~Rouser() { stop(); }
  Rouser(const Rouser&) = delete;
  Rouser& operator=(const Rouser&) = delete;

  /// Sees to it that all wake that sleep on the word now. Does not wait for that.
  void rouse(const void* word) noexcept;
  /// Ends the thread, which does first what it was asked.
  void stop() noexcept;

 private:
  enum State : std::uint32_t { kAbsent, kAwake, kAsleep, kEnding };

  bool note(const void* word) noexcept;
  bool has_notes() const noexcept;
  void wake_noted() noexcept;
  void start() noexcept;
  void run() noexcept;

  WardenThread& warden_;
  std::atomic<std::uint32_t> state_{kAbsent};               ///< what the thread does. Futex
  std::array<std::atomic<const void*>, kPlaces> places_{};  ///< null: free
  std::thread thread_;
};

}  // namespace lot::transport
