// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <string_view>

#include "findings.hpp"
#include "topics.hpp"

/// What the supervisor and the nodes tell each other: in anonymous memory that they share, never
/// through the segment under test.
namespace lot::chaos {

inline constexpr unsigned kMostNodes = 64;
inline constexpr std::uint32_t kIncarnations = 1 << 19;
/// Putters of items that are for one reader: so many, while a segment lives, and so many items
/// each.
inline constexpr std::uint32_t kPutters = 1 << 15;
inline constexpr std::uint32_t kItems = 1 << 10;

/// What a node is about to do, for the table of kills and for the report of stuck nodes.
enum class Doing : std::uint32_t {
  Starting,
  Opening,
  Advertising,
  Subscribing,
  Running,
  Loaning,
  Filling,
  Pushing,
  Looking,
  Reading,
  Finishing,
  Closing,
  Leaving,
};
inline constexpr std::array kDoingNames{
    "starting", "opening", "advertising", "subscribing", "running", "loaning", "filling",
    "pushing",  "looking", "reading",     "finishing",   "closing", "leaving"};

enum class Count : std::uint32_t {
  Opened,
  Advertised,
  InSlots,
  Subscribed,
  Observed,
  Published,
  Refused,
  Received,
  Missed,
  Kept,
  Rechecked,
  Relayed,
  References,
  WeakAlive,
  WeakDead,
  NoMemory,
  HeldTooMuch,
  Closed,
  Taken,
  Finished,
  GivenBack,
  Redelivered,
  TypeRefused,
  TypeChanged,
  kCounts
};
inline constexpr std::array kCountNames{
    "engines opened",
    "advertised",
    "advertised, with messages in their slots",
    "subscribed",
    "subscribed, to look on",
    "published",
    "refused (Full)",
    "received",
    "missed, and told so",
    "kept",
    "checked again before letting go",
    "relayed without a copy",
    "read through a reference",
    "weak, alive",
    "weak, expired",
    "out of memory",
    "kept too much, and told so",
    "books closed: nothing more to read, all accounted for",
    "items taken by one of their readers",
    "tasks finished",
    "tasks given back",
    "tasks delivered again",
    "refused, as the topic carries another type",
    "left, as the topic got another type",
};
static_assert(kCountNames.size() == static_cast<std::size_t>(Count::kCounts));

/// A step towards a checkpoint that all nodes take together.
enum class Stage : std::uint32_t {
  Run,
  Awake,  ///< no node waits for long
  Quiet,  ///< no node publishes
  Settle  ///< everybody reads to the end and lets go of everything
};

/// What NodeRecord::reached says.
constexpr std::uint32_t step_of(std::uint32_t checkpoint, Stage stage) {
  return checkpoint << 2 | static_cast<std::uint32_t>(stage);
}

/// One name under which a node is started again and again.
struct alignas(64) NodeRecord {
  using Ends = std::array<std::atomic<std::uint16_t>, kTopics>;  ///< by topic

  std::atomic<std::uint32_t> life;     ///< how often it has been started
  std::atomic<std::uint32_t> doomed;   ///< 1: the supervisor ends it, or has
  std::atomic<std::uint64_t> beats;    ///< moves with everything it does
  std::atomic<std::uint32_t> doing;    ///< Doing << 16 | topic
  std::atomic<std::uint32_t> reached;  ///< step_of() the last checkpoint that it has reached
  std::atomic<std::uint64_t> serial;   ///< messages made under this name, in all lives
  std::atomic<std::int64_t> taking;    ///< since when it takes an item that has no mark yet, or 0
  Ends pushers;                        ///< that it has now
  Ends pullers;
  Ends observers;
  std::array<std::atomic<std::uint64_t>, static_cast<std::size_t>(Count::kCounts)> counts;
};

/// A publisher from advertise to its end. Its numbers begin with 0.
///
/// `done` <= published <= `begun`, at every moment and after a kill at any moment: begun is raised
/// before a push and done after it, so a publisher that dies leaves at most one message in doubt.
struct alignas(64) Incarnation {
  enum State : std::uint32_t { None, Advertising, Live, Closed };
  std::atomic<std::uint32_t> state;
  std::uint32_t topic;
  std::uint32_t before;  ///< the one before on this topic, or 0
  std::uint32_t slot;    ///< the node
  std::uint32_t life;    ///< of the node
  std::uint32_t depth;
  std::uint32_t blocking;
  std::uint32_t takes_back;  ///< what all have read, where memory runs out
  std::uint32_t putter;      ///< where its items' records are
  std::uint64_t segment;     ///< of one that puts items: the file that they are in
  std::atomic<std::uint64_t> begun;
  std::atomic<std::uint64_t> done;
  /// Items before this one were looked for by a reader of its ring, and are not there.
  std::atomic<std::uint64_t> cleared;
};

/// An item that is for one of its readers.
struct Item {
  static constexpr std::uint32_t kWrittenOff = ~std::uint32_t{0};
  /// Of a task, beside its worker: that one is about to call finish(). By itself: finish() has
  /// returned.
  static constexpr std::uint32_t kFinishing = std::uint32_t{1} << 31;
  std::atomic<std::int64_t> put_at;  ///< just before its put began
  /// {life : 24 | slot + 1 : 8}, kWrittenOff, or 0; of a task, its worker
  std::atomic<std::uint32_t> taken_by;
  std::atomic<std::uint16_t> deliveries;  ///< of a task: as its last worker was told
  std::atomic<std::uint16_t> noted;       ///< of a task: by how many workers
};

/// Under which number a relay publishes a message again: the message itself cannot say it.
struct Relayed {
  std::atomic<std::uint64_t> serial;
  std::atomic<std::uint32_t> incarnation;
  std::atomic<std::uint32_t> number;
};

/// Something that may be for a moment, and must not last.
struct Doubt {
  std::atomic<std::int64_t> since;
  std::atomic<std::uint32_t> looks;

