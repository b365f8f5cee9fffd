// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "tool/observation.hpp"
#include "tool/rates.hpp"

/// What the topics and processes of a segment do now: the rows of `lot top`.
namespace lot::tool {

/// How large the messages of each queue are. The tool sees the messages that are in a queue when it
/// observes the segment, so of a fast publisher it sees some of them only.
///
/// Threads: one.
class Sizes {
 public:
  /// Notes the messages that have come since the last observation.
  void note(const Observation& seen);
  /// Bytes of a message of this queue, the mean of those seen last; nothing when none was seen.
  std::optional<double> mean(const Channel& channel) const;

 private:
  struct Sum {
    std::uint64_t next = 0;  ///< sequence of the first message that is not in it
    double bytes = 0;
    double messages = 0;
  };
  std::map<std::pair<std::uint32_t, std::uint32_t>, Sum> sums_;  ///< by {channel, generation}
};

/// One topic, or one process.
struct Activity {
  std::string name;
  std::int32_t pid = 0;                    ///< of a process
  std::size_t publishers = 0;              ///< of a process: topics that it publishes on
  std::size_t subscribers = 0;             ///< of a process: topics that it subscribes to
  Rate rate;                               ///< of what is published
  std::optional<double> bytes_per_second;  ///< of what is published
  std::uint64_t memory = 0;  ///< of all messages made for the topic, or by the process
  std::uint64_t lag = 0;     ///< of the subscriber that is furthest behind
  std::uint64_t lost = 0;    ///< the most that a subscriber has lost of its lag
  bool has_stamps = false;   ///< some message has the time of its push
  /// How long the oldest message waits, of all that a subscriber has not finished: seconds since
  /// its push. Nothing: none waits, or its publisher does not stamp.
  std::optional<double> delay;
  std::string state;  ///< what is wrong, or worth knowing; empty: nothing
  bool is_wrong = false;
};

std::vector<Activity> topics_of(const Observation& seen, const Rates& rates, const Sizes& sizes);
std::vector<Activity> processes_of(const Observation& seen, const Rates& rates, const Sizes& sizes);

}  // namespace lot::tool
