// SPDX-License-Identifier: Apache-2.0
#include "transport/membership.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <exception>
#include <optional>
#include <string>
#include <thread>
#include <unistd.h>
#include <utility>

#include "lot/error.hpp"

#include "liveness/lock_holder.hpp"
#include "transport/gate.hpp"

namespace lot::transport {
namespace {

using namespace std::chrono_literals;
/// A process that joins while all indexes are taken tries again for this long. A reaper may be
/// freeing an index just now.
constexpr auto kFullPatience = 200ms;
/// How long a process that may be the last one waits, in the gate, for the end of those that are
/// being killed. Less than others wait for the gate.
constexpr auto kDyingPatience = 200ms;

}  // namespace

Membership::Membership(const EngineOptions& options, const segment::Trust& trust,
                       std::shared_ptr<liveness::LockFile> lock_file)
    : trust_(trust),
      lock_file_(std::move(lock_file)),
      segment_(segment::path_of(options.directory, options.segment),
               segment::Segment::Access::ReadWrite, trust),
      presence_(segment_, *lock_file_) {
  if (options.lock_memory) segment_.lock_memory();
}

void Membership::take_index(std::string_view name, const Repair& repair) {
  const auto until = futex::Clock::now() + kFullPatience;
  // An index of a dead participant must be reaped first. The wardens do that, so a joiner prefers a
  // clean index.
  while (!try_take_index(false, until, repair) && !try_take_index(true, until, repair)) {
    lock_file_->require_intact();
    const auto longer = presence_.is_unsure() ? liveness::Presence::kConviction : 0s;
    if (futex::Clock::now() >= until + longer) {
      throw Error(
          EUSERS, segment_.path(),
          "all " + std::to_string(participants() - 1) + " processes of the segment are taken",
          participants() < segment::kMaxParticipants
              ? "make the segment with a larger EngineOptions::processes, or use several segments"
              : "EngineOptions::processes is at its maximum: use several segments");
    }
    std::this_thread::sleep_for(1ms);
  }
  auto& entry = segment_.participants()[index()];
  entry.pid = getpid();
  entry.since_ns = static_cast<std::uint64_t>(std::chrono::system_clock::now().time_since_epoch() /
                                              std::chrono::nanoseconds(1));
  rename(name);
  // What the former owner of this index has left goes before this process is in the segment, so
  // that no reader of the tables takes it for this process's.
  segment_.sightings()[index()].clear();
  segment_.witnesses()[index()].errands.forget();
  participant_state(index()).take();
}

/// Takes a free index: a clean one, or one of a dead process. The latter is repaired first, under
/// the name of this process.
bool Membership::try_take_index(bool of_a_dead_one, futex::Clock::time_point until,
                                const Repair& repair) {
  const auto may_take = [&](std::uint32_t k) {
    // Acquire: edge "state". A joiner that sees 0 sees all that the reaper has done.
    const bool is_clean = participant_state(k).load(std::memory_order_acquire) == 0;
    return is_clean != of_a_dead_one && presence_.may_be_claimed(k);
  };
  for (std::uint32_t k = 1; k < participants(); ++k) {
    if (!may_take(k) || !lock_file_->try_lock(k)) continue;
    if (may_take(k) && presence_.claim(k)) {
      index_ = k;
      if (repair(until)) return true;
      presence_.end();
    }
    lock_file_->unlock(k);
  }
  return false;
}

void Membership::return_index() noexcept { participant_state(index()).free(); }

void Membership::rename(std::string_view name) noexcept {
  auto& entry = segment_.participants()[index()];
  std::memset(entry.name, 0, sizeof(entry.name));
  std::memcpy(entry.name, name.data(), std::min(name.size(), sizeof(entry.name) - 1));
}

void Membership::refuse() const {
  // Relaxed: it only chooses the text.
  if (is_expelled_.load(std::memory_order_relaxed)) {
    throw Error(ESTALE, segment_.path(),
                "this process was stopped, and taken for dead: another one has its place",
                "make new lot objects; a kernel that allows set_robust_list() prevents it");
  }
  throw Error(ECHILD, segment_.path(), "this object was inherited through fork() and is inert",
              "make a new lot::ShmEngine in the child, or exec");
}

void Membership::abandon() noexcept {
  inert_.store(true, std::memory_order_relaxed);  // relaxed: the child has one thread
  presence_.abandon();
  lock_file_->abandon();  // else the child would make the parent look alive to other processes
}

/// This process was taken for dead, and another process has its index or will get it. From now on
/// it is inert. A thread that is in the midst of a call gets no lock in the old name. The kernel's
/// robust list leads to the seat no more: in another PID namespace a thread of the next owner may
/// have the same thread id as a thread of this process.
void Membership::expel() noexcept {
  // Relaxed, both: other threads only have to see them soon. They carry nothing.
  is_expelled_.store(true, std::memory_order_relaxed);
  inert_.store(true, std::memory_order_relaxed);  // as above
  presence_.end();
  lock_file_->unlock(index());  // another process has the index, or will have it
  note_settled();
}

bool Membership::is_there(std::uint32_t k, bool are_locks_held) noexcept {
  if (are_locks_held && lock_file_->held_by_other(k)) return true;
  // Acquire: edge "state". A living process may have lost its byte to closefrom(). Its notice still
  // stands then.
  return participant_state(k).load(std::memory_order_acquire) != 0 && !presence_.looks_dead(k);
}

/// Removes the segment and its lock file if no other process uses them. The orphanage's lock does
/// not count as use: the process that acts for the orphanage has an index of its own. A process
/// that is ending may act for it to its end, behind its *ending* mark, since a thread closes a
/// ring.
///
/// REQUIRES: the gate.
void Membership::remove_files_if_last() noexcept {
  if (!lock_file_->intact()) return;
  const bool are_locks_held = lock_file_->held_by_other(1, participants() - 1);
  const auto until = futex::Clock::now() + kDyingPatience;
  for (std::uint32_t k = 1; k < participants(); ++k) {
    if (k == index() || segment_.witnesses()[k].errands.is_ending()) continue;
    while (is_there(k, are_locks_held)) {
      // One that was killed just now removes nothing, and nobody would after us.
      if (futex::Clock::now() >= until ||
          !liveness::is_being_killed(segment_.participants()[k].pid))
        return;
      std::this_thread::sleep_for(1ms);
    }
  }
  const bool is_there = segment_.is_at_its_path();
  // After the look at the others: one of them may have set it without the gate, and died since.
  if (is_there && segment_.keeps_files()) return;
  if (is_there) segment::Segment::remove(segment_.path(), trust_);
  ::unlink(lock_file_->path().c_str());
}

/// Crash:   killed in the gate, the effect is as when it leaves. Killed behind the mark, the
///          process was about to die in any case.
void Membership::settle_files() noexcept {
  try {
    if (lock_file_->intact() && lock_file_->enter_gate(kGatePatience)) {
      remove_files_if_last();
      segment_.witnesses()[index()].errands.note_ending();
      lock_file_->leave_gate();
    }
  } catch (const std::exception&) {  // a stopped process keeps the gate, or memory is short
  }
  note_settled();
}

void Membership::note_settled() noexcept {
  // Relaxed: what it tells of is in the file system.
  files_settled_.store(1, std::memory_order_relaxed);
  futex::wake_all(&files_settled_);
}

void Membership::await_settled(futex::Clock::time_point until) noexcept {
  // Relaxed: what it tells of is in the file system.
  while (files_settled_.load(std::memory_order_relaxed) == 0 &&
         futex::wait(&files_settled_, 0, until)) {
  }
}

}  // namespace lot::transport
