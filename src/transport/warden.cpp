// SPDX-License-Identifier: Apache-2.0
#include "transport/warden.hpp"

#include <algorithm>
#include <chrono>
#include <exception>
#include <optional>
#include <pthread.h>
#include <system_error>

#include "lot/detail/no_signals.hpp"
#include "lot/error.hpp"

#include "segment/system_limits.hpp"
#include "transport/gate.hpp"

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
/// A look gives memory back for at most this long. The rest waits for the next look, since the
/// warden has to watch the other processes. What idle publishers have given back to the segment
/// goes back to the system after as many looks more.
constexpr auto kGiveBackTime = 20ms;
/// Two looks for unused memory are at least this far apart.
constexpr auto kTurn = kIdleLook * 9 / 10;
/// The warden rests this long after it has run errands of other processes, however many they bring.
constexpr auto kErrandRest = 1ms;

}  // namespace

Warden::Warden(const Parts& parts)
    : membership_(parts.membership),
      lock_file_(parts.membership.lock_file()),
      presence_(parts.membership.presence()),
      segment_(parts.membership.segment()),
      world_(parts.world),
      holder_(parts.holder),
      thread_(parts.thread),
      eviction_(parts.eviction),
      stock_(parts.stock),
      reaper_(parts.reaper),
      rings_(parts.rings),
      topics_(parts.topics),
      no_fork_(parts.no_fork),
      idle_look_(segment_, holder_, stock_, eviction_),
      held_since_(segment_, world_, holder_) {
  watched_.reserve(futex::kMaxWords);
}

void Warden::start() {
  try {
    const detail::NoSignals quiet;
    thread_.start([this] { run(); });
  } catch (const std::system_error& e) {
    throw Error(e.code().value(), segment_.path(), "no thread to watch over the others",
                segment::advice_on_threads());
  }
}

void Warden::stop() noexcept {
  warden_stop_.store(true, std::memory_order_relaxed);  // relaxed: the errand (E1) carries it
  wake();
  thread_.join();
}

void Warden::end_soon() noexcept {
  is_ending_.store(true, std::memory_order_relaxed);  // relaxed: the errand (E1) carries it
  wake();
}

void Warden::wake() noexcept { holder_.ask(index(), errand::kOwn); }

void Warden::run() {
  pthread_setname_np(pthread_self(), "lot-warden");  // to name another thread would need /proc
  stand_guard();
  // This process may have been stopped meanwhile and taken for dead. Then nothing of its index
  // belongs to it.
  if (membership_.is_expelled()) return;
  if (!presence_.renew()) return membership_.expel();
  reaper_.keep_own_lock(no_fork_);
  leave();
}

/// To leave, the participant reaps itself. After that the last participant removes the files.
void Warden::leave() noexcept {
  bool in_gate = false;
  try {
    // Without its lock file the process has nothing to remove. The descriptor may even name another
    // file.
    in_gate = lock_file_.intact() && lock_file_.enter_gate(kGatePatience);
  } catch (const std::exception&) {  // a stopped process keeps the gate, or memory is short
  }
  const Reaper::Own own = reaper_.reap_own(in_gate);
  if (own == Reaper::Own::Lost) {
    if (in_gate) lock_file_.leave_gate();
    return membership_.expel();
  }
  presence_.end();
  if (in_gate) {
    if (own == Reaper::Own::Reaped) membership_.remove_files_if_last();
    // Inside the gate: the next process that leaves must see that this one has gone.
    lock_file_.unlock(index());
    lock_file_.leave_gate();
  }
  membership_.note_settled();
}

