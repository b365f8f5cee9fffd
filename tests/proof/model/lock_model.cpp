// SPDX-License-Identifier: Apache-2.0
#include "policy.hpp"
#include "robust_mutex/lock_word.hpp"
#include "scenario.hpp"
#include "world.hpp"

/// The word of a lock between processes: it excludes, wakes, and outlives its holder.
namespace lot::model {
namespace {

/// A lock, what it guards, and who is there. What the lock does not order is a race.
struct Locked {
  using Steps = lock::LockWord<Policy>;

  Locked() { guarded.write(0); }

  void work() { guarded.write(guarded.read() + 1); }

  /// As RobustMutex::lock_for() with all the time of the world, of living holders.
  void lock(std::uint32_t name) {
    Steps steps(word);
    if (steps.try_lock(name, false)) return;
    for (;;) {
      const std::uint32_t seen = steps.announce();
      if (seen != 0) word.wait_while(seen);
      if (steps.try_lock(name, true)) return;
    }
  }
  /// As RobustMutex::try_lock(). True when it was locked, or taken over.
  bool try_lock(std::uint32_t name) {
    Steps steps(word);
    if (steps.try_lock(name, false)) return true;
    const std::uint32_t seen = steps.seen();
    return seen != 0 && is_gone(lock::name(seen)) && steps.take_over(seen, name);
  }
  /// As RobustMutex::lock_for(), whose looks are due again and again: with them nobody sleeps.
  void lock_or_take_over(std::uint32_t name) {
    Steps steps(word);
    if (steps.try_lock(name, false)) return;
    for (;;) {
      const std::uint32_t seen = steps.announce();
      if (steps.try_lock(name, true)) return;
      if (seen != 0 && is_gone(lock::name(seen)) && steps.take_over(seen, name)) return;
      Policy::pause();
    }
  }
  void unlock(std::uint32_t name) {
    if (Steps(word).unlock(name)) word.wake_one();
  }

  /// The seat of each participant: {incarnation, is dead}, as Presence sees it.
  static constexpr std::uint32_t seat(std::uint32_t incarnation, bool dead) {
    return incarnation << 1 | (dead ? 1 : 0);
  }
  bool is_gone(std::uint32_t name) {
    const std::uint32_t seen = seats[lock::participant(name)].load(std::memory_order_acquire);
    return seen >> 1 != lock::incarnation(name) || (seen & 1) != 0;
  }

  CheckedAtomic<std::uint32_t> word;
  CheckedAtomic<std::uint32_t> seats[3];
  Plain<int> guarded;
};

constexpr std::uint32_t kFirst = 1;  ///< the incarnation with which all begin

template <class Derived, unsigned kThreads>
struct LockScene : SceneBegins, rl::test_suite<Derived, kThreads> {
  void before() {
    for (auto& seat : locked.seats) {
      seat.store(Locked::seat(kFirst, false), std::memory_order_seq_cst);
    }
    static_cast<Derived*>(this)->prepare();
  }
  void prepare() {}
  void after() { killer.aim_at_nobody(); }

  Locked locked;
};

/// Three processes work under the lock, twice each, and sleep while another one has it.
struct LockersSleep : LockScene<LockersSleep, 3> {
  void thread(unsigned t) {
    const std::uint32_t name = lock::make_name(t, kFirst);
    for (int i = 0; i < 2; ++i) {
      locked.lock(name);
      locked.work();
      locked.unlock(name);
    }
  }
  void after() {
    RL_ASSERT(locked.guarded.read() == 6);
    RL_ASSERT(locked.word.load(std::memory_order_seq_cst) == 0);
  }
};

/// Two threads of one process have one name.
struct ThreadsOfOneProcess : LockScene<ThreadsOfOneProcess, 2> {
  void thread(unsigned) {
    const std::uint32_t name = lock::make_name(0, kFirst);
    for (int i = 0; i < 2; ++i) {
      locked.lock(name);
      locked.work();
      locked.unlock(name);
    }
  }
  void after() { RL_ASSERT(locked.guarded.read() == 4); }
};

/// A process is killed anywhere while it locks, works and unlocks; two others take the lock, one
/// after the other, and what it guards.
struct HolderKilled : LockScene<HolderKilled, 3> {
  void thread(unsigned t) {
    const std::uint32_t name = lock::make_name(t, kFirst);
    if (t == 0) {
      killer.aim(1 + rl::rand(6));
      try {
        locked.lock(name);
        locked.work();
        locked.unlock(name);
      } catch (const Killed&) {  // nothing here: Relacy may not switch threads inside a handler
      }
      killer.aim(0);
      locked.seats[0].store(Locked::seat(kFirst, true), std::memory_order_release);
      return;
    }
    if (t == 1) {
      while (!locked.try_lock(name)) Policy::pause();
    } else {
      locked.lock_or_take_over(name);
    }
    locked.work();
    locked.unlock(name);
  }
  void after() {
    killer.aim_at_nobody();
    RL_ASSERT(locked.guarded.read() >= 2);
  }
};

/// A process has died with the lock. While another one judges it dead, its index comes again, and
/// the next owner locks: the late judge must not take the lock from that one.
template <bool kHeld, bool kWaits>
struct IndexComesAgain : LockScene<IndexComesAgain<kHeld, kWaits>, 2> {
  using LockScene<IndexComesAgain<kHeld, kWaits>, 2>::locked;
  void prepare() {
    if (kHeld) RL_ASSERT(locked.try_lock(lock::make_name(0, kFirst)));
    locked.seats[0].store(Locked::seat(kFirst, true), std::memory_order_release);
  }
  void thread(unsigned t) {
    if (t == 0) {
      locked.seats[0].store(Locked::seat(kFirst + 1, false), std::memory_order_release);
      const std::uint32_t name = lock::make_name(0, kFirst + 1);
      for (int i = 0; i < 2; ++i) {
        while (!locked.try_lock(name)) Policy::pause();
        locked.work();
        locked.unlock(name);
      }
      return;
    }
    const std::uint32_t name = lock::make_name(1, kFirst);
    if constexpr (kWaits) {
      locked.lock_or_take_over(name);
    } else {
      while (!locked.try_lock(name)) Policy::pause();
    }
    locked.work();
    locked.unlock(name);
  }
  void after() { RL_ASSERT(locked.guarded.read() == 3); }
};

const Entered entered{
    {"lockers_sleep", "a lock excludes, and who sleeps for it is woken", cast_of<LockersSleep>, 4},
    {"threads_of_one_process", "a lock excludes threads of one name", cast_of<ThreadsOfOneProcess>,
     4},
    {"holder_killed", "a lock outlives its holder, and orders what that one did",
     cast_of<HolderKilled>, 3},
    {"index_comes_again", "a late judge takes no lock from the next owner of an index",
     cast_of<IndexComesAgain<true, false>>, 6},
    {"index_comes_again_to_a_waiter", "the same, of one that waits",
     cast_of<IndexComesAgain<true, true>>, 6},
    {"index_comes_again_to_a_free_lock", "the same, where the dead one did not have the lock",
     cast_of<IndexComesAgain<false, false>>, 6},
};

}  // namespace
}  // namespace lot::model
