// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <string>
#include <sys/types.h>
#include <utility>
#include <vector>

#include "lot/detail/mutex.hpp"
#include "lot/recorder.hpp"

#include "mcap/records.hpp"
#include "record/past.hpp"
#include "record/pattern.hpp"

namespace lot::record {

/// What a recorder has seen, written, and not.
///
/// Threads: all members may be called at once.
/// Errors:  std::bad_alloc.
class Ledger {
 public:
  using Topic = RecorderStatus::Topic;
  using Count = std::uint64_t Topic::*;

  /// The line of a topic with that type, whose name is `type` and which is what `pairs` say. Lines
  /// never go.
  std::size_t line_of(const std::string& name, const std::string& in_segment,
                      const std::string& type, const mcap::Pairs& pairs) {
    const std::lock_guard guard(mutex_);
    for (std::size_t line = 0; line < told_.topics.size(); ++line) {
      const Topic& topic = told_.topics[line];
      if (topic.name == name && topic.type == type && pairs_[line] == pairs) return line;
    }
    Topic topic;
    topic.name = name;
    topic.in_segment = in_segment;
    topic.type = type;
    told_.topics.push_back(std::move(topic));
    sequences_.push_back(0);
    pairs_.push_back(pairs);
    return told_.topics.size() - 1;
  }
  void add(std::size_t line, Count count, std::uint64_t n) {
    const std::lock_guard guard(mutex_);
    told_.topics[line].*count += n;
  }
  void take(std::size_t line, Count count, std::uint64_t n) {
    const std::lock_guard guard(mutex_);
    told_.topics[line].*count -= n;
  }
  /// The number of the topic's next message, `missed` behind the one before it.
  std::uint32_t number(std::size_t line, std::uint64_t missed) {
    const std::lock_guard guard(mutex_);
    told_.topics[line].missed += missed;
    sequences_[line] += static_cast<std::uint32_t>(missed);
    return sequences_[line]++;
  }
  /// Messages that were missed, and no message behind them.
  void miss(std::size_t line, std::uint64_t missed) {
    const std::lock_guard guard(mutex_);
    told_.topics[line].missed += missed;
    sequences_[line] += static_cast<std::uint32_t>(missed);
  }
  void refuse(const std::string& name, const std::string& why) {
    const std::lock_guard guard(mutex_);
    const auto is_it = [&](const auto& refused) { return refused.name == name; };
    const auto found = std::ranges::find_if(told_.refused, is_it);
    if (found == told_.refused.end()) {
      told_.refused.push_back({name, why});
    } else {
      found->why = why;
    }
  }
  /// Names and patterns that are to be fitted by topics.
  void expects(std::vector<std::string> patterns) {
    const std::lock_guard guard(mutex_);
    told_.unmatched = std::move(patterns);
  }
  bool expects_more() const {
    const std::lock_guard guard(mutex_);
    return !told_.unmatched.empty();
  }
  /// There is a topic of that name.
  void saw(const std::string& name) {
    const std::lock_guard guard(mutex_);
    std::erase_if(told_.unmatched,
                  [&](const std::string& pattern) { return matches(pattern, name); });
  }
  /// `mode`: of the segment's file.
  void joined(const std::string& segment, mode_t mode) {
    const std::lock_guard guard(mutex_);
    mode_ &= mode;
    const bool is_anew = std::ranges::find(told_.segments, segment) != told_.segments.end();
    if (!is_anew) told_.segments.push_back(segment);
  }
  void keeps(const Past& past) {
    const std::lock_guard guard(mutex_);
    told_.kept_messages = past.messages();
    told_.kept_bytes = past.bytes();
    told_.cut_messages = past.cut_messages();
    told_.cut_time = std::chrono::nanoseconds(past.cut_time());
  }
  void triggered() {
    const std::lock_guard guard(mutex_);
    ++told_.triggers;
  }
  void made(const std::string& file) {
    const std::lock_guard guard(mutex_);
    const bool is_anew = std::ranges::find(told_.files, file) != told_.files.end();
    if (!is_anew) told_.files.push_back(file);
  }
  void went_wrong(const std::string& what) {
    const std::lock_guard guard(mutex_);
    if (told_.first_error.empty()) told_.first_error = what;
    told_.error = what;
  }

  /// What all segments together give that were joined so far.
  mode_t mode() const {
    const std::lock_guard guard(mutex_);
    return mode_;
  }
  Topic topic(std::size_t line) const {
    const std::lock_guard guard(mutex_);
    return told_.topics[line];
  }
  RecorderStatus told() const {
    const std::lock_guard guard(mutex_);
    return told_;
  }

 private:
  mutable detail::Mutex mutex_{detail::Rank::Recording};
  RecorderStatus told_;
  mode_t mode_ = 0666;
  std::vector<std::uint32_t> sequences_;  ///< of the next message, for each topic
  std::vector<mcap::Pairs> pairs_;        ///< what each topic carries
};

}  // namespace lot::record
