// SPDX-License-Identifier: Apache-2.0

// Records a message, and reads it again.

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <utility>

#include <lot/lot.hpp>
#include <lot/recorder.hpp>
#include <lot/recording.hpp>

struct Frame {
  std::uint32_t number;
  lot::ShmVector<std::uint8_t> pixels;
};
LOT_DESCRIBE(Frame, number, pixels)

static void record(const std::string& path) {
  lot::ShmEngine engine;
  auto camera = engine.advertise<Frame>("/frames");
  auto frame = camera.loan();
  frame->number = 4711;
  frame->pixels.resize(1 << 20);
  if (camera.push(std::move(frame)) != lot::Status::Ok) return;  // nothing is recorded

  lot::RecorderOptions what;
  what.path = path;
  what.topics = {"/frames"};
  what.compression = lot::Compression::Zstd;
  lot::Recorder recorder(what);
  recorder.stop();
}

static bool has_the_frame(const std::string& path) {
  lot::Recording recording(path);
  auto messages = recording.messages();
  const auto first = messages.next();
  return first && first->topic().name == "/frames" && first->payload().size() > 1 << 20 &&
         !messages.next();
}

int main() {
  std::string directory = std::filesystem::temp_directory_path() / "lot_consumer_XXXXXX";
  if (!mkdtemp(directory.data())) return 1;
  const std::string path = directory + "/frames.mcap";
  record(path);
  const bool right = has_the_frame(path);
  std::filesystem::remove_all(directory);
  if (!right) return 2;
  std::puts("ok");
}
