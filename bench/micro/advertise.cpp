// SPDX-License-Identifier: Apache-2.0
#include <atomic>
#include <chrono>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <string>

#include "lot/detail/core.hpp"
#include "lot/detail/message_type.hpp"

#include "micro.hpp"

/// What the description of its type adds to a publisher that comes and ends: the first one of a
/// process, for which the process makes the description; the first one for a type, where the
/// process has described another; and later ones. The other arm has the same type without a
/// description.
namespace bench {
namespace {

struct Point {
  double x, y, z;
};
struct Header {
  std::uint64_t number;
  std::chrono::time_point<std::chrono::system_clock, std::chrono::nanoseconds> stamp;
  lot::ShmString frame;
};
/// `Which`: a process describes each type once.
template <int Which>
struct Scan {
  Header header;
  Point origin, direction;
  float least, most, step;
  bool is_dense;
  std::uint8_t kind[4];
  lot::ShmVector<Point> points;
  lot::ShmVector<float> intensities;
  lot::ShmVector<lot::ShmString> notes;
};

double advertise(const std::shared_ptr<lot::transport::Participant>& participant,
                 const lot::detail::MessageType& type, std::uint64_t count) {
  return time_ns(count, [&] {
    for (std::uint64_t n = 0; n < count; ++n) {
      expect(lot::detail::make_pusher(participant, "/advertised", type, lot::PusherOptions(),
                                      lot::detail::Delivery::ToAll) != nullptr,
             "a publisher");
    }
  });
}

lot::detail::MessageType undescribed(lot::detail::MessageType type) {
  type.described = nullptr;
  return type;
}

/// In a process that has done nothing yet but advertise the types `before`.
double advertise_first(const lot::detail::MessageType& type,
                       std::initializer_list<const lot::detail::MessageType*> before) {
  const Shared<std::atomic<double>> took;
  Companion child([&](Companion& here) {
    for (; here.hear() != Companion::kStop; here.meet()) {
      const auto participant = lot::detail::join(segment());
      for (const auto* other : before) advertise(participant, *other, 1);
      *took = advertise(participant, type, 1);
    }
  });
  child.tell(1);
  child.meet();
  return took->load();
}

void first(benchmark::State& state) {
  const auto& type = lot::detail::message_type<Scan<1>>();
  const lot::ShmEngine keeps_the_segment(segment());
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    rounds.run([&] { return advertise_first(type, {}); },
               [&] { return advertise_first(undescribed(type), {}); });
  }
  rounds.report_difference(state);
}

void another(benchmark::State& state) {
  const auto& type = lot::detail::message_type<Scan<3>>();
  const auto& before = lot::detail::message_type<Scan<4>>();
  const lot::ShmEngine keeps_the_segment(segment());
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    rounds.run([&] { return advertise_first(type, {&before}); },
               [&] { return advertise_first(undescribed(type), {&before}); });
  }
  rounds.report_difference(state);
}

void again(benchmark::State& state) {
  constexpr std::uint64_t kCount = 10;
  pin(0);
  const auto& type = lot::detail::message_type<Scan<2>>();
  const auto participant = lot::detail::join(segment());
  advertise(participant, type, 1);
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    rounds.run([&] { return advertise(participant, type, kCount); },
               [&] { return advertise(participant, undescribed(type), kCount); });
  }
  rounds.report_difference(state);
  unpin();
}

}  // namespace

BENCHMARK(first)->Name("advertise/first")->Iterations(200);
BENCHMARK(another)->Name("advertise/another")->Iterations(200);
BENCHMARK(again)->Name("advertise/again")->Iterations(200);

}  // namespace bench
