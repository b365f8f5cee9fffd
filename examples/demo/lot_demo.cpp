// SPDX-License-Identifier: Apache-2.0
/// Shows what LOT does: one camera process, five consumer processes, beside a plain TCP copy; then
/// what happens when processes are killed. With --input, a real video instead.
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

/// Removes our own segment if killed processes have left it. Not one that the user has named:
/// others may be in it.
struct Cleaner {
  std::string name;
  ~Cleaner() {
    if (std::getenv("LOT_SEGMENT") != nullptr) return;
    const char* directory = std::getenv("LOT_DIR");
    std::error_code ignored;
    for (const auto& entry : std::filesystem::directory_iterator(
             directory != nullptr ? directory : "/dev/shm", ignored)) {
      const std::string file = entry.path().filename().string();
      if (file == name || file.rfind(name + ".", 0) == 0) {
        std::filesystem::remove(entry.path(), ignored);
      }
    }
  }
};

int direct(Settings& s) {
  demo::catch_signals();
  s.segment = "lotdemo_" + std::to_string(getpid());
  const Cleaner cleaner{s.segment};
  bool good = false;
  if (!s.input.empty()) {
    good = demo::video(s);
  } else {
    good = demo::compare(s);
    good &= demo::crash(s);
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
  CLI11_PARSE(app, argc, argv);
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
