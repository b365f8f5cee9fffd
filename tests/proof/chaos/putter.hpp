// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <chrono>
#include <optional>
#include <thread>
#include <type_traits>
#include <utility>

#include "lot/lot.hpp"

#include "job.hpp"
#include "life.hpp"
#include "message.hpp"
#include "plan.hpp"
#include "unfinished.hpp"

namespace lot::chaos {

/// Makes items and puts them into a queue, a few at a time; keeps its record on the board as an
/// Outlet does.
template <class T>
class Putter final : public Job {
 public:
  Putter(Life& life, ShmEngine& engine, std::uint32_t topic)
      : life_(life),
        engine_(engine),
        topic_(topic),
        most_(life.random.chance(20) ? 100 : 4),
        pace_(life.random.between(most_ * std::chrono::microseconds(120),
                                  most_ * std::chrono::microseconds(1500))) {
    open();
  }
  ~Putter() override { close(); }

  void turn() override {
    if (!waiting_ && life_.random.chance(2)) reopen();
    for (std::uint64_t n = life_.random.below(most_ + 1); n > 0 && goes_on(); --n) {
      // A refused item is kept for the next time.
      if (waiting_ || (waiting_ = make())) put(waiting_);
    }
    life_.doing(Doing::Running);
    std::this_thread::sleep_for(pace_);
  }
  void quiet() override {
    waiting_ = nullptr;
    std::this_thread::sleep_for(pace_);
  }
  bool settle() override {
    quiet();
    return true;
  }

  /// Makes an item the next one to put: no other process has it.
  void stamp(T& item, std::uint64_t serial, std::uint64_t words) {
    if (number_ == kItems) reopen();
    item.stamp = {};
    item.stamp.serial = serial;
    item.stamp.incarnation = incarnation_;
    item.stamp.number = number_;
    item.stamp.words = words;
    item.stamp.seal = item.stamp.sealed();
  }

  /// Puts an item that bears the next number. When it is refused it stays with the caller.
  void put(ShmUniquePtr<T>& item) {
    life_.doing(Doing::Pushing, topic_);
    item->stamp.pushed_at = Life::now();
    life_.board.item(record(), number_).put_at.store(item->stamp.pushed_at);
    record().begun.store(number_ + 1, std::memory_order_release);
    const bool tries = plan_.refuses && plan_.policy != Policy::Refuse;
    const Status status = tries ? queue_->try_put(std::move(item))
                                : queue_->put_for(std::move(item), plan_.block_for);
    if ((status == Status::Ok) == static_cast<bool>(item)) {
      life_.fail(Finding::Crashed, "an item is not where the status says");
    }
    if (status == Status::Ok) {
      record().done.store(++number_, std::memory_order_release);
      life_.count(Count::Published);
    } else {
      record().begun.store(number_, std::memory_order_release);
      life_.count(Count::Refused);
    }
  }

 private:
  using Queue = ShmQueue<ShmUniquePtr<T>>;

  bool goes_on() const { return !life_.stopping() && life_.stage() == Stage::Run; }
  Incarnation& record() { return life_.board.incarnations[incarnation_]; }

  void open() {
    life_.doing(Doing::Advertising, topic_);
    plan_ = publishing(life_.random, topic_);
    incarnation_ =
        life_.new_incarnation(topic_, plan_.depth, plan_.is_lossless(), plan_.is_lossless());
    record().segment = segment_file(engine_.path());
    number_ = 0;
    QueueOptions options;
    options.depth = plan_.depth;
    options.redeliver = has_tasks(topic_);
    options.policy =
        life_.has(Plant::Spill) && !options.redeliver ? Policy::Overwrite : plan_.policy;
    options.engine = plan_.engine;
    options.fast_lane = plan_.in_slots;
    queue_.emplace(engine_.queue<ShmUniquePtr<T>>(kTopic[topic_].name, options));
    make_ring();
    record().state.store(Incarnation::Live, std::memory_order_release);
    life_.me.pushers[topic_].fetch_add(1);
    is_open_ = true;
    life_.count(Count::Advertised);
    if (plan_.in_slots && std::is_same_v<T, Plain>) life_.count(Count::InSlots);
  }
  /// The first thing that is put makes the ring. There may be no block for an item; what is empty
  /// needs none, and is refused behind that.
  void make_ring() {
    try {
      (void)queue_->put(ShmUniquePtr<T>());  // it throws
    } catch (const Error& e) {
      if (e.error_number() == EINVAL) return;
      throw;
    }
    life_.fail(Finding::Crashed, "an empty pointer was put");
  }
  void close() {
    if (!is_open_) return;
    is_open_ = false;
    life_.doing(Doing::Closing, topic_);
    record().state.store(Incarnation::Closed, std::memory_order_release);
    life_.me.pushers[topic_].fetch_sub(1);
    queue_.reset();
  }
  void reopen() {
    close();
    open();
  }

  ShmUniquePtr<T> make() {
    if (number_ == kItems) reopen();
    life_.doing(Doing::Loaning, topic_);
    try {
      auto item = queue_->make();
      life_.doing(Doing::Filling, topic_);
      stamp(*item, life_.new_serial(), std::is_same_v<T, Frame> ? frame_words(life_.random) : 0);
      fill(*item);
      return item;
    } catch (const OutOfMemory& e) {
      life_.no_memory(e.what());
      return nullptr;
    }
  }

  Life& life_;
  ShmEngine& engine_;
  std::uint32_t topic_;
  Publishing plan_{};
  unsigned most_;  ///< items at a time
  std::chrono::nanoseconds pace_;
  std::uint32_t incarnation_ = 0;
  std::uint64_t number_ = 0;
  std::optional<Queue> queue_;
  bool is_open_ = false;
  ShmUniquePtr<T> waiting_;
};

}  // namespace lot::chaos
