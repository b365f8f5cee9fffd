// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <vector>

/// Figures of many numbers that are not kept, and those of the last seconds: pure algorithms.
namespace lot::tool {

/// Mean, deviation, minimum and maximum of numbers.
///
/// A sum of squares would lose the deviation where it is small beside the mean: intervals of ten
/// seconds that differ by a microsecond. So this is Welford's way, and two Moments become one by
/// that of Chan, Golub and LeVeque.
///
/// Threads: one.
class Moments {
 public:
  void add(double x) {
    ++count_;
    const double before = x - mean_;
    mean_ += before / static_cast<double>(count_);
    squares_ += before * (x - mean_);
    least_ = std::min(least_, x);
    most_ = std::max(most_, x);
  }
  /// Adds all numbers of the other one.
  void merge(const Moments& other) {
    if (other.count_ == 0) return;
    const auto mine = static_cast<double>(count_);
    const auto its = static_cast<double>(other.count_);
    const double apart = other.mean_ - mean_;
    mean_ += apart * (its / (mine + its));
    squares_ += other.squares_ + apart * apart * (mine * its / (mine + its));
    count_ += other.count_;
    least_ = std::min(least_, other.least_);
    most_ = std::max(most_, other.most_);
  }

  std::uint64_t count() const { return count_; }
  // The next four REQUIRE that there is a number.
  double mean() const { return mean_; }
  double least() const { return least_; }
  double most() const { return most_; }
  /// The standard deviation of these numbers, not an estimate for others: 0 of one number.
  double deviation() const { return std::sqrt(squares_ / static_cast<double>(count_)); }

 private:
  std::uint64_t count_ = 0;
  double mean_ = 0;
  double squares_ = 0;  ///< of the distances to the mean
  double least_ = std::numeric_limits<double>::infinity();
  double most_ = -std::numeric_limits<double>::infinity();
};

/// Which number the part `q` of all numbers does not exceed: to within 1/64 of that number.
///
/// It counts numbers in buckets. A bucket is 1/32 as wide as its numbers are large; below 64 each
/// whole number has its own.
///
/// Threads: one.
/// Memory:  8 bytes for each bucket up to that of the largest number: 15 KiB at most, and as much
///          for numbers below zero.
class Ranks {
 public:
  void add(std::int64_t x) {
    std::vector<std::uint64_t>& side = x < 0 ? below_ : above_;
    const std::size_t i = bucket(static_cast<std::uint64_t>(x < 0 ? ~x : x));
    if (i >= side.size()) side.resize(i + 1);
    ++side[i];
    ++count_;
  }
  /// Adds all numbers of the other one.
  void merge(const Ranks& other) {
    merge(below_, other.below_);
    merge(above_, other.above_);
    count_ += other.count_;
  }

  std::uint64_t count() const { return count_; }
  /// The middle of the bucket. REQUIRES: there is a number; 0 < q <= 1.
  double at(double q) const {
    const auto wanted =
        std::max<std::uint64_t>(1, static_cast<std::uint64_t>(std::ceil(q * as_double(count_))));
    std::uint64_t so_far = 0;
    for (std::size_t i = below_.size(); i-- > 0;) {
      so_far += below_[i];
      if (so_far >= wanted) return -1 - middle(i);
    }
    for (std::size_t i = 0; i < above_.size(); ++i) {
      so_far += above_[i];
      if (so_far >= wanted) return middle(i);
    }
    return 0;
  }

 private:
  static constexpr unsigned kBits = 5;  ///< 2^kBits buckets where a number doubles
  static constexpr std::size_t kPerOctave = std::size_t{1} << kBits;

  static double as_double(std::uint64_t n) { return static_cast<double>(n); }
  static void merge(std::vector<std::uint64_t>& side, const std::vector<std::uint64_t>& other) {
    if (other.size() > side.size()) side.resize(other.size());
    for (std::size_t i = 0; i < other.size(); ++i) side[i] += other[i];
  }
  static std::size_t bucket(std::uint64_t x) {
    if (x < 2 * kPerOctave) return x;
    const auto shift = static_cast<unsigned>(std::bit_width(x)) - kBits - 1;
    return kPerOctave * shift + (x >> shift);
  }
  static double middle(std::size_t i) {
    if (i < 2 * kPerOctave) return static_cast<double>(i);
    const std::size_t shift = i / kPerOctave - 1;
    const auto first = static_cast<double>(i - kPerOctave * shift);
    return std::ldexp(first + 0.5, static_cast<int>(shift)) - 0.5;
  }

  std::uint64_t count_ = 0;
  std::vector<std::uint64_t> above_;  ///< zero and more
  std::vector<std::uint64_t> below_;  ///< ~x of the numbers below zero
};

/// Moments and Ranks of whole numbers.
///
/// Threads: one.
struct Figures {
  Moments moments;
  Ranks ranks;

  void add(std::int64_t x) {
    moments.add(static_cast<double>(x));
    ranks.add(x);
  }
  void merge(const Figures& other) {
    moments.merge(other.moments);
    ranks.merge(other.ranks);
  }
  bool empty() const { return moments.count() == 0; }
  /// As Ranks::at(), and never outside of all numbers.
  double at(double q) const { return std::clamp(ranks.at(q), moments.least(), moments.most()); }
};

/// What came in the last seconds, without keeping each thing that came: Panes has one Part for each
/// 1/16 of these seconds, and drops the oldest one when all of it is too old. A topic of 0.1 Hz has
/// nothing in most seconds, so the last `fewest` things stay however old they are.
///
/// A Part has weight(): how many things it counts for `fewest`; and merge().
///
/// Threads: one.
/// Memory:  18 Parts, and one for each of `fewest`.
template <class Part>
class Panes {
 public:
  using Time = std::chrono::steady_clock::time_point;
  using Span = std::chrono::nanoseconds;

  /// REQUIRES: `window` is positive.
  Panes(Span window, std::uint64_t fewest)
      : window_(window), width_(std::max(window / 16, Span(1))), fewest_(fewest) {}

  /// Where to note what comes now.
  Part& at(Time now) {
    if (panes_.empty() || now - panes_.back().begin >= width_) {
      prune(now);
      panes_.push_back({now, {}});
    }
    return panes_.back().part;
  }
  /// All of the last seconds.
  Part whole(Time now) {
    prune(now);
    Part sum{};
    for (const Pane& pane : panes_) sum.merge(pane.part);
    return sum;
  }
  void clear() { panes_.clear(); }
  /// How many Parts there are.
  std::size_t size() const { return panes_.size(); }

 private:
  struct Pane {
    Time begin;
    Part part;
  };

  void prune(Time now) {
    std::uint64_t weight = 0;
    for (const Pane& pane : panes_) weight += pane.part.weight();
    while (!panes_.empty() && now - panes_.front().begin >= window_ + width_) {
      weight -= panes_.front().part.weight();
      if (weight < fewest_) break;
      panes_.pop_front();
    }
  }

  Span window_;
  Span width_;
  std::uint64_t fewest_;
  std::deque<Pane> panes_;
};

}  // namespace lot::tool