/// The warden's loop. It sleeps on its errands and on the notice of each other participant, which
/// the kernel changes when that participant dies. The kernel wakes one of the wardens that sleep on
/// a notice. If that warden is stopped or killed, the others find the death at their next look.
void Warden::stand_guard() noexcept {
  auto& errands = segment_.witnesses()[index()].errands;
  auto soon = kFirstLook;
  auto rested = looked_ = futex::Clock::now();
  for (;;) {
    // First: this process may have been stopped for long and taken for dead. Then nothing of the
    // index is its own any more, and neither are the errands.
    if (!presence_.renew()) return membership_.expel();
    // Requests of other processes stay in the word until the warden has rested.
    const std::uint32_t mine = futex::Clock::now() >= rested ? ~std::uint32_t{0} : errand::kOwn;
    const std::uint32_t before = errands.take(mine);
    const std::uint32_t left = before & ~mine;
    // Relaxed: the errand (E1) carries both flags.
    if (is_ending_.load(std::memory_order_relaxed)) settle_files();
    if (warden_stop_.load(std::memory_order_relaxed) || membership_.is_expelled())
      return;  // as above
    if ((before & mine & ~errand::kOwn) != 0) {
      run_errands(before & mine);
      rested = futex::Clock::now() + kErrandRest;
    }
    const bool finished = look_around();
    watched_.clear();
    watched_.push_back({errands.word(), left});
    const bool all_stand = watch_others();
    auto until = looked_ + kIdleLook;
    if (left != 0) until = std::min(until, rested);
    if (finished && all_stand) {
      futex::wait_any(watched_, until);
      soon = kFirstLook;
    } else {
      futex::wait_any(watched_, std::min(futex::Clock::now() + soon, until));
      const bool asked = errands.waiting() != left;
      soon = asked ? kFirstLook : std::min(2 * soon, kLastLook);
    }
  }
}

/// Settles the files for a process that a signal ends. The warden does it, as it does when it
/// leaves, so one thread of the process at a time uses the gate. Afterwards the warden does nothing
/// more, since the process ends now.
void Warden::settle_files() noexcept {
  if (!presence_.renew()) return membership_.expel();
  membership_.settle_files();
  auto& errands = segment_.witnesses()[index()].errands;
  for (;;) {
    const std::uint32_t left = errands.take(errand::kOwn);
    // Relaxed: the errand (E1) carries it.
    if (warden_stop_.load(std::memory_order_relaxed)) return;
    futex::wait(errands.word(), left & ~errand::kOwn, std::nullopt);
  }
}

void Warden::run_errands(std::uint32_t asked) noexcept {
  stock_.settle_kept();
  if ((asked & (errand::kTrim | errand::kGive)) == 0) return;
  segment::Errands& ours = segment_.witnesses()[index()].errands;
  eviction_.settle();
  if ((asked & errand::kGive) != 0) {
    const std::uint64_t request = ours.request();
    const bool given = eviction_.give(Request::of(request));
    stock_.trim(Stock::kNobody);
    ours.reply(request, given ? Request::kGiven : Request::kRefused);
  } else {
    stock_.trim(Stock::kNobody);
  }
  ours.answer();
}

/// False when something is left that another look may finish.
bool Warden::look_around() noexcept {
  const auto now = futex::Clock::now();
  const bool due = now - looked_ >= kIdleLook;
  const bool has_lock = reaper_.keep_own_lock(no_fork_);
  const std::uint32_t adoptions =
      segment_.directory().adoptions.load(std::memory_order_acquire);  // D3
  if (reaper_.reap_dead() || (due && (orphans_ || adoptions != adoptions_)) ||
      reaper_.has_deserted_ring()) {
    orphans_ = reaper_.collect();
    adoptions_ = adoptions;
  }
  const bool closed = rings_.finish_closing();
  if (due) {
    stock_.settle_kept();  // once a second, since an errand may have been lost
    idle_look_.look();
    give_unused_back();
    held_since_.note();
    looked_ = now;
  }
  const bool departed = topics_.finish_departures();
  return closed && departed && has_lock && !world_.has_ending_rings();
}

/// Adds the notices of the other participants to the words that the warden sleeps on, beginning
/// with the next index. False when one of them has died and is not reaped yet (it was not quite
/// dead), or when this kernel cannot wait for several words.
bool Warden::watch_others() noexcept {
  if (!futex::waits_for_many()) return false;  // asked each time, since a sandbox may have come
  bool all_stand = true;
  for (std::uint32_t n = 1; n < world_.participants(); ++n) {
    const std::uint32_t k = (index() + n) % world_.participants();
    // Acquire: edge "state".
    if (k == refcount::kOrphanage ||
        world_.participant_state(k).load(std::memory_order_acquire) == 0)
      continue;
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

/// Gives unused memory back to the system. Of all wardens, one looks, about once a second.
void Warden::give_unused_back() noexcept {
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
  stock_.give_back_to_system(IdleLook::kOldLooks, [&] {
    return errands.waiting() != 0 || futex::Clock::now() >= now + kGiveBackTime;
  });
}

}  // namespace lot::transport
