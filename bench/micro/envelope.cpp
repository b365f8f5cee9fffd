// SPDX-License-Identifier: Apache-2.0
#include "micro.hpp"

/// What an envelope costs where it is asked for: the publisher that stamps, beside one that does
/// not; the reader that asks, beside one that does not. In one process, all lines warm.
namespace bench {
namespace {

constexpr std::uint64_t kBlock = 256;  ///< messages at a stretch

lot::PusherOptions deep(bool stamp) {
  lot::PusherOptions options;
  options.depth = 2 * kBlock;
  options.stamp = stamp;
  return options;
}

/// Nanoseconds of a loan and a push.
double push_block(lot::ShmPusher<Ball>& out) {
  return time_ns(kBlock, [&] {
    for (std::uint64_t n = 0; n < kBlock; ++n) {
      auto ball = out.loan();
      ball->fill(n);
      expect(out.push(std::move(ball)) == lot::Status::Ok, "push");
    }
  });
}

void stamped_vs_plain(benchmark::State& state) {
  pin(0);
  {
    lot::ShmEngine engine(segment());
    auto stamped = engine.advertise<Ball>("/stamped", deep(true));
    auto plain = engine.advertise<Ball>("/plain", deep(false));
    Rounds rounds;
    for ([[maybe_unused]] auto _ : state) {
      rounds.run([&] { return push_block(stamped); }, [&] { return push_block(plain); });
    }
    rounds.report(state);
  }
  unpin();
}

/// Nanoseconds of a borrow and its end, with its envelope or without.
double borrow_block(lot::ShmPuller<Ball>& in, bool asks) {
  return time_ns(kBlock, [&] {
    for (std::uint64_t n = 0; n < kBlock; ++n) {
      const auto ball = in.try_borrow();
      expect(ball && ball->is(n), "a ball was lost");
      if (!asks) continue;
      const lot::Envelope envelope = ball.envelope();
      expect(envelope.pushed.has_value() && !envelope.publisher.empty(), "an envelope is empty");
    }
  });
}

void asked_vs_not(benchmark::State& state) {
  pin(0);
  {
    lot::ShmEngine engine(segment());
    auto out = engine.advertise<Ball>("/stamped", deep(true));
    auto asks = engine.subscribe<Ball>("/stamped");
    auto does_not = engine.subscribe<Ball>("/stamped");
    Rounds rounds;
    for ([[maybe_unused]] auto _ : state) {
      push_block(out);
      rounds.run([&] { return borrow_block(asks, true); },
                 [&] { return borrow_block(does_not, false); });
    }
    rounds.report(state);
  }
  unpin();
}

}  // namespace

BENCHMARK(stamped_vs_plain)->Name("envelope/stamped_vs_plain")->UseRealTime();
BENCHMARK(asked_vs_not)->Name("envelope/asked_vs_not")->UseRealTime();

}  // namespace bench
