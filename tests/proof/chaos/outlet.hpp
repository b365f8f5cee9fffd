// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <type_traits>
#include <utility>

#include "lot/lot.hpp"

#include "life.hpp"
#include "message.hpp"
#include "plan.hpp"

namespace lot::chaos {

/// A pusher that keeps its record on the board.
template <class T>
class Outlet {
 public:
  Outlet(Life& life, ShmEngine& engine, std::uint32_t topic)
      : life_(life), topic_(topic), plan_(publishing(life.random, topic)) {
    life_.doing(Doing::Advertising, topic);
    // Else what a late reader gets is exact.
    if (life_.epoch.roomy) {
      plan_.history = PusherOptions::kAll;
      plan_.max_bytes = 0;
    }
    const bool takes_back = plan_.is_lossless() || plan_.history != PusherOptions::kAll;
    incarnation_ = life_.new_incarnation(topic, plan_.depth, plan_.is_lossless(), takes_back);
    Publishing real = plan_;
    if (life_.has(Plant::Overrun) && real.depth > 1) {
      real.policy = Policy::Overwrite;
      --real.depth;  // as much history as under Block
    }
    try {
      pusher_.emplace(engine.advertise<T>(kTopic[topic].name, pusher_options(real)));
    } catch (...) {
      record().state.store(Incarnation::Closed, std::memory_order_release);
      throw;
    }
    reserve();
    record().state.store(Incarnation::Live, std::memory_order_release);
    life_.me.pushers[topic].fetch_add(1);
    life_.count(Count::Advertised);
    if (plan_.in_slots && std::is_same_v<T, Plain>) life_.count(Count::InSlots);
  }
  ~Outlet() {
    life_.doing(Doing::Closing, topic_);
    record().state.store(Incarnation::Closed, std::memory_order_release);
    life_.me.pushers[topic_].fetch_sub(1);
    pusher_.reset();
  }
  Outlet(const Outlet&) = delete;
  Outlet& operator=(const Outlet&) = delete;

  /// The place of the next message.
  Place next() const { return {incarnation_, number_}; }
  std::uint32_t topic() const { return topic_; }
  const Publishing& plan() const { return plan_; }

  /// A message without payload, or null when the segment is full.
  ShmUniquePtr<T> loan() {
    life_.doing(Doing::Loaning, topic_);
    if (life_.random.chance(50)) return pusher_->try_loan();
    try {
      return pusher_->loan();
    } catch (const OutOfMemory&) {
      return nullptr;
    }
  }

  /// Pushes a unique or a shared message that bears next().
  template <class Pointer>
  Status push(Pointer&& message) {
    life_.doing(Doing::Pushing, topic_);
    record().begun.store(number_ + 1, std::memory_order_release);
    const Status status = push_now(std::forward<Pointer>(message));
    if (status == Status::Ok) {
      record().done.store(++number_, std::memory_order_release);
      life_.count(Count::Published);
    } else {
      record().begun.store(record().done.load(std::memory_order_relaxed),
                           std::memory_order_release);
      life_.count(Count::Refused);
    }
    return status;
  }

  // Mistakes.
  void skip_number() {
    record().begun.store(++number_);
    record().done.store(number_);
  }
  void use_number_again() {
    if (number_ != 0 && number_ == record().done.load()) --number_;  // else it looks like a loss
  }

 private:
  void reserve() {
    if (plan_.reserved == 0) return;
    try {
      pusher_->reserve(plan_.reserved, kReserved);
    } catch (const OutOfMemory& e) {
      life_.no_memory(e.what());
    }
  }
  Incarnation& record() { return life_.board.incarnations[incarnation_]; }
  Status push_now(ShmUniquePtr<T>&& message) {
    return tries() ? pusher_->try_push(std::move(message)) : pusher_->push(std::move(message));
  }
  Status push_now(const ShmSharedPtr<const T>& message) {
    return tries() ? pusher_->push(message, std::chrono::nanoseconds(0)) : pusher_->push(message);
  }
  bool tries() const { return plan_.refuses && plan_.policy != Policy::Refuse; }

  Life& life_;
  std::uint32_t topic_;
  Publishing plan_;
  std::uint32_t incarnation_ = 0;
  std::uint64_t number_ = 0;
  std::optional<ShmPusher<T>> pusher_;
};

}  // namespace lot::chaos
