// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

#include "lot/detail/mutex.hpp"

#include "futex/futex.hpp"
#include "segment/segment.hpp"
#include "transport/pieces.hpp"
#include "transport/pool.hpp"
#include "transport/warden_thread.hpp"

namespace lot::transport {

/// Makes the block that a publisher will loan next, with its memory mapped, so that only the first
/// frame waits for the kernel. docs/memory.md says how much is made, and for which publishers.
///
/// A thread of its own does it, since the warden answers other processes within milliseconds. The
/// thread starts with the first request.
///
/// Threads: all members may be called at once, but those marked "no lock": the caller has no pool's
///          lock, which is for sections that never block.
/// Crash:   a block that is made carries the process's name, and its memory the block's: as a loan.
class Ahead {
 public:
  /// Its thread runs beside the warden.
  Ahead(segment::Segment& segment, WardenThread& warden) noexcept
      : segment_(segment), warden_(warden) {}
  ~Ahead() { stop(); }
  Ahead(const Ahead&) = delete;
  Ahead& operator=(const Ahead&) = delete;

  /// Tells that messages of the publisher with this pool have such pieces. No lock.
  void expect(Pool& pool, const Pieces& pieces) noexcept;
  /// The publisher will need another block, and does not need its core now. It has claimed a block,
  /// perhaps the one that was made, and is done with it. No lock.
  void next(Pool& pool) noexcept;
  /// When this returns nothing is made for the publisher any more, until it expects something
  /// again. A closed pool does not. No lock.
  void forget(Pool& pool) noexcept;
  /// Memory is short. When this returns the thread holds nothing, so that what was made lies in the
  /// pools, and nothing is made for a while. No lock.
  void leave_off() noexcept;
  /// The same for one publisher, whose quota is short, until it claims a block again. No lock.
  void leave_off(Pool& pool) noexcept;
  /// Ends the thread: nothing is made any more, and the thread holds nothing. No lock.
  void stop() noexcept;

 private:
  struct Want {
    Pool* pool;
    Pieces pieces;
    bool is_due;
  };
  std::vector<Want>::iterator find(const Pool& pool) noexcept;
  void start();
  void run() noexcept;
  void make(Pool& pool, const Pieces& pieces) noexcept;
  bool may_make(const Pool& pool, const Pieces& pieces) const noexcept;
  bool furnish(Pool& pool, std::uint32_t b, const Pieces& pieces) noexcept;
  /// Makes the thread give back what it is making, as soon as the kernel has finished a unit.
  /// Returns when it has. REQUIRES: the lock on mutex_.
  void call_off(std::unique_lock<detail::Mutex>& lock) noexcept;

  segment::Segment& segment_;
  WardenThread& warden_;
  detail::Mutex mutex_{detail::Rank::Ahead};
  detail::Condition signal_;
  std::vector<Want> wants_;   ///< one for each publisher
  const Pool* at_ = nullptr;  ///< the pool whose block is being made
  std::uint64_t turn_ = 0;    ///< how many blocks it has begun
  bool is_ending_ = false;
  futex::Clock::time_point short_until_{};
  std::atomic<bool> is_called_off_{false};
  std::thread thread_;
};

}  // namespace lot::transport
