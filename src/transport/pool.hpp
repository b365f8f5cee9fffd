// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <utility>
#include <vector>

#include "lot/detail/control.hpp"

#include "refcount/ownership.hpp"
#include "segment/segment.hpp"
#include "transport/biased_lock.hpp"
#include "transport/kept_list.hpp"
#include "transport/process_barrier.hpp"

namespace lot::transport {

namespace hold = detail::hold;
using refcount::Left;
using HardwareOwnership = refcount::Ownership<detail::HardwareAtomics>;

class Pool;

/// What a pool needs of its process: hold words, blocks, and the rings' hazards.
struct Holder {
  segment::Segment* segment = nullptr;
  HardwareOwnership own;
  detail::ControlBlock* controls = nullptr;  ///< [blocks]
  const std::vector<std::unique_ptr<Pool>>* pools = nullptr;
  /// [blocks] 1: the message was put into a queue from which one reader takes it. A unique pointer
  /// to it was taken from there. Other processes may still look at its block.
  std::vector<std::atomic<std::uint8_t>> in_queue;
  std::vector<KeptList::Link> kept_links;  ///< [blocks]
  /// [blocks] Used while a publisher's messages are weighed (Eviction). It counts how many places
  /// in the publisher's ring, and how many messages in it that refer to the block, would have gone.
  /// Guarded by Eviction's mutex.
  std::vector<std::uint32_t> leaving;
  /// [blocks] Links a thread's list of blocks that dead messages let go of and that the thread has
  /// still to bring home. The value is the next block plus 2; 1: the last block; 0: the block is on
  /// no list.
  mutable std::vector<std::atomic<std::uint32_t>> home_links;
  std::atomic<std::uint32_t> next_free{0};  ///< hint: where a free block may be found
  /// One more than the highest block that this process ever held: a search for such blocks ends
  /// there.
  mutable std::atomic<std::uint32_t> known{0};

  /// Makes the tables that have one entry for each block. REQUIRES: before the first use.
  void make_tables(std::size_t blocks) {
    in_queue = std::vector<std::atomic<std::uint8_t>>(blocks);
    kept_links.resize(blocks);
    leaving.resize(blocks);
    home_links = std::vector<std::atomic<std::uint32_t>>(blocks);
  }

  segment::BlockWords& words(std::uint32_t b) const noexcept { return segment->block(b); }
  detail::ControlBlock& control(std::uint32_t b) const noexcept { return controls[b]; }
  std::atomic<std::uint8_t>& queued(std::uint32_t b) noexcept { return in_queue[b]; }
  /// True while the block is at home in this process.
  bool is_home(std::uint32_t b) const noexcept {
    // Relaxed: a hint, unless the caller has a hold or the pool's lock, which keep it as it is.
    return (control(b).hold.load(std::memory_order_relaxed) & hold::kHome) != 0;
  }

  /// True when the message of a unique pointer was taken from a queue. Other processes may still
  /// look at its block, though not at the message.
  bool was_received(const detail::ControlBlock& c) const noexcept {
    // Relaxed: the slot that the message was taken from carries it (R1).
    return !is_home(c.block) || in_queue[c.block].load(std::memory_order_relaxed) != 0;
  }

  Pool& pool_of(std::uint32_t b) const noexcept { return pool_of(control(b)); }
  Pool& pool_of(const detail::ControlBlock& control) const noexcept {
    // Relaxed: see ControlBlock::pool.
    return *(*pools)[control.pool.load(std::memory_order_relaxed)];
  }

  /// Brings participant k's warden an errand.
  void ask(std::uint32_t k, std::uint32_t errand) const noexcept;
  /// Tells the home of a block of another participant, which waits for it, that the last hold of
  /// this process has gone.
  void tell_home(std::uint32_t b) const noexcept;

  /// Claims block b, for messages of that topic (its key, or 0). False: it is not free.
  bool claim(std::uint32_t b, std::uint64_t topic) noexcept;
  /// Gives a block back to the segment. REQUIRES: it is exclusively owned, and has no memory.
  void give_back(std::uint32_t b) const noexcept {
    segment->build(b).close();
    own.give_back(words(b), control(b).hold);
  }

