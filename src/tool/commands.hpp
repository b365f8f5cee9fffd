// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "lot/duration.hpp"
#include "lot/recorder.hpp"
#include "lot/recording.hpp"
#include "lot/value.hpp"

#include "tool/sight.hpp"

namespace lot::tool {

struct Settings {
  Where where;
  bool json = false;
};

/// Lists what is there: segments, processes, topics, publishers, subscribers, memory.
/// `each`: a row for each end, also where many are alike.
Exit ls(const Settings& settings, std::chrono::milliseconds interval, bool each);
/// Shows what topics and processes do now, and goes on until the user ends it. `only_once`: one
/// screen as text, which it also prints for programs and where there is no terminal.
Exit top(const Settings& settings, std::chrono::milliseconds interval, bool only_once);
/// Lists which process holds which message since when, and which reader is behind. `all`: queued
/// and spare messages too, and a row for each reader and publisher.
Exit who(const Settings& settings, bool all);
struct CleanOptions {
  bool dry_run = false;     ///< only say what would be done
  bool with_items = false;  ///< also remove segments in whose queues items wait
};
/// Reaps the dead and removes segments in which no process lives.
Exit clean(const Settings& settings, const CleanOptions& options);

struct EchoOptions {
  static constexpr std::uint64_t kNoLimit = ~std::uint64_t{0};
  std::string topic;
  std::string field;  ///< a path to what is printed; empty: all
  TextLimits limits;
  bool envelope = false;               ///< also where each message comes from
  std::uint64_t history = 1;           ///< messages of each publisher that are there already
  std::uint64_t count = kNoLimit;      ///< so many, and then it ends
  Duration timeout = Duration::max();  ///< it ends when no message comes for so long
};
/// Prints the messages of a topic, until the user ends it.
Exit echo(const Settings& settings, const EchoOptions& options);

struct PubOptions {
  std::string topic;
  std::string yaml;                    ///< "-": standard input
  std::string like;                    ///< a topic of the same type; empty: none
  std::optional<double> hertz;         ///< none: each message once
  std::optional<std::uint64_t> count;  ///< so many messages
  Duration wait = Duration();          ///< so long it waits for a subscriber
  bool latch = false;                  ///< it stays, for subscribers that come later
};
/// Publishes messages of a topic's type.
Exit pub(const Settings& settings, const PubOptions& options);

struct RecordOptions {
  RecorderOptions what;
  bool has_default_name = false;        ///< `what.path` is one with the time
  Duration duration = Duration::max();  ///< it ends after so long
};
/// Records topics into files, until the user ends it.
Exit record(const Settings& settings, const RecordOptions& options);

struct InfoOptions {
  std::vector<std::string> files;
  bool recover = false;  ///< writes what a recorder that was killed has not written
  bool quick = false;    ///< reads the index, and no chunk
};
/// Says what recordings hold, also damaged ones.
Exit info(const Settings& settings, const InfoOptions& options);

struct PlayOptions {
  std::vector<std::string> files;
  RecordingQuery query;
  std::vector<std::string> except;             ///< topics that are left out
  std::map<std::string, std::string> renamed;  ///< topics, and what they are called here
  double rate = 1;                             ///< so many times as fast
  Duration start = Duration();                 ///< so long behind the first message
  Duration end = Duration::max();              ///< and no message so long behind it
  Duration wait = Duration();                  ///< for a subscriber
  bool loop = false;                           ///< again and again
  bool paused = false;                         ///< it begins with a pause
};
/// Publishes what was recorded.
Exit play(const Settings& settings, const PlayOptions& options);

/// What `lot hz`, `lot bw` and `lot delay` are asked for.
struct GaugeOptions {
  std::string topic;
  std::chrono::milliseconds interval{1000};  ///< between two lines
  std::chrono::nanoseconds window{};         ///< what a line is about
  std::uint64_t count = 0;                   ///< ends after so many messages; 0: does not
  std::chrono::nanoseconds duration{};       ///< ends after so long; 0: does not
  bool each = false;                         ///< a line for each publisher, too
  std::string field;                         ///< the time in the message; empty: that of its push
};
/// Says how often messages come on a topic, until the user ends it. They throw lot::Error.
Exit hz(const Settings& settings, const GaugeOptions& options);
/// Says how many bytes come, and how large the messages are.
Exit bw(const Settings& settings, const GaugeOptions& options);
/// Says how long messages have been under way.
Exit delay(const Settings& settings, const GaugeOptions& options);

/// Looks at the machine, and says what to change. It reads only.
Exit doctor(const Settings& settings);

}  // namespace lot::tool
