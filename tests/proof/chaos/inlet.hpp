// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <deque>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>

#include "lot/lot.hpp"

#include "account.hpp"
#include "canary.hpp"
#include "job.hpp"
#include "life.hpp"
#include "plan.hpp"
#include "segment/layout.hpp"
#include "slot_copy.hpp"

namespace lot::chaos {

using namespace std::chrono_literals;

/// A subscription that checks all that it reads, while it holds it and before it lets go, and keeps
/// the books.
template <class T>
class Inlet final : public Job {
 public:
  /// What it does depends on the role of the reader.
  Inlet(Life& life, ShmEngine& engine, std::uint32_t topic, Role role = Role::Read)
      : life_(life),
        engine_(engine),
        topic_(topic),
        plan_(reading(life.random, role)),
        account_(life, topic, plan_.options.observer) {
    subscribe();
  }
  ~Inlet() override {
    leave();
    life_.doing(Doing::Closing, topic_);
    recheck_kept(0);
  }

  void turn() override {
    if (life_.random.chance(plan_.rejoin_percent)) {
      leave();
      subscribe();
    }
    read(true, [](const T&, auto&&) {});
    look_at_weak(8);
    rest();
  }
  void quiet() override {
    read(true, [](const T&, auto&&) {});
    rest();
    deaf_since_ = std::chrono::steady_clock::now();
  }
  bool settle() override {
    recheck_kept(0);
    look_at_weak(0);
    if (read(false, [](const T&, auto&&) {})) return false;
    const std::uint32_t unheard = account_.unheard();
    const auto now = std::chrono::steady_clock::now();
    if (unheard == 0) {
      deaf_since_ = now;
    } else if (now - deaf_since_ > life_.settings.patience / 2) {
      account_.fail_unheard(unheard);
    }
    return unheard == 0;
  }

  /// A reader that spins leaves the processor to others all the same.
  void rest() {
    if (plan_.options.wait != Wait::Park) {
      std::this_thread::sleep_for(1ms);
    }
  }

  /// Reads some messages, waiting for the first at most. handle(message, keep) may call keep() for
  /// a pointer. False when a look found nothing.
  template <class Handle>
  bool read(bool wait, Handle&& handle) {
    for (unsigned n = 0; n < 16; ++n) {
      if (!read_one(wait && n == 0, handle)) return false;
    }
    return true;
  }

 private:
  template <class U>
  struct Kept {
    ShmSharedPtr<const U> message;
    std::uint64_t seal = 0;
    unsigned subscription = 0;  ///< its number
  };
  struct Weak {
    ShmWeakPtr<const T> message;
    std::uint64_t seal;
  };
  using Style = Reading::Style;

  void subscribe() {
    life_.doing(Doing::Subscribing, topic_);
    account_.before_subscribe();
    PullerOptions real = plan_.options;
    if (life_.has(Plant::Greed)) real.max_held_bytes = PullerOptions::kNoQuota;
    if (life_.has(Plant::Cling) && topic_ >= kFirstShape) real.observer = false;
    puller_.emplace(engine_.subscribe<T>(kTopic[topic_].name, real));
    ++subscriptions_;
    account_.after_subscribe(plan_.options.history);
    mine().fetch_add(1);
    life_.count(plan_.options.observer ? Count::Observed : Count::Subscribed);
  }
  void leave() {
    life_.doing(Doing::Closing, topic_);
    if (!puller_) return;  // it was refused when it came again
    mine().fetch_sub(1);
    puller_.reset();
  }
  /// How many such subscriptions this node has.
  std::atomic<std::uint16_t>& mine() {
    return (plan_.options.observer ? life_.me.observers : life_.me.pullers)[topic_];
  }

