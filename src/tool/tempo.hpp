// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>

namespace lot::tool {

/// What is known of the rate of one queue.
struct Rate {
  std::optional<double> per_second;  ///< nothing: too few messages came to tell
  std::optional<double> below;       ///< then: the rate of an even publisher is less
  std::uint64_t messages = 0;        ///< that came while the tool looked
  double seconds = 0;                ///< how long it looked
};

/// Tells the rate of a queue by the moments at which its messages came.
///
/// The count alone is wrong at low rates: in 0.3 s a topic of 1 Hz has none or one, so 0 or 3.3 a
/// second. Tempo measures from the first arrival to the last one, and tells no rate before two more
/// messages have followed the first one, nor when they came unevenly (a burst, a pause).
///
/// Threads: one.
class Tempo {
 public:
  /// Seconds, of any clock that does not jump.
  explicit Tempo(double begin) : begin_(begin), last_(begin) {}

  /// At this moment `n` more messages are there than at the last call.
  void see(double at, std::uint64_t n) {
    if (n == 0) return;
    silence_ = std::max(silence_, at - last_);
    last_ = at;
    if (messages_ == 0) {
      first_ = at;
    } else {
      followed_ += n;
    }
    messages_ += n;
  }

  Rate rate(double now) const {
    const double seconds = now - begin_;
    Rate rate{{}, {}, messages_, seconds};
    if (seconds <= 0) return rate;
    if (const auto per_second = mean(); per_second && is_even(*per_second, now)) {
      rate.per_second = per_second;
    } else {
      rate.below = static_cast<double>(messages_ + 1) / seconds;
    }
    return rate;
  }

  /// Messages a second from the first arrival to the last one, also when they came unevenly;
  /// nothing when fewer than two have followed the first one.
  std::optional<double> mean() const {
    if (followed_ < kLeast || last_ <= first_) return std::nullopt;
    return static_cast<double>(followed_) / (last_ - first_);
  }

 private:
  static constexpr std::uint64_t kLeast = 2;  ///< messages behind the first one
  static constexpr double kPeriods = 3;       ///< a pause as long is none
  static constexpr double kPart = 0.2;  ///< nor one of this part of the time: a fast one may halt

  bool is_even(double per_second, double now) const {
    const double silence = std::max(silence_, now - last_);
    return silence <= std::max(kPeriods / per_second, kPart * (now - begin_));
  }

  double begin_;
  double first_ = 0;
  double last_;
  double silence_ = 0;  ///< the longest time without a message so far
  std::uint64_t messages_ = 0;
  std::uint64_t followed_ = 0;  ///< after the moment of the first
};

}  // namespace lot::tool
