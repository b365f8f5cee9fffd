// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "frame.hpp"
#include "process.hpp"

namespace demo {

/// What a consumer notes about the frames that it gets.
class Tally {
 public:
  explicit Tally(const Settings& settings) : settings_(settings) {}

  void note(const Head& head, const std::uint8_t* picture, std::size_t bytes) {
    const std::int64_t now = now_ns();
    if (head.run != run_) {  // the camera lives again
      run_ = head.run;
      expected_ = received_ == 0 ? head.number : 0;
      received_by_run_.resize(std::max<std::size_t>(received_by_run_.size(), run_ + 1));
    }
    lost_ += head.number - expected_;
    expected_ = head.number + 1;
    ++received_;
    ++received_by_run_[run_];
    if (received_ > 1) silence_ns_ = std::max(silence_ns_, now - before_ns_);
    before_ns_ = now;
    if (settings_.hash) {
      hashes_.push_back(adler32(picture, bytes));
    } else {
      latency_ns_.push_back(now - head.stamp_ns);
      damaged_ += looks_right(picture, bytes, head.number) ? 0 : 1;
    }
    if (head.number == 0 || received_ == 1 || received_ % settings_.report_every == 0) {
      say("at", {{"frames", received_}, {"run", run_}});
    }
  }

  /// `missed`: what the transport itself says it has lost.
  void report(std::uint64_t missed) const {
    say("done", {{"received", received_},
                 {"received_by_run", received_by_run_},
                 {"lost", std::max(lost_, missed)},
                 {"damaged", damaged_},
                 {"silence_ns", silence_ns_},
                 {"latency_ns", latency_ns_},
                 {"hashes", hashes_},
                 {"cpu", cpu_.seconds()}});
  }

 private:
  const Settings& settings_;
  CpuTime cpu_;
  std::uint32_t run_ = 0;
  std::uint32_t expected_ = 0;
  std::uint64_t received_ = 0;
  std::uint64_t lost_ = 0;
  std::uint64_t damaged_ = 0;
  std::int64_t before_ns_ = 0;
  std::int64_t silence_ns_ = 0;
  std::vector<std::uint64_t> received_by_run_;
  std::vector<std::int64_t> latency_ns_;
  std::vector<std::uint32_t> hashes_;
};

}  // namespace demo
