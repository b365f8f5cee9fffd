// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <filesystem>
#include <iterator>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "micro.hpp"

/// What a wake-up costs that one thread gets from one of many topics (docs/ear.md): a WaitSet over
/// 1000 topics beside one over 10, in another process. Where there are two cores, that process has
/// one and the publisher has the other.
namespace bench {
namespace {

constexpr std::uint64_t kFew = 10;
constexpr std::uint64_t kMany = 1000;
constexpr std::uint64_t kPushes = 50;  ///< in one block
constexpr auto kAsleep = 1ms;          ///< after this time the other process sleeps again

struct Board {
  std::atomic<std::int64_t> at{0};  ///< when the handler was called last
  std::atomic<std::uint64_t> heard{0};
  std::atomic<std::size_t> threads{0};
};

std::string topic(std::uint64_t n) { return "/topics/" + std::to_string(n); }
std::int64_t now() { return Clock::now().time_since_epoch().count(); }
std::size_t threads_of(const std::string& process) {
  const std::filesystem::directory_iterator all("/proc/" + process + "/task");
  return static_cast<std::size_t>(std::distance(begin(all), end(all)));
}

std::vector<lot::ShmPuller<Ball>> subscribe(lot::ShmEngine& engine, std::uint64_t count) {
  std::vector<lot::ShmPuller<Ball>> pullers;
  for (std::uint64_t n = 0; n < count; ++n) {
    pullers.push_back(engine.subscribe<Ball>(topic(n), {lot::Wait::Park, 0}));
  }
  return pullers;
}

/// Topics 0 to 9 are in both sets: a run has pullers of its own.
void listen(lot::ShmEngine& engine, Companion& here, Board& board) {
  for (std::uint64_t order; (order = here.hear()) != Companion::kStop;) {
    auto pullers = subscribe(engine, order);
    lot::WaitSet set;
    for (auto& puller : pullers) {
      set.add(puller, [&board, &puller] {
        while (puller.try_pull()) {
          board.at = now();
          ++board.heard;
        }
      });
    }
    const std::uint64_t all = board.heard + 2 * kPushes;
    set.run_once(1ms);
    here.meet();
    while (board.heard < all) {
      set.run_once(1s);
      if (board.heard == all - 1) board.threads = threads_of("self");
    }
    for (auto& puller : pullers) set.remove(puller);
    here.meet();
  }
}

struct Block {
  double latency_ns;
  double cpu_ns;
  std::size_t threads;  ///< of the other process, as it is woken
};

class Topics {
 public:
  Topics()
      : other_([this](Companion& here) {
          lot::ShmEngine engine(segment());
          if (cores() > 1) pin(1);
          listen(engine, here, *board_);
        }),
        engine_(segment()) {
    for (std::uint64_t n = 0; n < kMany; ++n) {
      out_.push_back(engine_.advertise<Ball>(topic(n), {lot::Policy::Overwrite, 4}));
    }
    if (cores() > 1) pin(0);
  }
  ~Topics() { unpin(); }
  Topics(const Topics&) = delete;
  Topics& operator=(const Topics&) = delete;

  /// The first half of the pushes warms up.
  Block play(std::uint64_t topics) {
    other_.tell(topics);
    other_.meet();
    push(topics);
    const auto before = other_.cpu_time();
    const double latency = push(topics);
    const std::chrono::duration<double, std::nano> cpu = other_.cpu_time() - before;
    other_.meet();
    return {latency, cpu.count() / kPushes, board_->threads};
  }

 private:
  /// The median time from before a push to the handler.
  double push(std::uint64_t topics) {
    std::vector<double> times;
    std::uniform_int_distribution<std::uint64_t> any(0, topics - 1);
    for (std::uint64_t n = 0; n < kPushes; ++n) {
      std::this_thread::sleep_for(kAsleep);
      auto& out = out_[any(random_)];
      auto ball = out.loan();
      const std::uint64_t heard = board_->heard;
      const std::int64_t start = now();
      expect(out.push(std::move(ball)) == lot::Status::Ok, "push");
      while (board_->heard == heard) std::this_thread::sleep_for(100us);
      times.push_back(static_cast<double>(board_->at - start));
    }
    const auto middle = times.begin() + static_cast<std::ptrdiff_t>(times.size() / 2);
    std::nth_element(times.begin(), middle, times.end());
    return *middle;
  }

  Shared<Board> board_;
  Companion other_;
  lot::ShmEngine engine_;
  std::vector<lot::ShmPusher<Ball>> out_;
  std::mt19937_64 random_{1};
};

void wake(benchmark::State& state) {
  Topics topics;
  Rounds latency, cpu;
  Block many{}, few{};
  for ([[maybe_unused]] auto _ : state) {
    latency.run([&] { return (many = topics.play(kMany)).latency_ns; },
                [&] { return (few = topics.play(kFew)).latency_ns; });
    cpu.run([&] { return many.cpu_ns; }, [&] { return few.cpu_ns; });
  }
  cpu.report(state);
  for (const char* name : {"ratio", "lo", "hi", "arm_ns", "floor_ns"}) {
    state.counters[std::string("cpu_") + name] = state.counters[name];
  }
  latency.report(state);
  state.counters["threads"] = static_cast<double>(many.threads);
  state.counters["threads_of_few"] = static_cast<double>(few.threads);
}

/// Threads that fd() of 1000 pullers costs.
void descriptors(benchmark::State& state) {
  lot::ShmEngine engine(segment());
  std::size_t more = 0;
  for ([[maybe_unused]] auto _ : state) {
    auto pullers = subscribe(engine, kMany);
    const std::size_t before = threads_of("self");
    for (auto& puller : pullers) expect(puller.fd() >= 0, "fd()");
    more = threads_of("self") - before;
  }
  state.counters["threads"] = static_cast<double>(more);
}

}  // namespace

BENCHMARK(descriptors)->Name("topics/descriptors")->Iterations(1)->UseRealTime();
BENCHMARK(wake)->Name("topics/wake")->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace bench
