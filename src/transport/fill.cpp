// SPDX-License-Identifier: Apache-2.0
#include "transport/fill.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <map>
#include <sys/statvfs.h>
#include <utility>
#include <vector>

#include "transport/memory.hpp"

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

/// What has run out, granules or blocks, by its owners. All words are read once and bounds are
/// checked, since other processes change them meanwhile. Relaxed, wherever this file reads a word:
/// the text says what was there a moment ago.
class Fill {
 public:
  /// Why a part that is in use cannot be evicted for others.
  enum class Why { Kept, Unread, Reserved, InQueue, Loaned, Queues };
  static constexpr std::size_t kWhys = 6;

  Fill(Memory& memory, Shortage shortage)
      : world_(memory.world()),
        neighbours_(memory.neighbours()),
        segment_(memory.segment()),
        shortage_(shortage) {
    std::vector<std::uint32_t> weights(world_.blocks());
    if (shortage == Shortage::Memory) {
      weigh(weights);
    } else {
      total_ = world_.blocks();
      for (std::uint32_t b = 0; b < total_; ++b) {
        weights[b] =
            // Relaxed: see Fill.
            segment_.block(b).home.load(std::memory_order_relaxed) != refcount::kHomeFree ? 1 : 0;
        used_ += weights[b];
      }
    }
    const std::vector<Place> places = look_at_rings();
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) {
      if (weights[b] != 0) enter(b, weights[b], places[b]);
    }
  }

  std::uint32_t used() const { return used_; }
  std::uint32_t total() const { return total_; }
  std::uint32_t largest() const { return largest_; }

  /// "412 MiB are of /camera, made by node"
  std::string richest() const {
    const auto most = greatest(made_);
    if (most == made_.end()) return {};
    const auto& [maker, topic] = most->first;
    std::string text = amount(most->second) + " are ";
    text += topic.empty() ? "made without a topic by " : "of " + topic + ", made by ";
    return text + name_of(maker);
  }
  /// "viewer keeps 200 MiB", when a process keeps some.
  std::string keeper() const {
    const auto most = greatest(kept_);
    return most == kept_.end() ? "" : name_of(most->first) + " keeps " + amount(most->second);
  }
  /// What would make room, besides a larger segment. It depends on what takes most of the memory.
  std::string remedy() const {
    const auto most = std::max_element(whys_.begin(), whys_.end());
    if (*most == 0) return {};
    switch (static_cast<Why>(most - whys_.begin())) {
      case Why::Kept:
        return "let that one keep fewer messages (PullerOptions::max_held_bytes)";
      case Why::Unread:
        return "let who reads or takes from queues without loss be faster, or give those a smaller "
               "depth";
      case Why::Reserved:
        return "reserve() less";
      case Why::InQueue:
        return "have fewer publishers (the newest two messages of each stay), or smaller messages";
      case Why::Loaned:
        return "push or drop what is loaned";
      case Why::Queues:
        return "have fewer publishers, or a smaller depth: their queues have most of it";
    }
    return {};
  }

  std::string amount(std::uint64_t n) const {
    if (shortage_ == Shortage::Blocks) return std::to_string(n) + " blocks";
    constexpr std::uint64_t kInMiB = (std::uint64_t{1} << 20) / segment::kGranule;
    return n < kInMiB ? std::to_string(n * (segment::kGranule >> 10)) + " KiB"
                      : std::to_string(n / kInMiB) + " MiB";
  }

 private:
  enum class Place : std::uint8_t { None, Queue, Lossless };

  void weigh(std::vector<std::uint32_t>& weights) {
    const auto& tags = segment_.granules();
    total_ = tags.count();
    std::uint32_t run = 0;
    for (std::uint32_t i = 0; i < total_; ++i) {
      const std::uint32_t tag = tags.tag(i);
      run = tag == 0 ? run + 1 : 0;
      largest_ = std::max(largest_, run);
      used_ += tag != 0;
      if (tag != 0 && tag <= weights.size()) ++weights[tag - 1];
      if (tag != 0 && tag > weights.size()) ++of(Why::Queues);
    }
  }

  static bool has_readers(const segment::Ring& ring) {
    for (std::uint32_t c = 0; c < ring.readers; ++c) {
      // Relaxed: see Fill.
      if (ring.who[c].load(std::memory_order_relaxed) != 0) return true;
    }
    return false;
  }

  std::vector<Place> look_at_rings() const {
    std::vector<Place> places(world_.blocks());
    for (std::uint32_t c = 0; c < world_.channels(); ++c) {
      const auto state =
          // Acquire: R7.
          ring::writer_state(segment_.channels()[c].writer.load(std::memory_order_acquire));
      if (state != ring::State::Live && state != ring::State::Orphan) continue;
      const segment::Ring ring = segment_.ring(c);
      const bool waits = ring.blocking && (ring.taken || has_readers(ring));
      for (std::uint32_t i = 0; i < ring.depth; ++i) {
        // Relaxed: see Fill.
        const ring::Word b = ring::block(ring.slots[i].load(std::memory_order_relaxed));
        if (b >= places.size()) continue;
        Place& place = places[static_cast<std::size_t>(b)];
        place = std::max(place, waits ? Place::Lossless : Place::Queue);
      }
    }
    return places;
  }

  void enter(std::uint32_t b, std::uint32_t weight, Place place) {
    auto& words = segment_.block(b);
    // Relaxed, here and below: see Fill.
    const std::uint32_t home = words.home.load(std::memory_order_relaxed);
    const std::uint64_t key = detail::read_once(segment_.arena(b).topic);
    if (home == refcount::kHomeFree) return;
    made_[{home - 1, topic_of(segment_, key)}] += weight;
    bool is_kept = false;
    for (std::uint32_t k = 1; k < world_.participants(); ++k) {
      const auto& own = HardwareOwnership::word(words, k);
      // Relaxed: see Fill.
      const bool has = (own.load(std::memory_order_relaxed) & HardwareOwnership::bit(k)) != 0;
      // Its maker has it in any case. It keeps it if a pointer says so.
      if (!has || (k == home - 1 && words.home_points.load(std::memory_order_relaxed) == 0)) {
        continue;
      }
      kept_[k] += weight;
      is_kept = true;
    }
    of(is_kept                                   ? Why::Kept
       : place == Place::Lossless                ? Why::Unread
       : segment::is_reserved(segment_.arena(b)) ? Why::Reserved
       : place == Place::Queue                   ? Why::InQueue
                                                 : Why::Loaned) += weight;
  }

  std::uint32_t& of(Why why) { return whys_[static_cast<std::size_t>(why)]; }

  std::string name_of(std::uint32_t k) const {
    if (k == refcount::kOrphanage || k >= world_.participants()) {
      return "a process that has gone";
    }
    return std::string(world_.name_of(k)) + " (pid " +
           std::to_string(segment_.participants()[k].pid) +
           (neighbours_.is_silent(k) ? ", which does not answer)" : ")");
  }

  template <class Map>
  static typename Map::const_iterator greatest(const Map& map) {
    return std::max_element(map.begin(), map.end(),
                            [](const auto& a, const auto& b) { return a.second < b.second; });
  }

  const World& world_;
  const Neighbours& neighbours_;
  segment::Segment& segment_;
  Shortage shortage_;
  std::uint32_t total_ = 0;
  std::uint32_t used_ = 0;
  std::uint32_t largest_ = 0;                ///< the longest run of free granules
  std::array<std::uint32_t, kWhys> whys_{};  ///< by Why
  std::map<std::pair<std::uint32_t, std::string>, std::uint32_t> made_;  ///< by maker and topic
  std::map<std::uint32_t, std::uint32_t> kept_;  ///< by the process that keeps them
};