  /// Takes a hold of the given kind for this process. REQUIRES: the caller protects the block.
  [[gnu::hot]] void acquire(std::uint32_t b, std::uint64_t amount) const noexcept;
  /// Notes that this process holds, or held, the block.
  void know(std::uint32_t b) const noexcept;
  /// Lets go of a hold of the given kind.
  void release(std::uint32_t b, std::uint64_t amount) const noexcept;
  /// Lets go of what a dead message referred to.
  void release_references(std::uint32_t b) const noexcept;
  /// Freezes a message that is published, if pointers of this process could make it grow.
  void freeze(const detail::ControlBlock& c) const noexcept {
    detail::Arena& arena = segment->arena(c.block);
    if (!arena.is_frozen() && (is_home(c.block) || may_grow(c))) arena.freeze();
  }
  /// Completes a message of this process that no other process has seen yet.
  void complete(std::uint32_t b) const noexcept {
    segment->build(b).trim();
    tell(b);
  }
  /// Writes into the segment where its pieces are.
  void tell(std::uint32_t b) const noexcept {
    if (!segment->arena(b).is_frozen()) segment->build(b).tell();
  }
  /// Freezes what the message refers to, since that is published with it.
  void freeze_references(std::uint32_t b) const noexcept {
    if (segment->arena(b).references != 0) freeze_reachable(b);
  }

 private:
  /// Blocks that the thread that has the list must bring home. The block that came last is first.
  class HomeList {
   public:
    explicit HomeList(const Holder& holder) noexcept : holder_(holder) {}
    bool is_of(const Holder& holder) const noexcept { return &holder_ == &holder; }
    bool empty() const noexcept { return first_ == kEnd; }
    void push(std::uint32_t b) noexcept;
    /// REQUIRES: not empty.
    std::uint32_t pop() noexcept;

   private:
    static constexpr std::uint32_t kEnd = 1;
    const Holder& holder_;
    std::uint32_t first_ = kEnd;
  };

  bool may_grow(const detail::ControlBlock& c) const noexcept;
  void freeze_reachable(std::uint32_t b) const noexcept;
};

/// Blocks, first in, first out. It has room for each block of the segment, so that a push needs no
/// memory. Threads: one at a time; the owner ensures it.
class BlockQueue {
 public:
  explicit BlockQueue(std::uint32_t blocks)
      : blocks_(std::make_unique_for_overwrite<std::uint32_t[]>(blocks)), room_(blocks) {}

  bool empty() const noexcept { return count_ == 0; }
  std::size_t size() const noexcept { return count_; }
  std::uint32_t front() const noexcept { return blocks_[first_]; }
  void pop_front() noexcept {
    if (++first_ == room_) first_ = 0;
    if (--count_ == 0) first_ = 0;  // so it uses few cache lines
  }
  /// A block that is in it twice, because the segment is damaged, may be lost.
  void push_back(std::uint32_t b) noexcept {
    if (count_ == room_) return;
    const std::uint32_t at = first_ + count_++;
    blocks_[at < room_ ? at : at - room_] = b;
  }

 private:
  std::unique_ptr<std::uint32_t[]> blocks_;
  std::uint32_t room_;
  std::uint32_t first_ = 0;
  std::uint32_t count_ = 0;
};

/// Blocks, last in, first out. It has room for each block of the segment, so that a push needs no
/// memory. Threads: one at a time; the owner ensures it.
class BlockStack {
 public:
  explicit BlockStack(std::uint32_t blocks)
      : blocks_(std::make_unique_for_overwrite<std::uint32_t[]>(blocks)), room_(blocks) {}

  bool empty() const noexcept { return count_ == 0; }
  /// REQUIRES, as pop_back(): not empty.
  std::uint32_t back() const noexcept { return blocks_[count_ - 1]; }
  std::uint32_t pop_back() noexcept { return blocks_[--count_]; }
  /// A block that is in it twice, because the segment is damaged, may be lost.
  void push_back(std::uint32_t b) noexcept {
    if (count_ != room_) [[likely]]
      blocks_[count_++] = b;
  }
  /// Takes out each block for which f(block) is true.
  template <class F>
  void take_if(F&& f) noexcept {
    std::uint32_t stays = 0;
    for (std::uint32_t i = 0; i < count_; ++i) {
      if (!f(blocks_[i])) blocks_[stays++] = blocks_[i];
    }
    count_ = stays;
  }

