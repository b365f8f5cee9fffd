// SPDX-License-Identifier: Apache-2.0
#include "transport/reaper.hpp"

#include <new>
#include <thread>

#include "robust_mutex/robust_mutex.hpp"

namespace lot::transport {
namespace {

using namespace std::chrono_literals;
/// How long to wait inside the gate for another process that acts for the orphanage. Processes that
/// come and go wait there, too. They get in within a second.
constexpr auto kOrphanagePatienceInGate = 400ms;
constexpr auto kOrphanageLook = 100us;

}  // namespace

/// False: another process has acted for the orphanage all the time, or memory is short.
bool Reaper::repair_index(futex::Clock::time_point until) noexcept {
  if (world_.participant_state(index()).load(std::memory_order_acquire) == 0)
    return true;  // edge "state"
  while (!enter_orphanage()) {
    if (futex::Clock::now() >= until) return false;
    std::this_thread::sleep_for(1ms);
  }
  bool repaired = true;
  try {
    // A reaper with another lock file may have repaired the index meanwhile. Acquire:
    // edge "state".
    if (world_.participant_state(index()).load(std::memory_order_acquire) != 0)
      Recovery(world_).reap(index());
  } catch (const std::bad_alloc&) {  // as if killed here
    repaired = false;
  }
  leave_orphanage();
  lock_file_.take_turn();
  if (repaired) tell_homes();
  return repaired;
}

Reaper::Own Reaper::reap_own(bool in_gate) noexcept {
  const std::lock_guard guard(reap_mutex_);
  const auto until = futex::Clock::now() + kOrphanagePatienceInGate;
  while (futex::Clock::now() < until) {
    if (enter_orphanage()) {
      if (in_gate) lock_file_.take_turn();
      // Other processes judge and reap only in the orphanage. So from here on the index stays with
      // this process.
      if (!presence_.renew()) {
        leave_orphanage();
        return Own::Lost;
      }
      bool reaped = false;
      try {
        Recovery(world_).reap(index());
        reaped = true;
      } catch (const std::bad_alloc&) {  // as if killed here: the reap starts anew
      }
      leave_orphanage();
      if (in_gate) lock_file_.take_turn();
      if (reaped) {
        tell_homes();
        return Own::Reaped;
      }
    } else {
      std::this_thread::sleep_for(1ms);
    }
  }
  return Own::Left;
}

/// Acting for the orphanage takes two locks: byte 0 of the lock file, and a robust mutex word. Byte
/// 0 mostly shows at once that another process acts. The word is needed because there are two lock
/// files after one was removed and made anew, and none in a process that has lost its own.
///
/// REQUIRES: reap_mutex_, or that no other thread knows this participant yet.
bool Reaper::enter_orphanage() noexcept {
  if (lock_file_.intact() && !lock_file_.try_lock(refcount::kOrphanage)) return false;
  RobustMutex mutex(segment_.directory().orphanage.word, presence_);
  if (mutex.try_lock() != RobustMutex::Outcome::Busy) return true;
  lock_file_.unlock(refcount::kOrphanage);
  return false;
}

void Reaper::leave_orphanage() noexcept {
  RobustMutex(segment_.directory().orphanage.word, presence_).unlock();
  lock_file_.unlock(refcount::kOrphanage);
}

/// Tells all homes to look again, after ownership bits of a dead participant or of the orphanage
/// were cleared.
void Reaper::tell_homes() noexcept {
  for (std::uint32_t b = 0; b < world_.blocks(); ++b) holder_.tell_home(b);
}

bool Reaper::reap_if_dead(std::uint32_t k) noexcept {
  if (k == index() || k == refcount::kOrphanage || k >= world_.participants()) return false;
  const std::unique_lock guard(reap_mutex_, std::try_to_lock);
  if (!guard || !lock_file_.intact() || !lock_file_.try_lock(k)) return false;
  bool done = false;
  // Acquire: edge "state".
  if (world_.participant_state(k).load(std::memory_order_acquire) != 0 && presence_.judge(k) &&
      enter_orphanage()) {
    // Once more: another reaper, with another lock file, may have been faster, and a new process
    // may have taken k.
    if (world_.participant_state(k).load(std::memory_order_acquire) != 0 &&
        presence_.is_judged(k)) {
      try {
        done = Recovery(world_).reap(k);
      } catch (const std::bad_alloc&) {  // as if killed here: the next look does it all again
      }
    }
    leave_orphanage();
    if (done) tell_homes();
  }
  lock_file_.unlock(k);
  return done;
}

bool Reaper::reap_dead() noexcept {
  bool done = false;
  for (std::uint32_t k = 1; k < world_.participants(); ++k) {
    if (looks_dead(k)) done |= reap_if_dead(k);
  }
  return done;
}

void Reaper::reap_all_dead() noexcept {
  const auto until = futex::Clock::now() + kAnotherReaper;
  while (has_dead() && futex::Clock::now() < until) {
    if (!reap_dead()) std::this_thread::sleep_for(1ms);
  }
}

bool Reaper::looks_dead(std::uint32_t k) noexcept {
  // Acquire: edge "state".
  return k != index() && world_.participant_state(k).load(std::memory_order_acquire) != 0 &&
         presence_.looks_dead(k);
}

bool Reaper::has_dead() noexcept {
  for (std::uint32_t k = 1; k < world_.participants(); ++k) {
    if (looks_dead(k)) return true;
  }
  return false;
}

/// Whether an ended ring has no reader any more. Only the process that acts for the orphanage may
/// ask: when another process recycles the ring, its memory may get a new owner. While another
/// process acts for the orphanage the answer is no, and the next look asks again.
bool Reaper::has_deserted_ring() noexcept {
  if (!world_.has_orphan_rings()) return false;
  const std::unique_lock guard(reap_mutex_, std::try_to_lock);
  if (!guard || !enter_orphanage()) return false;
  const bool found = Recovery(world_).has_deserted_ring(world_.used_channels());
  leave_orphanage();
  return found;
}

bool Reaper::collect() noexcept {
  bool orphans = world_.has_orphan_rings();
  for (std::uint32_t b = 0; b < world_.blocks() && !orphans; ++b) {
    // Relaxed: a hint. collect() looks again in the orphanage.
    orphans = world_.block(b).home.load(std::memory_order_relaxed) == refcount::kHomeOrphanage;
  }
  if (!orphans) return false;
  const std::unique_lock guard(reap_mutex_, std::try_to_lock);
  if (!guard || !enter_orphanage()) return true;
  try {
    Recovery(world_).collect();
  } catch (const std::bad_alloc&) {  // as if killed here: the next look does it all again
  }
  leave_orphanage();
  tell_homes();
  return true;
}

void Reaper::end_ring(const registry::ChannelName& name) noexcept {
  // give_up_rings() takes this mutex before it gives the ring to the orphanage. Until then no
  // process can recycle the ring.
  const std::lock_guard guard(reap_mutex_);
  world_.channel_writer(name.channel).end(name.generation, index());
  segment::Ring r = world_.ring(name.channel);
  Recovery(world_).wake_readers(r);
}

bool Reaper::is_closing(std::uint32_t channel) noexcept {
  // Acquire: as in ring_closed().
  const auto w = world_.channel_writer(channel).load(std::memory_order_acquire);
  return ring::writer_state(w) == ring::State::Orphan && ring::writer_owner(w) == index();
}

bool Reaper::ring_closed(const registry::ChannelName& name) const noexcept {
  // Acquire: the orphanage's name is stored (release) after it has adopted all blocks of the ring.
  const auto w = world_.channel_writer(name.channel).load(std::memory_order_acquire);
  return ring::writer_generation(w) != name.generation || ring::writer_owner(w) != index();
}

bool Reaper::has_closing_rings() noexcept {
  const std::uint32_t used = world_.used_channels();
  for (std::uint32_t c = 0; c < used; ++c) {
    if (is_closing(c)) return true;
  }
  return false;
}

bool Reaper::give_up_rings() noexcept {
  if (!has_closing_rings()) return true;
  const std::lock_guard guard(reap_mutex_);
  if (!enter_orphanage()) return false;
  bool all = true;
  try {
    Recovery recovery(world_);
    const std::uint32_t used = world_.used_channels();
    for (std::uint32_t c = 0; c < used; ++c) {
      if (is_closing(c)) recovery.orphan_ring(c, index());
    }
    recovery.collect();
  } catch (const std::bad_alloc&) {
    all = false;  // memory is short: as if killed here; the warden's next look does it again
  }
  leave_orphanage();
  return all;
}

bool Reaper::take_out(std::uint32_t channel, std::uint32_t b,
                      futex::Clock::time_point until) noexcept {
  std::unique_lock guard(reap_mutex_, std::defer_lock);
  const auto enter = [&] {
    if (!guard.try_lock()) return false;
    if (enter_orphanage()) return true;
    guard.unlock();
    return false;
  };
  while (!enter()) {
    if (futex::Clock::now() >= until) return false;
    std::this_thread::sleep_for(kOrphanageLook);
  }
  bool is_out = false;
  try {
    Recovery recovery(world_);
    is_out = recovery.take_out(channel, b);
    if (is_out) recovery.collect();
  } catch (const std::bad_alloc&) {  // as if killed here: the next look does it all again
  }
  leave_orphanage();
  if (is_out) tell_homes();
  return is_out;
}

bool Reaper::keep_own_lock(detail::Mutex& no_fork) noexcept {
  if (!lock_file_.intact()) {
    const std::lock_guard guard(reap_mutex_);
    // Tried only: a handler of fork() may end a ring, and that waits for reap_mutex_.
    const std::unique_lock no_child(no_fork, std::try_to_lock);
    if (!no_child) return false;
    lock_lost_ = lock_file_.reopen();
  }
  // A process that probes the byte may have it for a moment. Then the next look tries again.
  if (lock_lost_) lock_lost_ = !lock_file_.try_lock(index());
  return !lock_lost_;
}

}  // namespace lot::transport
