// SPDX-License-Identifier: Apache-2.0
/// Cameras that film for bench/record/record.py: so many topics, frames of a size, at a rate. Each
/// frame differs from the one before it. Prints one line of JSON when it ends.
///
///     lot_cameras --cameras 4 --bytes 1048576 --hz 30 --seconds 60
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <exception>
#include <string>
#include <thread>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include <lot/lot.hpp>

namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

struct Frame {
  std::uint64_t number;
  lot::ShmVector<std::uint8_t> data;
};

struct Settings {
  unsigned cameras = 4;
  std::uint64_t bytes = 1 << 20;
  double hz = 30;
  double seconds = 60;
  std::uint32_t depth = 16;
};

/// What a camera has done.
struct Done {
  std::uint64_t sent = 0;
  std::uint64_t failed = 0;       ///< no memory, or no place
  std::vector<double> push_us{};  ///< loan, fill of the first bytes, push
};

Done film(lot::ShmEngine& engine, const Settings& settings, unsigned number) {
  lot::PusherOptions how;
  how.depth = settings.depth;
  auto pusher = engine.advertise<Frame>("/camera/" + std::to_string(number), how);
  pusher.reserve(settings.depth + 4, settings.bytes);
  Done done;
  const auto period =
      std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1 / settings.hz));
  const auto frames = static_cast<std::uint64_t>(settings.seconds * settings.hz);
  std::this_thread::sleep_for(1s);  // a recorder subscribes
  const auto begin = Clock::now();
  for (std::uint64_t n = 0; n < frames; ++n) {
    std::this_thread::sleep_until(begin + n * period);
    const auto before = Clock::now();
    auto frame = pusher.try_loan();
    if (!frame) {
      ++done.failed;
      continue;
    }
    frame->number = n;
    frame->data.resize(settings.bytes);
    std::memset(frame->data.data(), static_cast<int>(n & 0xff),
                std::min<std::size_t>(4096, settings.bytes));
    const bool good = pusher.push(std::move(frame)) == lot::Status::Ok;
    const std::chrono::duration<double, std::micro> took = Clock::now() - before;
    done.push_us.push_back(took.count());
    ++(good ? done.sent : done.failed);
  }
  std::this_thread::sleep_for(1s);  // what is in the queues is read
  return done;
}

int run(const Settings& settings) {
  lot::ShmEngine engine;
  std::vector<Done> done(settings.cameras);
  std::vector<std::thread> threads;
  for (unsigned c = 0; c < settings.cameras; ++c) {
    threads.emplace_back([&, c] { done[c] = film(engine, settings, c); });
  }
  for (std::thread& thread : threads) thread.join();
  Done all;
  for (const Done& one : done) {
    all.sent += one.sent;
    all.failed += one.failed;
    all.push_us.insert(all.push_us.end(), one.push_us.begin(), one.push_us.end());
  }
  std::sort(all.push_us.begin(), all.push_us.end());
  const auto quantile = [&](double q) {
    if (all.push_us.empty()) return 0.0;
    return all.push_us[static_cast<std::size_t>(q * static_cast<double>(all.push_us.size() - 1))];
  };
  const nlohmann::json said{{"sent", all.sent},
                            {"failed", all.failed},
                            {"push_us_median", quantile(0.5)},
                            {"push_us_p99", quantile(0.99)}};
  std::printf("%s\n", said.dump().c_str());
  return all.failed == 0 ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Cameras for the recorder's benchmark", "lot_cameras");
  Settings settings;
  app.add_option("--cameras", settings.cameras)->check(CLI::Range(1, 64));
  app.add_option("--bytes", settings.bytes)->transform(CLI::AsSizeValue(false));
  app.add_option("--hz", settings.hz)->check(CLI::Range(0.1, 10000.0));
  app.add_option("--seconds", settings.seconds)->check(CLI::Range(0.1, 86400.0));
  app.add_option("--depth", settings.depth)->check(CLI::Range(1, 1024));
  CLI11_PARSE(app, argc, argv);
  try {
    return run(settings);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "lot_cameras: %s\n", e.what());
    return 1;
  }
}
