// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

#include <lot/lot.hpp>

namespace demo {

inline constexpr unsigned kConsumers = 5;
inline constexpr const char* kTopic = "/camera/front";
/// Frames that each consumer keeps while it waits for the next.
inline constexpr unsigned kHeld = 2;

/// What the user asked for, and, in a child process, which part it plays.
struct Settings {
  std::uint32_t frames = 150;
  double hz = 30;
  std::uint64_t bytes = 16 << 20;
  std::uint32_t depth = 16;
  std::uint64_t size = std::uint64_t{1} << 30;  ///< of the segment
  std::string input;
  std::string segment;  ///< name; LOT_SEGMENT comes before it

  std::string role;  ///< empty in the process that the user has started
  unsigned number = 0;
  std::uint32_t run = 1;  ///< counts the lives of the camera
  std::uint16_t port = 0;
  std::uint32_t report_every = 15;
  bool until_told = false;  ///< the camera goes on until it is told to stop
  bool hash = false;        ///< the consumer hashes every frame
  bool mutex = false;       ///< the camera's queue is the other engine

  std::chrono::nanoseconds period() const {
    return std::chrono::nanoseconds(static_cast<std::int64_t>(1e9 / hz));
  }
  lot::EngineOptions engine() const {
    lot::EngineOptions options;
    options.segment = segment;
    options.size_bytes = size;
    options.name = number == 0 ? role : role + std::to_string(number);
    return options;
  }
};

// What the processes do. Each returns its exit code.
int ring_camera(const Settings& settings);
int ring_consumer(const Settings& settings);
int tcp_camera(const Settings& settings);
int tcp_consumer(const Settings& settings);
int video_camera(const Settings& settings);

// What the user sees. False: something was lost or leaked.
bool compare(const Settings& settings);
bool crash(const Settings& settings);
bool video(const Settings& settings);
bool record(const Settings& settings);  ///< needs the command `lot`

}  // namespace demo
