// SPDX-License-Identifier: Apache-2.0
#include <vector>

#include "screen.hpp"
#include "segment/segment.hpp"

namespace demo {
namespace {

using namespace std::chrono_literals;

/// What of the segment is in use, read from outside.
class Memory {
 public:
  explicit Memory(const std::string& path) : segment_(path) {}
  std::uint32_t pages() { return segment_.granules().used(); }

 private:
  lot::segment::Segment segment_;
};

double mib(std::uint32_t pages) { return pages / 256.0; }

/// Kills processes at the worst moments and tells how the others take it.
class Drama {
 public:
  explicit Drama(const Settings& settings)
      : consumer_(settings), camera_(settings), start_(std::chrono::steady_clock::now()) {
    consumer_.role = "ring-consumer";
    camera_.role = "ring-camera";
    consumer_.report_every = camera_.report_every = 5;
    camera_.until_told = true;
  }

  bool play() {
    begin();
    kill_a_consumer();
    kill_the_camera();
    const bool shown = show_a_frame();
    const bool whole = end();
    const bool clean = leave();
    return shown && whole && clean;
  }

 private:
  static constexpr unsigned kVictim = 3;

  template <class... Args>
  void tell(const char* format, Args... args) const {
    const std::chrono::duration<double> t = std::chrono::steady_clock::now() - start_;
    std::printf("  %5.2f s  ", t.count());
    if constexpr (sizeof...(Args) == 0) {
      std::fputs(format, stdout);
    } else {
      std::printf(format, args...);
    }
    std::printf("\n");
    std::fflush(stdout);
  }

  void start_consumer(unsigned number) {
    consumer_.number = number;
    const Child& child = family_.start(consumer_name(number), consumer_);
    family_.wait_until("a consumer joins", [&] { return child.has_said("ready"); });
  }

  /// Until every consumer but `except` has `more` frames more than now.
  void let_run(std::uint64_t more, unsigned except = 0) {
    std::vector<std::uint64_t> goal(kConsumers + 1);
    for (unsigned i = 1; i <= kConsumers; ++i) goal[i] = frames_of(consumer(i)) + more;
    family_.wait_until("the consumers go on", [&] {
      for (unsigned i = 1; i <= kConsumers; ++i) {
        if (i != except && frames_of(consumer(i)) < goal[i]) return false;
      }
      return true;
    });
  }

  Child& consumer(unsigned number) { return family_[consumer_name(number)]; }

  void begin() {
    for (unsigned i = 1; i <= kConsumers; ++i) start_consumer(i);
    path_ = consumer(1).said["ready"].at("path").get<std::string>();
    memory_ = std::make_unique<Memory>(path_);
    pages_before_ = memory_->pages();
    tell("5 consumers have joined %s; messages use %.1f MiB", path_.c_str(), mib(pages_before_));
    family_.start("camera", camera_);
    let_run(15);
    tell("the camera publishes; its frames and queue have %.1f MiB", mib(memory_->pages()));
  }

  void kill_a_consumer() {
    Child& victim = consumer(kVictim);
    victim.kill();
    tell("kill -9 consumer %u, which held %u frames", kVictim, kHeld);
    let_run(15, kVictim);
    tell("the other four have gone on for 15 frames and more");
    start_consumer(kVictim);
    let_run(10);
    tell("consumer %u has been started again, and all five have gone on", kVictim);
  }

  void kill_the_camera() {
    Child& camera = family_["camera"];
    camera.tell(Child::kPause);
    family_.wait_until("the camera pauses", [&] { return camera.has_said("paused"); });
    pushed_first_ = camera.said["paused"].at("pushed").get<std::uint64_t>();
    camera.kill();
    tell("kill -9 the camera between loan and push of frame %llu",
         static_cast<unsigned long long>(pushed_first_ + 1));
    camera_.run = 2;
    const auto restart = std::chrono::steady_clock::now();
    family_.start("camera", camera_);
    family_.wait_until("the new camera's frames come", [&] {
      for (unsigned i = 1; i <= kConsumers; ++i) {
        if (consumer(i).said["at"].at("run") != 2) return false;
      }
      return true;
    });
    const std::chrono::duration<double, std::milli> gap =
        std::chrono::steady_clock::now() - restart;
    tell("the camera has been started again; all five had its first frame after %.0f ms",
         gap.count());
    let_run(15);
    tell("all five go on; frames and queue have %.1f MiB", mib(memory_->pages()));
  }

  /// What any process can see of the topic, by the command `lot`, which does not know the type.
  bool show_a_frame() {
    if (*LOT_COMMAND == '\0') return true;  // built without the command
    tell("lot echo %s --field head --count 1", kTopic);
    const bool shown = echo_a_frame(path_);
    if (!shown) std::printf("           ended badly  <-- WRONG\n");
    return shown;
  }

  bool end() {
    family_["camera"].tell(Child::kStop);
    family_.wait_until("the last frame comes", [&] {
      bool done = family_["camera"].has_said("done");
      for (unsigned i = 1; i <= kConsumers; ++i) done &= consumer(i).has_said("done");
      return done;
    });
    const auto pushed_second = family_["camera"].said["done"].at("sent").get<std::uint64_t>();
    bool whole = true;
    for (unsigned i = 1; i <= kConsumers; ++i) {
      const Json& done = consumer(i).said["done"];
      const auto lost = done.at("lost").get<std::uint64_t>();
      const auto by_run = done.at("received_by_run").get<std::vector<std::uint64_t>>();
      const bool good = lost == 0 && done.at("damaged") == 0 && by_run.size() == 3 &&
                        by_run[2] == pushed_second && (i == kVictim || by_run[1] == pushed_first_);
      std::printf(
          "         consumer %u: %3llu of %llu frames before the kill, %3llu of %llu after it, "
          "lost %llu%s%s\n",
          i, static_cast<unsigned long long>(by_run.size() > 1 ? by_run[1] : 0),
          static_cast<unsigned long long>(pushed_first_),
          static_cast<unsigned long long>(by_run.size() > 2 ? by_run[2] : 0),
          static_cast<unsigned long long>(pushed_second), static_cast<unsigned long long>(lost),
          i == kVictim ? " since its restart" : "", good ? "" : "  <-- WRONG");
      whole &= good;
    }
    return whole;
  }

  bool leave() {
    std::uint32_t pages = 0;
    try {
      family_.wait_until(
          "the memory comes back", [&] { return (pages = memory_->pages()) <= pages_before_; }, 5s);
    } catch (const Interrupted&) {
      throw;
    } catch (const std::runtime_error&) {  // shown below
    }
    const bool back = pages <= pages_before_;
    tell("the camera has left, messages use %.1f MiB, as before: %s", mib(pages),
         back ? "nothing leaked" : "LEAKED");
    family_.dismiss();
    const auto files = files_of(path_);
    tell("all have left: %zu files of the segment are left%s", files.size(),
         files.empty() ? "" : "  <-- WRONG");
    for (const std::string& name : files) std::printf("           %s\n", name.c_str());
    return back && files.empty();
  }

  Family family_;
  Settings consumer_;
  Settings camera_;
  std::chrono::steady_clock::time_point start_;
  std::string path_;
  std::unique_ptr<Memory> memory_;
  std::uint32_t pages_before_ = 0;
  std::uint64_t pushed_first_ = 0;  ///< in the camera's first life
};

}  // namespace

bool crash(const Settings& settings) {
  std::printf("\nNow processes are killed; the others must not notice.\n");
  return Drama(settings).play();
}

}  // namespace demo
