// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "lot/any_message.hpp"
#include "lot/detail/mutex.hpp"

#include "mcap/records.hpp"
#include "record/stream.hpp"

namespace lot::record {

/// A message that was seen and is not written yet; or a trigger.
struct Entry {
  std::shared_ptr<const Stream> stream;  ///< null: it is a trigger
  mcap::MessageHead head;                ///< without its channel
  AnyMessage message;                    ///< where it lies; null: `bytes` are the message
  std::vector<std::byte> bytes;          ///< as CDR
  std::uint64_t held = 0;                ///< what it takes of the quota
};

/// What waits between the observer's thread and the writer's. Messages together take at most the
/// limit; one is always allowed. What the writer has taken counts until it says done().
///
/// Threads: all members may be called at once.
/// Errors:  std::bad_alloc of put().
class Backlog {
 public:
  using Time = std::chrono::steady_clock::duration;

  /// How many bytes more there may be. Waits until there are some.
  std::uint64_t room(std::uint64_t limit) {
    std::unique_lock lock(mutex_);
    is_room_.wait(lock, [&] { return held_ < limit || held_ == 0; });
    return limit - std::min(limit, held_);
  }
  void put(std::vector<Entry>& entries) {
    if (entries.empty()) return;
    const std::lock_guard guard(mutex_);
    for (Entry& entry : entries) {
      held_ += entry.held;
      entries_.push_back(std::move(entry));
    }
    entries.clear();
    has_news_.notify_one();
  }
  /// All that is there. Waits for something, so long at most; nothing: nothing came, or there will
  /// be no more.
  std::deque<Entry> take(Time most) {
    std::unique_lock lock(mutex_);
    has_news_.wait_for(lock, most, [&] { return !entries_.empty() || has_ended_; });
    return std::exchange(entries_, {});
  }
  /// Messages that took so much are written.
  void done(std::uint64_t held) {
    const std::lock_guard guard(mutex_);
    held_ -= held;
    is_room_.notify_one();
  }
  /// Nothing will be put any more.
  void end() {
    const std::lock_guard guard(mutex_);
    has_ended_ = true;
    has_news_.notify_one();
  }
  bool is_over() const {
    const std::lock_guard guard(mutex_);
    return has_ended_ && entries_.empty();
  }
  std::uint64_t held() const {
    const std::lock_guard guard(mutex_);
    return held_;
  }

 private:
  mutable detail::Mutex mutex_{detail::Rank::Recording};
  detail::Condition has_news_;
  detail::Condition is_room_;
  std::deque<Entry> entries_;
  std::uint64_t held_ = 0;
  bool has_ended_ = false;
};

}  // namespace lot::record
