// SPDX-License-Identifier: Apache-2.0
#include "micro.hpp"
#include "table.hpp"

/// One-way latency: half of a round trip between two processes over two topics.
namespace bench {
namespace {

struct Game {
  Use use;
  lot::Policy policy;
  lot::Wait wait;
  unsigned core;  ///< of the second process
  std::uint64_t trips;
  bool fast_lane = false;
};

constexpr std::uint64_t kFloor = 1;
constexpr std::uint64_t kArm = 2;

/// `floor` and `serve` are the two ends of the bare hand-over on a Floor.
template <class Message = Ball, class Floor>
void play(benchmark::State& state, const Game& game, double (*floor)(Floor&, std::uint64_t),
          void (*serve)(Floor&, std::uint64_t)) {
  if (game.core != 0 && !needs_two_cores(state)) return;
  const Shared<Floor> bare;
  Companion other([&](Companion& here) {
    lot::ShmEngine engine(segment());
    auto end = End<Message>::make(engine, here, false, game.policy, game.wait, game.fast_lane);
    pin(game.core);
    std::uint64_t ball = 0;
    for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
      if (order == kFloor) {
        serve(*bare, game.trips);
        continue;
      }
      for (std::uint64_t i = 0; i < game.trips; ++i, ++ball) {
        receive(end, ball, game.use);
        send(end, ball);
      }
    }
  });
  lot::ShmEngine engine(segment());
  auto end = End<Message>::make(engine, other, true, game.policy, game.wait, game.fast_lane);
  pin(0);
  std::uint64_t ball = 0;
  Rounds rounds;
  const auto arm_block = [&] {
    other.tell(kArm);
    const double ns = time_ns(2 * game.trips, [&] {
      for (std::uint64_t i = 0; i < game.trips; ++i, ++ball) {
        send(end, ball);
        receive(end, ball, game.use);
      }
    });
    other.meet();
    return ns;
  };
  const auto floor_block = [&] {
    other.tell(kFloor);
    const double ns = floor(*bare, game.trips);
    other.meet();
    return ns;
  };
  for ([[maybe_unused]] auto _ : state) rounds.run(arm_block, floor_block);
  rounds.report(state);
}

void hot(benchmark::State& state, Use use, lot::Policy policy) {
  play<>(state, {use, policy, lot::Wait::Spin, 1, 1'000}, cross_lines, serve_lines);
}

/// A message of kWords words, in its slot or in a block.
template <std::uint64_t kWords>
void small(benchmark::State& state, Use use, bool fast_lane) {
  play<BallOf<kWords>>(state, {use, lot::Policy::Overwrite, lot::Wait::Spin, 1, 1'000, fast_lane},
                       cross_lines, serve_lines);
}
void small_48(benchmark::State& state, Use use, bool fast_lane) { small<6>(state, use, fast_lane); }
void small_128(benchmark::State& state, Use use, bool fast_lane) {
  small<16>(state, use, fast_lane);
}

/// The prototype beside a bare line, in the place of LOT.
void one_line(benchmark::State& state) {
  if (!needs_two_cores(state)) return;
  constexpr std::uint64_t kTrips = 1'000;
  const Shared<Lines> lines;
  const Shared<OneLineTable> table;
  Companion other([&](Companion& here) {
    pin(1);
    for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
      order == kFloor ? serve_lines(*lines, kTrips) : serve_one_lines(*table, kTrips);
    }
  });
  pin(0);
  Rounds rounds;
  const auto block = [&](std::uint64_t order) {
    other.tell(order);
    const double ns =
        order == kFloor ? cross_lines(*lines, kTrips) : cross_one_lines(*table, kTrips);
    other.meet();
    return ns;
  };
  for ([[maybe_unused]] auto _ : state) {
    rounds.run([&] { return block(kArm); }, [&] { return block(kFloor); });
  }
  rounds.report(state);
}

void parked(benchmark::State& state, unsigned core) {
  play<>(state, {Use::Borrowed, lot::Policy::Overwrite, lot::Wait::Park, core, 100}, cross_futexes,
         serve_futexes);
}

/// Both ends push the same message again and again, a large one and a small one in turn: what is
/// left is the way, which should not depend on the size.
void big(benchmark::State& state) {
  if (!needs_two_cores(state)) return;
  constexpr std::uint64_t kTrips = 1'000;
  constexpr std::size_t kBytes[] = {128, 16 << 20};
  const auto build = [](lot::ShmEngine& engine, std::size_t bytes) {
    auto frame = engine.make<Frame>();
    frame->data.resize(bytes);
    for (std::size_t i = 0; i < kLine; ++i) frame->data[bytes - 1 - i] = 7;
    return lot::ShmSharedPtr<const Frame>(std::move(frame));
  };
  const auto send_frame = [](End<Frame>& end, const lot::ShmSharedPtr<const Frame>& frame) {
    expect(end.out.push(frame) == lot::Status::Ok, "push");
  };
  const auto receive_frame = [](End<Frame>& end, std::size_t bytes) {
    const auto frame = end.in.borrow(10s);
    expect(frame && frame->data.size() == bytes, "a frame was lost");
    unsigned sum = 0;
    for (std::size_t i = 0; i < kLine; ++i) sum += frame->data[bytes - 1 - i];
    expect(sum == 7 * kLine, "a frame was damaged");
  };
  const auto make_end = [](lot::ShmEngine& engine, Companion& other, bool first) {
    return End<Frame>::make(engine, other, first, lot::Policy::Overwrite, lot::Wait::Spin);
  };
  Companion other([&](Companion& here) {
    lot::ShmEngine engine(segment());
    auto end = make_end(engine, here, false);
    const lot::ShmSharedPtr<const Frame> frames[] = {build(engine, kBytes[0]),
                                                     build(engine, kBytes[1])};
    pin(1);
    for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
      for (std::uint64_t i = 0; i < kTrips; ++i) {
        receive_frame(end, kBytes[order - 1]);
        send_frame(end, frames[order - 1]);
      }
    }
  });
  lot::ShmEngine engine(segment());
  auto end = make_end(engine, other, true);
  const lot::ShmSharedPtr<const Frame> frames[] = {build(engine, kBytes[0]),
                                                   build(engine, kBytes[1])};
  pin(0);
  Rounds rounds;
  const auto block = [&](std::uint64_t order) {
    other.tell(order);
    const double ns = time_ns(2 * kTrips, [&] {
      for (std::uint64_t i = 0; i < kTrips; ++i) {
        send_frame(end, frames[order - 1]);
        receive_frame(end, kBytes[order - 1]);
      }
    });
    other.meet();
    return ns;
  };
  for ([[maybe_unused]] auto _ : state) {
    rounds.run([&] { return block(2); }, [&] { return block(1); });
  }
  rounds.report(state);
}

}  // namespace

BENCHMARK_CAPTURE(hot, , Use::Borrowed, lot::Policy::Overwrite)
    ->Name("latency/borrowed/overwrite")
    ->UseRealTime();
BENCHMARK_CAPTURE(hot, , Use::Borrowed, lot::Policy::Block)
    ->Name("latency/borrowed/block")
    ->UseRealTime();
BENCHMARK_CAPTURE(hot, , Use::Kept, lot::Policy::Overwrite)
    ->Name("latency/kept/overwrite")
    ->UseRealTime();
BENCHMARK_CAPTURE(hot, , Use::Kept, lot::Policy::Block)->Name("latency/kept/block")->UseRealTime();
BENCHMARK_CAPTURE(small_48, , Use::Borrowed, false)
    ->Name("latency/48B/block/borrowed")
    ->UseRealTime();
BENCHMARK_CAPTURE(small_48, , Use::Borrowed, true)
    ->Name("latency/48B/slot/borrowed")
    ->UseRealTime();
BENCHMARK_CAPTURE(small_48, , Use::Kept, false)->Name("latency/48B/block/kept")->UseRealTime();
BENCHMARK_CAPTURE(small_48, , Use::Kept, true)->Name("latency/48B/slot/kept")->UseRealTime();
BENCHMARK(one_line)->Name("latency/48B/one_line")->UseRealTime();
BENCHMARK_CAPTURE(small_128, , Use::Borrowed, false)
    ->Name("latency/128B/block/borrowed")
    ->UseRealTime();
BENCHMARK_CAPTURE(small_128, , Use::Borrowed, true)
    ->Name("latency/128B/slot/borrowed")
    ->UseRealTime();
BENCHMARK_CAPTURE(small_128, , Use::Kept, false)->Name("latency/128B/block/kept")->UseRealTime();
BENCHMARK_CAPTURE(small_128, , Use::Kept, true)->Name("latency/128B/slot/kept")->UseRealTime();
BENCHMARK(big)->Name("latency/16MiB_vs_128B")->UseRealTime();
BENCHMARK_CAPTURE(parked, , 0)->Name("latency/parked/one_core")->UseRealTime();
BENCHMARK_CAPTURE(parked, , 1)->Name("latency/parked/across")->UseRealTime();

}  // namespace bench
