// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <deque>
#include <string>
#include <thread>
#include <vector>

#include "micro.hpp"

/// What processes cost that have nothing to do, and what the push costs that wakes them. Each has a
/// publisher of its own, and sleeps in a `pull()` without a time limit.
namespace bench {
namespace {

constexpr auto kWatched = 3s;
constexpr auto kAsleep = 30ms;  ///< after this time they sleep again
constexpr std::uint64_t kWakes = 20;

void sleep_and_wake(Companion& here, std::size_t number) {
  lot::ShmEngine engine(segment());
  const auto out = engine.advertise<Ball>("/quiet/" + std::to_string(number % 10));
  auto in = engine.subscribe<Ball>("/idle");
  here.meet();
  for (std::uint64_t n = 0; n < kWakes; ++n) {
    const auto ball = in.pull();
    expect(ball && ball->is(n), "a ball was lost");
  }
  while (here.hear() != Companion::kStop) {
  }
}

/// Of a core, while all of them sleep.
double share(const std::deque<Companion>& others) {
  const auto used = [&] {
    std::chrono::nanoseconds all{0};
    for (const Companion& other : others) all += other.cpu_time();
    return all;
  };
  const auto before = used();
  const auto start = Clock::now();
  std::this_thread::sleep_for(kWatched);
  const std::chrono::duration<double> cost = used() - before;
  return cost / std::chrono::duration<double>(Clock::now() - start);
}

/// The median time of a push that wakes all of them.
double push_us() {
  lot::ShmEngine engine(segment());
  auto out = engine.advertise<Ball>("/idle");
  std::vector<double> times;
  for (std::uint64_t n = 0; n < kWakes; ++n) {
    std::this_thread::sleep_for(kAsleep);
    auto ball = out.loan();
    ball->fill(n);
    const auto start = Clock::now();
    expect(out.push(std::move(ball)) == lot::Status::Ok, "push");
    times.push_back(std::chrono::duration<double, std::micro>(Clock::now() - start).count());
  }
  std::nth_element(times.begin(), times.begin() + kWakes / 2, times.end());
  return times[kWakes / 2];
}

void idle(benchmark::State& state) {
  const auto count = static_cast<std::size_t>(state.range(0));
  std::deque<Companion> others;
  for (std::size_t i = 0; i < count; ++i) {
    others.emplace_back([i](Companion& here) { sleep_and_wake(here, i); });
  }
  for (Companion& other : others) other.meet();
  std::this_thread::sleep_for(1s);  // they have fallen asleep
  for ([[maybe_unused]] auto _ : state) {
    state.counters["percent_of_a_core"] = 100 * share(others);
    state.counters["push_us"] = push_us();
  }
}

}  // namespace

BENCHMARK(idle)->Name("idle/processes")->Arg(50)->Arg(250)->Iterations(1)->UseRealTime();

}  // namespace bench
