// SPDX-License-Identifier: Apache-2.0
#include "liveness/presence.hpp"

namespace lot::liveness {
namespace {
/// A process that has not looked for this long does not know what happened meanwhile.
constexpr std::chrono::seconds kLookedAway{2};
}  // namespace

bool Presence::may_be_claimed(std::uint32_t k) noexcept {
  const std::uint64_t seat = seen(k);
  if (seat::stands(seat)) return false;
  if (seat::notice(seat) != seat::kUnwitnessed) return true;
  if (lock_file_.held_by_other(k)) {
    clear_doubt(k);
    return false;
  }
  is_unsure_ = true;
  return doubted_long_enough(k, seat);
}

bool Presence::claim(std::uint32_t k) {
  const std::uint64_t seat = seen(k);
  if (seat::stands(seat)) return false;
  // Since may_be_claimed() a process with another lock file may have taken the seat.
  if (seat::notice(seat) == seat::kUnwitnessed && !doubted_long_enough(k, seat)) return false;
  if (!notice_.claim(seat_of(k), seat)) return false;
  // Relaxed: the name is all that it tells. The seat has released it to other processes (L3).
  name_.store(lock::make_name(k, seat::incarnation(seat) + 1), std::memory_order_relaxed);
  return true;
}

void Presence::end() noexcept {
  name_.store(0, std::memory_order_relaxed);  // first: the witness thread may take some time
  notice_.end();
}

/// A byte may stay locked for seconds after its process has died, or for longer: while the kernel
/// frees gigabytes or writes a core, or while a forked child has the descriptor. A reaper can wait
/// for that. A process that waits for a lock cannot.
bool Presence::is_gone(std::uint32_t name) noexcept {
  const std::uint32_t k = lock::participant(name);
  if (k >= segment_.capacity().participants) return true;  // a damaged word
  const std::uint64_t seat = seen(k);
  if (lock::make_name(k, seat::incarnation(seat)) != name) return true;
  if (looks_dead(k) || seat::notice(seat) == seat::kJudged) return true;
  return !seat::stands(seat) && seat::notice(seat) != seat::kUnwitnessed &&
         doubted_long_enough(k, seat);
}

LockOwner::Stopped Presence::stopped(std::uint32_t name) const {
  const auto holder = lock_file_.holder(lock::participant(name));
  if (!holder || !holder->is_stopped) return {};
  return {holder->describe(), holder->advice()};
}

bool Presence::looks_dead(std::uint32_t k) noexcept {
  const std::uint64_t seat = seen(k);
  const bool may_be = !seat::stands(seat) && !lock_file_.held_by_other(k);
  if (seat::notice(seat) != seat::kUnwitnessed) return may_be;
  if (!may_be) clear_doubt(k);
  return may_be && doubted_long_enough(k, seat);
}

bool Presence::judge(std::uint32_t k) noexcept {
  const std::uint64_t seat = seen(k);
  if (seat::stands(seat)) return false;
  if (seat::notice(seat) == seat::kUnwitnessed && !doubted_long_enough(k, seat)) return false;
  return seat::notice(seat) == seat::kJudged || DeathNotice::judge(seat_of(k), seat);
}

/// True when the seat has had this word at every look for long enough (kConviction).
bool Presence::doubted_long_enough(std::uint32_t k, std::uint64_t seat) noexcept {
  const std::lock_guard guard(doubts_mutex_);
  Doubt& doubt = doubts_[k];
  const auto now = futex::Clock::now();
  if (doubt.seat != seat || now - doubt.last > kLookedAway) doubt = {seat, now, now};
  doubt.last = now;
  return now - doubt.since >= kConviction;
}

void Presence::clear_doubt(std::uint32_t k) noexcept {
  const std::lock_guard guard(doubts_mutex_);
  doubts_[k] = {};
}

}  // namespace lot::liveness