/// Puts "; " before each part that is not empty.
std::string list(std::initializer_list<std::string> parts) {
  std::string text;
  for (const std::string& part : parts) {
    if (!part.empty()) text += "; " + part;
  }
  return text;
}

std::string or_else(const std::string& remedy) { return remedy.empty() ? "" : ", or " + remedy; }

/// Describes that `what` needs so much memory, which is not there.
std::string describe(Memory& memory, const Shortfall& shortfall, const std::string& what) {
  const Fill fill(memory, Shortage::Memory);
  const segment::Segment& segment = memory.segment();
  std::string text = "lot: " + segment.path() + ": no room for " + what + ": " +
                     fill.amount(fill.used()) + " of " + fill.amount(fill.total()) +
                     " are in use, the largest free piece has " + fill.amount(fill.largest());
  const bool is_full = shortfall.error == ENOSPC;  // the file system is full
  const std::string directory = segment.path().substr(0, segment.path().rfind('/'));
  std::string remedy = "free memory in " + directory + ", enlarge it, or set LOT_DIR";
  if (is_full) {
    struct statvfs room {};
    const bool is_known = statvfs(directory.c_str(), &room) == 0;
    const std::uint64_t free = std::uint64_t{room.f_bavail} * room.f_frsize / segment::kGranule;
    const bool is_refused = is_known && free >= shortfall.granules;
    text += is_refused ? ", and the system gives no memory" : ", and the file system is full";
    if (is_known) text += ": " + fill.amount(free) + " are free in " + directory;
    if (is_refused)
      remedy =
          "try again; where it stays so, have the sandbox let madvise or fallocate through, or "
          "look "
          "for a quota";
  }
  const bool is_too_large = shortfall.granules > fill.total();
  if (!is_too_large) {
    const std::uint32_t most = memory.longest_run(
        shortfall.asker, static_cast<std::uint32_t>(shortfall.granules), is_full);
    if (most > fill.largest() || is_full) {
      text += "; with messages that may go " + fill.amount(most) + " would have fitted";
    }
  }
  text += list({fill.richest(), fill.keeper()});
  if (is_too_large) return text + "; the whole segment is too small for it: raise LOT_SIZE";
  if (is_full) return text + "; " + remedy;
  return text + "; raise LOT_SIZE" + or_else(fill.remedy());
}

}  // namespace

