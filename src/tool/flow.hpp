// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>
#include <vector>

#include "tool/statistics.hpp"

namespace lot::tool {

/// What is known of a Flow: of its last seconds, or of all of it.
struct FlowTold {
  std::uint64_t messages = 0;  ///< that were seen
  std::uint64_t missed = 0;    ///< that were not
  /// Messages a second, those that were not seen too; nothing: fewer than two came.
  std::optional<double> rate;
  std::chrono::nanoseconds span{};  ///< what the rate is measured over: first message to last one
  Figures figures;
  std::chrono::nanoseconds silence{};  ///< since the last message, or since the begin
  bool is_silent = false;              ///< none comes now: then there is nothing else to tell
};

/// The messages of a publisher, or of a whole topic, as they come: how many a second, and a figure
/// of each (its size, its delay, the time since the one before it).
///
/// The rate of a publisher is the number of its messages behind the first one, divided by the time
/// from the first to the last. So two messages are enough, and no rate is too high or too low. The
/// rate of all is the sum. A publisher that was there for a part of the time counts with that part:
/// one that takes the place of another does not double the rate. It is that of the last
/// seconds, and of the last kFewest messages where these took longer. A flow that halts has no rate
/// any more: nothing for a second, and for kPauses times its longest pause, is a halt. When it goes
/// on, it begins anew.
///
/// Threads: one.
/// Memory:  bounded, whatever comes: Panes, and a few words in each for each publisher.
class Flow {
 public:
  using Time = std::chrono::steady_clock::time_point;
  using Span = std::chrono::nanoseconds;
  static constexpr std::uint64_t kFewest = 5;
  static constexpr int kPauses = 3;
  static constexpr Span kShortestHalt = std::chrono::seconds(1);

  /// What came in the last `window` counts.
  Flow(Span window, Time begin) : panes_(window, kFewest), last_looked_(begin) {}

  /// One more message. `publisher`: Postmark::publisher. `at`: the moment that counts; that of
  /// another publisher's message before it may be later. `looked`: when it was seen. `n`: itself,
  /// and how many of its publisher's came before it and were not seen. `missed`: how many to report
  /// as missed.
  void see(std::uint64_t publisher, Time at, Time looked, std::uint64_t n, std::uint64_t missed,
           std::optional<std::int64_t> figure) {
    if (has_halted(looked)) forget();
    Part& part = panes_.at(looked);
    for (Part* sum : {&part, &all_}) {
      ++sum->messages;
      sum->missed += missed;
      if (figure) sum->figures.add(*figure);
    }
    if (has_last_) {
      part.span += at - last_at_;
      part.longest = std::max(part.longest, (looked - last_looked_) / static_cast<Span::rep>(n));
    }
    if (all_.messages == 1) first_at_ = at;
    all_.span = at - first_at_;
    count(part, publisher, at, n);
    has_last_ = true;
    last_at_ = at;
    last_looked_ = looked;
  }
  bool has_begun() const { return all_.messages != 0; }
  /// What came does not count any more, but in all().
  void forget() {
    panes_.clear();
    has_last_ = false;
    for (Last& last : lasts_) last.goes_on = false;
  }
  /// Of all publishers these are there. Those that have gone do not come again.
  void keep(const std::vector<std::uint64_t>& publishers) {
    const auto has_gone = [&](std::uint64_t id) {
      return std::find(publishers.begin(), publishers.end(), id) == publishers.end();
    };
    std::erase_if(lasts_, [&](const Last& last) { return has_gone(last.publisher); });
    std::erase_if(all_.shares, [&](const Share& share) {
      if (!has_gone(share.publisher)) return false;
      all_.past += share.n + 1;
      return true;
    });
  }

