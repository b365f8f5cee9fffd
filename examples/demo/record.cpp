// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include <lot/recording.hpp>

#include "command.hpp"
#include "frame.hpp"
#include "screen.hpp"

namespace demo {
namespace {

using namespace std::chrono_literals;

constexpr std::uint32_t kFrames = 30;
constexpr std::uint64_t kMostBytes = 1 << 20;  // of a frame: the two files shall fit anywhere

/// A directory for files, which goes with them.
class Scratch {
 public:
  Scratch() {
    path_ = std::filesystem::temp_directory_path() / "lot_demo_XXXXXX";
    if (mkdtemp(path_.data()) == nullptr) {
      throw std::system_error(errno, std::generic_category(), path_);
    }
  }
  ~Scratch() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;

  std::string file(const char* name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

/// What a file has of the frames.
struct Content {
  std::vector<std::uint32_t> hashes;
  std::uint64_t missed = 0;

  explicit Content(const std::string& file) {
    lot::Recording recording(file);
    auto messages = recording.messages();
    while (const auto message = messages.next()) {
      const lot::Bytes bytes = message->payload();
      hashes.push_back(adler32(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()));
    }
    for (const lot::RecordedTopic& topic : recording.topics()) missed += topic.missed + topic.lost;
  }
  /// Of the hashes, in their order.
  std::uint32_t hash() const {
    return adler32(reinterpret_cast<const std::uint8_t*>(hashes.data()),
                   hashes.size() * sizeof(std::uint32_t));
  }
};

/// `lot`, with these words and the demo's segment.
std::vector<std::string> command(const Settings& settings, std::vector<std::string> words) {
  const char* const named = std::getenv("LOT_SEGMENT");
  words.insert(words.begin(), LOT_COMMAND);
  words.insert(words.end(), {"--segment", named != nullptr ? named : settings.segment});
  return words;
}

/// Records what `publish` has published when it returns.
template <class Publish>
Content record_into(const std::string& file, const Settings& settings, Publish&& publish) {
  Command recorder(command(settings, {"record", kTopic, "-o", file}));
  const auto end = std::chrono::steady_clock::now() + 10s;
  while (!std::filesystem::exists(file)) {  // it has made the file when it looks for topics
    if (interrupted()) throw Interrupted();
    if (std::chrono::steady_clock::now() > end)
      throw std::runtime_error("lot record does not begin");
    std::this_thread::sleep_for(10ms);
  }
  publish();
  recorder.interrupt();
  (void)recorder.read_all();
  recorder.finish();
  return Content(file);
}

}  // namespace

bool record(const Settings& settings) {
  Settings camera = settings;
  camera.role = "ring-camera";
  camera.frames = kFrames;
  camera.bytes = std::min(settings.bytes, kMostBytes);
  camera.depth = std::max(settings.depth, kFrames);  // however late the recorder looks
  camera.run = 2;                                    // it does not wait for the consumers
  const Scratch scratch;
  std::printf("\nNow frames are recorded, played back, and recorded again.\n");
  std::fflush(stdout);  // before what `lot` says on standard error
  const auto tell = [](const char* did, const std::string& file, const Content& content) {
    std::printf("  %s: %zu frames, %.1f MB, missed %llu, hash %08x\n", did, content.hashes.size(),
                static_cast<double>(std::filesystem::file_size(file)) / 1e6,
                static_cast<unsigned long long>(content.missed), content.hash());
    std::fflush(stdout);
  };

  const std::string first = scratch.file("first.mcap");
  const Content recorded = record_into(first, settings, [&] {
    Family family;
    family.start("camera", camera);
    family.wait_until("the camera has filmed", [&] { return family["camera"].has_said("done"); });
    family.dismiss();
  });
  tell("lot record /camera/front -o first.mcap", first, recorded);

  const std::string again = scratch.file("again.mcap");
  const Content played = record_into(again, settings, [&] {
    Command player(command(settings, {"play", first}));
    (void)player.read_all();
    player.finish();
  });
  tell("lot play first.mcap, recorded again  ", again, played);

  const bool same = recorded.hashes.size() == kFrames && recorded.hashes == played.hashes &&
                    recorded.missed + played.missed == 0;
  std::printf("  %s\n", same ? "all hashes are equal" : "NOT EQUAL  <-- WRONG");
  return same;
}

}  // namespace demo
