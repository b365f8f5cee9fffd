// SPDX-License-Identifier: Apache-2.0
/// Who is alive: taking an index, the warden, reaping, collecting, and leaving the segment.
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
/// How often the warden looks while there is something to finish: first soon, then ever more
/// seldom.
constexpr std::chrono::milliseconds kFirstLook{1};
constexpr std::chrono::milliseconds kLastLook{100};
/// And when there is nothing: somebody may have died whose death it was not told of.
constexpr auto kIdleLook = 1s;
/// Idle memory of a publisher goes back to the segment after so many looks, and from the segment to
/// the system after as many more.
constexpr std::uint8_t kOldLooks = 5;
/// What is more waits for the next look: the warden watches over the other processes.
constexpr auto kGiveBackTime = 20ms;
/// Looks for unused memory are so far apart, at the least.
constexpr auto kTurn = kIdleLook * 9 / 10;
/// Between two errands of other processes, however many they bring.
constexpr auto kErrandRest = 1ms;
/// Who joins when all indexes are taken asks again so long: somebody may be reaping just now.
constexpr auto kFullPatience = 200ms;

}  // namespace

void Participant::take_index(const EngineOptions& options) {
  const auto until = futex::Clock::now() + kFullPatience;
  // What a dead one has left costs a reap: the wardens do that, when there are other indexes.
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
  // Errands were for the one before us. Relaxed: what comes after the name is seen by the name.
  segment_.witnesses()[index()].errands.store(0, std::memory_order_relaxed);
  part(index()).store(1, std::memory_order_release);
}

