// SPDX-License-Identifier: Apache-2.0
/// The arm of python.py that is LOT in C++: its two ends of a topic of small messages.
///
///     lot_python_arm send COUNT PAUSE       publishes: so many nanoseconds lie between two
///     lot_python_arm receive COUNT PAUSE    prints the median of their delays in us, or, without a
///                                           pause, how many came in a second
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include <lot/lot.hpp>

struct Small {
  std::uint64_t number = 0;
  std::uint64_t stamp = 0;
};

namespace {

std::uint64_t now() {
  return static_cast<std::uint64_t>(std::chrono::steady_clock::now().time_since_epoch().count());
}

bool send(lot::ShmEngine& engine, std::uint64_t count, std::chrono::nanoseconds pause) {
  lot::PusherOptions options;
  options.policy = lot::Policy::Block;
  options.block_for = std::chrono::minutes(1);
  options.depth = 64;
  auto topic = engine.advertise<Small>("/topic", options);
  const lot::StopToken stop = lot::stop_on_signals();
  if (!topic.wait_for_readers(1, stop)) return false;
  for (std::uint64_t number = 0; number < count; ++number) {
    if (pause.count() != 0) std::this_thread::sleep_for(pause);
    const std::uint64_t stamp = now();
    auto small = topic.loan();
    small->number = number;
    small->stamp = stamp;
    if (topic.push(std::move(small)) != lot::Status::Ok) return false;
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(200));  // until all is read
  return true;
}

bool receive(lot::ShmEngine& engine, std::uint64_t count, std::chrono::nanoseconds pause) {
  const bool rests = pause.count() != 0;
  lot::PullerOptions options;
  options.wait = rests ? lot::Wait::Park : lot::Wait::Adaptive;
  auto topic = engine.subscribe<Small>("/topic", options);
  std::vector<std::uint64_t> delays;
  std::uint64_t begin = 0;
  for (std::uint64_t number = 0; number < count; ++number) {
    const auto small = topic.borrow();
    if (!small || small->number != number) return false;
    if (number == 0) begin = small->stamp;
    if (rests) delays.push_back(now() - small->stamp);
  }
  const std::uint64_t whole = now() - begin;
  if (!rests) {
    std::printf("%.1f\n", static_cast<double>(count) * 1e9 / static_cast<double>(whole));
    return true;
  }
  const auto middle = delays.begin() + static_cast<std::ptrdiff_t>(delays.size() / 2);
  std::nth_element(delays.begin(), middle, delays.end());
  std::printf("%.1f\n", static_cast<double>(*middle) / 1000);
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 4) return 2;
  try {
    lot::ShmEngine engine;
    const std::uint64_t count = std::strtoull(argv[2], nullptr, 10);
    const std::chrono::nanoseconds pause(std::strtoll(argv[3], nullptr, 10));
    const bool sends = argv[1] == std::string_view("send");
    return (sends ? send(engine, count, pause) : receive(engine, count, pause)) ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "lot_python_arm: %s\n", error.what());
    return 1;
  }
}
