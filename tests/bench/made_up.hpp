// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "result.hpp"

/// Runs that nobody measured, whose answers are known because they were made that way.
namespace ab::testing {

/// A directory of the test's own that goes with it.
class TemporaryDirectory {
 public:
  TemporaryDirectory() {
    std::string name = (std::filesystem::temp_directory_path() / "lot_ab_test_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw std::runtime_error("mkdtemp " + name);
    path_ = name;
  }
  ~TemporaryDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryDirectory(const TemporaryDirectory&) = delete;
  TemporaryDirectory& operator=(const TemporaryDirectory&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

struct Shape {
  unsigned publishers = 1;
  unsigned subscribers = 1;
  unsigned blocks = 10;
  unsigned messages = 20;  ///< of each publisher in a block
};

/// Latency from fill to entry in nanoseconds.
using Latency =
    std::function<std::int64_t(unsigned block, unsigned message, unsigned publisher, unsigned to)>;

inline StreamResult stream_of(const Shape& shape, const Latency& latency, std::size_t size = 128) {
  StreamResult stream;
  stream.size = size;
  stream.rate_hz = 30;
  const std::uint64_t each = std::uint64_t{shape.blocks} * shape.messages;
  for (unsigned p = 0; p < shape.publishers; ++p) stream.publishers.push_back({p, each, 0, {}});
  for (unsigned s = 0; s < shape.subscribers; ++s) {
    Subscriber subscriber;
    subscriber.index = s;
    subscriber.received = each * shape.publishers;
    for (unsigned b = 0; b < shape.blocks; ++b) {
      for (unsigned m = 0; m < shape.messages; ++m) {
        for (unsigned p = 0; p < shape.publishers; ++p) {
          const std::uint64_t number = std::uint64_t{b} * shape.messages + m;
          const auto loaned =
              static_cast<std::int64_t>(1'000'000'000'000 + number * 33'333'333 + p * 1'000'000);
          const std::int64_t filled = loaned + 3000;
          subscriber.samples.push_back(
              {number, p, b, loaned, filled, filled + 1000, filled + latency(b, m, p, s)});
        }
      }
    }
    stream.subscribers.push_back(std::move(subscriber));
  }
  return stream;
}

inline Arm arm_of(const std::string& transport, StreamResult stream) {
  Arm arm;
  arm.transport = transport;
  arm.is_floor = transport.starts_with("floor-");
  arm.streams.push_back(std::move(stream));
  return arm;
}

inline Latency always(std::int64_t ns) {
  return [ns](unsigned, unsigned, unsigned, unsigned) { return ns; };
}

/// Around `median_ns`, to the right more than to the left, as latencies are.
inline Latency noisy(double median_ns, double spread, std::uint64_t seed) {
  auto random = std::make_shared<std::mt19937_64>(seed);
  return [=](unsigned, unsigned, unsigned, unsigned) {
    std::normal_distribution<double> normal;
    const double tail = (*random)() % 50 == 0 ? 1.5 : 1.0;
    return std::llround(median_ns * tail * std::exp(spread * normal(*random)));
  };
}

inline Run run_of(std::vector<Cell> cells) {
  Run run;
  run.machine = {
      "A made-up CPU @ 3 GHz", 2, 1, 7.5, "6.1.0", "Debian 12", "g++ 12.2", "performance", "none",
      "0.10 0.20 0.30"};
  run.command = "lot_ab --made-up";
  run.started = "2026-01-02T03:04:05Z";
  run.revision = "0123abc";
  run.seed = 42;
  run.cells = std::move(cells);
  return run;
}

}  // namespace ab::testing
