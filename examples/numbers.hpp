// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstdio>
#include <optional>

#include <lot/lot.hpp>

#include "example.hpp"

/// What the event loops of loops.cpp and glib.cpp read: numbers from another process.
namespace example {

struct Number {
  std::uint64_t value;
};

/// Publishes 0, 1, 2 ..., at a pace that lets the loops sleep now and then. None is lost: who
/// waits for room asks for Policy::Block.
inline bool publish_numbers(std::uint64_t count) {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  lot::PusherOptions options;
  options.policy = lot::Policy::Block;
  auto pusher = engine.advertise<Number>("/numbers", options);
  if (!pusher.wait_for_readers(1, stop)) return false;
  for (std::uint64_t n = 0; n < count && !stop.stop_requested();) {
    if (pusher.push(pusher.loan(Number{n}), stop) == lot::Status::Ok) ++n;
    if (n % 10 == 0) usleep(1000);
  }
  return true;
}

/// Counts the numbers that come, and says whether one was missing.
class Count {
 public:
  explicit Count(lot::ShmPuller<Number>& puller) : puller_(puller) {}

  /// What a loop does when the descriptor is readable: pulls until there is nothing.
  void pull_all() {
    while (const auto number = puller_.try_pull()) good_ &= number->value == next_++;
  }
  /// Ends the loop, as Ctrl-C does.
  bool reached(std::uint64_t count) const { return next_ >= count || stop_.stop_requested(); }
  bool good() const { return good_; }
  std::uint64_t value() const { return next_; }

 private:
  const lot::StopToken stop_ = lot::stop_on_signals();
  lot::ShmPuller<Number>& puller_;
  std::uint64_t next_ = 0;
  bool good_ = true;
};

}  // namespace example
