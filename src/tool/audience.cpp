// SPDX-License-Identifier: Apache-2.0
#include "tool/audience.hpp"

#include <algorithm>
#include <chrono>
#include <thread>

namespace lot::tool {
namespace {

using namespace std::chrono_literals;

/// So long it stays for those that have not read yet.
constexpr std::chrono::seconds kForReaders = 1s;

Audience audience_of(const Observation& seen, std::uint32_t me,
                     const std::set<std::string>& topics) {
  Audience found;
  std::set<std::uint32_t> unread;
  for (const Topic& topic : seen.topics) {
    if (!topics.contains(topic.name)) continue;
    found.observers += topic.observers.size();
    std::set<std::uint32_t> looking(topic.subscribers.begin(), topic.subscribers.end());
    looking.insert(topic.observers.begin(), topic.observers.end());
    std::set<std::uint32_t> have_read;
    for (const Channel& channel : seen.channels) {
      if (channel.topic != topic.index || channel.publisher != me) continue;
      for (const Reader& reader : channel.readers) {
        if (!reader.joining && reader.lag == 0) have_read.insert(reader.process);
      }
    }
    for (const std::uint32_t k : looking) {
      const Process* const process = seen.process(k);
      if (process != nullptr && process->alive && !have_read.contains(k)) unread.insert(k);
    }
  }
  found.unread = unread.size();
  return found;
}

}  // namespace

Audience linger(const Where& where, const std::string& segment, std::uint32_t me,
                const std::set<std::string>& topics) {
  const Sight seen = sight(where, segment);
  if (seen.window == nullptr) return {};
  const auto until = std::chrono::steady_clock::now() + kForReaders;
  for (auto pause = 1ms;; pause = std::min(2 * pause, 50ms)) {
    const Audience found = audience_of(observe(*seen.window), me, topics);
    if (found.unread == 0 || std::chrono::steady_clock::now() >= until) return found;
    std::this_thread::sleep_for(pause);
  }
}

std::set<std::string> publishers_of(const Where& where, const std::string& segment,
                                    std::uint32_t me, const std::string& topic) {
  std::set<std::string> names;
  const Sight seen = sight(where, segment);
  if (seen.window == nullptr) return names;
  const Observation all = observe(*seen.window);
  for (const Channel& channel : all.channels) {
    const Topic* const its = all.topic(channel.topic);
    const Process* const process = all.process(channel.publisher);
    const bool publishes = process != nullptr && process->alive && channel.publisher != me;
    if (publishes && its != nullptr && its->name == topic) {
      names.insert(all.who(channel.publisher));
    }
  }
  return names;
}

}  // namespace lot::tool
