// SPDX-License-Identifier: Apache-2.0
#include <type_traits>

#include "micro.hpp"

/// 64-byte messages from one process to another, none lost, every one checked; beside them a queue
/// that protects nothing, or where they travel in slots, a ring of one line a message.
namespace bench {
namespace {

/// Short enough that most blocks see no other process on their cores.
constexpr std::uint64_t kMessages = 20'000;
constexpr std::uint64_t kFloor = 1;
constexpr std::uint64_t kArm = 2;

template <class Floor, class Receive>
void stream(benchmark::State& state, Receive receive) {
  constexpr bool kFastLane = std::is_same_v<Floor, OneLineRing>;
  if (!needs_two_cores(state)) return;
  const Shared<Floor> bare;
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
  options.fast_lane = kFastLane;
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
  kFastLane ? rounds.report_with_rate(state) : rounds.report_rate(state);
}

template <class Floor>
void borrowed(benchmark::State& state) {
  stream<Floor>(state, [](auto& in, Clock::time_point until) { return in.borrow_until(until); });
}
template <class Floor>
void kept(benchmark::State& state) {
  stream<Floor>(state, [](auto& in, Clock::time_point until) { return in.pull_until(until); });
}

}  // namespace

BENCHMARK(borrowed<BareQueue>)->Name("throughput/borrowed")->UseRealTime();
BENCHMARK(kept<BareQueue>)->Name("throughput/kept")->UseRealTime();
BENCHMARK(borrowed<OneLineRing>)->Name("throughput/slot/borrowed")->UseRealTime();
BENCHMARK(kept<OneLineRing>)->Name("throughput/slot/kept")->UseRealTime();

}  // namespace bench