  FlowTold now(Time now) {
    FlowTold told;
    told.silence = now - last_looked_;
    Part sum = panes_.whole(now);
    told.is_silent =
        sum.messages == 0 || (told.silence > kShortestHalt && (sum.count() < 2 || has_halted(now)));
    if (!told.is_silent) fill(told, sum);
    return told;
  }
  FlowTold all(Time now) const {
    FlowTold told;
    told.silence = now - last_looked_;
    told.is_silent = all_.messages == 0;
    fill(told, all_);
    return told;
  }

 private:
  /// Of one publisher.
  struct Share {
    std::uint64_t publisher;
    std::uint64_t n = 0;  ///< messages behind the first one
    Span span{};          ///< and how long these took
  };
  struct Part {
    std::vector<Share> shares;
    std::uint64_t past = 0;  ///< messages of publishers that have gone, and have no share any more
    Span span{};             ///< from the first message of all to the last one
    Span longest{};          ///< the longest pause between two of them
    std::uint64_t messages = 0;
    std::uint64_t missed = 0;
    Figures figures;

    std::uint64_t weight() const { return messages; }
    void merge(const Part& other) {
      for (const Share& share : other.shares) add(share);
      past += other.past;
      span += other.span;
      longest = std::max(longest, other.longest);
      messages += other.messages;
      missed += other.missed;
      figures.merge(other.figures);
    }
    void add(const Share& share) {
      const auto is_it = [&](const Share& s) { return s.publisher == share.publisher; };
      const auto found = std::find_if(shares.begin(), shares.end(), is_it);
      if (found == shares.end()) return shares.push_back(share);
      found->n += share.n;
      found->span += share.span;
    }
    /// All messages, the first ones of publishers, too.
    std::uint64_t count() const {
      std::uint64_t sum = past;
      for (const Share& share : shares) sum += share.n + 1;
      return sum;
    }
    std::optional<double> rate() const {
      const auto all = static_cast<double>(count());
      if (all < 2 || span <= Span(0)) return std::nullopt;
      // From before the first message to the last one.
      const double whole = seconds(span) * all / (all - 1);
      double sum = static_cast<double>(past) / whole;
      for (const Share& share : shares) {
        const auto n = static_cast<double>(share.n);
        const double of_all = (n + 1) / whole;
        sum += share.span > Span(0) ? std::min(n / seconds(share.span), of_all) : of_all;
      }
      return sum;
    }
  };
  /// What came last of a publisher.
  struct Last {
    std::uint64_t publisher;
    Time at;
    bool goes_on;  ///< it counts for the rate of what comes next
  };

  static double seconds(Span span) { return std::chrono::duration<double>(span).count(); }

  /// Counts a message for the rate of its publisher.
  void count(Part& part, std::uint64_t publisher, Time at, std::uint64_t n) {
    const auto is_it = [&](const Last& last) { return last.publisher == publisher; };
    const auto last = std::find_if(lasts_.begin(), lasts_.end(), is_it);
    if (last == lasts_.end()) {
      part.add({publisher});
      all_.add({publisher});
      lasts_.push_back({publisher, at, true});
      return;
    }
    const Share share{publisher, n, at - last->at};
    part.add(last->goes_on ? share : Share{publisher});
    all_.add(share);
    *last = {publisher, at, true};
  }

  /// One message alone is no flow that could halt.
  bool has_halted(Time now) {
    const Span silence = now - last_looked_;
    if (!has_last_ || silence <= kShortestHalt) return false;
    const Part sum = panes_.whole(now);
    return sum.count() > 1 && silence / kPauses > sum.longest;
  }
  static void fill(FlowTold& told, const Part& sum) {
    told.messages = sum.messages;
    told.missed = sum.missed;
    told.figures = sum.figures;
    told.span = std::max(sum.span, Span(0));
    told.rate = sum.rate();
  }

  Panes<Part> panes_;
  Part all_;
  std::vector<Last> lasts_;
  Time first_at_{};
  Time last_at_{};
  Time last_looked_;
  bool has_last_ = false;
};

}  // namespace lot::tool
