// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

#include "micro.hpp"

/// What a push costs that wakes readers of its ring, and how long the last of them waits. The
/// readers are threads of a second process, each asleep in a `pull()`. Where there are two cores,
/// they have one and the publisher has the other: a reader that runs holds up no push.
namespace bench {
namespace {

constexpr std::uint64_t kPushes = 300;
constexpr auto kAsleep = 5ms;  ///< after this time all sleep again

struct Board {
  std::atomic<std::int64_t> last{0};  ///< when the last reader had the message
  std::atomic<std::uint64_t> read{0};
};

std::int64_t now() { return Clock::now().time_since_epoch().count(); }

void read_all(lot::ShmEngine& engine, Board& board, std::atomic<std::size_t>& ready) {
  lot::PullerOptions options;
  options.wait = lot::Wait::Park;
  auto in = engine.subscribe<Ball>("/sleepers", options);
  ++ready;
  for (std::uint64_t n = 0; n < kPushes; ++n) {
    const auto ball = in.pull();
    const std::int64_t at = now();
    expect(ball && ball->is(n), "a ball was lost");
    std::int64_t last = board.last;
    while (last < at && !board.last.compare_exchange_weak(last, at)) {
    }
    ++board.read;
  }
}

double median_us(std::vector<double>& times) {
  const auto middle = times.begin() + static_cast<std::ptrdiff_t>(times.size() / 2);
  std::nth_element(times.begin(), middle, times.end());
  return *middle / 1000;
}

void sleepers(benchmark::State& state) {
  const auto count = static_cast<std::size_t>(state.range(0));
  Shared<Board> board;
  Companion other([&](Companion& here) {
    lot::ShmEngine engine(segment());
    here.meet();
    if (cores() > 1) pin(1);
    std::atomic<std::size_t> ready{0};
    std::vector<std::thread> readers;
    for (std::size_t i = 0; i < count; ++i) {
      readers.emplace_back([&] { read_all(engine, *board, ready); });
    }
    while (ready != count) std::this_thread::sleep_for(1ms);
    here.meet();
    for (std::thread& reader : readers) reader.join();
    here.meet();
    while (here.hear() != Companion::kStop) {
    }
  });
  lot::ShmEngine engine(segment());
  auto out = engine.advertise<Ball>("/sleepers");
  other.meet();
  if (cores() > 1) pin(0);
  other.meet();
  std::vector<double> push, last;
  for ([[maybe_unused]] auto _ : state) {
    for (std::uint64_t n = 0; n < kPushes; ++n) {
      std::this_thread::sleep_for(kAsleep);
      auto ball = out.loan();
      ball->fill(n);
      const std::int64_t start = now();
      expect(out.push(std::move(ball)) == lot::Status::Ok, "push");
      push.push_back(static_cast<double>(now() - start));
      while (board->read != (n + 1) * count) std::this_thread::sleep_for(1ms);
      if (count != 0) last.push_back(static_cast<double>(board->last - start));
    }
  }
  other.meet();
  unpin();
  state.counters["push_us"] = median_us(push);
  if (count != 0) state.counters["last_us"] = median_us(last);
}

}  // namespace

BENCHMARK(sleepers)
    ->Name("sleepers/push")
    ->Arg(0)
    ->Arg(1)
    ->Arg(2)
    ->Arg(5)
    ->Arg(250)
    ->Iterations(1)
    ->UseRealTime();

}  // namespace bench