 private:
  std::unique_ptr<std::uint32_t[]> blocks_;
  std::uint32_t room_;
  std::uint32_t count_ = 0;
};

/// The blocks of one publisher. The pool loans them, and takes them back when their messages have
/// died.
///
/// A block stays at home from loan to loan, with its extents: so a loan of a warm block touches no
/// word that another process writes.
///
///     ready   --loan-->  a message is built  --push-->  in the ring
///       ^                                                  | overwritten
///       |                                                  v
///       +--- reclaimed --- free (no hazard) <--scan--- retired (may still be borrowed)
///       |                    | others hold it
///       +--- reclaimed --- kept
///
/// Threads: all members may be called at once, but those marked "locked": these need lock() to be
///          held.
class Pool {
 public:
  Pool(Holder& holder, std::uint32_t index)
      : holder_(holder),
        index_(index),
        ready_(holder.segment->capacity().blocks),
        free_(holder.segment->capacity().blocks),
        kept_(holder.kept_links.data()) {}

  BiasedLock& lock() noexcept { return lock_; }
  /// Sets the topic that the pool will claim blocks for: its key, or 0. REQUIRES: the pool is not
  /// in use.
  void serve(std::uint64_t topic) noexcept {
    const std::lock_guard guard(lock_);
    is_in_use_ = true;
    topic_ = topic;
    // Relaxed, both: the lock carries them, and readers without it take them for hints.
    may_wait_.store(topic != 0, std::memory_order_relaxed);  // a maker has no ring
    // Relaxed: Ahead::expect() comes later in the same thread.
    has_publisher_.store(topic != 0, std::memory_order_relaxed);
    limit(0);
  }

  /// The publisher of the pool has gone. Blocks that come home from now on, from pointers that
  /// outlive it, go back to the segment.
  void close() noexcept {
    const std::lock_guard guard(lock_);
    is_in_use_ = false;
    // Relaxed: Ahead::forget() comes next. It takes Ahead's mutex, which carries it.
    has_publisher_.store(false, std::memory_order_relaxed);
  }

  /// An exclusively owned block for a message of this type, or kNone. Locked.
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};
  std::uint32_t try_loan() { return ready_.empty() ? try_reclaim() : ready_.pop_back(); }
  /// Does as much of the next loan's work as it can, after a publish, when no reader waits for it.
  /// Locked.
  void prepare() noexcept {
    if (!ready_.empty() || free_.empty()) return;
    const std::uint32_t b = free_.front();
    free_.pop_front();
    if (reclaim(b, hold::kRing)) ready_.push_back(b);
  }
  /// Fetches the cache lines that the next loan will write. Locked.
  void fetch_ready() const noexcept {
    if (!ready_.empty()) fetch(ready_.back());
  }
  /// Fetches the cache lines that a loan of this block will write. Does nothing where there is no
  /// such block.
  void prefetch(std::uint64_t b) const noexcept;
  /// A block as by try_loan(), from the free blocks of the segment.
  std::uint32_t claim();

  /// Lays out the arena of an exclusively owned block for a message. Throws OutOfMemory. `waits`:
  /// it waits for memory as long as a message that grows does.
  void* lay_out(detail::ControlBlock& control, const detail::MessageType& type, bool waits) {
    // A small plain message lies where the last message of its type lay in this block.
    if (control.type == &type && is_laid_out_for_ever(type))
      return holder_.segment->small(control.block);
    return lay_out_anew(control, type, waits);
  }

  /// Takes back an exclusively owned block: its message was never shared, or has died.
  void give_back(std::uint32_t b) noexcept { give_back(holder_.control(b)); }
  void give_back(detail::ControlBlock& control) noexcept;
  /// The same for that publisher. Locked. REQUIRES: the message has no destructor to run, and no
  /// memory besides its own bytes.
  void take_back(std::uint32_t b) noexcept { ready_.push_back(b); }
  /// The same while the pool has a publisher. Callable without Lifetime::enter(): that publisher is
  /// one of the participant's handles, so the participant does not wait for its last pointer. When
  /// the handles have gone, the pool has the block, and this thread has touched nothing since it
  /// left the lock. False: there is no publisher, and the caller still has the block.
  bool try_give_back(detail::ControlBlock& control) noexcept {
    destroy_message(control);
    const std::uint32_t b = control.block;
    const std::lock_guard guard(lock_);
    if (is_in_use_) ready_.push_back(b);
    return is_in_use_;
  }
  /// The last hold of this process on a message of the pool has gone.
  void last_hold_gone(std::uint32_t b) noexcept;

