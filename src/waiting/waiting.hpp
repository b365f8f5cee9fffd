// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <optional>
#include <thread>

#include "lot/detail/atomics.hpp"
#include "lot/detail/stop_word.hpp"
#include "lot/detail/wait.hpp"

#include "futex/futex.hpp"
#include "waiting/habit.hpp"

/// How a thread waits for another thread or process: one strategy for the message of a puller, the
/// room of a pusher, the item of a queue, the pullers of a wait set and the words of a descriptor.
///
///     look -> spin -> yield -> arm -> sleep -> look -> arm -> sleep -> ...
///
/// The caller makes the first look itself: what is there already sets nothing up. wait() decides
/// all that follows. A *waiter* supplies the steps: how to look, which words to sleep on.
///
/// No wake-up is lost, since arm() leaves the marks that ask for one, and looks once more when they
/// stand. What comes later changes a word that the waiter is about to sleep on. So does a stop.
///
/// Threads: a waiter belongs to one thread. Its habits may belong to several: they are touched
///          between lock() and unlock() only.
/// Crash:   a waiter that is killed leaves the marks of arm(), which cost one needless wake each.
namespace lot::waiting {

/// What a waiter sleeps on.
template <class Words>
struct Sleep {
  Words words;            ///< it sleeps until one of them changes,
  futex::Deadline again;  ///< and until then at most
};

/// What has no word to sleep on: the waiter looks again when it is time.
struct NoWords {};

/// The steps that few waiters have need of. A waiter is derived from this class, and has besides:
///
///     bool look();                        // true: there it is, and the waiter has it
///     std::optional<Sleep<Words>> arm();  // leaves marks, then looks; nothing: look() now
///
/// `Words` is what Kernel::sleep() takes.
template <class Waiter>
struct Steps {
  /// Looks of a spin between two looks at the clock.
  static constexpr unsigned kPollsPerClock = 1;
  /// The first looks of a spin. One that finds something reads no clock, since latency counts.
  static constexpr unsigned kEagerPolls = 0;

  /// Null: the waiter never spins, or never yields.
  SpinHabit* spins() noexcept { return nullptr; }
  YieldHabit* yields() noexcept { return nullptr; }

  /// Pauses before look `n` of a spin, counted from 0.
  unsigned pauses([[maybe_unused]] unsigned n) const noexcept { return 1; }
  /// A look of a spin. `now`: the time at most kPollsPerClock looks ago.
  bool poll([[maybe_unused]] futex::Clock::time_point now) {
    return static_cast<Waiter*>(this)->look();
  }
  /// The look after the deadline. False: the waiter gives up.
  bool last_look() { return static_cast<Waiter*>(this)->look(); }
  /// Does what other processes may be waiting for. Called now and then in a spin, and before the
  /// waiter yields.
  void settle() {}

  /// The waiter holds its locks, except while it pauses, yields and sleeps.
  void unlock() {}
  void lock() {}
  /// Called without the locks, between arm() and the sleep.
  void before_sleep() {}
};

/// Passes a wake-up on that may have been for others, too (docs/waiting.md, "How a push wakes
/// many"). Called when a sleep has ended, for whatever reason.
///
/// Only where the word has changed: else sleepers would wake each other for ever. Relaxed: the look
/// that follows acquires.
inline void pass_on(const detail::FutexWaits& words) noexcept {
  for (const detail::FutexWait& wait : words) {
    if (!wait.is_shared) continue;
    const auto* word = static_cast<const std::uint32_t*>(wait.word);
    if (__atomic_load_n(word, __ATOMIC_RELAXED) == wait.value) continue;  // as above
    futex::wake(wait.word, futex::kWakes);
  }
}

/// What wait() needs of the machine. Tests have a clock and words of their own.
struct Kernel {
  static futex::Clock::time_point now() noexcept { return futex::Clock::now(); }
  static void pause() noexcept { detail::HardwareAtomics::pause(); }
  static void yield() noexcept { std::this_thread::yield(); }

