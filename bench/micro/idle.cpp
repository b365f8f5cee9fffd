// SPDX-License-Identifier: Apache-2.0
#include <deque>
#include <thread>

#include "micro.hpp"

/// What processes cost that have nothing to do: each has a publisher, and sleeps in a `pull()`
/// without a time limit.
namespace bench {
namespace {

constexpr auto kWatched = 4s;

std::string topic(std::size_t process) { return "/idle/" + std::to_string(process % 10); }

void idle(benchmark::State& state) {
  const auto count = static_cast<std::size_t>(state.range(0));
  std::deque<Companion> others;
  for (std::size_t i = 0; i < count; ++i) {
    others.emplace_back([i](Companion& here) {
      lot::ShmEngine engine(segment());
      const auto out = engine.advertise<Ball>("/quiet/" + std::to_string(i % 10));
      auto in = engine.subscribe<Ball>(topic(i));
      here.meet();
      const auto ball = in.pull();
      expect(ball && ball->is(0), "the last ball was lost");
      while (here.hear() != Companion::kStop) {
      }
    });
  }
  for (Companion& other : others) other.meet();
  const auto used = [&] {
    std::chrono::nanoseconds all{0};
    for (const Companion& other : others) all += other.cpu_time();
    return all;
  };
  for ([[maybe_unused]] auto _ : state) {
    std::this_thread::sleep_for(1s);  // they have fallen asleep
    const auto before = used();
    const auto start = Clock::now();
    std::this_thread::sleep_for(kWatched);
    const auto cost = used() - before;
    const auto took = std::chrono::duration<double>(Clock::now() - start);
    state.counters["percent_of_a_core"] = 100 * std::chrono::duration<double>(cost) / took;
  }
  lot::ShmEngine engine(segment());
  for (std::size_t i = 0; i < std::min<std::size_t>(count, 10); ++i) {
    auto out = engine.advertise<Ball>(topic(i));
    auto ball = out.loan();
    ball->fill(0);
    expect(out.push(std::move(ball)) == lot::Status::Ok, "push");
  }
}

}  // namespace

BENCHMARK(idle)->Name("idle/processes")->Arg(1)->Arg(50)->Arg(300)->Iterations(1)->UseRealTime();

}  // namespace bench
