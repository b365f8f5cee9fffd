// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <mutex>

#include "futex/futex.hpp"
#include "liveness/death_notice.hpp"
#include "liveness/lock_file.hpp"
#include "robust_mutex/robust_mutex.hpp"
#include "segment/segment.hpp"

namespace lot::liveness {

/// That a process is there, and what it can tell of the others: by two witnesses of each, its byte
/// of the lock file and its notice in the segment. Dead is a process that both call dead
/// (docs/locks.md).
///
/// Threads: claim(), renew() and end() by one at a time; the rest by all.
/// Crash:   killed at any step, it is dead for the others.
class Presence final : public LockOwner {
 public:
  /// So long the witnesses must have said what one alone can not be believed. A living process
  /// takes a byte again that its application has closed, and renews a notice that another process
  /// has changed, within a second.
  static constexpr std::chrono::seconds kConviction{3};

  Presence(const segment::Segment& segment, const LockFile& lock_file)
      : segment_(segment), lock_file_(lock_file) {}

  /// True when index k may be taken: nobody is there, as far as its notice says. Where that is not
  /// sure yet, is_unsure() is true from then on: it may be so in kConviction.
  bool may_be_claimed(std::uint32_t k) noexcept;
  bool is_unsure() const noexcept { return is_unsure_; }
  /// Takes index k, with a name that nobody has had. False: another one was quicker, which has the
  /// byte of another lock file. Throws lot::Error. REQUIRES: byte k; may_be_claimed().
  bool claim(std::uint32_t k);
  /// Our notice is set again if another process has changed it. False: the index is another one's
  /// by now. We have been taken for dead.
  bool renew() noexcept { return notice_.renew(); }
  void end() noexcept;
  /// In a forked child: it is no participant.
  void abandon() noexcept { name_.store(0, std::memory_order_relaxed); }

  /// 0: we have no index.
  std::uint32_t name() const noexcept override { return name_.load(std::memory_order_relaxed); }
  bool is_gone(std::uint32_t name) noexcept override;
  Stopped stopped(std::uint32_t name) const override;

  /// True when both witnesses say that k is dead.
  bool looks_dead(std::uint32_t k) noexcept;
  /// The same, said to all: whichever process has its byte from now on, k is dead.
  /// REQUIRES: byte k.
  bool judge(std::uint32_t k) noexcept;
  bool is_judged(std::uint32_t k) const noexcept { return seat::notice(seen(k)) == seat::kJudged; }
  /// What to sleep on until k dies.
  detail::FutexWait watch(std::uint32_t k) const noexcept {
    return {futex::low_half(seat_of(k)), seat::notice(seen(k))};
  }

 private:
  /// What a participant's seat says, that one alone can not be believed.
  struct Doubt {
    std::uint64_t seat = 0;
    futex::Clock::time_point since, last;
  };

  DeathNotice::Seat& seat_of(std::uint32_t k) const noexcept {
    return segment_.witnesses()[k].seat;
  }
  // Acquire: what the one did before whose seat it was.
  std::uint64_t seen(std::uint32_t k) const noexcept {
    return seat_of(k).load(std::memory_order_acquire);
  }
  bool is_convinced(std::uint32_t k, std::uint64_t seat) noexcept;
  void is_sure(std::uint32_t k) noexcept;

  const segment::Segment& segment_;
  const LockFile& lock_file_;
  DeathNotice notice_;
  bool is_unsure_ = false;
  std::atomic<std::uint32_t> name_{0};
  std::mutex doubts_mutex_;
  std::array<Doubt, segment::kMaxParticipants> doubts_;
};

}  // namespace lot::liveness
