// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <optional>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include "lot/lot.hpp"

#include "job.hpp"
#include "outlet.hpp"

namespace lot::chaos {

/// Makes messages and pushes them, a few at a time.
template <class T>
class Publisher final : public Job {
 public:
  Publisher(Life& life, ShmEngine& engine, std::uint32_t topic)
      : life_(life),
        outlet_(life, engine, topic),
        most_(life.random.chance(20) ? 100 : 4),
        pace_(life.random.between(most_ * std::chrono::microseconds(120),
                                  most_ * std::chrono::microseconds(1500))) {
    if constexpr (std::is_same_v<T, Frame>) {
      // A message is pushed on both topics or on none.
      if (topic == kCamera && life.random.chance(50)) twin_.emplace(life, engine, kTwin);
    }
  }

  void turn() override {
    // Each one may wait for a reader; when all come to rest, no node reads any more.
    for (std::uint64_t n = life_.random.below(most_ + 1); n > 0 && goes_on(); --n) publish();
    if (life_.has(Plant::Hoard)) {
      for (unsigned n = 0; n < 200; ++n) hoard_.push_back(outlet_.loan());
    }
    life_.doing(Doing::Running);
    std::this_thread::sleep_for(pace_);
  }
  void quiet() override {
    waiting_ = nullptr;
    mine_ = nullptr;
    std::this_thread::sleep_for(pace_);
  }
  bool settle() override {
    quiet();
    return true;
  }

 private:
  bool goes_on() const { return !life_.stopping() && life_.stage() == Stage::Run; }

  void publish() {
    if (!waiting_) {  // it bears its number already
      if (life_.has(Plant::Skip, 2)) outlet_.skip_number();
      if (life_.has(Plant::Twice, 2)) outlet_.use_number_again();
    }
    if (smeared_ != nullptr) tear(*std::exchange(smeared_, nullptr));
    // A refused message is kept for the next time.
    if (!waiting_ && !(waiting_ = make())) return;
    T* const raw = waiting_.get();
    raw->stamp.pushed_at = Life::now();
    if (twin_ || life_.random.chance(15)) {
      push_shared();
    } else if (outlet_.push(std::move(waiting_)) == Status::Ok) {
      if (waiting_) life_.fail(Finding::Crashed, "a message stayed with the caller after Ok");
    } else if (!waiting_) {
      life_.fail(Finding::Lost, "a refused message did not stay with the caller");
    }
    if (!waiting_ && life_.has(Plant::Tear, 5)) tear(*raw);
    if (!waiting_ && life_.has(Plant::Smear, 5)) smeared_ = raw;
  }

  /// As a message that we go on holding for a while.
  void push_shared() {
    const ShmSharedPtr<const T> message = std::move(waiting_);
    const bool twin = message->stamp.twin_incarnation != 0;
    if (outlet_.push(message) != Status::Ok) return;  // it dies; its number goes to the next
    if constexpr (std::is_same_v<T, Frame>) {
      if (twin && twin_->push(message) != Status::Ok) {
        life_.fail(Finding::Crashed, "Overwrite refused a message");
      }
    }
    if (mine_ && mine_seal_ != mine_->stamp.seal) {
      life_.fail(Finding::Torn, "what its publisher holds became another message");
    }
    mine_ = life_.random.chance(50) ? message : nullptr;
    mine_seal_ = message->stamp.seal;
  }

  ShmUniquePtr<T> make() {
    auto message = outlet_.loan();
    if (!message) {
      life_.no_memory("no block to loan");
      return nullptr;
    }
    life_.doing(Doing::Filling, outlet_.topic());
    Stamp& stamp = message->stamp;
    const Place place = outlet_.next();
    stamp = {};
    stamp.serial = life_.new_serial();
    stamp.incarnation = place.incarnation;
    stamp.number = place.number;
    if (twin_) {
      stamp.twin_incarnation = twin_->next().incarnation;
      stamp.twin_number = twin_->next().number;
    }
    if constexpr (std::is_same_v<T, Frame>) stamp.words = frame_words(life_.random);
    stamp.seal = stamp.sealed();
    try {
      fill(*message);
    } catch (const OutOfMemory& e) {
      life_.no_memory(e.what());
      return nullptr;
    }
    return message;
  }

  static void tear(Plain& message) {
    std::this_thread::sleep_for(std::chrono::microseconds(100));
    message.data[4] ^= 1;
  }
  static void tear(Frame& message) {
    std::this_thread::sleep_for(std::chrono::microseconds(100));
    message.stamp.words ^= 1;
  }

  Life& life_;
  Outlet<T> outlet_;
  std::optional<Outlet<Frame>> twin_;
  unsigned most_;  ///< messages at a time
  std::chrono::nanoseconds pace_;
  T* smeared_ = nullptr;
  std::vector<ShmUniquePtr<T>> hoard_;
  ShmUniquePtr<T> waiting_;
  ShmSharedPtr<const T> mine_;
  std::uint64_t mine_seal_ = 0;
};

}  // namespace lot::chaos