  /// A block has left the ring; its hold is still the ring's. Locked. `borrowed` says whether a
  /// reader may still look at it.
  void retire(std::uint32_t b, bool borrowed) { borrowed ? retired_.push_back(b) : let_go(b); }
  /// Makes room to retire so many more blocks. Throws std::bad_alloc, and then all is as before.
  /// Locked.
  void make_room(std::size_t more) {
    // Each retired block may turn out to be foreign, and the same block may be there several times.
    if (const std::size_t n = retired_.size() + foreign_.size() + more; n > room_) [[unlikely]]
      grow(2 * n);
  }
  std::size_t retired() const noexcept { return retired_.size(); }
  /// Takes ring holds on blocks of other pools out, as many as `into` has room for. The caller
  /// releases them after it has unlocked, since their own pools' locks are taken then. Returns how
  /// many. Locked.
  std::size_t take_foreign(std::span<std::uint32_t> into) noexcept;
  /// A message of another pool has left the ring, or the same message has replaced itself. Locked.
  void retire_foreign(std::uint32_t b);
  /// How many blocks only other processes hold. Callable at any time, without the lock.
  std::size_t kept() const noexcept { return kept_.size(); }
  bool has_free() const noexcept { return !ready_.empty() || !free_.empty(); }
  bool has_foreign() const noexcept { return !foreign_.empty(); }
  /// The retired blocks, for the publisher that closes the ring. Locked.
  std::vector<std::uint32_t> take_retired() noexcept {
    room_ = 0;
    return std::exchange(retired_, {});
  }
  /// Frees the retired blocks for which is_protected(block) is false. Locked.
  template <class Protected>
  void scan(Protected&& is_protected);
  /// Looks at all blocks that other processes hold, and at those that are free. Locked.
  void poll_kept();
  /// The same for those that are free only. Locked.
  void poll_free();
  /// Tells the warden whether blocks wait for the publisher's next turn, retired or free. Where the
  /// publisher does not say so each turn, they may wait. Locked. Relaxed, here and below: a hint,
  /// since settle_free() looks with the lock.
  void note_waiting() noexcept {
    may_wait_.store(!retired_.empty() || !free_.empty(), std::memory_order_relaxed);  // a hint
  }
  void note_batches() noexcept { may_wait_.store(true, std::memory_order_relaxed); }    // a hint
  bool may_wait() const noexcept { return may_wait_.load(std::memory_order_relaxed); }  // a hint

  /// Destroys messages that only other processes held, and that no process holds any more.
  void settle() noexcept;
  /// Destroys messages that have left the ring and wait for the publisher's next turn. Those that
  /// other processes still hold become kept ones.
  void settle_free() noexcept;

  /// Marks the block's memory as reserved: it stays with this publisher, whatever other topics
  /// need. REQUIRES: the block is exclusively owned.
  void keep_reserved(std::uint32_t b) noexcept;

  std::uint32_t index() const noexcept { return index_; }

  // The block that was made ahead (ahead.hpp). There is one at most, in a word of its own. So
  // neither the thread that makes it nor the one that takes it needs the lock, and the lock keeps
  // its bias. The word hands the block over: put_ahead() releases, the takers acquire. All other
  // orders here are relaxed, since they are hints.

  /// For Ahead. False for the pool of a maker, and after its publisher has gone.
  bool has_publisher() const noexcept {
    return has_publisher_.load(std::memory_order_relaxed);  // a hint
  }
  bool expects() const noexcept { return expects_.load(std::memory_order_relaxed); }   // a hint
  void expects(bool yes) noexcept { expects_.store(yes, std::memory_order_relaxed); }  // a hint
  /// Takes the exclusively owned block with its memory, or kNone. Acquire: put_ahead().
  std::uint32_t take_ahead() noexcept {
    return ahead_.load(std::memory_order_relaxed) == kNone  // a hint
               ? kNone
               : ahead_.exchange(kNone, std::memory_order_acquire);  // put_ahead()
  }
  // Relaxed: a hint.
  bool has_ahead() const noexcept { return ahead_.load(std::memory_order_relaxed) != kNone; }
  /// Release: what has been built of the block. False: there is one already.
  bool put_ahead(std::uint32_t b) noexcept {
    std::uint32_t none = kNone;
    return ahead_.compare_exchange_strong(none, b, std::memory_order_release,  // see above
                                          std::memory_order_relaxed);
  }
  /// Gives the block that was made ahead back to the segment. True when there was one.
  bool trim_ahead() noexcept {
    return trim_ahead([](std::uint32_t) { return true; });
  }
  /// Gives a block back to the segment that no other thread or process has seen.
  void release(std::uint32_t b) noexcept { release_block(b); }

