// SPDX-License-Identifier: Apache-2.0

// The system's clock is set, by years, while lot::Recorder, lot record and lot play are at work.

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>
#include <lot/recorder.hpp>
#include <lot/recording.hpp>

#include "mcap/reader.hpp"
#include "proof/faults/wall_clock.hpp"
#include "record/clock.hpp"
#include "stage.hpp"
#include "support/janitor.hpp"

namespace {

using namespace lot::testing;
using Steady = std::chrono::steady_clock;

[[maybe_unused]] const bool has_clock = WallClock::take();
[[maybe_unused]] const bool has_janitor = start_janitor();

constexpr std::int64_t kYear = std::int64_t{365} * 24 * 3600 * 1'000'000'000;
constexpr int kYears[] = {10, -30, 0, -5, 20};

/// Says that a case can not be run here.
bool skipped() {
  if (WallClock::lacking().empty()) return false;
  std::printf("skipped: %s\n", WallClock::lacking().c_str());
  return true;
}
/// The clock is right again behind a case.
struct Jumps {
  ~Jumps() { WallClock::set(0); }
};

lot::PusherOptions stamped() {
  lot::PusherOptions options;
  options.stamp = true;
  return options;
}

/// The times of a recording's messages follow each other within what has passed.
void check_times(const std::string& file, std::size_t messages, Steady::duration passed) {
  lot::Recording recording(file);
  CHECK(recording.end() - recording.begin() <= passed);
  auto each = recording.messages();
  lot::RecordedTime last = lot::RecordedTime::min();
  std::size_t number = 0;
  while (const auto message = each.next()) {
    CHECK(message->sequence() == number++);
    CHECK(message->log_time() >= last);
    CHECK(message->publish_time() <= message->log_time());
    CHECK(message->log_time() - message->publish_time() <= passed);
    last = message->log_time();
  }
  CHECK(number == messages);
}

TEST_SUITE_BEGIN("record");

TEST_CASE("lot record while the clock is set: its times are those at which it was all the same") {
  const Watchdog watchdog(120);
  if (skipped()) return;
  const Jumps jumps;
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose", stamped());
  const auto begin = Steady::now();
  Running recorder(stage.record({"/pose"}));
  REQUIRE(recorder.says("writes"));
  std::size_t messages = 0;
  for (const int years : kYears) {
    WallClock::set(years);
    for (int i = 0; i < 10; ++i) {
      put(pusher, i);
      ++messages;
      std::this_thread::sleep_for(2ms);
    }
  }
  CHECK(recorder.interrupt().exit == 0);
  check_times(stage.file(), messages, Steady::now() - begin);
  WallClock::set(0);
  const auto now = std::chrono::system_clock::now();
  const lot::Recording recording(stage.file());
  CHECK(now - recording.end() <= Steady::now() - begin);
}

TEST_CASE("each file of a recording says how far the clock was from its times then") {
  const Watchdog watchdog(120);
  if (skipped()) return;
  const Jumps jumps;
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose", stamped());
  lot::RecorderOptions what;
  what.path = stage.file();
  what.topics = {"*"};
  what.split_bytes = 1;  // a file for each message
  const auto begin = Steady::now();
  lot::Recorder recorder(what, stage.options);
  std::size_t files = 0;
  for (const int years : kYears) {
    WallClock::set(years);
    put(pusher, years);
    ++files;
    REQUIRE(eventually([&] {
      const auto status = recorder.status();
      return status.files.size() == files && !status.topics.empty() &&
             status.topics[0].messages == files;
    }));
  }
  recorder.stop();
  const std::vector<std::string> all = recorder.status().files;
  REQUIRE(all.size() == std::size(kYears));
  for (std::size_t i = 1; i < all.size(); ++i) {  // the first one was made before a jump
    CAPTURE(i);
    lot::mcap::Reader reader(all[i]);
    const auto about = reader.read(reader.metadata().at(0));
    REQUIRE(about.name == "lot.recording");
    const auto ahead = std::stoll(about.pairs.at("system_clock_ahead_ns"));
    CHECK(std::abs(ahead - kYears[i] * kYear) < kYear / 2);
  }
  const lot::Recording recording(all);
  CHECK(recording.end() - recording.begin() <= Steady::now() - begin);
}

TEST_CASE("lot play while the clock is set keeps the distances, and ends") {
  const Watchdog watchdog(120);
  if (skipped()) return;
  const Jumps jumps;
  Stage stage;
  CHECK(stage.record_ten().exit == 0);
  auto puller = stage.engine.subscribe<Pose>("/pose");
  const lot::Recording recording(stage.file());
  const auto begin = Steady::now();
  Running player(stage.play({"--wait", "60", "--rate", "0.1"}));
  for (int i = 0; i < 10; ++i) {
    const auto pose = puller.pull(20s);
    REQUIRE(pose);
    CHECK(pose->x == i);
    WallClock::set(kYears[static_cast<std::size_t>(i) % std::size(kYears)]);
  }
  CHECK(Steady::now() - begin >= 10 * (recording.end() - recording.begin()));
  CHECK(player.finish().exit == 0);
}

TEST_CASE("a recording's clock: before its begin, and before 1970") {
  const Steady::time_point steady(1h);
  const lot::record::Clock clock(5'000'000'000, steady);
  CHECK(clock.at(steady) == 5'000'000'000);
  CHECK(clock.at(steady + 3s) == 8'000'000'000);
  CHECK(clock.at(steady - 3s) == 2'000'000'000);
  CHECK(clock.at(steady - 5s) == 0);
  CHECK(clock.at(steady - 6s) == 0);  // what was pushed before a clock that was set to 1970
}

}  // namespace
