// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
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

/// Opens a file for reading and writing, made with exactly this mode and group if absent; never
/// follows a link. What is there keeps its mode and owner, and must be trusted; with O_EXCL in
/// `flags` it is an error. Throws lot::Error with advice.
int open_private(const std::string& path, const Trust& trust, int flags = 0);

/// "<directory>/<name>", after a check that the name is one. Throws lot::Error.
std::string path_of(const std::string& directory, const std::string& name);

/// What arenas say of the topic that their messages were made for; never 0.
std::uint64_t topic_key(std::string_view name);

/// True when an error says that the file is no good: not that this process could not look at it.
bool means_damage(const Error& e) noexcept;

/// One segment, mapped. All tables are reached through it; nothing here is shared state of its own.
///
/// Absent or complete: a segment is built under a temporary name and renamed in one step, so that
/// nobody ever sees a half-made one. REQUIRES (create, attach, remove): the gate is held.
class Segment {
 public:
  /// Makes a new segment; size 0 takes a default that the directory has room for.
  static void create(const std::string& path, Capacity capacity, const Trust& trust);
  enum class Fit {
    Absent,
    Fits,    ///< complete, of this version, machine and boot, and of the size asked for
    Stale,   ///< a segment, but not one that we can join
    Narrow,  ///< one that fits, and is narrow (Trust::shortfall)
    Foreign  ///< no segment at all: never touched
  };
  /// What is at path; `size` 0 means any. Says why it does not fit in `reason`. Throws lot::Error
  /// when it is not trusted.
  static Fit examine(const std::string& path, std::uint64_t size, const Trust& trust,
                     std::string& reason);
  /// The same for who only looks: opens it for reading.
  static Fit inspect(const std::string& path, const Trust& trust, std::string& reason);
  /// What belongs to other users stays.
  static void remove(const std::string& path, const Trust& trust) noexcept;
  /// False when the path names another file by now, or none.
  bool is_at_its_path() const noexcept;

  enum class Access {
    ReadWrite,
    ReadOnly  ///< REQUIRES: nothing is written through it
  };
  /// Maps the segment at path. Throws lot::Error when it is not one, or not trusted, with the
  /// reason.
  explicit Segment(const std::string& path, Access access = Access::ReadWrite,
                   const Trust& trust = {});
  /// From now on what this process has touched of it is not swapped out, and this process gives no
  /// memory back. Nothing is touched for it. Throws lot::Error, which names the limit.
  void lock_memory();
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
  std::span<ChannelEntry> channels() const noexcept;
  std::span<BlockWords> blocks() const noexcept { return {blocks_, capacity_.blocks}; }
  BlockWords& block(std::uint32_t b) const noexcept { return blocks_[b]; }
  detail::Arena& arena(std::uint32_t b) const noexcept { return arenas_[b]; }
  /// What this process knows of the message that it builds in block b, or has built there.
  detail::Build& build(std::uint32_t b) const noexcept { return builds_[b]; }
  void open_build(std::uint32_t b) const noexcept { build(b).open(arena(b), mapping_.mapping()); }
  /// The block of an arena; one that there is not when it is none of ours.
  std::uint32_t block_of(const detail::Arena& arena) const noexcept {
    const std::uint64_t b = (offset_of(&arena) - geometry_.arenas) / sizeof(detail::Arena);
    return static_cast<std::uint32_t>(std::min<std::uint64_t>(b, capacity_.blocks));
  }
  /// The payload that block b has without any extent.
  unsigned char* small(std::uint32_t b) const noexcept { return small_ + b * kSmallBytes; }
  /// Where the message in block b lies; null when it is said to lie where it cannot be.
  unsigned char* message_at(std::uint32_t b, const detail::MessageType& type) const noexcept {
    if (is_small(type)) return small(b);
    const std::uint64_t root = detail::read_once(arenas_[b].root);
    return root % type.align == 0 && holds(b, root, type.size) ? base_ + root : nullptr;
  }
  std::uint64_t offset_of(const void* p) const noexcept {
    return static_cast<std::uint64_t>(static_cast<const unsigned char*>(p) - base_);
  }

  /// True when these bytes, which begin at an offset that was read from the segment, lie in memory
  /// of block b: in its small payload, or in granules that carry its tag (the first and the last
  /// do).
  bool holds(std::uint32_t b, std::uint64_t offset, std::uint64_t bytes) const noexcept;

