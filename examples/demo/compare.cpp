// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <string>
#include <vector>

#include "screen.hpp"

namespace demo {
namespace {

using namespace std::chrono_literals;

/// The first frames of a round are not in the latencies: TCP needs them to find its window.
constexpr std::size_t kWarmUp = 5;
constexpr std::uint32_t kRounds = 3;

enum class Transport { Ring, Mutex, Tcp };
constexpr std::array kTransports{Transport::Ring, Transport::Mutex, Transport::Tcp};
constexpr std::array kTitles{"ring", "same, mutex", "TCP copy"};

constexpr std::size_t index(Transport transport) { return static_cast<std::size_t>(transport); }

/// What one transport has done, all rounds together.
struct Result {
  std::array<std::vector<std::int64_t>, kConsumers> latency_ns;
  double camera_cpu_seconds = 0, cpu_seconds = 0, seconds = 0;
  std::uint64_t sent = 0, skipped = 0, lost = 0, damaged = 0;
};

/// All consumers' values of a quantile, in milliseconds: the best and the worst.
std::string best_and_worst(const Result& result, double part) {
  std::array<double, kConsumers> ms{};
  std::transform(result.latency_ns.begin(), result.latency_ns.end(), ms.begin(), [&](auto ns) {
    if (ns.empty()) return std::nan("");
    std::sort(ns.begin(), ns.end());
    const auto rank = static_cast<std::size_t>(std::ceil(part * static_cast<double>(ns.size())));
    return 1e-6 * static_cast<double>(ns[std::max<std::size_t>(rank, 1) - 1]);  // nearest rank
  });
  const auto [best, worst] = std::minmax_element(ms.begin(), ms.end());
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "%.2f .. %.2f", *best, *worst);
  return text.data();
}

/// A round of one transport: a camera and its consumers come, and go.
void measure(const Settings& settings, Transport transport, Result& result) {
  const bool tcp = transport == Transport::Tcp;
  Family family;
  Settings camera = settings;
  camera.role = tcp ? "tcp-camera" : "ring-camera";
  camera.mutex = transport == Transport::Mutex;
  Settings consumer = settings;
  consumer.role = tcp ? "tcp-consumer" : "ring-consumer";

  family.start("camera", camera);
  family.wait_until("the camera gets ready", [&] { return family["camera"].has_said("ready"); });
  if (tcp) consumer.port = family["camera"].said["ready"].at("port").get<std::uint16_t>();
  for (unsigned i = 1; i <= kConsumers; ++i) {  // one by one: TCP serves them in this order
    consumer.number = i;
    const Child& child = family.start(consumer_name(i), consumer);
    family.wait_until("a consumer joins", [&] { return child.has_said("ready"); });
  }

  Progress progress(kTitles[index(transport)]);
  family.on_report = [&] { progress.show(how_far(family)); };
  const auto patience =
      30s + 3 * std::chrono::seconds(static_cast<int>(settings.frames / settings.hz));
  family.wait_until(
      "all frames cross",
      [&] {
        bool done = family["camera"].has_said("done");
        for (unsigned i = 1; i <= kConsumers; ++i)
          done &= family[consumer_name(i)].has_said("done");
        return done;
      },
      patience);
  family.on_report = nullptr;
  family.dismiss();

  const Json& done = family["camera"].said["done"];
  const auto sent = done.at("sent").get<std::uint64_t>();
  result.sent += sent;
  result.skipped += done.at("skipped").get<std::uint64_t>();
  result.camera_cpu_seconds += done.at("cpu").get<double>();
  result.cpu_seconds += done.at("cpu").get<double>();
  result.seconds += done.at("seconds").get<double>();
  for (unsigned i = 0; i < kConsumers; ++i) {
    const Json& own = family[consumer_name(i + 1)].said["done"];
    const auto ns = own.at("latency_ns").get<std::vector<std::int64_t>>();
    auto& all = result.latency_ns[i];
    all.insert(all.end(), ns.begin() + static_cast<std::ptrdiff_t>(std::min(kWarmUp, ns.size())),
               ns.end());
    result.cpu_seconds += own.at("cpu").get<double>();
    result.damaged += own.at("damaged").get<std::uint64_t>();
    result.lost += sent - own.at("received").get<std::uint64_t>();
  }
}

void print_table(const std::array<Result, kTransports.size()>& results) {
  std::printf(
      "\nlatency in ms, best .. worst consumer\n%-11s  %-15s  %-15s  %-15s %12s %9s %6s %7s\n", "",
      "median", "p99", "max", "camera CPU s", "all CPU s", "lost", "unsent*");
  for (const Transport transport : kTransports) {
    const Result& r = results[index(transport)];
    std::printf("%-11s  %-15s  %-15s  %-15s %12.2f %9.2f %6llu %7llu\n", kTitles[index(transport)],
                best_and_worst(r, 0.5).c_str(), best_and_worst(r, 0.99).c_str(),
                best_and_worst(r, 1).c_str(), r.camera_cpu_seconds, r.cpu_seconds,
                static_cast<unsigned long long>(r.lost),
                static_cast<unsigned long long>(r.skipped));
  }
}

}  // namespace

bool compare(const Settings& settings) {
  std::printf("%.4g MiB frames at %.4g Hz: 1 camera process, %u consumer processes\n",
              static_cast<double>(settings.bytes) / (1 << 20), settings.hz, kConsumers);
  Settings round = settings;
  round.frames = std::max<std::uint32_t>(settings.frames / kRounds, 2 * kWarmUp);
  std::array<Result, kTransports.size()> results;
  for (std::uint32_t n = 0; n < kRounds; ++n) {
    for (const Transport transport : kTransports)
      measure(round, transport, results[index(transport)]);
  }
  print_table(results);
  std::printf(
      "\n%u rounds of %u frames for each, in turn. Latency: from right before the push (TCP: the\n"
      "first send) until the consumer has the whole frame; memory was warm: made and touched "
      "before\n"
      "the first frame; the first %zu frames of a round are not counted. CPU: user and system "
      "seconds\n"
      "of the processes; drawing the frame is in the camera's. Mutex: the same transport with a "
      "queue\n"
      "of which every step is under one lock. * The camera skips pictures once it is %u behind.\n",
      kRounds, round.frames, kWarmUp, settings.depth);
  if (const char* engine = std::getenv("LOT_QUEUE")) {
    std::printf("LOT_QUEUE=%s: the first two rows are both of this engine.\n", engine);
  }

  std::uint64_t lost = 0;
  std::uint64_t frames = 0;
  std::uint64_t damaged = 0;
  for (const Transport transport : kTransports) {
    const Result& r = results[index(transport)];
    damaged += r.damaged;
    if (transport == Transport::Tcp) continue;
    lost += r.lost;
    frames += r.sent * kConsumers;
    if (r.skipped != 0) {
      std::printf(
          "This machine kept the camera from running: %llu pictures were never taken (%s).\n",
          static_cast<unsigned long long>(r.skipped), kTitles[index(transport)]);
    }
  }
  std::printf("\nRing and mutex: %llu of %llu frames lost. Damaged frames: %llu.\n",
              static_cast<unsigned long long>(lost), static_cast<unsigned long long>(frames),
              static_cast<unsigned long long>(damaged));
  return lost == 0 && damaged == 0;
}

}  // namespace demo
