// SPDX-License-Identifier: Apache-2.0
/// Life and death of participants: taking an index, the warden, reaping, collecting, and leaving
/// the segment.
#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <unistd.h>
#include <utility>

#include "lot/error.hpp"

#include "robust_mutex/robust_mutex.hpp"
#include "transport/participant.hpp"

namespace lot::transport {
namespace {

using namespace std::chrono_literals;
namespace errand = segment::errand;
/// The time between two looks of the warden while something is left to finish. It grows from the
/// first value to the second.
constexpr std::chrono::milliseconds kFirstLook{1};
constexpr std::chrono::milliseconds kLastLook{100};
/// The same where nothing is left to finish. The warden may have missed the notice of a death.
constexpr auto kIdleLook = 1s;
/// Idle memory of a publisher goes back to the segment after this many looks. After as many looks
/// more it goes from the segment back to the system.
constexpr std::uint8_t kOldLooks = 5;
/// A look gives memory back for at most this long. The rest waits for the next look, since the
/// warden has to watch the other processes.
constexpr auto kGiveBackTime = 20ms;
/// Two looks for unused memory are at least this far apart.
constexpr auto kTurn = kIdleLook * 9 / 10;
/// The warden rests this long after it has run errands of other processes, however many they bring.
constexpr auto kErrandRest = 1ms;
/// A process that joins while all indexes are taken tries again for this long. A reaper may be
/// freeing an index just now.
constexpr auto kFullPatience = 200ms;

}  // namespace

void Participant::take_index(const EngineOptions& options) {
  const auto until = futex::Clock::now() + kFullPatience;
  // An index of a dead participant must be reaped first. The wardens do that, so a joiner prefers a
  // clean index.
  while (!try_take_index(false, until) && !try_take_index(true, until)) {
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
  rename(options.name);
  forget_sightings();
  // The errands were meant for the former owner of the index. Relaxed: a participant that asks this
  // one has seen its new state, or its name in a home word. Both come later.
  segment_.witnesses()[index()].errands.store(0, std::memory_order_relaxed);
  part(index()).store(1, std::memory_order_release);  // edge "state"
}

/// Takes a free index: a clean one, or one of a dead process. The latter is repaired first, under
/// the name of this process.
bool Participant::try_take_index(bool of_a_dead_one, futex::Clock::time_point until) {
  const auto may_take = [&](std::uint32_t k) {
    // Acquire: edge "state". A joiner that sees 0 sees all that the reaper has done.
    const bool is_clean = part(k).load(std::memory_order_acquire) == 0;
    return is_clean != of_a_dead_one && presence_.may_be_claimed(k);
  };
  for (std::uint32_t k = 1; k < segment_.capacity().participants; ++k) {
    if (!may_take(k) || !lock_file_->try_lock(k)) continue;
    if (may_take(k) && presence_.claim(k)) {
      holder_.own = HardwareOwnership(k);
      if (repair_index(until)) return true;
      presence_.end();
    }
    lock_file_->unlock(k);
  }
  return false;
}

/// False: another process has acted for the orphanage all the time.
bool Participant::repair_index(futex::Clock::time_point until) noexcept {
  if (part(index()).load(std::memory_order_acquire) == 0) return true;  // edge "state"
  while (!enter_orphanage()) {
    if (futex::Clock::now() >= until) return false;
    std::this_thread::sleep_for(1ms);
  }
  bool repaired = true;
  try {
    // A reaper with another lock file may have repaired the index meanwhile. Acquire: edge "state".
    if (part(index()).load(std::memory_order_acquire) != 0) Recovery(*this).reap(index());
  } catch (const std::bad_alloc&) {  // as if killed here
    repaired = false;
  }
  leave_orphanage();
  lock_file_->take_turn();
  if (repaired) tell_homes();
  return repaired;
}

void Participant::place_beside_warden() noexcept {
  cpu_set_t cores;
  if (pthread_getaffinity_np(warden_.native_handle(), sizeof(cores), &cores) == 0) {
    pthread_setaffinity_np(pthread_self(), sizeof(cores), &cores);
  }
  const sched_param none{};
  pthread_setschedparam(pthread_self(), SCHED_BATCH, &none);
}

void Participant::warden() {
  pthread_setname_np(pthread_self(), "lot-warden");  // to name another thread would need /proc
  stand_guard();
  // This process may have been stopped meanwhile and taken for dead. Then nothing of its index
  // belongs to it. Relaxed: only this thread stores it.
  if (is_expelled_.load(std::memory_order_relaxed)) return;
  if (!presence_.renew()) return expel();
  keep_own_lock();

  // To leave, the participant reaps itself. After that the last participant removes the files.
  bool in_gate = false;
  try {
    // Without its lock file the process has nothing to remove. The descriptor may even name another
    // file.
    in_gate = lock_file_->intact() && lock_file_->enter_gate(kGatePatience);
  } catch (const std::exception&) {  // a stopped process keeps the gate, or memory is short
  }
  bool reaped = false;
  {
    const std::lock_guard guard(reap_mutex_);
    const auto until = futex::Clock::now() + kOrphanagePatienceInGate;
    while (!reaped && futex::Clock::now() < until) {
      if (enter_orphanage()) {
        if (in_gate) lock_file_->take_turn();
        // Other processes judge and reap only in the orphanage. So from here on the index stays
        // with this process.
        if (!presence_.renew()) {
          leave_orphanage();
          if (in_gate) lock_file_->leave_gate();
          return expel();
        }
        try {
          Recovery(*this).reap(index());
          reaped = true;
        } catch (const std::bad_alloc&) {  // as if killed here: the reap starts anew
        }
        leave_orphanage();
        if (in_gate) lock_file_->take_turn();
        if (reaped) tell_homes();
      } else {
        std::this_thread::sleep_for(1ms);
      }
    }
  }
  presence_.end();
  if (in_gate) {
    if (reaped) remove_files_if_last();
    // Inside the gate: the next process that leaves must see that this one has gone.
    lock_file_->unlock(index());
    lock_file_->leave_gate();
  }
  note_settled();
}

/// Removes the segment and its lock file if no other process uses them. The orphanage's lock does
/// not count as use: the process that acts for the orphanage has an index of its own. A process
/// that is ending may act for it to its end, behind its *ending* mark, since a thread closes a
/// ring.
///
/// REQUIRES: the gate.
void Participant::remove_files_if_last() noexcept {
  if (!lock_file_->intact()) return;
  const bool are_locks_held = lock_file_->held_by_other(1, participants() - 1);
  for (std::uint32_t k = 1; k < participants(); ++k) {
    // Relaxed: the gate carries it.
    const std::uint32_t errands = segment_.witnesses()[k].errands.load(std::memory_order_relaxed);
    if (k == index() || (errands & errand::kEnding) != 0) continue;
    if (are_locks_held && lock_file_->held_by_other(k)) return;
    if (part(k).load(std::memory_order_acquire) == 0) continue;  // edge "state"
    // A living process may have lost its byte to closefrom(). Its notice still stands then.
    if (!presence_.looks_dead(k)) return;
  }
  const bool is_there = segment_.is_at_its_path();
  // After the look at the others: one of them may have set it without the gate, and died since.
  if (is_there && segment_.keeps_files()) return;
  if (is_there) segment::Segment::remove(segment_.path(), trust_);
  ::unlink(lock_file_->path().c_str());
}

/// Settles the files for a process that a signal ends. The warden does it, as it does when it
/// leaves, so one thread of the process at a time uses the gate. Afterwards the warden does nothing
/// more, since the process ends now.
///
/// Crash:   killed in the gate, the effect is as when it leaves. Killed behind the mark, the
///          process was about to die in any case.
void Participant::settle_files() noexcept {
  if (!presence_.renew()) return expel();
  try {
    if (lock_file_->intact() && lock_file_->enter_gate(kGatePatience)) {
      remove_files_if_last();
      // Relaxed: the gate carries it.
      segment_.witnesses()[index()].errands.fetch_or(errand::kEnding, std::memory_order_relaxed);
      lock_file_->leave_gate();
    }
  } catch (const std::exception&) {  // a stopped process keeps the gate, or memory is short
  }
  note_settled();
  auto& errands = segment_.witnesses()[index()].errands;
  for (;;) {
    const std::uint32_t left = errands.fetch_and(~errand::kOwn, std::memory_order_acquire);  // E1
    // Relaxed: the errand (E1) carries it.
    if (warden_stop_.load(std::memory_order_relaxed)) return;
    futex::wait(&errands, left & ~errand::kOwn, std::nullopt);
  }
}

void Participant::note_settled() noexcept {
  // Relaxed: what it tells of is in the file system.
  files_settled_.store(1, std::memory_order_relaxed);
  futex::wake_all(&files_settled_);
}

/// The warden's loop. It sleeps on its errands and on the notice of each other participant, which
/// the kernel changes when that participant dies. The kernel wakes one of the wardens that sleep on
/// a notice. If that warden is stopped or killed, the others find the death at their next look.
void Participant::stand_guard() noexcept {
  auto& errands = segment_.witnesses()[index()].errands;
  auto soon = kFirstLook;
  auto rested = looked_ = futex::Clock::now();
  for (;;) {
    // First: this process may have been stopped for long and taken for dead. Then nothing of the
    // index is its own any more, and neither are the errands.
    if (!presence_.renew()) return expel();
    // Requests of other processes stay in the word until the warden has rested.
    const std::uint32_t mine = futex::Clock::now() >= rested ? ~std::uint32_t{0} : errand::kOwn;
    const std::uint32_t before = errands.fetch_and(~mine, std::memory_order_acquire);  // E1
    const std::uint32_t left = before & ~mine;
    // Relaxed: the errand (E1) carries both flags.
    if (is_ending_.load(std::memory_order_relaxed)) settle_files();
    if (warden_stop_.load(std::memory_order_relaxed) ||
        is_expelled_.load(std::memory_order_relaxed)) {  // as above
      return;
    }
    if ((before & mine & ~errand::kOwn) != 0) {
      run_errands(before & mine);
      rested = futex::Clock::now() + kErrandRest;
    }
    const bool finished = look_around();
    watched_.assign(1, {&errands, left});
    const bool all_stand = watch_others();
    auto until = looked_ + kIdleLook;
    if (left != 0) until = std::min(until, rested);
    if (finished && all_stand) {
      futex::wait_any(watched_, until);
      soon = kFirstLook;
    } else {
      futex::wait_any(watched_, std::min(futex::Clock::now() + soon, until));
      // Relaxed: a hint. The next turn fetches the errands with acquire.
      const bool asked = errands.load(std::memory_order_relaxed) != left;
      soon = asked ? kFirstLook : std::min(2 * soon, kLastLook);
    }
  }
}

void Participant::ring_warden() noexcept { holder_.ask(index(), errand::kOwn); }

void Participant::run_errands(std::uint32_t asked) noexcept {
  settle_kept();
  if ((asked & (errand::kTrim | errand::kGive)) == 0) return;
  segment::Witness& ours = segment_.witnesses()[index()];
  eviction_.settle();
  if ((asked & errand::kGive) != 0) {
    std::uint64_t word = ours.request.load(std::memory_order_relaxed);  // E1 carries it
    const bool given = eviction_.give(Request::of(word));
    trim(kNobody);
    // Of several requests the last one counts. If it has come just now, it gets another answer, by
    // the compare-and-swap. Relaxed: G1 carries the memory.
    ours.request.compare_exchange_strong(word, given ? Request::kGiven : Request::kRefused,
                                         std::memory_order_relaxed);
  } else {
    trim(kNobody);
  }
  ours.answers.fetch_add(1, std::memory_order_release);  // E2
}

/// Buries kept messages that no other process holds any more. It leaves pools without kept messages
/// alone, and so the bias of their locks.
void Participant::settle_kept() noexcept {
  const std::lock_guard guard(settle_mutex_);
  std::size_t n;
  {
    const std::lock_guard pools(pools_mutex_);
    n = pools_.size();
  }
  for (std::size_t i = 0; i < n; ++i) pools_[i]->settle();  // a pool is never destroyed or moved
}

/// Looks at messages that other processes have kept and that have left the ring of an idle
/// publisher. Without a turn of its own, such a publisher does not see that they are free. A
/// publisher that had a turn since the last look has seen it. The warden leaves pools alone whose
/// messages no other process ever kept, and so the bias of their locks.
void Participant::settle_idle() noexcept {
  std::size_t pools;
  {
    const std::lock_guard guard(pools_mutex_);
    pools = pools_.size();
  }
  std::fill(to_settle_.begin(), to_settle_.end(), false);
  std::fill(new_prints_.begin(), new_prints_.end(), 0);
  std::fill(to_trim_.begin(), to_trim_.end(), false);
  // Relaxed, as `pool` and `hold` below: hints. The pool looks again under its lock.
  const std::uint32_t known = holder_.known.load(std::memory_order_relaxed);
  for (std::uint32_t b = 0; b < known; ++b) {
    if (idle_looks_[b] >= kOldLooks) idle_looks_[b] = 0;  // it was a loan: the count starts anew
    if (!holder_.is_home(b)) {
      idle_looks_[b] = 0;
      continue;
    }
    // Each hold of another participant bumps the version (I3). Relaxed: a hint. Where the last look
    // saw another message, the comparison reports a hold too many rather than one too few.
    const std::uint64_t life = block(b).life.load(std::memory_order_relaxed);
    const std::uint64_t before = std::exchange(lives_[b], life);
    const bool same = refcount::generation_of(life) == refcount::generation_of(before);
    was_held_[b] =
        life / refcount::kVersion != before / refcount::kVersion || (same && was_held_[b]);
    const std::uint32_t pool = holder_.cell(b).pool.load(std::memory_order_relaxed);  // a hint
    const std::uint64_t v = holder_.cell(b).hold.load(std::memory_order_relaxed);     // a hint
    // A loan that the application keeps looks the same, but its pool does not have it among its
    // ready blocks.
    const bool rests = life == before && (v & hold::kHolds) == hold::kPointer &&
                       block(b).home_points.load(std::memory_order_relaxed) == 0;
    // Locked memory stays, and so do the blocks that have it.
    if (!rests || segment_.is_locked() || segment::is_reserved(segment_.arena(b))) {
      idle_looks_[b] = 0;
    } else {
      ++idle_looks_[b];
    }
    if (pool >= pools) continue;
    if (idle_looks_[b] >= kOldLooks) to_trim_[pool] = true;
    constexpr std::uint64_t kSpread = 0x9e3779b97f4a7c15;
    new_prints_[pool] += ((v + refcount::generation_of(life)) * kSpread) ^ b * kSpread;
    if (was_held_[b] && hold::pointers(v) == 0) to_settle_[pool] = true;
  }
  for (std::uint32_t i = 0; i < pools; ++i) {  // a pool is never destroyed or moved
    if (to_trim_[i] && pools_[i]->granules() != 0) {
      const std::lock_guard guard(settle_mutex_);
      pools_[i]->trim_old([this](std::uint32_t b) { return idle_looks_[b] >= kOldLooks; });
    }
    const bool is_idle = std::exchange(prints_[i], new_prints_[i]) == new_prints_[i];
    if (!is_idle || !to_settle_[i] || !pools_[i]->may_wait()) continue;
    std::array<std::uint32_t, 16> foreign;
    for (std::size_t n = foreign.size(); n == foreign.size();) {
      n = eviction_.look(i, foreign);  // without settle_mutex_, under which destructors run
      const std::lock_guard guard(settle_mutex_);
      for (std::size_t k = 0; k < n; ++k) holder_.release(foreign[k], hold::kRing);
    }
    const std::lock_guard guard(settle_mutex_);
    pools_[i]->settle_free();
  }
}

/// Gives unused memory back to the system. Of all wardens, one looks, about once a second.
void Participant::give_unused_back() noexcept {
  if (!segment_.can_give_back()) return;  // another process perhaps can
  auto& looked = segment_.directory().looked_ns;
  // Relaxed, both: the word only says when to look; it carries nothing.
  std::uint64_t before = looked.load(std::memory_order_relaxed);
  const auto now = futex::Clock::now();
  const auto ns = static_cast<std::uint64_t>(now.time_since_epoch() / 1ns);
  // Signed: another warden may have looked a moment later than `now`. In another time namespace the
  // difference can be anything.
  const auto since = std::chrono::nanoseconds(static_cast<std::int64_t>(ns - before));
  if ((since > -kTurn && since < kTurn) ||
      !looked.compare_exchange_strong(before, ns, std::memory_order_relaxed)) {  // as above
    return;
  }
  segment_.look_at_units();
  const auto& errands = segment_.witnesses()[index()].errands;
  give_back_to_system(kOldLooks, [&] {
    // Relaxed: a hint to stop early.
    return errands.load(std::memory_order_relaxed) != 0 ||
           futex::Clock::now() >= now + kGiveBackTime;
  });
}

/// Tells all homes to look again, after ownership bits of a dead participant or of the orphanage
/// were cleared.
void Participant::tell_homes() noexcept {
  for (std::uint32_t b = 0; b < blocks(); ++b) holder_.tell_home(b);
}

/// This process was taken for dead, and another process has its index or will get it. From now on
/// it is inert. A thread that is in the midst of a call gets no lock in the old name. The kernel's
/// robust list leads to the seat no more: in another PID namespace a thread of the next owner may
/// have the same thread id as a thread of this process.
void Participant::expel() noexcept {
  // Relaxed, both: other threads only have to see them soon. They carry nothing.
  is_expelled_.store(true, std::memory_order_relaxed);
  inert_.store(true, std::memory_order_relaxed);  // as above
  presence_.end();
  lock_file_->unlock(index());  // another process has the index, or will have it
  note_settled();
}

/// False when something is left that another look may finish.
bool Participant::look_around() noexcept {
  const auto now = futex::Clock::now();
  const bool due = now - looked_ >= kIdleLook;
  keep_own_lock();
  const std::uint32_t bequests =
      segment_.directory().bequests.load(std::memory_order_acquire);  // D3
  if (reap_dead() || (due && (orphans_ || bequests != bequests_)) || has_deserted_ring()) {
    orphans_ = collect();
    bequests_ = bequests;
  }
  const bool closed = finish_closing();
  if (due) {
    settle_kept();  // once a second, since an errand may have been lost
    settle_idle();
    give_unused_back();
    note_sightings();
    looked_ = now;
  }
  const bool departed = finish_departures();
  return closed && departed && !lock_lost_ && !has_ending_rings();
}

void Participant::depart(std::list<registry::Departure> departure) noexcept {
  try {
    const registry::Registry::Lock lock(registry_);
    registry_.remove(departure.front(), index());
  } catch (const std::exception&) {  // a stopped process keeps the registry's lock
    {
      const std::lock_guard guard(departures_mutex_);
      departures_.splice(departures_.end(), departure);
    }
    ring_warden();
    return;
  }
  leave_topic(departure.front().topic);
}

bool Participant::finish_departures() noexcept {
  const std::lock_guard guard(departures_mutex_);
  if (departures_.empty()) return true;
  // The warden must not wait, since it has to watch the other processes.
  const std::unique_lock topics(topics_mutex_, std::try_to_lock);
  if (!topics || !registry_.try_lock()) return false;
  for (const auto& departure : departures_) {
    registry_.remove(departure, index());
    count_out(departure.topic);
  }
  registry_.unlock();
  departures_.clear();
  return true;
}

/// Adds the notices of the other participants to the words that the warden sleeps on, beginning
/// with the next index. False when one of them has died and is not reaped yet (it was not quite
/// dead), or when this kernel cannot wait for several words.
bool Participant::watch_others() noexcept {
  if (!futex::waits_for_many()) return false;  // asked each time, since a sandbox may have come
  bool all_stand = true;
  for (std::uint32_t n = 1; n < participants(); ++n) {
    const std::uint32_t k = (index() + n) % participants();
    // Acquire: edge "state".
    if (k == refcount::kOrphanage || part(k).load(std::memory_order_acquire) == 0) continue;
    const detail::FutexWait notice = presence_.watch(k);
    if (notice.value == liveness::seat::kUnwitnessed) continue;
    if (!liveness::seat::stands(notice.value)) {
      all_stand = false;
    } else if (watched_.size() < futex::kMaxWords) {
      watched_.push_back(notice);
    }
  }
  return all_stand;
}

/// Takes the own byte lock again after closefrom() or the like has dropped it. Other processes do
/// not reap this one meanwhile, because its notice stands. With the byte back, they need not look
/// at the notice.
void Participant::keep_own_lock() noexcept {
  if (!lock_file_->intact()) {
    const std::scoped_lock guard(reap_mutex_, no_fork());
    lock_lost_ = lock_file_->reopen();
  }
  // A process that probes the byte may have it for a moment. Then the next look tries again.
  if (lock_lost_) lock_lost_ = !lock_file_->try_lock(index());
}

/// Acting for the orphanage takes two locks: byte 0 of the lock file, and a robust mutex word. Byte
/// 0 mostly shows at once that another process acts. The word is needed because there are two lock
/// files after one was removed and made anew, and none in a process that has lost its own.
///
/// REQUIRES: reap_mutex_, or that no other thread knows this participant yet.
bool Participant::enter_orphanage() noexcept {
  if (lock_file_->intact() && !lock_file_->try_lock(refcount::kOrphanage)) return false;
  RobustMutex mutex(segment_.directory().orphanage.word, presence_);
  if (mutex.try_lock() != RobustMutex::Outcome::Busy) return true;
  lock_file_->unlock(refcount::kOrphanage);
  return false;
}
void Participant::leave_orphanage() noexcept {
  RobustMutex(segment_.directory().orphanage.word, presence_).unlock();
  lock_file_->unlock(refcount::kOrphanage);
}

bool Participant::reap_if_dead(std::uint32_t k) noexcept {
  if (k == index() || k == refcount::kOrphanage || k >= participants()) return false;
  const std::unique_lock guard(reap_mutex_, std::try_to_lock);
  if (!guard || !lock_file_->intact() || !lock_file_->try_lock(k)) return false;
  bool done = false;
  // Acquire: edge "state".
  if (part(k).load(std::memory_order_acquire) != 0 && presence_.judge(k) && enter_orphanage()) {
    // Once more: another reaper, with another lock file, may have been faster, and a new process
    // may have taken k.
    if (part(k).load(std::memory_order_acquire) != 0 && presence_.is_judged(k)) {
      try {
        done = Recovery(*this).reap(k);
      } catch (const std::bad_alloc&) {  // as if killed here: the next look does it all again
      }
    }
    leave_orphanage();
    if (done) tell_homes();
  }
  lock_file_->unlock(k);
  return done;
}

bool Participant::reap_dead() noexcept {
  bool done = false;
  for (std::uint32_t k = 1; k < participants(); ++k) {
    // Acquire: edge "state".
    if (k != index() && part(k).load(std::memory_order_acquire) != 0 && presence_.looks_dead(k)) {
      done |= reap_if_dead(k);
    }
  }
  return done;
}

/// How many channels, from the lowest, were ever in use. Channels are taken lowest first. A thread
/// that has seen one of a higher number has seen those below it, so a search ends at the first
/// channel that was never taken. (After 2^31 uses a channel looks new. A search may then end too
/// early, until the channel is taken once more.)
std::uint32_t Participant::used_channels() noexcept {
  // Relaxed: the number only grows, and two threads find the same. The writer words are acquired
  // (R7): a ring that is found is whole.
  std::uint32_t used = used_channels_.load(std::memory_order_relaxed);
  // Acquire: R7.
  while (used < channels() && channel_writer(used).load(std::memory_order_acquire) != 0) ++used;
  used_channels_.store(used, std::memory_order_relaxed);  // as above
  return used;
}

bool Participant::has_orphan_rings() noexcept {
  const std::uint32_t used = used_channels();
  for (std::uint32_t c = 0; c < used; ++c) {
    // Acquire: R9.
    const auto w = channel_writer(c).load(std::memory_order_acquire);
    if (ring::writer_state(w) == ring::State::Orphan) return true;
  }
  return false;
}

/// Whether a ring has ended whose readers are at their last messages. A ring of items to be taken
/// counts only when it has no news: its items may wait for long, and the reader that takes the last
/// one says so. A hint: a ring may be recycled meanwhile.
bool Participant::has_ending_rings() noexcept {
  const std::uint32_t used = used_channels();
  for (std::uint32_t c = 0; c < used; ++c) {
    // Acquire: R9.
    const auto w = channel_writer(c).load(std::memory_order_acquire);
    if (ring::writer_state(w) != ring::State::Orphan) continue;
    const segment::Ring r = ring(c);
    if (!r.taken || !r.has_news()) return true;
  }
  return false;
}

/// Whether an ended ring has no reader any more. Only the process that acts for the orphanage may
/// ask: when another process recycles the ring, its memory may get a new owner. While another
/// process acts for the orphanage the answer is no, and the next look asks again.
bool Participant::has_deserted_ring() noexcept {
  if (!has_orphan_rings()) return false;
  const std::unique_lock guard(reap_mutex_, std::try_to_lock);
  if (!guard || !enter_orphanage()) return false;
  const bool found = Recovery(*this).has_deserted_ring(used_channels());
  leave_orphanage();
  return found;
}

bool Participant::collect() noexcept {
  bool orphans = has_orphan_rings();
  for (std::uint32_t b = 0; b < blocks() && !orphans; ++b) {
    // Relaxed: a hint. collect() looks again in the orphanage.
    orphans = block(b).home.load(std::memory_order_relaxed) == refcount::kHomeOrphanage;
  }
  if (!orphans) return false;
  const std::unique_lock guard(reap_mutex_, std::try_to_lock);
  if (!guard || !enter_orphanage()) return true;
  try {
    Recovery(*this).collect();
  } catch (const std::bad_alloc&) {  // as if killed here: the next look does it all again
  }
  leave_orphanage();
  tell_homes();
  return true;
}

void Participant::renew_directory() noexcept {
  auto& version = segment_.directory().version;
  // Relaxed, as in ring::announce(): D1 carries nothing.
  version.fetch_add(1, std::memory_order_relaxed);
  futex::wake_all(&version);
}

/// Crash:   killed after this and before the dead participant's name goes, the next reaper does it
///          all again.
void Participant::forget(std::uint32_t k) noexcept {
  // The dead participant may have had this lock. Freed here, it keeps no process waiting.
  if (registry_.try_lock()) registry_.unlock();
  registry_.forget(k);
  segment_.directory().bequests.fetch_add(1, std::memory_order_release);  // D3
}

void Participant::release_extents(const std::vector<bool>& dead) noexcept {
  segment_.granules().release_if([&dead](std::uint32_t tag) {
    return (tag & segment::kRingTag) == 0 && tag - 1 < dead.size() && dead[tag - 1];
  });
}

}  // namespace lot::transport
