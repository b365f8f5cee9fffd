// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "lot/detail/control.hpp"
#include "lot/detail/described.hpp"
#include "lot/options.hpp"

#include "registry/known_type.hpp"
#include "registry/type_table.hpp"
#include "segment/segment.hpp"

namespace lot::registry {

/// How a process is at a topic.
enum class Role {
  User,     ///< the topic keeps its type while it is there
  Observer  ///< it looks on: others may make the topic anew, with another type
};

/// How a publisher wants its ring.
struct RingOptions {
  std::uint32_t depth = 0;
  std::uint32_t readers = 0;
  Policy policy = Policy::Overwrite;
  QueueEngine engine = QueueEngine::Ring;
  std::uint32_t taken = 0;   ///< ChannelEntry::taken
  std::uint64_t first = 0;   ///< sequence of the first message; 0: the depth
  std::uint32_t extra = 0;   ///< ChannelEntry::extra: zero bytes when the ring is made
  bool stamps = false;       ///< RingHead::stamps
  std::uint16_t stride = 0;  ///< ChannelEntry::stride
};

/// One ring of a topic.
struct ChannelName {
  std::uint32_t channel;
  std::uint32_t generation;
  friend bool operator==(const ChannelName&, const ChannelName&) = default;
};

/// A puller that leaves, and the rings that it knows: no cell there awaits it any more.
struct Departure {
  std::uint32_t topic = 0;
  Role role = Role::User;
  std::vector<ChannelName> known;
};

/// The topics and their rings: which publisher and which puller meet where. All of it is slow path,
/// under one robust lock. A holder of the lock that dies leaves words that are each true by
/// themselves, so there is nothing to repair.
///
/// Edges
///   D1  directory version bump after LIVE -> version load of a puller
///       carries nothing: a puller that finds it changed takes the lock, which carries the new
///       ring.
///   R13 pullers = 0 in unsubscribe() (seq_cst), then the reaper's look at the cells <-> a cell
///       made by open(), then its look at the pullers: see lockfree_ring/ring.hpp.
///   users  a user's bit (release) -> in_use() (acquire)
///       carries: name and type of the topic.
///   pullers  bump in add_puller() (release) -> load in has_pullers() (acquire)
///       carries: what the participant has written before it announced the puller.
class Registry {
 public:
  /// `owner` is the participant in whose name the lock is taken.
  Registry(segment::Segment& segment, LockOwner& owner) : segment_(segment), owner_(owner) {}

  /// The registry's lock, held while this lives. Joiners of rings hold it as well, so that no
  /// process recycles a ring that they join. Throws lot::Error when a stopped process keeps it.
  class Lock {
   public:
    explicit Lock(Registry& registry);
    ~Lock();
    Lock(const Lock&) = delete;
    Lock& operator=(const Lock&) = delete;

   private:
    Registry& registry_;
  };
  /// Takes the lock if it is free, or if its holder is dead.
  bool try_lock() noexcept;
  void unlock() noexcept;

  // The following REQUIRE the lock.

  /// Finds or makes a topic and enters the participant as one of its users or observers. A topic
  /// is there as long as it has users, observers, or items that wait to be taken. One that has
  /// observers only is passed over where the type is another one. Throws lot::Error when the topic
  /// has another type, or the table is full.
  std::uint32_t enter(std::string_view name, const detail::MessageType& type,
                      std::uint32_t participant, Role role = Role::User);
  void leave(std::uint32_t topic, std::uint32_t participant, Role role = Role::User) noexcept;
  /// The type of the topic that has users or items, else of one that is observed. Null: there is no
  /// such topic. Throws as the constructor of KnownType.
  std::shared_ptr<const KnownType> type_of(std::string_view name) const;
  /// The names of all topics that have users.
  std::vector<std::string> names() const;
  /// True when a topic that has only observers was made anew, with another type.
  bool is_superseded(std::uint32_t topic) const;
  /// Announces a puller before it joins the rings that there are. Each ring that is opened later
  /// has a cell for it from the start.
  void add_puller(std::uint32_t topic, std::uint32_t participant) noexcept;

  /// Makes a ring for the participant, with a cell for each puller of the topic, and announces it.
  /// So a message that is published there waits for each puller, however late that one looks, and
  /// even when the publisher has died. Nothing: there is no memory for the ring, and all is as
  /// before; errno says why, as with Segment::claim_run(). Throws lot::Error.
  std::optional<ChannelName> open(std::uint32_t topic, std::uint32_t participant,
                                  const RingOptions& options);
  /// The rings of a topic: those that are live, and those that have ended and are still read.
  std::vector<ChannelName> rings(std::uint32_t topic) const;
  /// True when a reader can join the ring: it is live, or messages wait there to be taken.
  bool is_open(const ChannelName& name) const noexcept;
  /// Takes away the cells that await a puller of the participant, and that puller's announcement.
  void remove(const Departure& departure, std::uint32_t participant) noexcept;
  /// Takes away the announcement of a puller that no cell awaits.
  void remove_puller(std::uint32_t topic, std::uint32_t participant) noexcept;
  /// Gives a ring's memory back. REQUIRES: no process reads or writes it.
  void recycle(std::uint32_t channel) noexcept;

  // Without the lock.

  /// How many granules such a ring takes.
  static std::uint32_t granules_of(const RingOptions& options) noexcept;
  /// True when the participant has pullers on the topic.
  bool has_pullers(std::uint32_t topic, std::uint32_t participant) const noexcept;
  /// The parts of a reap: first the participant has no pullers any more, and then no topics.
  void unsubscribe(std::uint32_t participant) noexcept;
  void forget(std::uint32_t participant) noexcept;

 private:
  /// What a name leads to.
  struct Found {
    segment::TopicEntry* lasting = nullptr;   ///< has users or items; there is one at most
    segment::TopicEntry* observed = nullptr;  ///< has observers only, and the type asked for
    segment::TopicEntry* free = nullptr;
  };
  RobustMutex mutex() const noexcept;
  /// `type`: that of a topic which is only observed. Null: any.
  Found find(std::string_view name, const detail::MessageType* type) const;
  /// The words of the descriptions of all topics that are there.
  std::vector<std::uint64_t> descriptions() const;
  void make_topic(segment::TopicEntry& free, std::string_view name,
                  const detail::MessageType& type);
  /// Gives the topic the names of its fields that this side knows and the topic does not, and a
  /// description with them. REQUIRES: no name differs.
  void name_fields(segment::TopicEntry& topic, const detail::Described& described);
  [[noreturn]] void refuse_type(const segment::TopicEntry& topic,
                                const detail::MessageType& type) const;
  /// For each topic: true when items wait there whose publishers have gone.
  std::vector<bool> topics_with_items() const;
  /// How many pullers the participant has on the topic. Relaxed: the lock carries it.
  std::uint32_t pullers(std::uint32_t topic, std::uint32_t participant) const noexcept;
  /// Says that there is a new ring, and wakes the pullers that wait for one. REQUIRES: the lock, so
  /// that no process recycles a ring meanwhile.
  void announce(std::uint32_t topic) noexcept;

  segment::Segment& segment_;
  LockOwner& owner_;
};

}  // namespace lot::registry
