// SPDX-License-Identifier: Apache-2.0
#include "micro.hpp"

/// What making a message costs: loan and reset, beside std::make_shared and reset.
namespace bench {
namespace {

struct Bytes {
  std::uint8_t bytes[128];
};

/// Nanoseconds of a loan and its end.
double small(lot::ShmPusher<Bytes>& out, std::uint64_t count) {
  return time_ns(count, [&] {
    for (std::uint64_t n = 0; n < count; ++n) {
      auto p = out.loan();
      benchmark::DoNotOptimize(p.get());
      p.reset();
    }
  });
}

double large(lot::ShmPusher<Frame>& out, std::uint64_t count) {
  return time_ns(count, [&] {
    for (std::uint64_t n = 0; n < count; ++n) {
      auto p = out.loan();
      p->data.resize(16 << 20);
      p->data[8 << 20] = static_cast<std::uint8_t>(n);
      benchmark::DoNotOptimize(p->data.data());
      p.reset();
    }
  });
}

constexpr std::uint64_t kCount = 5'000;

template <class T>
void alone(benchmark::State& state, double (*arm)(lot::ShmPusher<T>&, std::uint64_t)) {
  pin(0);
  {
    lot::ShmEngine engine(segment());
    auto out = engine.advertise<T>("/loan");
    arm(out, 100);
    Rounds rounds;
    for ([[maybe_unused]] auto _ : state) {
      rounds.run([&] { return arm(out, kCount); }, [&] { return make_shared(kCount); });
    }
    rounds.report(state);
  }
  unpin();
}

/// Two processes at it at once, beside one while the other sleeps.
template <class T>
void together(benchmark::State& state, double (*arm)(lot::ShmPusher<T>&, std::uint64_t)) {
  if (!needs_two_cores(state)) return;
  const Shared<std::atomic<bool>> go_on;
  Companion other([&](Companion& here) {
    lot::ShmEngine engine(segment());
    auto out = engine.advertise<T>("/loan");
    pin(1);
    for (; here.hear() != Companion::kStop; here.meet()) {
      while (go_on->load(std::memory_order_relaxed)) arm(out, 100);
    }
  });
  lot::ShmEngine engine(segment());
  auto out = engine.advertise<T>("/loan");
  pin(0);
  arm(out, 100);
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    rounds.run(
        [&] {
          go_on->store(true, std::memory_order_relaxed);
          other.tell(1);
          const double ns = arm(out, kCount);
          go_on->store(false, std::memory_order_relaxed);
          other.meet();
          return ns;
        },
        [&] { return arm(out, kCount); });
  }
  rounds.report(state);
}

}  // namespace

BENCHMARK_CAPTURE(alone, , &small)->Name("loan/128B")->UseRealTime();
BENCHMARK_CAPTURE(alone, , &large)->Name("loan/16MiB")->UseRealTime();
BENCHMARK_CAPTURE(together, , &small)->Name("loan/128B/two_processes")->UseRealTime();
BENCHMARK_CAPTURE(together, , &large)->Name("loan/16MiB/two_processes")->UseRealTime();

}  // namespace bench