/// Takes an index that nobody has: one that is clean, or one of a dead process, which is repaired
/// first, in its own name.
bool Participant::try_take_index(bool of_a_dead_one, futex::Clock::time_point until) {
  const auto may_take = [&](std::uint32_t k) {
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

/// False: somebody else acts for the orphanage all the time.
bool Participant::repair_index(futex::Clock::time_point until) noexcept {
  if (part(index()).load(std::memory_order_acquire) == 0) return true;
  while (!enter_orphanage()) {
    if (futex::Clock::now() >= until) return false;
    std::this_thread::sleep_for(1ms);
  }
  bool repaired = true;
  try {
    // Another one, with another lock file, may have been at it.
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
  pthread_setname_np(pthread_self(), "lot-warden");  // of another thread it would go through /proc
  stand_guard();
  // Stopped meanwhile, perhaps: nothing of that index may be ours.
  if (is_expelled_.load(std::memory_order_relaxed)) return;
  if (!presence_.renew()) return expel();
  keep_own_lock();

  // Leaving is exactly a reap of oneself, and then: the last one out removes the files.
  bool in_gate = false;
  try {
    // Without a lock file there is nothing to remove, and its number may name another file.
    in_gate = lock_file_->intact() && lock_file_->enter_gate(kGatePatience);
  } catch (const std::exception&) {  // another one is stopped there, or memory is short
  }
  bool reaped = false;
  {
    const std::lock_guard guard(reap_mutex_);
    const auto until = futex::Clock::now() + kOrphanagePatienceInGate;
    while (!reaped && futex::Clock::now() < until) {
      if (enter_orphanage()) {
        if (in_gate) lock_file_->take_turn();
        // Others judge and reap in the orphanage: from here on the index stays ours.
        if (!presence_.renew()) {
          leave_orphanage();
          if (in_gate) lock_file_->leave_gate();
          return expel();
        }
        try {
          Recovery(*this).reap(index());
          reaped = true;
        } catch (const std::bad_alloc&) {  // as if killed here: it is done all again
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
    // Inside the gate: whoever leaves next must see that we are gone.
    lock_file_->unlock(index());
    lock_file_->leave_gate();
  }
  note_settled();
}

/// The orphanage's lock says nothing here: the process that acts for it has an index of its own,
/// and may do so to its end (a thread closes a ring), behind its *ending*.
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
    if (part(k).load(std::memory_order_acquire) == 0) continue;
    // A living process may have lost its byte to closefrom(): then its notice stands.
    if (!presence_.looks_dead(k)) return;
  }
  const bool is_there = segment_.is_at_its_path();
  // Behind the look at the others: one of them may have set it without the gate, and died since.
  if (is_there && segment_.keeps_files()) return;
  if (is_there) segment::Segment::remove(segment_.path(), trust_);
  ::unlink(lock_file_->path().c_str());
}

/// The warden does it, as when it leaves: so the gate has one user at a time. It does nothing more:
/// the process ends now.
///
/// Crash: killed in the gate, as when it leaves. Behind the mark: it was to die.
void Participant::settle_files() noexcept {
  if (!presence_.renew()) return expel();
  try {
    if (lock_file_->intact() && lock_file_->enter_gate(kGatePatience)) {
      remove_files_if_last();
      segment_.witnesses()[index()].errands.fetch_or(errand::kEnding, std::memory_order_relaxed);
      lock_file_->leave_gate();
    }
  } catch (const std::exception&) {  // another one is stopped there, or memory is short
  }
  note_settled();
  auto& errands = segment_.witnesses()[index()].errands;
  for (;;) {
    const std::uint32_t left = errands.fetch_and(~errand::kOwn, std::memory_order_acquire);  // E1
    if (warden_stop_.load(std::memory_order_relaxed)) return;
    futex::wait(&errands, left & ~errand::kOwn, std::nullopt);
  }
}

void Participant::note_settled() noexcept {
  files_settled_.store(1, std::memory_order_relaxed);
  futex::wake_all(&files_settled_);
}

/// The warden sleeps on what tells it that there is something to do: its errands, and the notice of
/// each other participant, which the kernel changes when that one dies. One of those who sleep on a
/// notice is woken; should it be stopped or killed, the others find out when they look by
/// themselves.
void Participant::stand_guard() noexcept {
  auto& errands = segment_.witnesses()[index()].errands;
  auto soon = kFirstLook;
  auto rested = looked_ = futex::Clock::now();
  for (;;) {
    // First: we may have been stopped for long. Nothing of the index may be ours any more, its
    // errands neither.
    if (!presence_.renew()) return expel();
    // What others ask waits, and stands there meanwhile, until we have rested.
    const std::uint32_t mine = futex::Clock::now() >= rested ? ~std::uint32_t{0} : errand::kOwn;
    const std::uint32_t before = errands.fetch_and(~mine, std::memory_order_acquire);  // E1
    const std::uint32_t left = before & ~mine;
    // The errand carries both.
    if (is_ending_.load(std::memory_order_relaxed)) settle_files();
    if (warden_stop_.load(std::memory_order_relaxed) ||
        is_expelled_.load(std::memory_order_relaxed)) {
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
    // Of several that have asked, the last one counts. It may have come just now: then it has
    // another answer. Relaxed: the memory is carried by G1.
    ours.request.compare_exchange_strong(word, given ? Request::kGiven : Request::kRefused,
                                         std::memory_order_relaxed);
  } else {
    trim(kNobody);
  }
  ours.answers.fetch_add(1, std::memory_order_release);  // E2
}

/// Pools without kept messages are left alone, and so is the bias of their locks.
void Participant::settle_kept() noexcept {
  const std::lock_guard guard(settle_mutex_);
  std::size_t n;
  {
    const std::lock_guard pools(pools_mutex_);
    n = pools_.size();
  }
  for (std::size_t i = 0; i < n; ++i) pools_[i]->settle();  // pools stay, and where they are
}

/// Looks at messages that other processes have kept and that have left the ring of an idle
/// publisher: without a turn of its own, the publisher does not see that they are free. A publisher
/// that had a turn since the last look has seen it. Pools whose messages no other process ever kept
/// are left alone, and so is the bias of their locks.
void Participant::settle_idle() noexcept {
  std::size_t pools;
  {
    const std::lock_guard guard(pools_mutex_);
    pools = pools_.size();
  }
  std::fill(to_settle_.begin(), to_settle_.end(), false);
  std::fill(new_prints_.begin(), new_prints_.end(), 0);
  std::fill(to_trim_.begin(), to_trim_.end(), false);
  const std::uint32_t known = holder_.known.load(std::memory_order_relaxed);
  for (std::uint32_t b = 0; b < known; ++b) {
    if (idle_looks_[b] >= kOldLooks) idle_looks_[b] = 0;  // it was a loan
    if (!holder_.is_home(b)) {
      idle_looks_[b] = 0;
      continue;
    }
    // Each hold of another one bumps the version (I3). Relaxed: a hint. The version of another
    // message's last look says too much rather than too little.
    const std::uint64_t life = block(b).life.load(std::memory_order_relaxed);
    const std::uint64_t before = std::exchange(lives_[b], life);
    const bool same = refcount::generation_of(life) == refcount::generation_of(before);
    was_held_[b] =
        life / refcount::kVersion != before / refcount::kVersion || (same && was_held_[b]);
    const std::uint32_t pool = holder_.cell(b).pool.load(std::memory_order_relaxed);
    const std::uint64_t v = holder_.cell(b).hold.load(std::memory_order_relaxed);
    // A loan that the application keeps looks the same, but its pool does not have it at hand.
    const bool rests = life == before && (v & hold::kHolds) == hold::kPointer &&
                       block(b).home_points.load(std::memory_order_relaxed) == 0;
    // Where memory is locked it stays, and so do the blocks that have it.
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
  for (std::uint32_t i = 0; i < pools; ++i) {  // pools stay, and where they are
    if (to_trim_[i] && pools_[i]->granules() != 0) {
      const std::lock_guard guard(settle_mutex_);
      pools_[i]->trim_old([this](std::uint32_t b) { return idle_looks_[b] >= kOldLooks; });
    }
    const bool is_idle = std::exchange(prints_[i], new_prints_[i]) == new_prints_[i];
    if (!is_idle || !to_settle_[i] || !pools_[i]->may_wait()) continue;
    std::array<std::uint32_t, 16> foreign;
    for (std::size_t n = foreign.size(); n == foreign.size();) {
      n = eviction_.look(i, foreign);  // before settle_mutex_, with which destructors run
      const std::lock_guard guard(settle_mutex_);
      for (std::size_t k = 0; k < n; ++k) holder_.release(foreign[k], hold::kRing);
    }
    const std::lock_guard guard(settle_mutex_);
    pools_[i]->settle_free();
  }
}

/// Of all wardens one looks, once a second.
void Participant::give_unused_back() noexcept {
  if (!segment_.can_give_back()) return;  // another process can, perhaps
  auto& looked = segment_.directory().looked_ns;
  std::uint64_t before = looked.load(std::memory_order_relaxed);
  const auto now = futex::Clock::now();
  const auto ns = static_cast<std::uint64_t>(now.time_since_epoch() / 1ns);
  // Signed: another warden may just have looked; in another time namespace it is any time.
  const auto since = std::chrono::nanoseconds(static_cast<std::int64_t>(ns - before));
  if ((since > -kTurn && since < kTurn) ||
      !looked.compare_exchange_strong(before, ns, std::memory_order_relaxed)) {
    return;
  }
  segment_.look_at_units();
  const auto& errands = segment_.witnesses()[index()].errands;
  give_back_to_system(kOldLooks, [&] {
    return errands.load(std::memory_order_relaxed) != 0 ||
           futex::Clock::now() >= now + kGiveBackTime;
  });
}

/// After bits of a dead one, or of the orphanage, were cleared: whoever waits for them looks.
void Participant::tell_homes() noexcept {
  for (std::uint32_t b = 0; b < blocks(); ++b) holder_.tell_home(b);
}

/// Our index is another process's: we were taken for dead, and are so from now on. A thread that is
/// in the midst of a call gets no lock in the old name, and the kernel's list leads to the seat no
/// more: in another PID namespace the next one's thread may be called as ours.
void Participant::expel() noexcept {
  is_expelled_.store(true, std::memory_order_relaxed);
  inert_.store(true, std::memory_order_relaxed);
  presence_.end();
  lock_file_->unlock(index());  // another one has the index, or will
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
    settle_kept();  // an errand may have been lost
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
  } catch (const std::exception&) {  // a stopped process keeps it
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
  // The warden must not wait: it watches over the other processes.
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

/// Adds the others' notices to what is slept on, the next ones first. False when one of them has
/// died and is not reaped yet (it was not quite dead), or when this kernel cannot watch.
bool Participant::watch_others() noexcept {
  if (!futex::waits_for_many()) return false;  // each time: a sandbox may have come
  bool all_stand = true;
  for (std::uint32_t n = 1; n < participants(); ++n) {
    const std::uint32_t k = (index() + n) % participants();
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

/// closefrom() and the like in the application drop our lock. Nobody reaps us then, because the
/// notice stands; but nobody should have to ask it.
void Participant::keep_own_lock() noexcept {
  if (!lock_file_->intact()) {
    const std::scoped_lock guard(reap_mutex_, no_fork());
    lock_lost_ = lock_file_->reopen();
  }
  // A prober may have the byte for a moment: then again the next time.
  if (lock_lost_) lock_lost_ = !lock_file_->try_lock(index());
}

/// Two locks: byte 0, by which most find without a question that somebody is at it, and a word,
/// since there are two lock files when somebody has removed one, and none in the process that has
/// lost it.
///
/// REQUIRES: reap_mutex_, or that nobody else knows this participant yet.
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
  if (part(k).load(std::memory_order_acquire) != 0 && presence_.judge(k) && enter_orphanage()) {
    // Once more: another reaper, with another lock file, may have been quicker, and k be taken.
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
    if (k != index() && part(k).load(std::memory_order_acquire) != 0 && presence_.looks_dead(k)) {
      done |= reap_if_dead(k);
    }
  }
  return done;
}

/// Channels are taken lowest first, and who has seen one of a higher number has seen those below
/// it: so the first that never was taken ends a search. (After 2^31 times a channel looks new; then
/// a search may be short until it is taken once more.)
std::uint32_t Participant::used_channels() noexcept {
  std::uint32_t used = used_channels_.load(std::memory_order_relaxed);
  while (used < channels() && channel_writer(used).load(std::memory_order_acquire) != 0) ++used;
  used_channels_.store(used, std::memory_order_relaxed);
  return used;
}

bool Participant::has_orphan_rings() noexcept {
  const std::uint32_t used = used_channels();
  for (std::uint32_t c = 0; c < used; ++c) {
    const auto w = channel_writer(c).load(std::memory_order_acquire);
    if (ring::writer_state(w) == ring::State::Orphan) return true;
  }
  return false;
}

/// Of those whose readers are at their last messages. What waits to be taken may wait for long, and
/// who takes the last one says so. A hint: a ring may be recycled meanwhile.
bool Participant::has_ending_rings() noexcept {
  const std::uint32_t used = used_channels();
  for (std::uint32_t c = 0; c < used; ++c) {
    const auto w = channel_writer(c).load(std::memory_order_acquire);
    if (ring::writer_state(w) != ring::State::Orphan) continue;
    const segment::Ring r = ring(c);
    if (!r.taken || !r.has_news()) return true;
  }
  return false;
}

/// Asked by who acts for the orphanage: the memory of a ring that another one recycles may be
/// anybody's. While somebody else acts for it the answer is no, and the next look asks again.
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
  version.fetch_add(1, std::memory_order_relaxed);  // as ring::announce()
  futex::wake_all(&version);
}

/// Crash: killed after this, before the dead one's name goes: the next reaper does it all again.
void Participant::forget(std::uint32_t k) noexcept {
  if (registry_.try_lock()) registry_.unlock();  // it may have had it: nobody has to wait for that
  registry_.forget(k);
  segment_.directory().bequests.fetch_add(1, std::memory_order_release);  // D3
}

void Participant::release_extents(const std::vector<bool>& dead) noexcept {
  segment_.granules().release_if([&dead](std::uint32_t tag) {
    return (tag & segment::kRingTag) == 0 && tag - 1 < dead.size() && dead[tag - 1];
  });
}

}  // namespace lot::transport
