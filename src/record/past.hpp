// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <utility>
#include <vector>

#include "mcap/records.hpp"
#include "record/stream.hpp"

namespace lot::record {

/// The messages of the last seconds, as bytes in this process's memory.
///
/// Threads: one at a time.
/// Errors:  std::bad_alloc.
class Past {
 public:
  struct Kept {
    std::shared_ptr<const Stream> stream;
    mcap::MessageHead head;
    std::vector<std::byte> bytes;
  };

  /// So many nanoseconds, and at most so many bytes.
  Past(std::uint64_t time, std::uint64_t most_bytes) : time_(time), most_bytes_(most_bytes) {}

  void add(Kept kept) {
    bytes_ += kept.bytes.size();
    const std::uint64_t now = kept.head.log_time;
    kept_.push_back(std::move(kept));
    while (kept_.size() > 1 && is_old(kept_.front(), now)) drop();
    while (kept_.size() > 1 && bytes_ > most_bytes_) {
      drop();
      ++cut_messages_;
      cut_time_ = now - std::min(now, kept_.front().head.log_time);
    }
  }
  /// Forgets what is older than it keeps.
  void look(std::uint64_t now) {
    while (!kept_.empty() && is_old(kept_.front(), now)) drop();
  }
  bool is_empty() const { return kept_.empty(); }
  std::uint64_t messages() const { return kept_.size(); }
  std::uint64_t bytes() const { return bytes_; }
  /// Those that went before their time, since there were too many bytes.
  std::uint64_t cut_messages() const { return cut_messages_; }
  /// How many nanoseconds were kept when the last one of them went.
  std::uint64_t cut_time() const { return cut_time_; }
  std::deque<Kept> take() {
    bytes_ = 0;
    return std::exchange(kept_, {});
  }

 private:
  bool is_old(const Kept& kept, std::uint64_t now) const {
    return now > kept.head.log_time && now - kept.head.log_time > time_;
  }
  void drop() {
    bytes_ -= kept_.front().bytes.size();
    kept_.pop_front();
  }

  std::uint64_t time_;
  std::uint64_t most_bytes_;
  std::deque<Kept> kept_;
  std::uint64_t bytes_ = 0;
  std::uint64_t cut_messages_ = 0;
  std::uint64_t cut_time_ = 0;
};

}  // namespace lot::record