  template <class Handle>
  bool read_one(bool wait, Handle&& handle) {
    life_.doing(Doing::Looking, topic_);
    account_.before_look();
    const bool waits = wait && plan_.style != Style::TryBorrow && plan_.style != Style::TryPull;
    if (wait && !waits) std::this_thread::sleep_for(plan_.patience);
    const bool sleeps_long = plan_.sleeps_long && life_.stage() == Stage::Run;
    const std::chrono::nanoseconds patience = sleeps_long ? kLongSleep : plan_.patience;
    auto begin = Life::now();
    if (sleeps_long && life_.has(Plant::Doze)) {
      begin = 0;
      std::this_thread::sleep_for(kLongSleep);
    }
    bool found = look(waits, patience, begin, handle);
    const auto holds_too_much = [&] { return !found && puller_->status() == Status::HoldsTooMuch; };
    if (holds_too_much()) {
      life_.count(Count::HeldTooMuch);
      recheck_kept(0);
      found = look(false, patience, begin, handle);
    }
    // Now it is another subscription of this process that keeps what this one has got, too.
    if (holds_too_much()) return false;
    if (!found) account_.found_nothing();
    return found;
  }

  template <class Handle>
  bool look(bool waits, std::chrono::nanoseconds patience, std::int64_t begin, Handle&& handle) {
    bool found = false;
    if (plan_.style == Style::Borrow || plan_.style == Style::TryBorrow) {
      auto look = waits ? puller_->borrow(patience) : puller_->try_borrow();
      found = static_cast<bool>(look);
      if (found) {
        if (waits) check_woken(look->stamp, begin);
        read_borrowed(look, handle);
      }
    } else {
      auto message = waits ? puller_->pull(patience) : puller_->try_pull();
      found = static_cast<bool>(message);
      if (found) {
        if (waits) check_woken(message->stamp, begin);
        accept(*message, puller_->missed());
        handle(*message, [&] { return message; });
        keep(message);
      }
    }
    return found;
  }

  /// A message that came while we slept has woken us: not the next one, nor the end of our
  /// patience.
  void check_woken(const Stamp& stamp, std::int64_t begin) {
    if (is_relayed(topic_) || stamp.pushed_at < begin) return;
    const auto late = std::chrono::nanoseconds(Life::now() - stamp.pushed_at);
    if (late > kMuchTooLate && !has_stalled(life_.board)) {
      life_.fail(Finding::Wedged, std::string(kTopic[topic_].name) + ": slept on for " +
                                      std::to_string(late / std::chrono::milliseconds(1)) +
                                      " ms when a message had come");
    }
  }

  template <class Handle>
  void read_borrowed(ShmBorrow<T>& look, Handle&& handle) {
    accept(*look, look.missed());
    const std::uint64_t seal = look->stamp.seal;
    handle(*look, [&] { return look.keep(); });
    if (life_.random.chance(plan_.keep_percent)) keep_borrowed(look);
    if (life_.random.chance(plan_.linger_percent)) {
      std::this_thread::sleep_for(life_.random.between(50us, plan_.longest_linger));
    }
    recheck(*look, seal, "borrowed");
    look.end();
  }

  void accept(const T& message, std::uint64_t missed) {
    life_.doing(Doing::Reading, topic_);
    life_.count(Count::Received);
    life_.count(Count::Missed, missed);
    if (const std::string w = wrong(message); !w.empty()) torn(w, message.stamp);
    if constexpr (std::is_same_v<T, Plain>) {
      if (life_.has(Plant::Trust, 20)) trust_a_copy();
    }
    const Place place = place_of(message.stamp);
    if (life_.has(Plant::Deaf) && account_.is_late(place.incarnation) &&
        kTopic[topic_].queueing == Queueing::Overwrite) {
      return;
    }
    if (life_.has(Plant::Miss)) missed = 0;
    if (life_.has(Plant::Overlook) && plan_.options.observer) missed = 0;
    if (life_.has(Plant::More, 1)) ++missed;
    account_.received(place, missed);
  }

  /// A mistake.
  void trust_a_copy() {
    const auto copy = copy_of_a_slot(engine_.path(), kTopic[topic_].name);
    if (!copy) return;
    if (const std::string w = wrong(*copy); !w.empty()) torn("in a slot, " + w, copy->stamp);
  }

  /// Under which number it came on this topic.
  Place place_of(const Stamp& stamp) {
    if (is_relayed(topic_)) {
      const Relayed& r = life_.board.relayed_as(topic_, stamp.serial);
      const Place place{r.incarnation.load(), r.number.load()};
      if (r.serial.load(std::memory_order_acquire) != stamp.serial) {
        torn("no relay has sent this", stamp);
      }
      return place;
    }
    if (stamp.twin_incarnation != 0 && stamp.twin_incarnation < kIncarnations &&
        life_.board.incarnations[stamp.twin_incarnation].topic == topic_) {
      return {stamp.twin_incarnation, stamp.twin_number};
    }
    return {stamp.incarnation, stamp.number};
  }

