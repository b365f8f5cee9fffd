// SPDX-License-Identifier: Apache-2.0
/// A program that does not have its topic's type. It reads fields by their names, prints whole
/// messages, and forwards those that it chooses to another topic, without a copy of the pixels.
#include <chrono>
#include <csignal>
#include <cstdint>
#include <iostream>
#include <thread>
#include <utility>

#include <lot/lot.hpp>

#include "example.hpp"

namespace {

using namespace std::chrono_literals;

constexpr std::uint32_t kBright = 128;

/// Only the camera and the viewer know it.
struct Frame {
  std::uint32_t number;
  std::uint32_t brightness;
  lot::ShmString encoding;
  lot::ShmVector<std::uint8_t> pixels;
};
LOT_DESCRIBE(Frame, number, brightness, encoding, pixels)  // C++20 needs no such line

bool camera() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  auto pusher = engine.advertise<Frame>("/frames");
  for (std::uint32_t n = 0; !stop.stop_requested(); ++n) {  // until main() says SIGTERM
    auto frame = pusher.loan();
    frame->number = n;
    frame->brightness = n * 64 % 256;
    frame->encoding = "mono8";
    frame->pixels.resize(1 << 20);
    (void)pusher.push(std::move(frame));
    std::this_thread::sleep_for(5ms);
  }
  return true;
}

/// Forwards bright messages of whatever type, if that has a field `brightness`.
bool filter() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  while (!engine.type_of("/frames")) {  // the camera has not come yet
    if (stop.stop_requested()) return true;
    std::this_thread::sleep_for(1ms);
  }
  lot::AnyPuller in = engine.subscribe_any("/frames");
  lot::AnyPusher out = engine.advertise_any("/frames/bright", in.type());

  const lot::Description::Type& type = in.type().description().root();
  std::cout << "the topic carries " << type.name << ", " << type.fields.size() << " fields:";
  for (const auto& field : type.fields) std::cout << ' ' << field.name;
  std::cout << '\n';

  while (const lot::AnyMessage message = in.pull(stop)) {
    if (message.root()["brightness"].as<std::uint32_t>() < kBright) continue;
    (void)out.push(message);
  }
  return true;
}

bool viewer() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  auto puller = engine.subscribe<Frame>("/frames/bright");
  for (unsigned n = 0; n < 10; ++n) {
    const lot::AnyMessage message = puller.pull(stop);
    if (!message) return false;  // Ctrl-C
    const auto frame = message.as<Frame>();
    if (!frame || frame->brightness < kBright) return false;
    std::cout << message.root()["number"] << ": " << frame->pixels.size() << " pixels\n";
    if (n == 0) std::cout << message.root() << '\n';
  }
  return true;
}

}  // namespace

int main() {
  return example::run("any", [] {
    const pid_t first = example::start("camera", camera);
    const pid_t second = example::start("filter", filter);
    const bool good = viewer();
    kill(second, SIGTERM);
    kill(first, SIGTERM);
    const bool both = example::finish(second);
    return example::finish(first) && both && good;
  });
}