  /// False when the time is up.
  static bool sleep(const detail::FutexWaits& words, const futex::Deadline& until) noexcept {
    const bool in_time = futex::wait_any(words, until);
    pass_on(words);
    return in_time;
  }
  static bool sleep(const detail::FutexWait& word, const futex::Deadline& until) noexcept {
    return futex::wait(word.word, word.value, until);
  }
  /// REQUIRES: `until` has a time.
  static bool sleep(NoWords, const futex::Deadline& until) {
    std::this_thread::sleep_until(*until);
    return false;
  }
};

template <class Machine>
bool has_passed(const futex::Deadline& deadline) noexcept {
  return deadline && Machine::now() >= *deadline;
}

/// Adds the word of a stop to those to sleep on.
inline void add(detail::FutexWaits& words, const detail::StopWord* stop) {
  if (stop != nullptr) words.push_back(stop->wait());
}
/// All other sleeps are short: the next look is soon enough.
template <class Words>
void add(Words&, const detail::StopWord*) noexcept {}

/// Spins. Returns what wait() returns, or nothing: it is time to sleep.
template <class Machine, class Waiter>
std::optional<bool> spin(Waiter& waiter, SpinHabit& habit, const futex::Deadline& deadline,
                         const detail::StopWord* stop) {
  const auto start = Machine::now();
  unsigned polls = 0;
  for (auto now = start;; now = Machine::now()) {
    if (detail::is_set(stop)) {
      waiter.settle();
      return false;
    }
    if (deadline && now >= *deadline) {
      waiter.settle();
      return waiter.last_look();  // this thread may have been held up since the one before
    }
    if (habit.enough(now - start)) {
      habit.spun(now - start);
      return std::nullopt;
    }
    for (unsigned n = 0; n < Waiter::kPollsPerClock; ++n, ++polls) {
      if (const unsigned pauses = waiter.pauses(polls); pauses != 0) {
        waiter.unlock();
        for (unsigned p = 0; p < pauses; ++p) Machine::pause();
        waiter.lock();
      }
      if (!waiter.poll(now)) continue;
      const bool eager = polls < Waiter::kEagerPolls;
      habit.spun(eager ? futex::Clock::duration(0) : Machine::now() - start);
      return true;
    }
    waiter.settle();
  }
}

/// Yields once. True when the look after it has found something.
template <class Machine, class Waiter>
bool yield(Waiter& waiter, YieldHabit& habit) {
  waiter.settle();
  waiter.unlock();
  const auto start = Machine::now();
  Machine::yield();
  const auto away = Machine::now() - start;
  waiter.lock();
  return habit.found(waiter.look(), away);
}

/// Waits until a look finds something: true. False when the deadline has passed; the last look
/// comes after it. Without a deadline it waits for ever. A deadline that had passed before costs a
/// look or two, and no sleep. False, too, when `stop` is set: it is looked at with the clock, and
/// before and after each sleep. A waiter that sleeps on other words than FutexWaits sees a stop
/// when its short sleep ends.
///
/// REQUIRES: the caller has looked, and has found nothing.
/// Throws what the waiter's steps throw.
///
/// It is inlined into its one caller for each waiter, so that it is hot or cold as the caller is.
template <class Machine = Kernel, class Waiter>
[[gnu::always_inline]] inline bool wait(Waiter& waiter, const futex::Deadline& deadline,
                                        const detail::StopWord* stop = nullptr) {
  if (SpinHabit* const habit = waiter.spins(); habit != nullptr && habit->worthwhile()) {
    if (const auto found = spin<Machine>(waiter, *habit, deadline, stop)) return *found;
  }
  if (YieldHabit* const habit = waiter.yields(); habit != nullptr) {
    if (!has_passed<Machine>(deadline) && habit->worthwhile() && yield<Machine>(waiter, *habit)) {
      return true;
    }
  }
  for (;;) {
    auto sleep = waiter.arm();
    if (detail::is_set(stop)) return false;
    // Also where arm() asks for a look: while other readers are faster, it does so each time.
    if (has_passed<Machine>(deadline)) return waiter.last_look();
    bool in_time = true;
    if (sleep) {
      const bool is_last = deadline && (!sleep->again || *deadline <= *sleep->again);
      add(sleep->words, stop);
      waiter.unlock();
      waiter.before_sleep();
      in_time = Machine::sleep(sleep->words, is_last ? deadline : sleep->again) || !is_last;
      waiter.lock();
      if (detail::is_set(stop)) return false;
    }
    if (waiter.look()) return true;
    if (!in_time) return false;
  }
}

}  // namespace lot::waiting