std::string describe_shortage(Memory& memory, const Shortfall& shortfall, std::size_t bytes) {
  return describe(memory, shortfall, std::to_string(bytes) + " bytes");
}

std::string describe_ring_shortage(Memory& memory, const Shortfall& shortfall,
                                   std::uint32_t topic) {
  const segment::TopicEntry& entry = memory.segment().topics()[topic];
  const std::string name(entry.name, strnlen(entry.name, sizeof(entry.name)));
  const std::uint64_t bytes = std::uint64_t{shortfall.granules} * segment::kGranule;
  return describe(
      memory, shortfall,
      "the queue of " + name + ", " + std::to_string(bytes) + " bytes, fewer with a smaller depth");
}

std::string describe_block_shortage(Memory& memory) {
  const Fill fill(memory, Shortage::Blocks);
  return "lot: " + memory.segment().path() +
         ": no room for a message: " + std::to_string(fill.used()) + " of " +
         fill.amount(fill.total()) + " are in use" + list({fill.richest(), fill.keeper()}) +
         "; make the segment with a larger EngineOptions::blocks" + or_else(fill.remedy());
}

std::string describe_limit(const Holder& holder, std::size_t bytes, std::uint32_t block) {
  const segment::Segment& segment = *holder.segment;
  // The caller has the block, and with it the topic stays.
  const std::uint64_t key = detail::read_once(segment.arena(block).topic);
  const Pool& pool = holder.pool_of(block);
  return "lot: " + segment.path() + ": no room for " + std::to_string(bytes) +
         " bytes: the publisher of " + topic_of(segment, key) + " has " +
         std::to_string(pool.granules() * segment::kGranule) + " of the " +
         std::to_string(pool.limit() * segment::kGranule) +
         " bytes that PusherOptions::max_bytes gives it, and no message that can go; raise it, "
         "keep fewer messages, or send smaller ones";
}

}  // namespace lot::transport
