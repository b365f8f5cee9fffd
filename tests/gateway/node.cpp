// SPDX-License-Identifier: Apache-2.0

// A program of LOT for the tests of the gateway.
//
//     gateway_node send TOPIC SIZE PERIOD_MS [COUNT]   publishes frames, or so many, and stays
//     until SIGTERM gateway_node receive TOPIC COUNT                 ends when so many frames have
//     come, and are right gateway_node follow TOPIC LAST                   ends with frame LAST;
//     says what it has seen before gateway_node latch TOPIC SIZE                    publishes one
//     frame, and stays until SIGTERM

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>
#include <thread>

#include "lot/lot.hpp"

#include "pattern.h"

namespace robot {

struct Frame {
  std::uint32_t number = 0;
  lot::ShmString label;
  lot::ShmVector<std::uint8_t> data;
};

}  // namespace robot

namespace {

using robot::Frame;

void push(lot::ShmPusher<Frame>& pusher, std::uint32_t number, std::size_t size) {
  auto frame = pusher.loan();
  frame->number = number;
  frame->label = "frame " + std::to_string(number);
  frame->data.resize(size);
  fill_pattern(frame->data.data(), size, number);
  (void)pusher.push(std::move(frame));
}

/// Says what is wrong with it, if anything is.
bool is_right(const Frame& frame) {
  const std::size_t wrong = first_wrong(frame.data.data(), frame.data.size(), frame.number);
  const bool is_label = std::string(frame.label) == "frame " + std::to_string(frame.number);
  if (is_label && wrong == frame.data.size()) return true;
  std::printf("frame %u: wrong at byte %zu, label %s\n", frame.number, wrong, frame.label.c_str());
  return false;
}

int receive(lot::ShmEngine& engine, const char* topic, unsigned count, const lot::StopToken& stop) {
  lot::PullerOptions options;
  options.history = 1;
  auto puller = engine.subscribe<Frame>(topic, options);
  std::printf("ready\n");
  for (unsigned seen = 0; seen < count;) {
    const auto frame = puller.pull(stop);
    if (stop.stop_requested()) return 1;
    if (!frame) continue;  // the publisher has gone: another one may come
    if (!is_right(*frame)) return 1;
    ++seen;
  }
  std::printf("%u frames, %llu missed\n", count,
              static_cast<unsigned long long>(puller.missed_total()));
  return 0;
}

/// Says how many frames have come, from which to which one. They are right, and come in their
/// order.
int follow(lot::ShmEngine& engine, const char* topic, std::uint32_t last,
           const lot::StopToken& stop) {
  lot::PullerOptions options;
  options.history = 1;
  auto puller = engine.subscribe<Frame>(topic, options);
  std::printf("ready\n");
  std::uint32_t first = 0;
  std::uint32_t before = 0;
  unsigned seen = 0;
  while (before < last && !stop.stop_requested()) {
    const auto frame = puller.pull(stop);
    if (!frame) continue;
    if (!is_right(*frame)) return 1;
    if (frame->number <= before) {
      std::printf("frame %u comes after %u\n", frame->number, before);
      return 1;
    }
    before = frame->number;
    if (++seen == 1) first = before;
    std::printf("at %u\n", before);
  }
  std::printf("seen %u from %u to %u, missed %llu\n", seen, first, before,
              static_cast<unsigned long long>(puller.missed_total()));
  return 0;
}

int work(int argc, char** argv) {
  const std::string what = argv[1];
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  const unsigned long number = argc > 3 ? std::strtoul(argv[3], nullptr, 10) : 0;
  if (what == "receive") return receive(engine, argv[2], static_cast<unsigned>(number), stop);
  if (what == "follow") return follow(engine, argv[2], static_cast<std::uint32_t>(number), stop);
  auto pusher = engine.advertise<Frame>(argv[2]);
  const unsigned long period = argc > 4 ? std::strtoul(argv[4], nullptr, 10) : 0;
  const unsigned long count = what != "send" ? 1
                              : argc > 5     ? std::strtoul(argv[5], nullptr, 10)
                                             : ~0UL;
  std::uint32_t sent = 0;
  std::printf("ready\n");
  do {
    if (sent < count) push(pusher, ++sent, number);
    std::this_thread::sleep_for(std::chrono::milliseconds(what == "send" ? period : 10));
  } while (!stop.stop_requested());
  std::printf("%u frames\n", sent);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  if (argc < 4) return 2;
  try {
    return work(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return 1;
  }
}
