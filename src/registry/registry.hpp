// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "lot/detail/control.hpp"
#include "lot/options.hpp"

#include "segment/segment.hpp"

namespace lot::registry {

/// How a publisher wants its ring.
struct RingOptions {
  std::uint32_t depth = 0;
  std::uint32_t readers = 0;
  Policy policy = Policy::Overwrite;
  QueueEngine engine = QueueEngine::Ring;
  bool taken = false;       ///< each message is for one reader, which takes it
  std::uint64_t first = 0;  ///< sequence of the first message; 0: the depth
};

/// One live ring of a topic.
struct ChannelName {
  std::uint32_t channel;
  std::uint32_t generation;
  friend bool operator==(const ChannelName&, const ChannelName&) = default;
};

/// Who talks where: topics and their rings. All of it is slow path, under one robust lock; a holder
/// that dies leaves words that are each true by themselves, so there is nothing to repair.
///
/// Edges
///   D1  directory version bump after LIVE -> version load of a puller
///       carries nothing: who finds it changed takes the lock, which carries the new ring.
///   D2  one puller less (release), after it has left -> pullers load in all_joined (acquire)
///       carries: its free cell. Else its cell would stand for another puller of the process.
class Registry {
 public:
  explicit Registry(segment::Segment& segment) : segment_(segment) {}

  /// The registry's lock, held while this lives. Joiners of rings hold it too, so that no ring is
  /// recycled under them. Throws lot::Error when a stopped process keeps it.
  class Lock {
   public:
    explicit Lock(Registry& registry);
    ~Lock();
    Lock(const Lock&) = delete;
    Lock& operator=(const Lock&) = delete;

   private:
    Registry& registry_;
  };
  bool try_lock() noexcept;
  void unlock() noexcept;

  // The following REQUIRE the lock.

  /// Finds or makes a topic and enters the participant as one of its users. Throws lot::Error when
  /// it has another type, or the table is full.
  std::uint32_t enter(std::string_view name, const detail::MessageType& type,
                      std::uint32_t participant);
  void leave(std::uint32_t topic, std::uint32_t participant) noexcept;
  /// Announces a puller, before it joins the rings that there are: who opens a ring after that
  /// knows of it.
  void add_puller(std::uint32_t topic, std::uint32_t participant) noexcept;

  /// Makes a ring for the participant and announces it. Throws lot::Error or OutOfMemory.
  ChannelName open(std::uint32_t topic, std::uint32_t participant, const RingOptions& options);
  /// The rings of a topic that are live now.
  std::vector<ChannelName> live(std::uint32_t topic) const;
  /// Gives a ring's memory back. REQUIRES: nobody reads or writes it.
  void recycle(std::uint32_t channel) noexcept;

  // Without the lock.

  /// Participant p has pullers on the topic, and does not want its messages another way.
  bool wants(std::uint32_t topic, std::uint32_t participant) const noexcept;
  /// And has said that it needs them no other way.
  bool is_content(std::uint32_t topic, std::uint32_t participant) const noexcept;
  /// The participant itself says the one or the other.
  void decline(std::uint32_t topic, std::uint32_t participant) noexcept;
  void content(std::uint32_t topic, std::uint32_t participant) noexcept;
  /// Takes `content` back, since it is asked anew.
  void ask(std::uint32_t topic, std::uint32_t participant) noexcept;
  void remove_puller(std::uint32_t topic, std::uint32_t participant) noexcept;
  /// Whether all pullers of the topic have joined the ring, or no other one can. Else `late` is who
  /// has not, and may be dead; nobody when the lock was not to be had just now.
  bool all_joined(std::uint32_t topic, const segment::Ring& ring,
                  std::vector<std::uint32_t>& late) noexcept;
  /// No participant uses these any more: part of a reap.
  void forget(std::uint32_t participant) noexcept;

 private:
  /// Says that a ring has come, and wakes who waits for that. REQUIRES: the lock, so that no ring
  /// is recycled meanwhile.
  void announce(std::uint32_t topic) noexcept;

  segment::Segment& segment_;
};

}  // namespace lot::registry
