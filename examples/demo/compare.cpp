// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "screen.hpp"

namespace demo {
namespace {

using namespace std::chrono_literals;

/// The first frames are not in the latencies: TCP needs them to find its window.
constexpr std::size_t kWarmUp = 5;

struct Row {
  double median_ms = 0, p99_ms = 0, max_ms = 0, cpu_seconds = 0;
  std::uint64_t lost = 0, damaged = 0;
};

struct Result {
  std::array<Row, kConsumers> consumers;
  double cpu_seconds = 0;  ///< the camera's
  double seconds = 0;
  std::uint64_t sent = 0, skipped = 0;

  double all_cpu_seconds() const {
    double sum = cpu_seconds;
    for (const Row& row : consumers) sum += row.cpu_seconds;
    return sum;
  }
};

Row make_row(const Json& done, std::uint64_t sent) {
  Row row;
  auto ns = done.at("latency_ns").get<std::vector<std::int64_t>>();
  if (ns.size() > 2 * kWarmUp) ns.erase(ns.begin(), ns.begin() + kWarmUp);
  std::sort(ns.begin(), ns.end());
  const auto ms = [&ns](double part) {  // nearest rank
    if (ns.empty()) return std::nan("");
    const auto rank = static_cast<std::size_t>(std::ceil(part * static_cast<double>(ns.size())));
    return 1e-6 * static_cast<double>(ns[std::max<std::size_t>(rank, 1) - 1]);
  };
  row.median_ms = ms(0.5);
  row.p99_ms = ms(0.99);
  row.max_ms = ms(1);
  row.cpu_seconds = done.at("cpu").get<double>();
  row.damaged = done.at("damaged").get<std::uint64_t>();
  row.lost = sent - done.at("received").get<std::uint64_t>();
  return row;
}

Result measure(const Settings& settings, bool ring) {
  Family family;
  Settings camera = settings;
  camera.role = ring ? "ring-camera" : "tcp-camera";
  Settings consumer = settings;
  consumer.role = ring ? "ring-consumer" : "tcp-consumer";

  family.start("camera", camera);
  family.wait_until("the camera gets ready", [&] { return family["camera"].has_said("ready"); });
  if (!ring) consumer.port = family["camera"].said["ready"].at("port").get<std::uint16_t>();
  for (unsigned i = 1; i <= kConsumers; ++i) {  // one by one: TCP serves them in this order
    consumer.number = i;
    const Child& child = family.start(consumer_name(i), consumer);
    family.wait_until("a consumer joins", [&] { return child.has_said("ready"); });
  }

  Progress progress(ring ? "ring" : "TCP copy");
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

  Result result;
  const Json& done = family["camera"].said["done"];
  result.sent = done.at("sent").get<std::uint64_t>();
  result.skipped = done.at("skipped").get<std::uint64_t>();
  result.cpu_seconds = done.at("cpu").get<double>();
  result.seconds = done.at("seconds").get<double>();
  for (unsigned i = 0; i < kConsumers; ++i) {
    result.consumers[i] = make_row(family[consumer_name(i + 1)].said["done"], result.sent);
  }
  return result;
}

void print_half(const Row& row) {
  std::printf("  | %8.3f %8.3f %8.3f %6.2f %5llu", row.median_ms, row.p99_ms, row.max_ms,
              row.cpu_seconds, static_cast<unsigned long long>(row.lost));
}

void print_table(const Result& ring, const Result& tcp) {
  const std::string half_rule = "+" + std::string(42, '-');
  const std::string rule = std::string(14, '-') + half_rule + half_rule + "\n";
  std::printf("\n%14s| %-41s| %s\n%-12s", "", "ring: latency in ms", "TCP copy: latency in ms", "");
  for (int half = 0; half < 2; ++half) {
    std::printf("  | %8s %8s %8s %6s %5s", "median", "p99", "max", "CPU s", "lost");
  }
  std::printf("\n%s", rule.c_str());
  for (unsigned i = 0; i < kConsumers; ++i) {
    std::printf("%-12s", consumer_name(i + 1).c_str());
    print_half(ring.consumers[i]);
    print_half(tcp.consumers[i]);
    std::printf("\n");
  }
  const auto line = [&](const char* title, double a, double b, const char* format) {
    std::printf("%-12s", title);
    for (const double value : {a, b}) {
      std::printf("  | %26s ", "");
      std::printf(format, value);
      std::printf(" %5s", "");
    }
    std::printf("\n");
  };
  line("camera", ring.cpu_seconds, tcp.cpu_seconds, "%6.2f");
  std::printf("%s", rule.c_str());
  line("all CPU s", ring.all_cpu_seconds(), tcp.all_cpu_seconds(), "%6.2f");
  line("frames sent", static_cast<double>(ring.sent), static_cast<double>(tcp.sent), "%6.0f");
  line("not sent *", static_cast<double>(ring.skipped), static_cast<double>(tcp.skipped), "%6.0f");
  line("per second", static_cast<double>(ring.sent) / ring.seconds,
       static_cast<double>(tcp.sent) / tcp.seconds, "%6.1f");
}

}  // namespace

bool compare(const Settings& settings) {
  std::printf("%.4g MiB frames at %.4g Hz, %u frames: 1 camera process, %u consumer processes\n",
              static_cast<double>(settings.bytes) / (1 << 20), settings.hz, settings.frames,
              kConsumers);
  const Result ring = measure(settings, true);
  const Result tcp = measure(settings, false);
  print_table(ring, tcp);
  std::printf(
      "\nLatency: from right before the push (TCP: the first send) until the consumer has the\n"
      "whole frame; memory was warm: made and touched before the first frame; the first %zu "
      "frames\n"
      "are not counted. CPU: user and system seconds of the process. Drawing the frame is in the\n"
      "camera's CPU on both sides. * The camera skips pictures once it is %u behind.\n",
      kWarmUp, settings.depth);

  std::uint64_t lost = 0;
  std::uint64_t damaged = 0;
  for (const Row& row : ring.consumers) lost += row.lost;
  for (const Result* result : {&ring, &tcp}) {
    for (const Row& row : result->consumers) damaged += row.damaged;
  }
  std::printf("\nRing: %llu of %llu frames lost. Damaged frames: %llu.\n",
              static_cast<unsigned long long>(lost),
              static_cast<unsigned long long>(ring.sent * kConsumers),
              static_cast<unsigned long long>(damaged));
  if (ring.skipped != 0) {
    std::printf("This machine kept the camera from running: %llu pictures were never taken.\n",
                static_cast<unsigned long long>(ring.skipped));
  }
  return lost == 0 && damaged == 0;
}

}  // namespace demo
