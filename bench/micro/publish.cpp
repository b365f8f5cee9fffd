// SPDX-License-Identifier: Apache-2.0
#include "micro.hpp"

/// What a push costs its caller, the loan not counted and nobody asleep.
namespace bench {
namespace {

constexpr std::uint64_t kBlock = 256;  ///< pushes at a stretch
constexpr std::uint32_t kDepth = 4096;

lot::PusherOptions deep() {
  lot::PusherOptions options;
  options.depth = kDepth;
  return options;
}

/// Nanoseconds of a push.
double push_block(lot::ShmPusher<Ball>& out, std::vector<lot::ShmUniquePtr<Ball>>& balls,
                  std::uint64_t from) {
  balls.clear();
  for (std::uint64_t i = 0; i < kBlock; ++i) {
    balls.push_back(out.loan());
    balls.back()->fill(from + i);
  }
  return time_ns(kBlock, [&] {
    for (auto& ball : balls) expect(out.push(std::move(ball)) == lot::Status::Ok, "push");
  });
}

/// Readers of one topic, in one process. Every tenth keeps a borrow of the newest message.
class Readers {
 public:
  Readers(lot::ShmEngine& engine, const char* topic, std::size_t count) : held_(count) {
    for (std::size_t i = 0; i < count; ++i) in_.push_back(engine.subscribe<Ball>(topic));
  }

  void catch_up(std::uint64_t from) {
    for (std::size_t i = 0; i < in_.size(); ++i) {
      held_[i].end();
      for (std::uint64_t n = 0; n < kBlock; ++n) {
        held_[i].end();
        held_[i] = in_[i].try_borrow();
        expect(held_[i] && held_[i]->is(from + n) && held_[i].missed() == 0, "a ball was lost");
      }
      if (i % 10 != 0) held_[i].end();
    }
  }

 private:
  std::vector<lot::ShmPuller<Ball>> in_;
  std::vector<lot::ShmBorrow<Ball>> held_;  // ends before its puller
};

/// The second process of both benchmarks: reads when told to.
void read(Companion& here, const char* topic, std::size_t readers, const char* second_topic) {
  lot::ShmEngine engine(segment());
  here.meet();
  Readers many(engine, topic, readers);
  Readers one(engine, second_topic, 1);
  here.meet();
  pin(cores() > 1 ? 1 : 0);
  for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
    many.catch_up(order);
    one.catch_up(order);
  }
}

void vs_exchange(benchmark::State& state, bool fast_lane) {
  Companion other([](Companion& here) { read(here, "/one", 1, "/other"); });
  lot::ShmEngine engine(segment());
  lot::PusherOptions options;
  options.fast_lane = fast_lane;
  auto out = engine.advertise<Ball>("/one", options);
  auto unused = engine.advertise<Ball>("/other");
  other.meet();
  other.meet();
  pin(0);
  std::vector<lot::ShmUniquePtr<Ball>> balls;
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    rounds.run([&] { return push_block(out, balls, 1); }, [&] { return exchange(kBlock); });
  }
  rounds.report(state);
}

void readers_250_vs_1(benchmark::State& state) {
  constexpr std::size_t kReaders = 125;  // in each of two processes
  Companion first([](Companion& here) { read(here, "/many", kReaders, "/one"); });
  Companion second([](Companion& here) { read(here, "/many", kReaders, "/unused"); });
  lot::ShmEngine engine(segment());
  auto many = engine.advertise<Ball>("/many", deep());
  auto one = engine.advertise<Ball>("/one", deep());
  auto unused = engine.advertise<Ball>("/unused", deep());
  for (int i = 0; i < 2; ++i) {
    first.meet();
    second.meet();
  }
  expect(many.readers() == 2 * kReaders && one.readers() == 1, "the readers are not there");
  pin(0);
  std::vector<lot::ShmUniquePtr<Ball>> balls;
  std::uint64_t ball = 1;
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    rounds.run([&] { return push_block(many, balls, ball); },
               [&] { return push_block(one, balls, ball); });
    push_block(unused, balls, ball);
    for (Companion* readers : {&first, &second}) {
      readers->tell(ball);
      readers->meet();
    }
    ball += kBlock;
  }
  rounds.report(state);
}

/// Loan and push where the ring has as many slots as the segment has blocks, so that each loan
/// needs the block of the oldest message, beside a ring of 64.
void deep_vs_shallow(benchmark::State& state) {
  constexpr std::uint32_t kBlocks = 16384;
  lot::EngineOptions options = segment();
  options.blocks = kBlocks;
  options.size_bytes = 64 << 20;
  lot::ShmEngine engine(options);
  lot::PusherOptions all;
  all.depth = kBlocks;
  lot::PusherOptions few;
  few.depth = 64;
  const auto arm = [](lot::ShmPusher<Ball>& out) {
    return time_ns(kBlock, [&] {
      for (std::uint64_t i = 0; i < kBlock; ++i) {
        auto ball = out.loan();
        ball->fill(i);
        expect(out.push(std::move(ball)) == lot::Status::Ok, "push");
      }
    });
  };
  pin(0);
  {
    auto shallow = engine.advertise<Ball>("/shallow", few);
    arm(shallow);
    auto deep = engine.advertise<Ball>("/deep", all);
    for (std::uint32_t n = 0; n < 2 * kBlocks; n += kBlock) arm(deep);
    Rounds rounds;
    for ([[maybe_unused]] auto _ : state) {
      rounds.run([&] { return arm(deep); }, [&] { return arm(shallow); });
    }
    rounds.report(state);
  }
  unpin();
}

/// The same with frames of 16 MiB at the default depth, which is more than the segment holds,
/// beside a depth of 8. The frames are not written: what counts is how their memory is found.
void full_vs_roomy(benchmark::State& state) {
  constexpr std::uint64_t kFrames = 16;
  lot::EngineOptions options = segment();
  options.size_bytes = 1 << 30;
  const auto arm = [](lot::ShmPusher<Frame>& out) {
    return time_ns(kFrames, [&] {
      for (std::uint64_t i = 0; i < kFrames; ++i) {
        auto frame = out.loan();
        frame->data.resize(16 << 20);
        expect(out.push(std::move(frame)) == lot::Status::Ok, "push");
      }
    });
  };
  pin(0);
  {
    lot::PusherOptions few;
    few.depth = 8;
    lot::ShmEngine engine(options);
    auto shallow = engine.advertise<Frame>("/roomy", few);
    arm(shallow);
    auto deep = engine.advertise<Frame>("/full");
    for (int n = 0; n < 8; ++n) arm(deep);
    Rounds rounds;
    for ([[maybe_unused]] auto _ : state) {
      rounds.run([&] { return arm(deep); }, [&] { return arm(shallow); });
    }
    rounds.report(state);
  }
  unpin();
}

}  // namespace

BENCHMARK_CAPTURE(vs_exchange, , false)->Name("publish/vs_exchange")->UseRealTime();
BENCHMARK_CAPTURE(vs_exchange, , true)->Name("publish/slot/vs_exchange")->UseRealTime();
BENCHMARK(readers_250_vs_1)->Name("publish/readers_250_vs_1")->UseRealTime();
BENCHMARK(deep_vs_shallow)->Name("publish/deep_vs_shallow")->UseRealTime();
BENCHMARK(full_vs_roomy)->Name("publish/full_vs_roomy")->UseRealTime();

}  // namespace bench
