// SPDX-License-Identifier: Apache-2.0
#include <memory>
#include <unistd.h>

#include <boost/interprocess/managed_shared_memory.hpp>
#include <boost/interprocess/smart_ptr/shared_ptr.hpp>

#include "micro.hpp"

/// What a copy of a pointer and its end cost.
namespace bench {
namespace {

namespace ipc = boost::interprocess;

constexpr std::uint64_t kCount = 50'000;

template <class Pointer>
double copies(const Pointer& p, std::uint64_t count) {
  return time_ns(count, [&] {
    for (std::uint64_t n = 0; n < count; ++n) {
      const Pointer copy = p;
      benchmark::DoNotOptimize(copy.get());
    }
  });
}

void vs_std(benchmark::State& state) {
  pin(0);
  {
    lot::ShmEngine engine(segment());
    const lot::ShmSharedPtr<Ball> ours(engine.make<Ball>());
    const auto standard = std::make_shared<Ball>();
    Rounds rounds;
    for ([[maybe_unused]] auto _ : state) {
      rounds.run([&] { return copies(ours, kCount); }, [&] { return copies(standard, kCount); });
    }
    rounds.report(state);
  }
  unpin();
}

/// Both processes copy pointers to one object all the time.
void two_processes_vs_boost(benchmark::State& state) {
  if (!needs_two_cores(state)) return;
  constexpr std::uint64_t kOurs = 1;
  constexpr std::uint64_t kBoosts = 2;
  const std::string name = segment().segment + "_boost";
  ipc::managed_shared_memory memory(ipc::create_only, name.c_str(), 1 << 20);
  ipc::shared_memory_object::remove(name.c_str());  // the child inherits the mapping
  const auto boosts = ipc::make_managed_shared_ptr(memory.construct<Ball>("ball")(), memory);
  const Shared<std::atomic<bool>> go_on;
  Companion other([&](Companion& here) {
    lot::ShmEngine engine(segment());
    here.meet();
    auto in = engine.subscribe<Ball>("/ball");
    here.meet();
    const auto ours = in.pull(10s);
    expect(ours && ours->is(1), "the message did not come");
    here.meet();
    pin(1);
    for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
      while (go_on->load(std::memory_order_relaxed)) {
        order == kOurs ? copies(ours, 100) : copies(boosts, 100);
      }
    }
  });
  lot::ShmEngine engine(segment());
  auto out = engine.advertise<Ball>("/ball");
  other.meet();
  auto in = engine.subscribe<Ball>("/ball");
  other.meet();
  auto ball = out.loan();
  ball->fill(1);
  expect(out.push(std::move(ball)) == lot::Status::Ok, "the message did not go");
  const auto ours = in.pull(10s);
  expect(ours && ours->is(1), "the message did not come");
  other.meet();
  pin(0);
  const auto both = [&](std::uint64_t order, const auto& pointer) {
    go_on->store(true, std::memory_order_relaxed);
    other.tell(order);
    const double ns = copies(pointer, kCount);
    go_on->store(false, std::memory_order_relaxed);
    other.meet();
    return ns;
  };
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    rounds.run([&] { return both(kOurs, ours); }, [&] { return both(kBoosts, boosts); });
  }
  rounds.report_faster(state);
}

}  // namespace

BENCHMARK(vs_std)->Name("pointers/vs_std")->UseRealTime();
BENCHMARK(two_processes_vs_boost)->Name("pointers/two_processes_vs_boost")->UseRealTime();

}  // namespace bench
