// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <mutex>

#include "lot/detail/mutex.hpp"

#include "futex/futex.hpp"
#include "liveness/death_notice.hpp"
#include "liveness/lock_file.hpp"
#include "robust_mutex/robust_mutex.hpp"
#include "segment/segment.hpp"

namespace lot::liveness {

/// Says that this process lives, and which of the others live. Each process has two witnesses: its
/// byte of the lock file, and its notice in the segment. A process is dead when both call it dead
/// (docs/locks.md).
///
/// Threads: one thread at a time calls claim(), renew() and end(). Any thread may call the rest.
/// Crash:   killed at any step, the process is dead for the others.
class Presence final : public LockOwner {
 public:
  /// How long one witness must call a process dead before others believe it without the second one.
  /// A living process corrects its witnesses within a second: it takes a byte again that its
  /// application has closed, and renews a notice that another process has changed.
  static constexpr std::chrono::seconds kConviction{3};

  Presence(const segment::Segment& segment, const LockFile& lock_file)
      : segment_(segment), lock_file_(lock_file) {}

  /// True when index k may be taken: its notice says that no process has it. Where that is not sure
  /// yet, is_unsure() is true from then on: the index may be free after kConviction.
  bool may_be_claimed(std::uint32_t k) noexcept;
  bool is_unsure() const noexcept { return is_unsure_; }
  /// Takes index k, with a name that no process has had. False: another process was quicker, which
  /// has the byte of another lock file. Throws lot::Error. REQUIRES: byte k; may_be_claimed().
  bool claim(std::uint32_t k);
  /// Sets our notice again if another process has changed it. False: others have taken us for dead:
  /// they have judged us, or another process has the index by now.
  bool renew() noexcept { return notice_.renew(); }
  void end() noexcept;
  /// For a forked child: it is no participant. Relaxed: the child has one thread.
  void abandon() noexcept { name_.store(0, std::memory_order_relaxed); }

  /// 0: we have no index. Relaxed: the name is all that it tells.
  std::uint32_t name() const noexcept override { return name_.load(std::memory_order_relaxed); }
  bool is_gone(std::uint32_t name) noexcept override;
  Stopped stopped(std::uint32_t name) const override;

  /// True when both witnesses say that k is dead.
  bool looks_dead(std::uint32_t k) noexcept;
  /// True when k is dead, which this then says to all: k stays dead, whichever process has its byte
  /// from now on. REQUIRES: byte k.
  bool judge(std::uint32_t k) noexcept;
  bool is_judged(std::uint32_t k) const noexcept { return seat::notice(seen(k)) == seat::kJudged; }
  /// The word and value to sleep on until k dies.
  detail::FutexWait watch(std::uint32_t k) const noexcept {
    return {futex::low_half(seat_of(k).word()), seat::notice(seen(k))};
  }

 private:
  /// The word of a participant's seat that is not believed yet, and since when it has been there.
  struct Doubt {
    std::uint64_t seat = 0;
    futex::Clock::time_point since, last;
  };

  DeathNotice::Seat& seat_of(std::uint32_t k) const noexcept {
    return segment_.witnesses()[k].seat;
  }
  // Acquire, edge "seat": what the seat's former owner did. For who takes a lock over, L2.
  std::uint64_t seen(std::uint32_t k) const noexcept {
    return seat_of(k).load(std::memory_order_acquire);
  }
  bool doubted_long_enough(std::uint32_t k, std::uint64_t seat) noexcept;
  void clear_doubt(std::uint32_t k) noexcept;

  const segment::Segment& segment_;
  const LockFile& lock_file_;
  DeathNotice notice_;
  bool is_unsure_ = false;
  std::atomic<std::uint32_t> name_{0};
  detail::Mutex doubts_mutex_{detail::Rank::Doubts};
  std::array<Doubt, segment::kMaxParticipants> doubts_;
};

}  // namespace lot::liveness
