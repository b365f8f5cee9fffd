// SPDX-License-Identifier: Apache-2.0
/// Shows what LOT does: one camera process, five consumer processes, beside a plain TCP copy; then
/// what happens when processes are killed; then frames are recorded and played back. With --input,
/// a real video instead.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <map>
#include <string>
#include <unistd.h>

#include <CLI/CLI.hpp>

#include "process.hpp"
#include "settings.hpp"

namespace {

using demo::Settings;

void parse(CLI::App& app, Settings& s) {
  app.add_option("--frames", s.frames, "Frames for each transport")->check(CLI::Range(10, 100000));
  app.add_option("--hz", s.hz, "Frames per second")->check(CLI::Range(1.0, 1000.0));
  app.add_option("--bytes", s.bytes, "Size of a frame, such as 4M")
      ->transform(CLI::AsSizeValue(false));
  app.add_option("--depth", s.depth, "Frames that the ring holds")->check(CLI::Range(1, 1024));
  app.add_option("--input", s.input, "A video to publish instead; needs ffmpeg")
      ->check(CLI::ExistingFile);
  // What the demo tells its own processes.
  const auto internal = [&app](const char* name, auto& value) {
    app.add_option(name, value)->group("");
  };
  internal("--size", s.size);
  internal("--role", s.role);
  internal("--number", s.number);
  internal("--run", s.run);
  internal("--port", s.port);
  internal("--report-every", s.report_every);
  internal("--segment", s.segment);
  app.add_flag("--until-told", s.until_told)->group("");
  app.add_flag("--hash", s.hash)->group("");
  app.add_flag("--mutex", s.mutex)->group("");
}

int play(const Settings& s) {
  const std::map<std::string, int (*)(const Settings&)> roles{
      {"ring-camera", demo::ring_camera},
      {"ring-consumer", demo::ring_consumer},
      {"tcp-camera", demo::tcp_camera},
      {"tcp-consumer", demo::tcp_consumer},
      {"video-camera", demo::video_camera}};
  return roles.at(s.role)(s);
}

/// Where the segments lie.
std::filesystem::path directory() {
  const char* name = std::getenv("LOT_DIR");
  return name != nullptr ? name : "/dev/shm";
}

/// Takes smaller frames where the file system has no room for these, and says so. A container often
/// has 64 MB.
void fit(Settings& s) {
  constexpr std::uint64_t kLeast = 64 << 10;
  std::error_code ignored;
  const std::uint64_t available = std::filesystem::space(directory(), ignored).available;
  if (ignored || available / 4 * 3 >= s.size) return;
  s.size = available / 4 * 3;
  // A camera that was killed and the next one each have a whole ring and what consumers hold.
  const std::uint64_t frames = 2 * (s.depth + demo::kConsumers * (demo::kHeld + 1));
  const std::uint64_t most = s.size / frames / kLeast * kLeast;
  if (!s.input.empty()) {
    std::printf("%s has %.0f MB free: a segment of %llu MB. Frames of a video keep their size\n\n",
                directory().c_str(), static_cast<double>(available) / 1e6,
                static_cast<unsigned long long>(s.size / 1'000'000));
    return;
  }
  if (s.bytes <= most) return;
  s.bytes = std::max(most, kLeast);
  std::printf("%s has %.0f MB free: frames of %llu KiB, so that all of them fit\n\n",
              directory().c_str(), static_cast<double>(available) / 1e6,
              static_cast<unsigned long long>(s.bytes >> 10));
}

/// Takes the segment along if killed processes have left it: the last process that leaves removes
/// it. Where the user has named one, the others in there stay.
struct Cleaner {
  const Settings& settings;
  ~Cleaner() {
    try {
      const lot::ShmEngine last(settings.engine());
    } catch (const lot::Error& e) {
      std::fprintf(stderr, "lot_demo: %s\n", e.what());
    }
  }
};

int direct(Settings& s) {
  demo::catch_signals();
  s.segment = "lotdemo_" + std::to_string(getpid());
  fit(s);
  const Cleaner cleaner{s};
  bool good = false;
  if (!s.input.empty()) {
    good = demo::video(s);
  } else {
    good = demo::compare(s);
    good &= demo::crash(s);
#ifdef LOT_DEMO_RECORDS
    good &= demo::record(s);
#endif
  }
  std::printf("\n%s\n", good ? "All is well: nothing lost, nothing leaked."
                             : "FAILED: something was lost or leaked, see above.");
  return good ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("LOT's demo: one camera, five consumers, and what happens when they are killed",
               "lot_demo");
  Settings settings;
  parse(app, settings);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  try {
    return settings.role.empty() ? direct(settings) : play(settings);
  } catch (const demo::Interrupted&) {
    std::fprintf(stderr, "\nstopped; nothing is left behind\n");
    return 130;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "\nlot_demo%s: %s\n",
                 settings.role.empty() ? "" : (" (" + settings.role + ")").c_str(), e.what());
    return 1;
  }
}
