// SPDX-License-Identifier: Apache-2.0
#include <cstring>
#include <optional>
#include <thread>
#include <vector>

#include "micro.hpp"

/// What the first frames of a publisher cost, of 16 MiB, from loan() to the last byte written,
/// beside memcpy of as much into memory that is warm. Each round has a new segment, so that its
/// memory is new, too.
namespace bench {
namespace {

constexpr std::size_t kBytes = 16 << 20;
constexpr int kRounds = 15;
/// Between two frames, as of a camera.
constexpr auto kPeriod = 33ms;

lot::EngineOptions fresh() {
  lot::EngineOptions options = segment();
  options.size_bytes = 256 << 20;
  return options;
}

class Source {
 public:
  Source() : from_(kBytes, 1), to_(kBytes, 2) {}
  double copy() {
    return time_ns(1, [&] { std::memcpy(to_.data(), from_.data(), kBytes); });
  }
  double frame(lot::ShmPusher<Frame>& out) const {
    std::optional<lot::ShmUniquePtr<Frame>> frame;
    const double ns = time_ns(1, [&] {
      frame.emplace(out.loan());
      (*frame)->data.resize(kBytes);
      std::memcpy((*frame)->data.data(), from_.data(), kBytes);
    });
    expect(out.push(std::move(*frame)) == lot::Status::Ok, "push");
    return ns;
  }

 private:
  std::vector<std::uint8_t> from_;
  std::vector<std::uint8_t> to_;
};

/// Of one publisher: `before` frames at 30 Hz, and the next one is timed.
void nth(benchmark::State& state, int before, bool reserves) {
  Source source;
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    lot::ShmEngine engine(fresh());
    auto out = engine.advertise<Frame>("/first");
    if (reserves) out.reserve(static_cast<std::size_t>(before) + 1, kBytes);
    for (int i = 0; i < before; ++i) {
      source.frame(out);
      std::this_thread::sleep_for(kPeriod);
    }
    source.copy();
    rounds.run([&] { return source.frame(out); }, [&] { return source.copy(); });
  }
  rounds.report(state);
}

/// The first frame, in memory that another process has used before.
void used(benchmark::State& state) {
  Companion other([](Companion& here) {
    Source source;
    std::optional<lot::ShmEngine> engine;
    for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
      engine.reset();
      if (order != 1) continue;
      engine.emplace(fresh());
      lot::PusherOptions two;
      two.depth = 2;
      auto out = engine->advertise<Frame>("/before", two);
      for (int i = 0; i < 4; ++i) source.frame(out);
    }
  });
  Source source;
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    other.tell(1);
    other.meet();
    {
      lot::ShmEngine engine(fresh());
      auto out = engine.advertise<Frame>("/first");
      source.copy();
      rounds.run([&] { return source.frame(out); }, [&] { return source.copy(); });
    }
    other.tell(2);
    other.meet();
  }
  rounds.report(state);
}

/// What a reader takes to read a frame in a block that it has never looked at, beside one in a
/// block that it knows.
void first_look(benchmark::State& state) {
  constexpr std::uint64_t kJoin = 1;
  constexpr std::uint64_t kRead = 2;
  constexpr std::uint64_t kLeave = 3;
  constexpr int kBlocks = 4;  // more than the ring and the loan have
  const Shared<std::atomic<double>> took;
  Companion reader([&](Companion& here) {
    std::optional<lot::ShmEngine> engine;
    std::optional<lot::ShmPuller<Frame>> in;
    for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
      if (order == kJoin) {
        engine.emplace(fresh());
        in.emplace(engine->subscribe<Frame>("/first"));
      } else if (order == kRead) {
        const auto frame = in->try_pull();
        expect(static_cast<bool>(frame), "a frame");
        std::uint64_t sum = 0;
        *took = time_ns(1, [&] {
          for (std::size_t i = 0; i < kBytes; i += kLine) sum += frame->data[i];
        });
        expect(sum == kBytes / kLine, "the frame's bytes");
      } else {
        in.reset();
        engine.reset();
      }
    }
  });
  Source source;
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    lot::ShmEngine engine(fresh());
    lot::PusherOptions two;
    two.depth = 2;
    auto out = engine.advertise<Frame>("/first", two);
    const auto read = [&] {
      source.frame(out);
      reader.tell(kRead);
      reader.meet();
      return took->load();
    };
    reader.tell(kJoin);
    reader.meet();
    const double first = read();
    for (int i = 0; i < kBlocks; ++i) read();
    const double known = read();
    rounds.run([&] { return first; }, [&] { return known; });
    reader.tell(kLeave);
    reader.meet();
  }
  rounds.report(state);
}

}  // namespace

BENCHMARK_CAPTURE(nth, , 0, false)->Name("first_frame/first")->Iterations(kRounds);
BENCHMARK_CAPTURE(nth, , 1, false)->Name("first_frame/second")->Iterations(kRounds);
BENCHMARK_CAPTURE(nth, , 5, false)->Name("first_frame/sixth")->Iterations(kRounds);
BENCHMARK_CAPTURE(nth, , 0, true)->Name("first_frame/reserved")->Iterations(kRounds);
BENCHMARK(used)->Name("first_frame/used_before")->Iterations(kRounds);
BENCHMARK(first_look)->Name("first_frame/first_look")->Iterations(kRounds);

}  // namespace bench
