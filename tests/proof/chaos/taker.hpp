// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <deque>
#include <optional>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>

#include "lot/lot.hpp"

#include "job.hpp"
#include "life.hpp"
#include "plan.hpp"
#include "takings.hpp"

namespace lot::chaos {

using namespace std::chrono_literals;

/// Takes items out of a queue and checks that it alone has them, while it has them.
template <class T>
class Taker final : public Job {
 public:
  Taker(Life& life, ShmEngine& engine, std::uint32_t topic)
      : life_(life),
        engine_(engine),
        topic_(topic),
        plan_(reading(life.random, Role::Take)),
        takings_(life, topic) {
    join();
  }
  ~Taker() override {
    leave();
    let_go(0);
  }

  void turn() override {
    read([](ShmUniquePtr<T>) {});
  }
  void quiet() override { turn(); }
  bool settle() override {
    let_go(0);
    return !take_one(false, [](ShmUniquePtr<T>) {});
  }

  /// Takes some items, waiting for the first at most; handle(item) gets those that are not kept.
  template <class Handle>
  void read(Handle&& handle) {
    if (life_.random.chance(plan_.rejoin_percent)) {
      leave();
      join();
    }
    for (unsigned n = 0; n < 16; ++n) {
      if (!take_one(n == 0, handle)) break;
    }
    // A taker that spins leaves the processor to others all the same.
    if (plan_.options.wait != Wait::Park) std::this_thread::sleep_for(1ms);
  }

 private:
  using Style = Reading::Style;

  void join() {
    life_.doing(Doing::Subscribing, topic_);
    takings_.before_listen();
    QueueOptions options;
    options.wait = plan_.options.wait;
    queue_.emplace(engine_.queue<ShmUniquePtr<T>>(kTopic[topic_].name, options));
    queue_->listen();
    takings_.after_listen();
    life_.me.pullers[topic_].fetch_add(1);
    life_.count(Count::Subscribed);
  }
  void leave() {
    if (!queue_) return;
    life_.doing(Doing::Closing, topic_);
    life_.me.pullers[topic_].fetch_sub(1);
    queue_.reset();
  }

  template <class Handle>
  bool take_one(bool wait, Handle&& handle) {
    const bool waits = wait && plan_.style != Style::TryBorrow && plan_.style != Style::TryPull;
    life_.doing(Doing::Looking, topic_);
    if (wait && !waits) std::this_thread::sleep_for(plan_.patience);
    takings_.before_look();
    life_.me.taking.store(Life::now());
    auto item = waits ? queue_->wait_and_pop_for(plan_.patience) : queue_->try_pop();
    if (item) accept(**item);
    life_.me.taking.store(0);
    if (!item) {
      takings_.found_nothing();
      return false;
    }
    check(**item, (*item)->stamp.seal);
    if (life_.random.chance(plan_.keep_percent)) {
      const std::uint64_t seal = (*item)->stamp.seal;
      kept_.push_back({std::move(*item), seal});
      let_go(plan_.most_kept);
    } else {
      handle(std::move(*item));
    }
    return true;
  }

  /// A kill before the mark is the item's end: now and then there is time for one.
  void accept(const T& item) {
    life_.doing(Doing::Reading, topic_);
    if (life_.has(Plant::Drop, 5)) return;
    if (life_.random.chance(plan_.linger_percent)) {
      std::this_thread::sleep_for(life_.random.between(50us, 3ms));
    }
    if (const std::string w = wrong(item.stamp); !w.empty()) torn(w, item.stamp);
    takings_.took(item.stamp);
    if (life_.has(Plant::TakeTwice, 5)) takings_.took(item.stamp);
    life_.count(Count::Received);
    life_.count(Count::Taken);
  }

  void let_go(std::size_t rest) {
    while (kept_.size() > rest) {
      Kept kept = std::move(kept_.front());
      kept_.pop_front();
      life_.count(Count::Rechecked);
      check(*kept.item, kept.seal);
      // It is ours alone: another process that has it sees this.
      kept.item->stamp = {};
    }
  }

  void check(const T& item, std::uint64_t seal) {
    if (item.stamp.seal != seal) torn("it became another", item.stamp);
    if (const std::string w = wrong(item); !w.empty()) torn(w, item.stamp);
  }
  [[noreturn]] void torn(const std::string& what, const Stamp& s) {
    life_.fail(Finding::Torn, std::string(kTopic[topic_].name) + ": " + what + " (incarnation " +
                                  std::to_string(s.incarnation) + " number " +
                                  std::to_string(s.number) + ")");
  }

  struct Kept {
    ShmUniquePtr<T> item;
    std::uint64_t seal;
  };
  Life& life_;
  ShmEngine& engine_;
  std::uint32_t topic_;
  Reading plan_;
  Takings takings_;
  std::optional<ShmQueue<ShmUniquePtr<T>>> queue_;
  std::deque<Kept> kept_;
};

}  // namespace lot::chaos