  void forget() {
    since.store(0);
    looks.store(0);
  }
  /// Notes that a look finds it so. True when many looks have, and none other, for longer than
  /// `most`.
  bool lasts(std::chrono::nanoseconds most);
};

struct Report {
  std::atomic<std::uint32_t> written;
  Finding finding;
  std::uint32_t slot;
  std::uint32_t life;
  std::array<char, 400> text;
};

struct Board {
  static constexpr std::uint32_t kReports = 256;
  /// A reader that is this many messages behind its relay is told so by missed() long before.
  static constexpr std::uint64_t kRelayedBack = 4096;
  static constexpr unsigned kProcessors = 256;

  std::atomic<std::uint32_t> stage;               ///< Stage
  std::atomic<std::uint32_t> last_came;           ///< the one that sees whether anything is left
  std::atomic<std::uint32_t> last_alone;          ///< all others have ended
  std::atomic<std::uint32_t> checkpoint;          ///< counts them; what `reached` refers to
  std::atomic<std::uint32_t> incarnations_begun;  ///< the next one; 0 is none
  std::array<std::atomic<std::uint32_t>, kTopics> newest;  ///< incarnation on each topic
  /// By shape: processes are refused, and none is there that has the other type.
  std::array<Doubt, kTopics - kFirstShape> refused;
  std::atomic<std::uint32_t> reports_begun;
  std::atomic<std::int64_t> stalled_at;  ///< when the machine stood still (canary.hpp)
  std::array<std::atomic<std::int64_t>, kProcessors> canary_seen;
  std::array<std::atomic<std::uint32_t>, kFindings> found;
  std::array<NodeRecord, kMostNodes + 1> nodes;  ///< the last: the one that sees what is left
  std::array<Incarnation, kIncarnations> incarnations;
  std::array<std::array<std::array<Relayed, kRelayedBack>, kMostNodes>, kFirstTaken - kFirstRelay>
      relayed;
  std::atomic<std::uint32_t> putters_begun;
  alignas(1 << 16) std::array<std::array<Item, kItems>, kPutters> items;
  std::array<Report, kReports> reports;

  /// A board that forked processes share.
  static Board& make();

  void report(Finding finding, std::uint32_t slot, std::string_view text);
  Relayed& relayed_as(std::uint32_t topic, std::uint64_t serial) {
    return relayed[topic - kFirstRelay][serial >> 56][serial % kRelayedBack];
  }
  Item& item(const Incarnation& r, std::uint64_t number) { return items[r.putter][number]; }
  /// True when this life of a node has not been killed, up to this moment.
  bool lives(std::uint32_t slot, std::uint32_t life) const {
    // In this order: a start sets the life before it takes the doom away.
    return nodes[slot].doomed.load(std::memory_order_acquire) == 0 &&
           nodes[slot].life.load(std::memory_order_acquire) == life;
  }
  /// True when this publisher has not been killed and has not closed, up to this moment.
  bool lives(const Incarnation& r) const {
    return r.state.load(std::memory_order_acquire) == Incarnation::Live && lives(r.slot, r.life);
  }
  /// A new segment: no publisher of before is in it.
  void forget_publishers();
  std::uint64_t total(Count count) const;
  std::uint32_t findings() const;
};

}  // namespace lot::chaos