  // The memory of the pool's blocks, idle ones too: how much its publisher may have, and how much
  // it has. It is counted and not searched for: the counter is private to the process, so no crash
  // leaves it wrong. Relaxed, all of it: the counter guards no data.

  /// Sets PusherOptions::max_bytes; 0: no limit. Messages of an earlier publisher, whose pointers
  /// have outlived it, count as well. Relaxed: the number is all that it tells.
  void limit(std::uint64_t bytes) noexcept {
    limit_.store(bytes == 0 ? kNoLimit : std::max<std::uint64_t>(bytes / segment::kGranule, 1),
                 std::memory_order_relaxed);
  }
  // Relaxed: it only counts.
  std::uint64_t limit() const noexcept { return limit_.load(std::memory_order_relaxed); }
  // Relaxed: it only counts.
  std::uint64_t granules() const noexcept { return granules_.load(std::memory_order_relaxed); }
  /// True if the publisher may have so many granules more. Only a hint: take() decides.
  bool may_take(std::uint64_t granules) const noexcept {
    return this->granules() + granules <= limit();
  }
  /// Counts so many granules, if `spare` more still fit after them. False: it counts none. Threads
  /// that take at once stay within the limit: each one counts a run before it claims it, and takes
  /// the count back when there is none. A claim may last as long as the kernel needs for the
  /// memory.
  bool take(std::uint64_t granules, std::uint64_t spare = 0) noexcept {
    std::uint64_t has = this->granules();
    do {
      if (has + granules + spare > limit()) return false;
      // Relaxed: it only counts.
    } while (!granules_.compare_exchange_weak(has, has + granules, std::memory_order_relaxed));
    return true;
  }
  /// Claims a run of free memory for a block of the pool. The run gets the block's tag. kNoRun:
  /// there is none, and errno says why: 0, ENOSPC (the file system), EDQUOT (the limit).
  std::uint32_t try_claim_run(std::uint32_t granules, std::uint32_t tag) noexcept;
  /// The same for Ahead, which leaves its publisher room for as many granules more. The run is
  /// mapped. It is given up when go_on() says no.
  template <class GoOn>
  std::uint32_t claim_run_while(std::uint32_t granules, std::uint32_t tag, GoOn&& go_on) noexcept {
    if (!take(granules, granules)) return kNoRun;
    const std::uint32_t run = holder_.segment->claim_run_while(granules, tag, go_on);
    if (run == kNoRun) count_out(granules);
    return run;
  }
  static constexpr auto kNoRun = segment::Granules<segment::Atomics>::kNone;
  /// Claims the granules behind a run that a block of the pool has.
  bool extend_run(std::uint32_t end, std::uint32_t granules, std::uint32_t tag) noexcept;
  /// Takes a count back: there was no run, or the run is given back.
  void count_out(std::uint64_t granules) noexcept;
  /// Gives a run of one of its blocks back to the segment.
  void release_run(std::uint32_t first, std::uint32_t granules) noexcept;

  /// Frees what it can. True when nothing is left. For a pool whose publisher has gone.
  bool drain() noexcept;
  /// Gives the memory of idle blocks back to the segment; what reserve() made only if told to. True
  /// when there was some.
  bool trim(bool with_reserved) noexcept;
  /// Says that the spare extents of block b are wanted: those that its last message left and its
  /// new one has not asked for. False: there are none. For any block.
  bool want_spare(std::uint32_t b) noexcept;
  /// Gives the spare extents back to the segment. True when there were some. REQUIRES: this thread
  /// has called want_spare(), and has passed ProcessBarrier since.
  bool take_spare(std::uint32_t b) noexcept;
  /// As trim(), for the blocks that is_old(block) names, except for what reserve() made.
  template <class Old>
  void trim_old(Old&& is_old) noexcept {
    trim_ahead(is_old);
    release_idle([&](std::uint32_t b) {
      return is_old(b) && holder_.segment->build(b).extents != 0 &&
             !segment::is_reserved(holder_.segment->arena(b));
    });
  }

