// SPDX-License-Identifier: Apache-2.0
/// A regression test: what a node has once received and sent is recorded. The test plays the input
/// to a node of today, and compares what it sends now with what it sent then.
///
///     replay FILE       records FILE where it is not there, and tests by it
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <iostream>
#include <string>
#include <unistd.h>
#include <utility>

#include <lot/lot.hpp>
#include <lot/recorder.hpp>
#include <lot/recording.hpp>

#include "example.hpp"

namespace {

using namespace std::chrono_literals;

struct Frame {
  std::uint32_t number;
  lot::ShmVector<std::uint8_t> pixels;
};
LOT_DESCRIBE(Frame, number, pixels)
struct Light {
  std::uint32_t frame;
  double mean;
};
LOT_DESCRIBE(Light, frame, mean)

/// The node under test: how bright is each frame?
class LightMeter {
 public:
  explicit LightMeter(lot::ShmEngine& engine)
      : out_(engine.advertise<Light>("/light")),
        in_(engine.listen<Frame>("/frames", [this](const lot::ShmSharedPtr<const Frame>& frame) {
          double sum = 0;
          for (const std::uint8_t pixel : frame->pixels) sum += pixel;
          const double mean = sum / static_cast<double>(frame->pixels.size());
          (void)out_.push(out_.loan(Light{frame->number, mean}));
        })) {}

 private:
  lot::ShmPusher<Light> out_;
  lot::ShmListener in_;
};

/// Once: a camera, the node, and a recorder beside them. Or on a robot: `lot record /frames
/// /light`.
void record(const std::string& path, const lot::StopToken& stop) {
  lot::ShmEngine engine;
  auto camera = engine.advertise<Frame>("/frames");
  const LightMeter meter(engine);
  auto light = engine.subscribe<Light>("/light");
  lot::RecorderOptions what;
  what.path = path;
  what.topics = {"/frames", "/light"};
  lot::Recorder recorder(what);
  for (std::uint32_t n = 0; n < 20 && !stop.stop_requested(); ++n) {
    auto frame = camera.loan();
    frame->number = n;
    frame->pixels.assign(100'000, static_cast<std::uint8_t>(n * 12));
    (void)camera.push(std::move(frame));
    (void)light.pull(10s, stop);
  }
  recorder.stop();
}

/// True: the node sends what it sent then.
bool test(const std::string& path, const lot::StopToken& stop) {
  lot::Recording recording(path);
  lot::RecordingQuery frames;
  frames.topics = {"/frames"};
  lot::RecordingQuery lights;
  lights.topics = {"/light"};
  auto input = recording.messages(frames);
  auto expected = recording.messages(lights);

  lot::ShmEngine engine;
  lot::AnyPusher player = engine.advertise_any("/frames", lot::AnyType::of<Frame>());
  const LightMeter meter(engine);
  auto light = engine.subscribe<Light>("/light");

  unsigned same = 0;
  while (const auto frame = input.next()) {
    lot::AnyLoan loan = player.loan();
    frame->copy_to(loan);  // the one copy: from the file into shared memory
    (void)player.push(std::move(loan));
    const auto now = light.pull(10s, stop);
    const auto then = expected.next();
    if (!now || !then || !then->is_equal(now)) {
      std::cout << "frame " << frame->root()["number"] << ": now ";
      if (now) std::cout << lot::AnyMessage(now).root();
      std::cout << ", then ";
      if (then) std::cout << then->root();
      std::cout << '\n';
      return false;
    }
    ++same;
  }
  std::cout << same << " results are what they were\n";
  return same != 0;
}

}  // namespace

int main(int argc, char** argv) {
  return example::run("replay", [&] {
    const bool is_named = argc > 1;
    const std::string path =
        is_named ? argv[1] : "/tmp/lot_replay_" + std::to_string(getpid()) + ".mcap";
    const lot::StopToken stop = lot::stop_on_signals();
    if (!std::filesystem::exists(path)) record(path, stop);
    const bool good = test(path, stop);
    if (!is_named) std::filesystem::remove(path);
    return good;
  });
}
