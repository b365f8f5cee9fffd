// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

namespace lot::gateway {

/// Lets so many messages a second pass, and a second's worth at once after a pause.
///
/// Threads: one.
class RateLimit {
 public:
  using Clock = std::chrono::steady_clock;

  /// 0: no limit.
  explicit RateLimit(double per_second)
      : per_second_(per_second), most_(std::max(per_second, 1.0)) {}

  bool allows(Clock::time_point now) {
    if (per_second_ <= 0) return true;
    if (last_) left_ += std::chrono::duration<double>(now - *last_).count() * per_second_;
    left_ = last_ ? std::min(left_, most_) : most_;
    last_ = now;
    if (left_ < 1) return false;
    left_ -= 1;
    return true;
  }

 private:
  double per_second_;
  double most_;
  double left_ = 0;
  std::optional<Clock::time_point> last_;
};

}  // namespace lot::gateway