  /// The ring of a channel; depth 0 when it was never finished, or its numbers make no sense, or
  /// its memory is not its own.
  Ring ring(std::uint32_t channel) const noexcept;
  /// The same while its maker makes it.
  Ring unformed_ring(std::uint32_t channel) const noexcept;
  /// How many items wait in a channel whose messages are taken: by one reader each, those included
  /// that a worker has and has not finished. 0 for any other channel. A hint while processes work.
  std::uint32_t waiting_items(std::uint32_t channel) const noexcept;
  /// From now on the files stay when the last process leaves.
  void keep_files() noexcept { directory().persists.store(1, std::memory_order_relaxed); }
  bool keeps_files() const noexcept {
    return directory().persists.load(std::memory_order_relaxed) != 0;
  }
  /// The lock of a channel's queue, if it has the mutex engine. REQUIRES: ring(channel) has found
  /// it in order.
  mutex_engine::QueueLock queue_lock(std::uint32_t channel, LockOwner& owner) const noexcept;
  /// Makes it. REQUIRES: the channel is INIT, its memory is claimed, and the caller owns it.
  static void construct_queue_lock(const Ring& ring) noexcept;
  static constexpr std::uint32_t kDeepest = 65536;  ///< slots of a ring
  /// `finished`: with a claim for each slot.
  static std::uint64_t ring_bytes(std::uint32_t depth, std::uint32_t readers,
                                  bool finished) noexcept;

  Granules<Atomics>& granules() noexcept { return granules_; }
  std::uint64_t granule_offset(std::uint32_t granule) const noexcept {
    return geometry_.data + granule * kGranule;
  }
  /// Claims a run for `tag` and makes sure that the system really has the memory. Where the system
  /// has no more, one that has been used before. kNone: there is no run; errno is ENOSPC when it
  /// was the system that had none.
  std::uint32_t claim_run(std::uint32_t granules, std::uint32_t tag) noexcept;
  /// The same for one that nobody waits for: it is mapped for writing, and given up between two
  /// units when go_on() says no, or the system has no more.
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
  /// Makes that writing there faults no page of this process. REQUIRES: the caller has the run, and
  /// no other thread or process writes there meanwhile.
  void map_for_writing(std::uint32_t first, std::uint32_t granules) noexcept;
  /// The same for the granules behind a run that carries `tag`, which then is longer. False: they
  /// are not all free, or the system has none.
  bool extend_run(std::uint32_t end, std::uint32_t granules, std::uint32_t tag) noexcept;
  /// The memory of a run that the caller has stays the segment's for ever.
  void keep_run(std::uint32_t first, std::uint32_t granules) noexcept;
  /// True when the system has given the memory of a run, or would give it. At any time.
  bool can_back_run(std::uint32_t first, std::uint32_t granules) noexcept;
  /// True when the system has given it.
  bool is_backed(std::uint32_t first, std::uint32_t granules) const noexcept;

  // Memory that nobody uses goes back to the system, in the units (units.hpp) from first_unit() to
  // units() - 1.

  /// The first one that has granules alone; before it are the tables.
  std::uint32_t first_unit() const noexcept {
    return static_cast<std::uint32_t>((geometry_.data + kUnit - 1) / kUnit);
  }
  std::uint32_t units() const noexcept { return units_.count(); }
  /// False when it has refused, for this process: memory is locked (mlock), or the file system can
  /// not.
  bool can_give_back() const noexcept { return can_give_back_.load(std::memory_order_relaxed); }
  std::uint64_t bytes_of_unit(std::uint32_t unit) const noexcept;
  /// One look at which of them are in use.
  void look_at_units() noexcept;
  /// So many looks in a row have found it unused, and it is now.
  bool is_unused(std::uint32_t unit, std::uint32_t looks) const noexcept;
  /// Gives the memory of a unit back, if it still is unused. Its granules carry `tag` meanwhile.
  /// Returns the bytes: 0 when it is in use, or the file system can not.
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
  /// From this granule to the end of its unit.
  std::uint32_t left_in_unit(std::uint32_t granule) const noexcept;
  /// REQUIRES: from first_unit() on.
  Run run_of_unit(std::uint32_t unit) const noexcept;
  /// REQUIRES, as all that gets memory: the caller has a granule of each of its units.
  bool back_run(std::uint32_t first, std::uint32_t granules) noexcept;
  bool populate(std::uint32_t unit) noexcept;
  /// 0, or an error: EINVAL where the kernel does not know how.
  int map_unit(std::uint32_t unit) noexcept;

  // Looked at for each message, so close to each other.
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
  /// [units] This process has mapped all of it. Relaxed, a hint: it may have gone and come back by
  /// others.
  std::vector<std::atomic<bool>> mapped_;
};

}  // namespace lot::segment
