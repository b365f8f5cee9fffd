// SPDX-License-Identifier: Apache-2.0
/// The lock-free ring against the same queue under one mutex: round trips between two processes.
///
///     engines                    ring and mutex, by PusherOptions::engine
///     LOT_QUEUE=mutex engines    both arms with the mutex: the ratio is then about 1
///
/// The arms take turns, so that a slow phase of the machine meets both of them.
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include <lot/lot.hpp>

#include "example.hpp"

namespace {

using Clock = std::chrono::steady_clock;

struct Ball {
  std::uint32_t arm;  ///< index of the pusher that it came by, and goes back by
};
using Pushers = std::vector<lot::ShmPusher<Ball>>;

constexpr std::uint32_t kBlocks = 25, kTrips = 100;  // of each arm

Pushers both_arms(lot::ShmEngine& engine, const char* topic) {
  Pushers pushers;
  for (const auto kind : {lot::QueueEngine::Ring, lot::QueueEngine::Mutex}) {
    lot::PusherOptions options;
    options.engine = kind;  // LOT_QUEUE comes before it; a reader follows the publisher
    pushers.push_back(engine.advertise<Ball>(topic, options));
  }
  return pushers;
}

bool echo() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  Pushers back = both_arms(engine, "/back");
  auto there = engine.subscribe<Ball>("/there");
  while (!stop.stop_requested()) {  // until main() says SIGTERM
    const auto ball = there.pull(stop);
    if (ball) (void)back[ball->arm].push(back[ball->arm].loan(*ball));  // never Full
  }
  return true;
}

double quantile(std::vector<double> values, double part) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(part * static_cast<double>(values.size() - 1))];
}

bool play() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  Pushers there = both_arms(engine, "/there");
  auto back = engine.subscribe<Ball>("/back");
  for (auto& pusher : there) {
    if (!pusher.wait_for_readers(1, stop)) return false;
  }
  std::vector<double> microseconds[2], ratio;
  for (std::uint32_t block = 0; block <= kBlocks; ++block) {  // the first is not counted
    double median[2];
    for (const std::uint32_t turn : {0U, 1U}) {
      const std::uint32_t arm = (block + turn) % 2;
      std::vector<double> trips;
      for (std::uint32_t n = 0; n < kTrips; ++n) {
        const auto begin = Clock::now();
        (void)there[arm].push(there[arm].loan(Ball{arm}));  // the oldest goes: never Full
        if (!back.pull(stop)) return false;
        trips.push_back(std::chrono::duration<double, std::micro>(Clock::now() - begin).count());
      }
      median[arm] = quantile(trips, 0.5);
      if (block != 0) microseconds[arm].push_back(median[arm]);
    }
    if (block != 0) ratio.push_back(median[1] / median[0]);
  }
  const auto print = [](const char* what, const std::vector<double>& values, const char* unit) {
    std::printf("%-7s %7.2f%s, half of the blocks %.2f .. %.2f\n", what, quantile(values, 0.5),
                unit, quantile(values, 0.25), quantile(values, 0.75));
  };
  std::printf("a round trip, median of %u, in %u blocks\n", kTrips, kBlocks);
  print("ring", microseconds[0], " us");
  print("mutex", microseconds[1], " us");
  print("ratio", ratio, "");
  return true;
}

}  // namespace

int main() {
  return example::run("engines", [] {
    const pid_t child = example::start("echo", echo);
    const bool good = play();
    kill(child, SIGTERM);
    example::finish(child);
    return good;
  });
}
