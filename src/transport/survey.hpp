// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "refcount/ownership.hpp"
#include "segment/segment.hpp"

namespace lot::transport {

/// What has run out.
enum class Shortage { Memory, Blocks };

/// Other topics never get this many of a publisher's newest messages.
inline constexpr std::uint32_t kNewest = 2;

/// What a process that is short asks another one for. It is one word, so that no half of it can be
/// old.
///
///     {blocks : 1 | keep : 31 | need : 32}
///
/// Both count granules, or blocks. The process that is asked gives its oldest messages until `need`
/// is free, while the publisher that gives keeps at least `keep`.
struct Request {
  Shortage shortage = Shortage::Memory;
  std::uint64_t keep = 0;
  std::uint64_t need = 0;

  /// What the warden stores in its place as the answer.
  static constexpr std::uint64_t kGiven = 0;
  static constexpr std::uint64_t kRefused = ~std::uint64_t{0};

  /// Never equal to an answer: `need` is at least 1, and `keep` is less than its greatest value.
  std::uint64_t word() const noexcept {
    const std::uint64_t blocks = shortage == Shortage::Blocks ? 1 : 0;
    return blocks << 63 | std::min(keep, kMostKept - 1) << 32 |
           std::clamp(need, std::uint64_t{1}, kMostNeeded);
  }
  static Request of(std::uint64_t word) noexcept {
    return {(word >> 63) != 0 ? Shortage::Blocks : Shortage::Memory, word >> 32 & kMostKept,
            word & kMostNeeded};
  }

 private:
  static constexpr std::uint64_t kMostKept = 0x7fffffff;
  static constexpr std::uint64_t kMostNeeded = 0xffffffff;
};

/// What publishers of other processes, and publishers that have gone, could give, as far as the
/// shared words say.
///
/// It counts by the granules' tags, since a counter could be wrong after a process is killed. All
/// that it finds are hints: words change meanwhile, and only the publisher itself knows whether a
/// reader looks at a message just now. So the survey chooses which process to ask, and that process
/// decides. What a message refers to counts with the last message of its ring that refers to it, if
/// no other process has it.
///
/// Threads: one at a time.
/// Memory:  private to the process, made once: memory of another kind may be short as well.
class Survey {
 public:
  explicit Survey(segment::Segment& segment) : segment_(segment) {}
  /// REQUIRES: before the first look().
  void prepare();

  struct Publisher {
    std::uint32_t owner = 0;    ///< the participant; kOrphanage: the publisher has gone
    std::uint32_t channel = 0;  ///< the channel of its ring
    std::uint64_t held = 0;     ///< weight of the messages that would die if they left the ring
    std::uint64_t unread = 0;   ///< the part of it that readers must not lose
    /// the weight of the oldest of them, if another topic may have it; else 0
    std::uint64_t oldest = 0;
    std::uint32_t first = 0;  ///< the block of the oldest of them
    /// weight of what they refer to that only a ring of `self` has besides: it would be held if it
    /// left that ring
    std::uint64_t behind = 0;
  };

  /// Weighs the messages of all publishers but those of `self`, in granules or blocks.
  void look(std::uint32_t self, Shortage shortage) noexcept;
  Shortage shortage() const noexcept { return shortage_; }
  /// The publisher that holds most, of those that can give and then keep `keep`, in processes that
  /// may(owner) allows. Null: there is none.
  template <class May>
  const Publisher* richest(std::uint64_t keep, May&& may) const noexcept {
    return best([&](const Publisher& p) {
      return p.owner != refcount::kOrphanage && p.oldest != 0 && p.held - p.oldest >= keep &&
             may(p.owner);
    });
  }
  /// The publisher that has gone and has left most. `all`: also if only its newest messages are
  /// left.
  const Publisher* ended(bool all) const noexcept {
    return best([all](const Publisher& p) {
      return p.owner == refcount::kOrphanage && (all ? p.held : p.oldest) != 0;
    });
  }
  /// Marks the blocks of messages that these publishers may give while each keeps `keep`: those of
  /// processes that may(owner) allows, and those of ended rings if may(kOrphanage) is true.
  /// `unread`: also those that readers have yet to read.
  template <class May>
  void mark(std::uint64_t keep, bool unread, std::vector<bool>& blocks, May&& may) noexcept {
    for (const Publisher& p : publishers_) {
      if (may(p.owner)) mark_of(p, keep, unread, blocks);
    }
  }
  /// True when messages that `self` gives up would weigh with a publisher of a process that
  /// may(owner) allows.
  template <class May>
  bool would_follow(May&& may) const noexcept {
    return std::any_of(publishers_.begin(), publishers_.end(),
                       [&](const Publisher& p) { return p.behind != 0 && may(p.owner); });
  }
  bool has_unread() const noexcept {
    return std::any_of(publishers_.begin(), publishers_.end(),
                       [](const Publisher& p) { return p.unread != 0; });
  }

 private:
  template <class Can>
  const Publisher* best(Can&& can) const noexcept {
    const Publisher* most = nullptr;
    for (const Publisher& p : publishers_) {
      if (can(p) && (most == nullptr || p.held > most->held)) most = &p;
    }
    return most;
  }
  /// Calls f(channel, owner) for each publisher in that state.
  template <class F>
  void each_publisher(ring::State state, F&& f) const noexcept;
  /// Notes a publisher that holds something.
  void weigh(std::uint32_t channel, std::uint32_t owner) noexcept;
  void mark_of(const Publisher& p, std::uint64_t keep, bool unread,
               std::vector<bool>& blocks) noexcept;
  /// A message that dies if it leaves its ring. With it die `follow_`.
  struct Message {
    std::uint32_t block;
    std::uint64_t weight;  ///< with what only it refers to
    std::uint64_t behind;  ///< as Publisher::behind
    std::uint32_t newer;   ///< so many newer ones are in the ring
    bool was_read;         ///< no reader that must not lose it still needs it
  };
  /// Calls f(message) for each message that counts, oldest first, until f says false.
  template <class F>
  void each_that_counts(std::uint32_t channel, std::uint32_t owner, F&& f) noexcept;
  /// Notes what dies with the message, the last one of its ring that refers to it.
  void follow(Message& message, std::uint32_t owner) noexcept;
  /// True when the message dies when it leaves the ring, and is not reserved.
  bool dies(std::uint32_t block, std::uint32_t owner) const noexcept;
  /// Which processes have a message that one of `owner` refers to: `owner` alone; that and a ring
  /// of `self`; or others.
  enum class Had { ByOwner, BySelfToo, ByOthers };
  Had had(std::uint32_t target, std::uint32_t owner) const noexcept;
  std::uint64_t weight_of(std::uint32_t block) const noexcept {
    return shortage_ == Shortage::Blocks ? 1 : granules_[block];
  }

  segment::Segment& segment_;
  Shortage shortage_ = Shortage::Memory;
  std::uint32_t self_ = 0;
  bool some_refer_ = false;                   ///< some message refers to another one
  std::vector<std::uint32_t> granules_;       ///< [blocks] how many granules carry its tag
  std::vector<std::uint32_t> all_referrers_;  ///< [blocks] how many messages refer to it
  std::vector<std::uint32_t> referrers_;      ///< [blocks] the same, of one ring
  std::vector<bool> is_in_live_ring_;         ///< [blocks]
  std::vector<std::uint32_t> follow_;         ///< blocks that die with a message
  std::vector<Publisher> publishers_;
};

}  // namespace lot::transport
