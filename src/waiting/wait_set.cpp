// SPDX-License-Identifier: Apache-2.0
#include "lot/wait_set.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <list>
#include <optional>
#include <utility>

#include "lot/error.hpp"

#include "futex/futex.hpp"
#include "waiting/waiting.hpp"

namespace lot {

namespace detail {

using namespace std::chrono_literals;

class WaitSetCore {
 public:
  explicit WaitSetCore(Wait wait) : habit_(wait) {}

  void add(Waitable& waitable, WaitSet::Handler handler) {
    entries_.push_back({&waitable, std::move(handler)});
  }
  void remove(const Waitable& waitable) {
    for (Entry& e : entries_) {
      if (e.waitable == &waitable) e.waitable = nullptr;
    }
  }

  WaitSet::Timer add(std::chrono::nanoseconds delay, std::chrono::nanoseconds period,
                     WaitSet::Handler handler) {
    timers_.push_back({WaitSet::Timer{++last_timer_}, after(delay), period, std::move(handler)});
    return timers_.back().name;
  }
  void remove(WaitSet::Timer name) {
    for (Timer& t : timers_) {
      if (t.name == name) t.removed = true;
    }
  }

  void stop() noexcept { stop_.set(); }

  /// Returns how many handlers were called; nothing when the set was stopped.
  std::optional<std::size_t> run_once(Limit limit) {
    if (limit.is_stopped()) return std::nullopt;
    token_ = limit.stop();
    Round round(*this);
    if (!round.look()) waiting::wait(round, limit.deadline(), limit.stop());
    if (round.is_stopped() || limit.is_stopped()) return std::nullopt;
    return round.called();
  }

 private:
  struct Entry {
    Waitable* waitable;  ///< null: removed
    WaitSet::Handler handler;
  };
  struct Timer {
    WaitSet::Timer name;
    Clock::time_point next;
    std::chrono::nanoseconds period;  ///< 0: it fires once
    WaitSet::Handler handler;
    bool removed = false;
  };

  /// Between two handlers: the rest of the round is left out.
  bool stopped() const noexcept { return stop_.is_set() || is_set(token_); }

  std::size_t call_timers() {
    std::size_t called = 0;
    const auto now = Clock::now();
    const WaitSet::Timer last{last_timer_};
    // a handler may add a timer: iterators of a list stay valid
    for (auto t = timers_.begin(); t != timers_.end(); ++t) {
      if (stopped()) break;
      // A timer that a handler adds meanwhile waits for the next turn, even if it is overdue.
      // Otherwise a handler that adds such a timer each time would keep all others from being
      // called.
      if (t->removed || t->next > now || t->name > last) continue;
      if (t->period.count() == 0) {
        t->removed = true;
      } else {
        t->next += t->period * ((now - t->next) / t->period + 1);
      }
      ++called;
      t->handler();
    }
    timers_.remove_if([](const Timer& t) { return t.removed; });
    return called;
  }

  /// How one run_once() waits for something to do, and does it.
  class Round : public waiting::Steps<Round> {
   public:
    static constexpr unsigned kPollsPerClock = 64;

    explicit Round(WaitSetCore& set) : set_(set) {}
    bool is_stopped() const noexcept { return is_stopped_; }
    std::size_t called() const noexcept { return called_; }

    /// True: handlers were called, or there was a stop. Else the pullers are armed, as well.
    bool look() {
      if (set_.stop_.take()) return is_stopped_ = true;
      called_ = set_.call_timers();
      set_.waits_.clear();
      again_ = set_.call_ready(called_);
      for (const Timer& t : set_.timers_) again_ = std::min(again_.value_or(t.next), t.next);
      return called_ != 0;
    }
    /// Arms nothing where there is nothing to do.
    bool poll(Clock::time_point now) {
      const bool is_due = set_.is_ready() || set_.stopped() || (again_ && now >= *again_);
      return is_due && look();
    }
    waiting::SpinHabit* spins() noexcept { return set_.entries_.empty() ? nullptr : &set_.habit_; }
    /// The last look has armed the pullers.
    std::optional<waiting::Sleep<FutexWaits&>> arm() {
      set_.waits_.push_back(set_.stop_.wait());
      return {{set_.waits_, again_}};
    }

   private:
    WaitSetCore& set_;
    std::size_t called_ = 0;
    bool is_stopped_ = false;
    futex::Deadline again_;  ///< when a timer is due, or a puller must be looked at
  };

  bool is_ready() const {
    return std::any_of(entries_.begin(), entries_.end(),
                       [](const Entry& e) { return e.waitable->ready(); });
  }

  /// Calls the handlers of the pullers that have something to read, and collects the words that the
  /// others wait for. Returns when to look again.
  std::optional<Clock::time_point> call_ready(std::size_t& called) {
    std::optional<Clock::time_point> until;
    for (auto e = entries_.begin(); e != entries_.end() && !stopped(); ++e) {
      if (e->waitable == nullptr) continue;
      const auto again = e->waitable->arm(waits_);
      if (again) {
        until = std::min(until.value_or(*again), *again);
      } else {
        ++called;
        e->handler();
      }
    }
    entries_.remove_if([](const Entry& e) { return e.waitable == nullptr; });
    return until;
  }

  waiting::SpinHabit habit_;
  std::list<Entry> entries_;
  std::list<Timer> timers_;
  std::uint64_t last_timer_ = 0;
  FutexWaits waits_;
  /// stop() was called. The thread in run() takes it.
  StopWord stop_;
  const StopWord* token_ = nullptr;  ///< of the run() that is at work; null: it has none
};

}  // namespace detail

namespace {

void check(const WaitSet::Handler& handler) {
  if (handler) return;
  throw Error(EINVAL, "WaitSet", "a handler is empty", "give a function to be called");
}

}  // namespace

WaitSet::WaitSet(Wait wait) : core_(std::make_unique<detail::WaitSetCore>(wait)) {}
WaitSet::~WaitSet() = default;

void WaitSet::add(detail::Waitable& waitable, Handler handler) {
  check(handler);
  core_->add(waitable, std::move(handler));
}
void WaitSet::remove(detail::Waitable& waitable) { core_->remove(waitable); }

WaitSet::Timer WaitSet::add_timer(Duration period, Handler handler) {
  if (period.count() <= 0) {
    throw Error(EINVAL, "WaitSet::add_timer", "a period must be longer than nothing",
                "use add_timer_once() for what is to be done once");
  }
  check(handler);
  return core_->add(period, period, std::move(handler));
}
WaitSet::Timer WaitSet::add_timer_once(Duration delay, Handler handler) {
  check(handler);
  return core_->add(delay, std::chrono::nanoseconds(0), std::move(handler));
}
void WaitSet::remove(Timer timer) { core_->remove(timer); }

void WaitSet::run(const StopToken& stop) {
  while (core_->run_once(detail::Limit::forever(stop))) {
  }
}
std::size_t WaitSet::run_once(Duration timeout, const StopToken& stop) {
  return run_once_until(detail::after(timeout), stop);
}
std::size_t WaitSet::run_once_until(Deadline deadline, const StopToken& stop) {
  return core_->run_once(detail::Limit::until(deadline, stop)).value_or(0);
}
void WaitSet::stop() noexcept { core_->stop(); }

}  // namespace lot
