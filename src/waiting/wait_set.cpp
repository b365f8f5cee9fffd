// SPDX-License-Identifier: Apache-2.0
#include "lot/wait_set.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <list>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "lot/error.hpp"

#include "futex/futex.hpp"
#include "waiting/hearing.hpp"
#include "waiting/waiting.hpp"

namespace lot {

namespace detail {

using namespace std::chrono_literals;

/// A set of more words than this listens by ears (docs/ear.md). A smaller one sleeps on its words.
constexpr std::size_t kFewWords = 8;
/// What listens by ears is looked at after this time in any case, as what sleeps on its words.
constexpr auto kLookAtAll = 1s;

class WaitSetCore {
 public:
  explicit WaitSetCore(Wait wait) : habit_(wait) {}

  void add(Waitable& waitable, WaitSet::Handler handler) {
    due_.reserve(entries_.size() + 1);
    restless_.reserve(entries_.size() + 1);
    entries_.emplace_back(waitable, std::move(handler));
    is_due(entries_.back());
    if (uses_ears_) all_again_ = {};  // it finds an ear in the next round
  }
  void remove(const Waitable& waitable) {
    for (Entry& e : entries_) {
      if (e.waitable != &waitable) continue;
      e.waitable = nullptr;
      has_removed_ = true;
      leave_ear(e);
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
  struct SetEar;

  struct Entry : waiting::Ear::Client {
    Entry(Waitable& w, WaitSet::Handler h) : waitable(&w), handler(std::move(h)) {}

    Waitable* waitable;  ///< null: removed
    WaitSet::Handler handler;
    SetEar* ear = nullptr;                   ///< null: it is armed by words
    bool is_due = false;                     ///< it is in due_
    std::optional<Clock::time_point> again;  ///< it is in restless_, and due then
  };
  /// The set's ear in one segment. Its clients are the entries of that segment.
  struct SetEar final : Hearer {
    SetEar(std::shared_ptr<waiting::EarOwner> o, std::unique_ptr<waiting::Ear> e)
        : owner(std::move(o)), ear(std::move(e)) {}

    void listen(std::uint32_t channel) override { ear->listen(*arms, channel); }
    void watch_directory(std::uint32_t version) override { ear->watch_directory(*arms, version); }

    std::shared_ptr<waiting::EarOwner> owner;  ///< outlives the ear
    std::unique_ptr<waiting::Ear> ear;
    Entry* arms = nullptr;  ///< the entry that is armed now
    std::size_t entries = 0;
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

    /// True: handlers were called, or there was a stop. Else all pullers are armed, as well.
    bool look() {
      if (set_.stop_.take()) return is_stopped_ = true;
      called_ = set_.call_timers();
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
      for (SetEar& e : set_.ears_) e.ear->prepare_to_sleep(set_.waits_);
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
    return std::any_of(ears_.begin(), ears_.end(),
                       [](const SetEar& e) { return e.ear->has_rung(); }) ||
           std::any_of(due_.begin(), due_.end(),
                       [](const Entry* e) { return e->waitable->ready(); });
  }

  /// It is looked at in the next round, and in each one until it is armed by an ear.
  void is_due(Entry& e) noexcept {
    if (!std::exchange(e.is_due, true)) due_.push_back(&e);  // add() has made room
  }
  void all_are_due() noexcept {
    for (Entry& e : entries_) is_due(e);
  }
  /// Looks whether an ear has failed to hear something.
  void look_at_all() {
    for (Entry& e : entries_) {
      if (!e.is_due && e.waitable != nullptr && e.waitable->ready()) is_due(e);
    }
  }

  /// Finds out which entries to look at.
  void gather(Clock::time_point now) {
    round_began_ = now;
    for (SetEar& s : ears_) {
      const bool hears = s.ear->take(
          [this](waiting::Ear::Client& client) { is_due(static_cast<Entry&>(client)); });
      if (!hears) all_are_due();  // their looks say why
    }
    finds_ears_ = uses_ears_ && now >= all_again_;
    if (now >= all_again_) {
      look_at_all();
      all_again_ = now + kLookAtAll;
    }
    std::erase_if(restless_, [&](Entry* e) {
      if (*e->again > now) return false;
      e->again.reset();
      is_due(*e);
      return true;
    });
  }

  /// Calls the handlers of the pullers that have something to read, and arms the others. Returns
  /// when to look again.
  std::optional<Clock::time_point> call_ready(std::size_t& called) {
    const struct Tidy {
      WaitSetCore& set;
      ~Tidy() { set.tidy(); }
    } tidy{*this};
    gather(Clock::now());
    auto until = look_at_due(called);
    if (!uses_ears_ && waits_.size() > kFewWords) {
      uses_ears_ = finds_ears_ = true;
      if (called == 0) until = look_at_due(called);
      all_again_ = {};  // those that were not looked at find ears in the next round
    }
    if (!ears_.empty()) until = std::min(until.value_or(all_again_), all_again_);
    for (const Entry* e : restless_) until = std::min(until.value_or(*e->again), *e->again);
    return until;
  }
  std::optional<Clock::time_point> look_at_due(std::size_t& called) {
    std::optional<Clock::time_point> until;
    waits_.clear();
    // A handler may add entries, which are due as well.
    for (std::size_t i = 0; i < due_.size() && !stopped(); ++i) {
      Entry& e = *due_[i];
      if (e.waitable == nullptr) continue;
      if (finds_ears_ && e.ear == nullptr) find_ear(e);
      const auto again = arm(e);
      if (!again) {
        ++called;
        e.handler();
      } else if (e.ear == nullptr) {
        until = std::min(until.value_or(*again), *again);
      } else {
        e.is_due = false;
        rest(e, *again);
      }
    }
    return until;
  }

  std::optional<Clock::time_point> arm(Entry& e) {
    if (e.ear != nullptr) e.ear->arms = &e;
    waits_.hear_by(e.ear);
    return e.waitable->arm(waits_);
  }
  /// It is armed by its ear until `again`. A look at all finds those that are ready by then. One
  /// that must be looked at sooner is not ready before its time, so that such a look may pass it
  /// over.
  void rest(Entry& e, Clock::time_point again) {
    if (again >= round_began_ + kLookAtAll) return;
    if (!e.again) restless_.push_back(&e);  // add() has made room
    e.again = again;
  }

  /// Forgets what need not be looked at any more, also where a handler has thrown.
  void tidy() noexcept {
    std::erase_if(due_, [](const Entry* e) { return !e->is_due || e->waitable == nullptr; });
    if (!std::exchange(has_removed_, false)) return;
    std::erase_if(restless_, [](const Entry* e) { return e->waitable == nullptr; });
    entries_.remove_if([](const Entry& e) { return e.waitable == nullptr; });
  }

  /// Has the entry listen by an ear, if there is one.
  void find_ear(Entry& e) {
    auto owner = e.waitable->ear_owner();
    if (owner == nullptr) return;
    auto s = std::find_if(ears_.begin(), ears_.end(),
                          [&](const SetEar& ear) { return ear.owner == owner; });
    if (s == ears_.end()) {
      auto ear = waiting::Ear::claim(*owner);
      if (ear == nullptr) return;
      s = ears_.emplace(s, std::move(owner), std::move(ear));
    }
    e.ear = &*s;
    ++s->entries;
  }
  /// The ear goes with its last entry: it keeps the participant.
  void leave_ear(Entry& e) noexcept {
    SetEar* const s = std::exchange(e.ear, nullptr);
    if (s == nullptr) return;
    s->ear->forget(e);
    if (--s->entries == 0) ears_.remove_if([s](const SetEar& ear) { return &ear == s; });
  }

  waiting::SpinHabit habit_;
  std::list<SetEar> ears_;
  std::list<Entry> entries_;
  std::vector<Entry*> due_;
  std::vector<Entry*> restless_;  ///< armed by ears, and due before all are
  bool has_removed_ = false;
  bool uses_ears_ = false;           ///< it has more words than few
  bool finds_ears_ = false;          ///< in this round it asks for ears where it has none
  Clock::time_point all_again_{};    ///< when to look at all entries
  Clock::time_point round_began_{};  ///< when it last found out which entries to look at
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
