// SPDX-License-Identifier: Apache-2.0
#include "own_loop.hpp"

/// A caller's own loop beside the one of latency.cpp: the headers are compiled with the caller's
/// options, and into his code.
namespace bench {
namespace {

constexpr std::uint64_t kTrips = 1'000;
constexpr std::uint64_t kOurs = 1;
constexpr std::uint64_t kTheirs = 2;

void own_loop(benchmark::State& state, MakeOwnLoop* make, Use use) {
  if (!needs_two_cores(state)) return;
  const auto table = [](lot::ShmEngine& engine, Companion& other, bool first) {
    return End<Ball>::make(engine, other, first, lot::Policy::Overwrite, lot::Wait::Spin);
  };
  Companion other([&](Companion& here) {
    lot::ShmEngine engine(segment());
    auto ours = table(engine, here, false);
    const auto theirs = make(engine, here, false, use);
    pin(1);
    std::uint64_t ball = 0;
    for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
      if (order == kTheirs) {
        theirs->play(false, kTrips);
        continue;
      }
      for (std::uint64_t i = 0; i < kTrips; ++i, ++ball) {
        receive(ours, ball, use);
        send(ours, ball);
      }
    }
  });
  lot::ShmEngine engine(segment());
  auto ours = table(engine, other, true);
  const auto theirs = make(engine, other, true, use);
  pin(0);
  std::uint64_t ball = 0;
  Rounds rounds;
  const auto their_block = [&] {
    other.tell(kTheirs);
    const double ns = time_ns(2 * kTrips, [&] { theirs->play(true, kTrips); });
    other.meet();
    return ns;
  };
  const auto our_block = [&] {
    other.tell(kOurs);
    const double ns = time_ns(2 * kTrips, [&] {
      for (std::uint64_t i = 0; i < kTrips; ++i, ++ball) {
        send(ours, ball);
        receive(ours, ball, use);
      }
    });
    other.meet();
    return ns;
  };
  for ([[maybe_unused]] auto _ : state) rounds.run(their_block, our_block);
  rounds.report(state);
}

}  // namespace

BENCHMARK_CAPTURE(own_loop, , own_loop_o1, Use::Borrowed)
    ->Name("own_loop/borrowed/O1")
    ->UseRealTime();
BENCHMARK_CAPTURE(own_loop, , own_loop_o2, Use::Borrowed)
    ->Name("own_loop/borrowed/O2")
    ->UseRealTime();
BENCHMARK_CAPTURE(own_loop, , own_loop_o3, Use::Borrowed)
    ->Name("own_loop/borrowed/O3")
    ->UseRealTime();
BENCHMARK_CAPTURE(own_loop, , own_loop_o3_words, Use::Borrowed)
    ->Name("own_loop/borrowed/O3_words")
    ->UseRealTime();
BENCHMARK_CAPTURE(own_loop, , own_loop_o1, Use::Kept)->Name("own_loop/kept/O1")->UseRealTime();
BENCHMARK_CAPTURE(own_loop, , own_loop_o2, Use::Kept)->Name("own_loop/kept/O2")->UseRealTime();
BENCHMARK_CAPTURE(own_loop, , own_loop_o3, Use::Kept)->Name("own_loop/kept/O3")->UseRealTime();

}  // namespace bench
