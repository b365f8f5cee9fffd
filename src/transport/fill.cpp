// SPDX-License-Identifier: Apache-2.0
#include "transport/fill.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <map>
#include <utility>

#include "transport/participant.hpp"

namespace lot::transport {
namespace {

std::string topic_of(const segment::Segment& segment, std::uint64_t key) {
  if (key == 0) return {};
  for (const segment::TopicEntry& topic : segment.topics()) {
    const std::string_view name(topic.name, strnlen(topic.name, sizeof(topic.name)));
    if (segment::topic_key(name) == key) return std::string(name);
  }
  return "a topic that has gone";
}

/// Granules, by whom they belong to. All words are read once and bounds are checked: others change
/// them meanwhile.
class Fill {
 public:
  explicit Fill(Participant& participant)
      : participant_(participant), segment_(participant.segment()) {
    std::map<std::uint32_t, std::uint32_t> blocks;
    const auto& tags = segment_.granules();
    std::uint32_t run = 0;
    for (std::uint32_t i = 0; i < tags.count(); ++i) {
      const std::uint32_t tag = tags.tag(i);
      run = tag == 0 ? run + 1 : 0;
      largest_ = std::max(largest_, run);
      used_ += tag != 0;
      if (tag != 0 && tag <= participant.blocks()) ++blocks[tag - 1];
    }
    for (const auto& [b, granules] : blocks) enter(b, granules);
  }

  std::uint32_t used() const { return used_; }
  std::uint32_t largest() const { return largest_; }

  /// "412 MiB are of /camera, made by node"
  std::string richest() const {
    const auto most = greatest(made_);
    if (most == made_.end()) return {};
    const auto& [maker, topic] = most->first;
    std::string text = mib(most->second) + " are ";
    text += topic.empty() ? "made without a topic by " : "of " + topic + ", made by ";
    return text + name_of(maker);
  }
  /// "viewer keeps 200 MiB", when a process that has not made them keeps some.
  std::string keeper() const {
    const auto most = greatest(kept_);
    return most == kept_.end() ? "" : name_of(most->first) + " keeps " + mib(most->second);
  }
  bool is_kept_mostly() const {
    const auto most = greatest(kept_);
    return most != kept_.end() && 2 * most->second > used_;
  }

  static std::string mib(std::uint32_t granules) { return std::to_string(granules / 256) + " MiB"; }

 private:
  void enter(std::uint32_t b, std::uint32_t granules) {
    auto& words = segment_.block(b);
    const std::uint32_t home = words.home.load(std::memory_order_relaxed);
    const std::uint64_t key =
        std::atomic_ref(segment_.arena(b).topic).load(std::memory_order_relaxed);
    if (home == refcount::kHomeFree) return;
    made_[{home - 1, topic_of(segment_, key)}] += granules;
    for (std::uint32_t k = 1; k < participant_.participants(); ++k) {
      const auto& own = HardwareOwnership::word(words, k);
      const bool holds =
          (own.load(std::memory_order_relaxed) & HardwareOwnership::bit(k)) != 0 && k != home - 1;
      if (holds) kept_[k] += granules;
    }
  }

  std::string name_of(std::uint32_t k) const {
    if (k == refcount::kOrphanage || k >= participant_.participants()) {
      return "a process that has gone";
    }
    return std::string(participant_.name_of(k)) + " (pid " +
           std::to_string(segment_.participants()[k].pid) + ")";
  }

  template <class Map>
  static typename Map::const_iterator greatest(const Map& map) {
    return std::max_element(map.begin(), map.end(),
                            [](const auto& a, const auto& b) { return a.second < b.second; });
  }

  Participant& participant_;
  segment::Segment& segment_;
  std::uint32_t used_ = 0;
  std::uint32_t largest_ = 0;  ///< granules that are free, side by side
  std::map<std::pair<std::uint32_t, std::string>, std::uint32_t> made_;  ///< by maker and topic
  std::map<std::uint32_t, std::uint32_t> kept_;                          ///< by who keeps them
};

/// `what` needs memory that is not there.
std::string describe(Participant& participant, const std::string& what, int error) {
  const Fill fill(participant);
  std::string text = "lot: " + participant.segment().path() + ": no room for " + what + ": " +
                     Fill::mib(fill.used()) + " of " +
                     Fill::mib(participant.segment().granules().count()) +
                     " are in use, the largest free piece has " + Fill::mib(fill.largest());
  if (error == ENOSPC) text += ", and the file system is full";
  for (const std::string& part : {fill.richest(), fill.keeper()}) {
    if (!part.empty()) text += "; " + part;
  }
  return text + (fill.is_kept_mostly()
                     ? "; let that one keep fewer messages, or raise LOT_SIZE"
                     : "; raise LOT_SIZE, keep fewer messages, or publish with a smaller depth");
}

}  // namespace

std::string describe_shortage(Participant& participant, std::size_t bytes, int error) {
  return describe(participant, std::to_string(bytes) + " bytes", error);
}

std::string describe_ring_shortage(Participant& participant, std::uint32_t topic,
                                   std::uint32_t granules, int error) {
  const segment::TopicEntry& entry = participant.segment().topics()[topic];
  const std::string name(entry.name, strnlen(entry.name, sizeof(entry.name)));
  return describe(participant,
                  "the queue of " + name + ", " +
                      std::to_string(granules * std::uint64_t{segment::kGranule}) + " bytes",
                  error);
}

std::string describe_limit(Participant& participant, std::size_t bytes, std::uint32_t block) {
  const segment::Segment& segment = participant.segment();
  const std::uint64_t key =
      std::atomic_ref(participant.segment().arena(block).topic).load(std::memory_order_relaxed);
  const Pool& pool = participant.holder().pool_of(block);
  return "lot: " + segment.path() + ": no room for " + std::to_string(bytes) +
         " bytes: the publisher of " + topic_of(segment, key) + " has " +
         std::to_string(pool.granules() * segment::kGranule) + " of the " +
         std::to_string(pool.limit() * segment::kGranule) +
         " bytes that PusherOptions::max_bytes gives it, and no message that can go; raise it, "
         "keep fewer messages, or send smaller ones";
}

}  // namespace lot::transport