  /// Or lets go of all others, if it may not.
  void keep_borrowed(const ShmBorrow<T>& look) {
    try {
      keep(look.keep());
    } catch (const Error& e) {
      if (e.error_number() != EDQUOT) throw;
      life_.count(Count::HeldTooMuch);
      recheck_kept(0);
    }
  }

  void keep(const ShmSharedPtr<const T>& message) {
    life_.count(Count::Kept);
    if (life_.random.chance(plan_.weak_percent)) {
      weak_.push_back({message, message->stamp.seal ^ (life_.has(Plant::Weak) ? 1 : 0)});
    }
    kept_.push_back({message, message->stamp.seal, subscriptions_});
    check_quota();
    if constexpr (std::is_same_v<T, Seen>) {
      if (message->now) seen_ = {message->now.lock(), message->now_seal};
    }
    recheck_kept(plan_.most_kept);
  }

  /// It may keep one more while it keeps less than that. What is in a block itself does not count.
  void check_quota() {
    std::uint64_t bytes = 0;
    for (std::size_t n = 0; n + 1 < kept_.size(); ++n) {
      const Kept<T>& kept = kept_[n];
      const bool counts_later =
          std::any_of(kept_.begin() + static_cast<std::ptrdiff_t>(n) + 1, kept_.end(),
                      [&kept](const Kept<T>& later) { return later.message == kept.message; });
      if (counts_later || kept.subscription != subscriptions_) continue;
      const std::uint64_t all = kept.message->stamp.words * sizeof(std::uint64_t);
      bytes += all - std::min<std::uint64_t>(all, segment::kSmallBytes);
    }
    if (bytes > plan_.options.max_held_bytes) {
      life_.fail(Finding::Leaked, std::string(kTopic[topic_].name) + ": a subscription keeps " +
                                      std::to_string(bytes) + " bytes and one message more, of " +
                                      std::to_string(plan_.options.max_held_bytes));
    }
  }

  void recheck_kept(std::size_t rest) {
    while (kept_.size() > rest) {
      const Kept<T> kept = std::move(kept_.front());
      kept_.pop_front();
      recheck(*kept.message, kept.seal, "kept");
    }
    if (seen_.message != nullptr) {
      life_.count(Count::References);
      recheck(*seen_.message, seen_.seal, "kept through a reference");
      if (rest == 0) seen_.message.reset();
    }
  }

  /// A weak pointer leads to the message that it was made of, or to none.
  void look_at_weak(std::size_t rest) {
    while (weak_.size() > rest) {
      const Weak weak = std::move(weak_.front());
      weak_.pop_front();
      const auto message = weak.message.lock();
      life_.count(message ? Count::WeakAlive : Count::WeakDead);
      if (message) recheck(*message, weak.seal, "weakly held");
    }
  }

  template <class U>
  void recheck(const U& message, std::uint64_t seal, const char* how) {
    life_.count(Count::Rechecked);
    if (message.stamp.seal != seal) torn(std::string(how) + ", it became another", message.stamp);
    if (const std::string w = wrong(message); !w.empty()) {
      torn(std::string(how) + ", it changed: " + w, message.stamp);
    }
  }

  [[noreturn]] void torn(const std::string& what, const Stamp& s) {
    life_.fail(Finding::Torn, std::string(kTopic[topic_].name) + ": " + what + " (incarnation " +
                                  std::to_string(s.incarnation) + " number " +
                                  std::to_string(s.number) + ", " + std::to_string(s.words) +
                                  " words)");
  }

  Life& life_;
  ShmEngine& engine_;
  std::uint32_t topic_;
  Reading plan_;
  Account account_;
  std::optional<ShmPuller<T>> puller_;
  unsigned subscriptions_ = 0;  ///< so far
  std::deque<Kept<T>> kept_;
  std::deque<Weak> weak_;
  Kept<Frame> seen_;  ///< what a message referred to
  std::chrono::steady_clock::time_point deaf_since_;
};

}  // namespace lot::chaos
