// SPDX-License-Identifier: Apache-2.0
#include "micro.hpp"

/// A call to a service in another process: half of the way there and back, as in latency.cpp.
namespace bench {
namespace {

constexpr std::uint64_t kFloor = 1;
constexpr std::uint64_t kArm = 2;

/// `floor` and `serve` are the two ends of the bare hand-over on a Floor.
template <class Floor>
void call(benchmark::State& state, lot::Wait wait, std::uint64_t trips,
          double (*floor)(Floor&, std::uint64_t), void (*serve)(Floor&, std::uint64_t)) {
  if (!needs_two_cores(state)) return;
  const Shared<Floor> bare;
  Companion other([&](Companion& here) {
    pin(1);  // the server's thread, too
    lot::ShmEngine engine(segment());
    lot::ServerOptions options;
    options.wait = wait;
    const auto server = engine.serve<Ball, Ball>(
        "echo", [](const Ball& request, Ball& response) { response = request; }, options);
    here.meet();
    for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
      if (order == kFloor) serve(*bare, trips);
    }
  });
  lot::ShmEngine engine(segment());
  lot::ClientOptions options;
  options.wait = wait;
  auto client = engine.client<Ball, Ball>("echo", options);
  pin(0);
  other.meet();
  std::uint64_t n = 0;
  Rounds rounds;
  const auto arm_block = [&] {
    other.tell(kArm);
    const double ns = time_ns(2 * trips, [&] {
      for (std::uint64_t i = 0; i < trips; ++i, ++n) {
        auto request = client.loan();
        request->fill(n);
        const auto answer = client.call(std::move(request), 10s);
        expect(answer && answer->is(n), "a call was lost");
      }
    });
    other.meet();
    return ns;
  };
  const auto floor_block = [&] {
    other.tell(kFloor);
    const double ns = floor(*bare, trips);
    other.meet();
    return ns;
  };
  for ([[maybe_unused]] auto _ : state) rounds.run(arm_block, floor_block);
  rounds.report(state);
}

void awake(benchmark::State& state) {
  call<Lines>(state, lot::Wait::Adaptive, 1'000, cross_lines, serve_lines);
}
void parked(benchmark::State& state) {
  call<Futexes>(state, lot::Wait::Park, 100, cross_futexes, serve_futexes);
}

}  // namespace

BENCHMARK(awake)->Name("service/awake")->UseRealTime();
BENCHMARK(parked)->Name("service/parked")->UseRealTime();

}  // namespace bench
