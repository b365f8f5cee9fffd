// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <sys/types.h>
#include <vector>

#include <boost/interprocess/mapped_region.hpp>

#include "lot/detail/mapping.hpp"
#include "lot/error.hpp"

#include "segment/granules.hpp"
#include "segment/layout.hpp"
#include "segment/trust.hpp"
#include "segment/units.hpp"

namespace lot::segment {

/// Opens a file for reading and writing. Makes it with exactly this mode and group if it is absent.
/// Never follows a link. A file that is there keeps its mode and owner, and must be trusted. With
/// O_EXCL in `flags` a file that is there is an error. Throws lot::Error with advice.
int open_private(const std::string& path, const Trust& trust, int flags = 0);

/// Whether a segment can have this name.
bool is_name(std::string_view name) noexcept;
/// "<directory>/<name>". Throws lot::Error for a name that no segment can have.
std::string path_of(const std::string& directory, const std::string& name);

/// The number by which arenas name the topic that their messages were made for. Never 0.
std::uint64_t topic_key(std::string_view name);

/// True when an error says that the file is damaged, and not that this process could not look at
/// it.
bool means_damage(const Error& e) noexcept;

/// One segment, mapped. All tables are reached through it. It has no shared state besides them.
///
/// A segment is absent or complete: its maker builds it under a temporary name and renames it in
/// one step, so that no process sees an unfinished one. REQUIRES: the gate is held for create(),
/// for remove(), and where a process maps the segment to join it.
class Segment {
 public:
  /// Makes a new segment. Size 0 means a default for which the directory has room.
  static void create(const std::string& path, Capacity capacity, const Trust& trust);
  enum class Fit {
    Absent,
    Fits,    ///< complete, of this version, machine and boot, and of the size asked for
    Stale,   ///< a segment, but not one that we can join
    Narrow,  ///< a segment that fits, and is narrow (Trust::shortfall)
    Foreign  ///< no segment at all: never touched
  };
  /// What is at path; `size` 0 means any. Says in `reason` why it does not fit. Throws lot::Error
  /// when it is not trusted.
  static Fit examine(const std::string& path, std::uint64_t size, const Trust& trust,
                     std::string& reason);
  /// As examine(), for a process that only looks: opens the segment for reading.
  static Fit inspect(const std::string& path, const Trust& trust, std::string& reason);
  /// Removes the segment and an unfinished one. Leaves files of users that are not trusted.
  static void remove(const std::string& path, const Trust& trust) noexcept;
  /// Why it is not a segment of `wanted` bytes; "" where it is. 0: any size will do.
  std::string other_size(std::uint64_t wanted) const;
  /// False when the path names another file by now, or none.
  bool is_at_its_path() const noexcept;

  enum class Access {
    ReadWrite,
    ReadOnly  ///< REQUIRES: no code writes through it
  };
  /// Maps the segment at path. Throws lot::Error, with the reason, when it is no segment or not
  /// trusted.
  explicit Segment(const std::string& path, Access access = Access::ReadWrite,
                   const Trust& trust = {});
  /// From now on the system does not swap out the pages that this process touches, and this process
  /// gives no memory back. It touches no page itself. Throws lot::Error, which names the limit.
  void lock_memory();
  // Relaxed: a flag that tells nothing else.
  bool is_locked() const noexcept { return is_locked_.load(std::memory_order_relaxed); }

  const std::string& path() const noexcept { return path_; }
  const Header& header() const noexcept { return *reinterpret_cast<const Header*>(base_); }
  const Capacity& capacity() const noexcept { return capacity_; }
  unsigned char* base() const noexcept { return base_; }
  std::uint64_t size() const noexcept { return capacity_.size; }

