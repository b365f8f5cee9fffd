// SPDX-License-Identifier: Apache-2.0
#include "micro.hpp"

/// 64-byte messages from one process to another, none lost, every one checked; beside it a queue
/// that protects nothing.
namespace bench {
namespace {

/// Short enough that most blocks see no other process on their cores.
constexpr std::uint64_t kMessages = 20'000;
constexpr std::uint64_t kFloor = 1;
constexpr std::uint64_t kArm = 2;

template <class Receive>
void stream(benchmark::State& state, bool fast_lane, Receive receive) {
  if (!needs_two_cores(state)) return;
  const Shared<BareQueue> bare;
  const Shared<Line> done;  // blocks that the reader has read
  Companion other([&](Companion& here) {
    lot::ShmEngine engine(segment());
    here.meet();  // the topic is there
    auto in = engine.subscribe<Ball>("/stream");
    here.meet();
    pin(1);
    std::uint64_t floor_ball = 0;
    std::uint64_t ball = 0;
    const auto read_bare = [&] {
      bare->receive(floor_ball, kMessages);
      floor_ball += kMessages;
    };
    const auto read_block = [&] {
      const auto until = Clock::now() + 60s;
      for (std::uint64_t i = 0; i < kMessages; ++i, ++ball) {
        const auto seen = receive(in, until);
        expect(seen && seen->is(ball), "a message was lost");
      }
      expect(in.missed_total() == 0, "messages were missed");
    };
    for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
      order == kFloor ? read_bare() : read_block();
      done->value.fetch_add(1, std::memory_order_release);
    }
  });
  lot::ShmEngine engine(segment());
  lot::PusherOptions options;
  options.policy = lot::Policy::Block;
  options.fast_lane = fast_lane;
  auto out = engine.advertise<Ball>("/stream", options);
  other.meet();
  other.meet();
  pin(0);
  std::uint64_t floor_ball = 0;
  std::uint64_t ball = 0;
  std::uint64_t blocks = 0;
  const auto await_reader = [&] {
    ++blocks;
    while (done->value.load(std::memory_order_acquire) != blocks) spin();
  };
  Rounds rounds;
  const auto arm_block = [&] {
    other.tell(kArm);
    const double ns = time_ns(kMessages, [&] {
      for (std::uint64_t i = 0; i < kMessages; ++i, ++ball) {
        auto message = out.loan();
        message->fill(ball);
        expect(out.push(std::move(message)) == lot::Status::Ok, "push");
      }
      await_reader();
    });
    other.meet();
    return ns;
  };
  const auto floor_block = [&] {
    other.tell(kFloor);
    const double ns = time_ns(kMessages, [&] {
      bare->send(floor_ball, kMessages);
      floor_ball += kMessages;
      await_reader();
    });
    other.meet();
    return ns;
  };
  for ([[maybe_unused]] auto _ : state) rounds.run(arm_block, floor_block);
  rounds.report_rate(state);
}

void borrowed(benchmark::State& state, bool fast_lane) {
  stream(state, fast_lane,
         [](auto& in, Clock::time_point until) { return in.borrow_until(until); });
}
void kept(benchmark::State& state, bool fast_lane) {
  stream(state, fast_lane, [](auto& in, Clock::time_point until) { return in.pull_until(until); });
}

}  // namespace

BENCHMARK_CAPTURE(borrowed, , false)->Name("throughput/borrowed")->UseRealTime();
BENCHMARK_CAPTURE(kept, , false)->Name("throughput/kept")->UseRealTime();
BENCHMARK_CAPTURE(borrowed, , true)->Name("throughput/slot/borrowed")->UseRealTime();
BENCHMARK_CAPTURE(kept, , true)->Name("throughput/slot/kept")->UseRealTime();

}  // namespace bench