 private:
  template <class May>
  bool trim_ahead(May&& may) noexcept {
    // Relaxed: the compare-and-swap decides, and acquires what put_ahead() has released.
    std::uint32_t b = ahead_.load(std::memory_order_relaxed);
    if (b == kNone || !may(b) ||
        !ahead_.compare_exchange_strong(b, kNone, std::memory_order_acquire,  // put_ahead()
                                        std::memory_order_relaxed)) {
      return false;
    }
    release_block(b);
    return true;
  }
  std::uint32_t try_reclaim();
  /// True if nothing of a message's layout depends on the message.
  static bool is_laid_out_for_ever(const detail::MessageType& type) noexcept {
    return type.plain && segment::is_small(type);
  }
  void* lay_out_anew(detail::ControlBlock& control, const detail::MessageType& type, bool waits);
  /// Destroys a message that has died; the block is exclusively this pool's. Its destructor runs,
  /// its references are let go, and its memory is kept for the next message.
  void destroy_message(detail::ControlBlock& control) noexcept {
    if (control.type == nullptr || !is_laid_out_for_ever(*control.type)) destroy_whole(control);
  }
  void destroy_whole(detail::ControlBlock& control) noexcept;
  void recycle_extents(detail::Build& build) noexcept;
  bool has_spare_in(std::uint32_t b) const noexcept;
  bool is_at_rest_here(std::uint32_t b) const noexcept;
  bool reclaim(std::uint32_t b, std::uint64_t expected) noexcept;
  void keep(std::uint32_t b) noexcept;
  void forget_queue(std::uint32_t b) noexcept;
  void let_go(std::uint32_t b);
  void fetch(std::uint32_t b) const noexcept;
  void grow(std::size_t room);
  template <class May>
  bool release_idle(May&& may) noexcept;
  void release_block(std::uint32_t b) noexcept;

  Holder& holder_;
  std::uint32_t index_;
  /// spare extents may be shared with the process
  const bool may_share_ = ProcessBarrier::is_there();
  std::uint64_t topic_ = 0;
  static constexpr std::uint64_t kNoLimit = ~std::uint64_t{0};
  std::atomic<std::uint64_t> limit_{kNoLimit};  ///< in granules
  std::atomic<std::uint64_t> granules_{0};
  BiasedLock lock_;
  bool is_in_use_ = false;  ///< a publisher or a maker uses it
  BlockStack ready_;
  std::atomic<bool> may_wait_{false};
  BlockQueue free_;  ///< retired and unprotected, still with the ring's hold
  std::vector<std::uint32_t> retired_;
  std::vector<std::uint32_t> foreign_;  ///< left this ring, but belong to other pools
  std::size_t room_ = 0;                ///< the room of retired_, and of foreign_
  KeptList kept_;
  // These lie behind the members that each message reads.
  std::atomic<bool> has_publisher_{false};
  std::atomic<bool> expects_{false};  ///< Ahead knows what its messages are like
  std::atomic<std::uint32_t> ahead_{kNone};
};

/// Gives idle blocks that may(block) names back to the segment. True when there was one.
template <class May>
bool Pool::release_idle(May&& may) noexcept {
  // Released without the lock, since destructors of messages may run. Piece by piece, into an array
  // that exists already: memory of another kind may be short as well.
  bool any = false;
  std::array<std::uint32_t, 64> idle;
  for (std::size_t n = idle.size(); n == idle.size();) {
    n = 0;
    {
      const std::lock_guard guard(lock_);
      ready_.take_if([&](std::uint32_t b) {
        const bool goes = n < idle.size() && may(b);
        if (goes) idle[n++] = b;
        return goes;
      });
    }
    for (std::size_t i = 0; i < n; ++i) release_block(idle[i]);
    any |= n != 0;
  }
  return any;
}

template <class Protected>
void Pool::scan(Protected&& is_protected) {
  std::size_t kept = 0;
  for (const std::uint32_t b : retired_) {
    if (is_protected(b)) {
      retired_[kept++] = b;
    } else {
      retire(b, false);
    }
  }
  retired_.resize(kept);
}

}  // namespace lot::transport