  std::span<ParticipantEntry> participants() const noexcept;
  std::span<Witness> witnesses() const noexcept;
  std::span<Sightings> sightings() const noexcept;
  Directory& directory() const noexcept;
  std::span<TopicEntry> topics() const noexcept;
  std::span<Replies> replies() const noexcept;  ///< by topic
  /// The table of descriptions, in words of 8 bytes.
  std::span<std::uint64_t> descriptions() const noexcept;
  std::span<ChannelEntry> channels() const noexcept;
  std::span<Listeners> listeners() const noexcept;  ///< by channel
  /// REQUIRES: e < ring::kEars.
  Ear ear(std::uint32_t e) const noexcept;
  /// Tells the ears that listen to a ring that it has news, and calls wake(bell, is_asleep) for
  /// each. The caller has changed the word in which the listeners have left their marks.
  template <class Wake>
  void ring_ears(std::uint32_t channel, Wake&& wake) const noexcept {
    if (channel >= capacity_.channels) return;
    listeners()[channel].each([&](std::uint32_t e) {
      Ear told = ear(e);
      const bool is_asleep = told.tell(channel);
      wake(&told.words->bell.word(), is_asleep);
    });
  }
  /// The same, and wakes those that are asleep.
  void ring_ears(std::uint32_t channel) const noexcept;
  /// Takes an ear for a wait set. None: there is no free one.
  std::optional<std::uint32_t> claim_ear(std::uint32_t participant) const noexcept;
  /// The ear listens to no ring any more, and no participant owns it.
  void free_ear(std::uint32_t e) const noexcept;
  /// The same of all ears of the participant. REQUIRES: it is dead, or is the caller, which leaves.
  ///
  /// Crash: may be repeated.
  void free_ears(std::uint32_t participant) const noexcept;
  std::span<BlockWords> blocks() const noexcept { return {blocks_, capacity_.blocks}; }
  BlockWords& block(std::uint32_t b) const noexcept { return blocks_[b]; }
  detail::Arena& arena(std::uint32_t b) const noexcept { return arenas_[b]; }
  /// The private data of this process about the message that it builds or has built in block b.
  detail::Build& build(std::uint32_t b) const noexcept { return builds_[b]; }
  void open_build(std::uint32_t b) const noexcept { build(b).open(arena(b), mapping_.mapping()); }
  /// The block of an arena. capacity().blocks, which is no block, for an arena elsewhere.
  std::uint32_t block_of(const detail::Arena& arena) const noexcept {
    const std::uint64_t b = (offset_of(&arena) - geometry_.arenas) / sizeof(detail::Arena);
    return static_cast<std::uint32_t>(std::min<std::uint64_t>(b, capacity_.blocks));
  }
  /// The payload that block b has without any extent.
  unsigned char* small(std::uint32_t b) const noexcept { return small_ + b * kSmallBytes; }
  /// Where the message in block b lies. Null when its arena names a place where it cannot be.
  unsigned char* message_at(std::uint32_t b, const detail::MessageType& type) const noexcept {
    if (is_small(type)) return small(b);
    const std::uint64_t root = detail::read_once(arenas_[b].root);
    return root % type.align == 0 && holds(b, root, type.size) ? base_ + root : nullptr;
  }
  std::uint64_t offset_of(const void* p) const noexcept {
    return static_cast<std::uint64_t>(static_cast<const unsigned char*>(p) - base_);
  }

  /// True when these bytes lie in memory of block b: in its small payload, or in granules whose
  /// first and last one carry its tag. The offset may have been read from the segment.
  bool holds(std::uint32_t b, std::uint64_t offset, std::uint64_t bytes) const noexcept;

  /// The ring of a channel. Its depth is 0 when its maker has not finished it, when its numbers
  /// make no sense, or when its memory belongs to another owner.
  Ring ring(std::uint32_t channel) const noexcept;
  /// The first bytes of its memory. REQUIRES: its depth is not 0.
  static RingHead& head_of(const Ring& ring) noexcept {
    return *reinterpret_cast<RingHead*>(ring.roster);
  }
  /// As ring(), also while the ring's maker makes it.
  Ring unformed_ring(std::uint32_t channel) const noexcept;
  /// How many items wait in a channel whose messages are each for one reader. Counts those that a
  /// worker has and has not finished. 0 for any other channel. A hint while processes work.
  std::uint32_t waiting_items(std::uint32_t channel) const noexcept;
  /// From now on the files stay when the last process leaves. Relaxed: see Directory::persists.
  void keep_files() noexcept { directory().persists.store(1, std::memory_order_relaxed); }
  bool keeps_files() const noexcept {
    return directory().persists.load(std::memory_order_relaxed) != 0;  // see Directory::persists
  }
  /// The lock of a channel's queue, if it has the mutex engine. REQUIRES: ring(channel) has found
  /// the channel in order.
  mutex_engine::QueueLock queue_lock(std::uint32_t channel, LockOwner& owner) const noexcept;
  /// Makes that lock. REQUIRES: the channel is INIT, its memory is claimed, and the caller owns it.
  static void construct_queue_lock(const Ring& ring) noexcept;
  static constexpr std::uint32_t kDeepest = 65536;  ///< the most slots of a ring
  /// What the slots of a ring are like.
  struct SlotShape {
    std::uint32_t depth;
    std::uint16_t stride;  ///< ChannelEntry::stride
    bool has_spare;        ///< where messages are in the slots: one slot more than `depth`
    /// How many there are: Ring::places().
    std::uint32_t places() const noexcept { return depth + (stride != 0 && has_spare ? 1 : 0); }
    std::uint64_t bytes() const noexcept;
  };
  /// The memory of a ring. `finished`: with a claim for each slot. `extra`: bytes of extra memory
  /// for each reader.
  static std::uint64_t ring_bytes(const SlotShape& slots, std::uint32_t readers, bool finished,
                                  std::uint32_t extra) noexcept;

