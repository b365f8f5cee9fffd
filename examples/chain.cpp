// SPDX-License-Identifier: Apache-2.0
/// Camera -> detector -> logger, three processes and not one copy: a detection refers to the frame
/// that it was made from, and each process finds the pixels at the same place of the segment.
#include <algorithm>
#include <cinttypes>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

#include <lot/lot.hpp>

#include "example.hpp"

namespace {

struct Frame {
  std::uint64_t place;  ///< where the camera has drawn the pixels
  lot::ShmVector<std::uint8_t> pixels;
};
LOT_DESCRIBE(Frame, place, pixels)  // for python/detector.py; C++20 needs no such line
struct Detection {
  lot::ShmRef<const Frame> frame;  ///< as long as the detection lives, the frame does
  std::uint64_t brightest;         ///< pixel
  std::uint64_t place;             ///< where the detector has seen the pixels
};
LOT_DESCRIBE(Detection, frame, brightest, place)

constexpr std::uint64_t kFrames = 5;
constexpr std::uint64_t kPixels = 4 << 20;

/// Offset in the segment's file, which all processes share; addresses differ between them.
std::uint64_t place_of(const lot::ShmEngine& engine, const void* address) {
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    std::uintptr_t begin = 0, end = 0, offset = 0;
    std::sscanf(line.c_str(), "%" SCNxPTR "-%" SCNxPTR " %*s %" SCNxPTR, &begin, &end, &offset);
    const auto at = reinterpret_cast<std::uintptr_t>(address);
    if (begin <= at && at < end && line.find(engine.path()) != std::string::npos) {
      return at - begin + offset;
    }
  }
  return 0;  // not in shared memory
}

bool camera() {
  const lot::StopToken stop = lot::stop_on_signals();  // Ctrl-C
  lot::ShmEngine engine;
  auto frames = engine.advertise<Frame>("/frames");
  if (!frames.wait_for_readers(1, stop)) return false;
  for (std::uint64_t n = 1; n <= kFrames; ++n) {
    auto frame = frames.loan();
    frame->pixels.assign(kPixels, 0);
    frame->pixels[n * 1000] = 255;
    frame->place = place_of(engine, frame->pixels.data());
    (void)frames.push(std::move(frame));  // the oldest goes: never Full
  }
  return true;
}

bool detector() {
  const lot::StopToken stop = lot::stop_on_signals();  // Ctrl-C
  lot::ShmEngine engine;
  auto detections = engine.advertise<Detection>("/detections");
  if (!detections.wait_for_readers(1, stop)) return false;
  auto frames = engine.subscribe<Frame>("/frames");
  while (const auto frame = frames.pull(stop)) {  // until the camera has gone, or Ctrl-C
    const auto& pixels = frame->pixels;
    auto detection = detections.loan();
    detection->frame = frame;
    detection->brightest =
        static_cast<std::uint64_t>(std::max_element(pixels.begin(), pixels.end()) - pixels.begin());
    detection->place = place_of(engine, pixels.data());
    (void)detections.push(std::move(detection));
  }
  return true;
}

bool logger() {
  const lot::StopToken stop = lot::stop_on_signals();  // Ctrl-C
  lot::ShmEngine engine;
  auto detections = engine.subscribe<Detection>("/detections");
  bool good = true;
  std::uint64_t n = 0;
  while (const auto detection = detections.pull(stop)) {  // until the detector has gone, or Ctrl-C
    ++n;
    const Frame& frame = *detection->frame;
    const std::uint64_t place = place_of(engine, frame.pixels.data());
    std::printf("frame %" PRIu64 ": %zu bytes; camera, detector and logger have them at %#" PRIx64
                ", %#" PRIx64 ", %#" PRIx64 "; pixel %" PRIu64 " is the brightest\n",
                n, frame.pixels.size(), frame.place, detection->place, place, detection->brightest);
    good &= place != 0 && place == frame.place && place == detection->place;
    good &= detection->brightest == n * 1000 && frame.pixels[detection->brightest] == 255;
  }
  return good && n == kFrames;
}

}  // namespace

/// `chain around`: the two without the detector, which is another program (python/detector.py).
int main(int argc, char** argv) {
  const bool has_detector = argc < 2 || argv[1] != std::string_view("around");
  return example::run("chain", [&] {
    std::vector<pid_t> children{example::start("camera", camera)};
    if (has_detector) children.push_back(example::start("detector", detector));
    bool good = logger();
    for (const pid_t child : children) good = example::finish(child) && good;
    return good;
  });
}
