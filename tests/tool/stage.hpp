// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>
#include <lot/recording.hpp>

#include "command.hpp"
#include "support/must_go.hpp"
#include "support/scratch.hpp"

/// What the tests of lot record, lot info and lot play share.
namespace lot::testing {

struct Pose {
  double x = 0;
  ShmString frame;
};

inline void put(ShmPusher<Pose>& pusher, double x) {
  auto pose = pusher.loan();
  pose->x = x;
  pose->frame = "map";
  must_go(pusher.push(std::move(pose)));
}

/// A segment, and a file.
struct Stage {
  std::vector<std::string> record(std::vector<std::string> words) const {
    words.insert(words.begin(), "record");
    words.insert(words.end(), {"-o", file()});
    return on(options, std::move(words));
  }
  std::vector<std::string> play(std::vector<std::string> words) const {
    words.insert(words.begin(), {"play", file()});
    return on(options, std::move(words));
  }
  std::string file() const { return directory.file(); }
  /// Records ten poses, half a tenth of a second apart from each other.
  Ran record_ten() {
    auto pusher = engine.advertise<Pose>("/pose");
    Running recorder(record({"/pose"}));
    REQUIRE(recorder.says("writes"));
    for (int i = 0; i < 10; ++i) {
      put(pusher, i);
      std::this_thread::sleep_for(5ms);
    }
    return recorder.interrupt();
  }

  Room room;
  Directory directory;
  EngineOptions options = room.options();
  ShmEngine engine{options};
};

inline std::vector<std::string> payloads(const std::string& file) {
  Recording recording(file);
  std::vector<std::string> all;
  auto messages = recording.messages();
  while (const auto message = messages.next()) all.push_back(text(message->payload()));
  return all;
}

}  // namespace lot::testing