  Granules<Atomics>& granules() noexcept { return granules_; }
  std::uint64_t granule_offset(std::uint32_t granule) const noexcept {
    return geometry_.data + granule * kGranule;
  }
  /// Claims a run for `tag` and makes sure that the system really has the memory. Where the system
  /// has no more, it claims a run that has been used before. kNone: there is no run; errno is
  /// ENOSPC when the system had no memory.
  std::uint32_t claim_run(std::uint32_t granules, std::uint32_t tag) noexcept;
  /// As claim_run(), for a run that no thread waits for. Maps it for writing as well. Gives it up
  /// between two units when go_on() says no, or when the system has no more memory.
  template <class GoOn>
  std::uint32_t claim_run_while(std::uint32_t granules, std::uint32_t tag, GoOn&& go_on) noexcept {
    const std::uint32_t run = granules_.claim(granules, tag);
    if (run == Granules<Atomics>::kNone) return run;
    for (std::uint32_t done = 0; done < granules;) {
      const std::uint32_t piece = std::min(granules - done, left_in_unit(run + done));
      if (!go_on() || !back_run(run + done, piece)) {
        granules_.release(run, granules);
        return Granules<Atomics>::kNone;
      }
      map_for_writing(run + done, piece);
      done += piece;
    }
    return run;
  }
  /// Maps a run, so that a write there causes no page fault in this process. REQUIRES: the caller
  /// has the run, and no other thread or process writes there meanwhile.
  void map_for_writing(std::uint32_t first, std::uint32_t granules) noexcept;
  /// As claim_run(), for the granules behind a run that carries `tag`: the run is longer then.
  /// False: they are not all free, or the system has no memory.
  bool extend_run(std::uint32_t end, std::uint32_t granules, std::uint32_t tag) noexcept;
  /// The memory of a run that the caller has stays the segment's for ever.
  void keep_run(std::uint32_t first, std::uint32_t granules) noexcept;
  /// True when the system has given the memory of a run, or would give it. Any process may ask at
  /// any time.
  bool can_back_run(std::uint32_t first, std::uint32_t granules) noexcept;
  /// True when the system has given the memory of a run.
  bool is_backed(std::uint32_t first, std::uint32_t granules) const noexcept;

  // Memory that no process uses goes back to the system, in the units (units.hpp) from first_unit()
  // to units() - 1.

  /// The first unit that has only granules. Before it are the tables.
  std::uint32_t first_unit() const noexcept {
    return static_cast<std::uint32_t>((geometry_.data + kUnit - 1) / kUnit);
  }
  std::uint32_t units() const noexcept { return units_.count(); }
  /// False when the system has refused it to this process: the memory is locked (mlock), or the
  /// file system cannot do it. Relaxed: a hint.
  bool can_give_back() const noexcept { return can_give_back_.load(std::memory_order_relaxed); }
  std::uint64_t bytes_of_unit(std::uint32_t unit) const noexcept;
  /// One look at which of the units are in use.
  void look_at_units() noexcept;
  /// True when `looks` looks in a row have found the unit unused, and it is unused now.
  bool is_unused(std::uint32_t unit, std::uint32_t looks) const noexcept;
  /// Gives the memory of a unit back, if the unit is still unused. Its granules carry `tag`
  /// meanwhile. Returns the bytes: 0 when the unit is in use, or the file system cannot do it.
  std::uint64_t give_back(std::uint32_t unit, std::uint32_t looks, std::uint32_t tag) noexcept;

 private:
  template <class T>
  T* at(std::uint64_t offset) const noexcept {
    return reinterpret_cast<T*>(base_ + offset);
  }
  struct Run {
    std::uint32_t first, granules;
  };
  std::uint32_t unit_of(std::uint32_t granule) const noexcept;
  /// How many granules there are from this one to the end of its unit.
  std::uint32_t left_in_unit(std::uint32_t granule) const noexcept;
  /// REQUIRES: the unit is first_unit() or a later one.
  Run run_of_unit(std::uint32_t unit) const noexcept;
  /// REQUIRES, as all functions that get memory: the caller has a granule of each of its units.
  bool back_run(std::uint32_t first, std::uint32_t granules) noexcept;
  bool populate(std::uint32_t unit) noexcept;
  /// 0, or an error: EINVAL where the kernel does not know the call.
  int map_unit(std::uint32_t unit) noexcept;

  // Each message needs these, so they lie close to each other.
  unsigned char* base_ = nullptr;
  BlockWords* blocks_ = nullptr;
  detail::Arena* arenas_ = nullptr;
  detail::Build* builds_ = nullptr;
  unsigned char* small_ = nullptr;
  Capacity capacity_;
  Geometry geometry_{};
  std::string path_;
  boost::interprocess::mapped_region region_;
  detail::Mapping::Scope mapping_;
  Granules<Atomics> granules_;
  Units<Atomics> units_;
  std::atomic<bool> can_give_back_{true};  ///< the file system has not refused yet
  std::atomic<bool> is_locked_{false};
  /// [units] True when this process has mapped the whole unit. Relaxed: a hint. Other processes may
  /// have given the unit back and got it again.
  std::vector<std::atomic<bool>> mapped_;
};

}  // namespace lot::segment
