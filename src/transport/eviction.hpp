// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <mutex>
#include <span>
#include <vector>

#include "transport/pool.hpp"

namespace lot::transport {

/// What has run out.
enum class Shortage { Memory, Blocks };

/// A publisher that can give messages up.
class Evictor {
 public:
  /// What the messages in its ring weigh: bytes, or, where blocks are short, one a block. Only what
  /// dies counts: no kept message does, and what a message refers to does with the last one that
  /// refers to it, if nothing else has it.
  struct Stock {
    std::uint64_t held = 0;    ///< all of them
    std::uint64_t oldest = 0;  ///< the oldest, if another topic may have it; else 0
  };

  /// The index of its pool: it names the publisher.
  virtual std::uint32_t pool() const noexcept = 0;
  /// Frees what needs no giving up: messages that were taken, or overwritten. True: some.
  virtual bool settle() noexcept = 0;
  /// Looks which of the messages that have left its ring are free of readers. What is not its
  /// pool's comes out: the caller lets go of it. Returns how many; as many as there is room for:
  /// again.
  virtual std::size_t look(std::span<std::uint32_t> foreign) noexcept = 0;
  virtual Stock stock(Shortage shortage) noexcept = 0;
  /// Marks the blocks that the rule can free: all, or the oldest, while `keep` bytes remain.
  virtual void mark(bool own, std::uint64_t keep, std::vector<bool>& blocks) noexcept = 0;
  /// Gives its oldest message up, whatever it is, for its own need. False: there is none.
  virtual bool give_up() noexcept = 0;
  /// Gives its oldest message up to another topic, if that one may have it still and `keep` remain:
  /// since stock() said so a message may have come, or the oldest may have been kept. False: not.
  virtual bool give_up_to_other(Shortage shortage, std::uint64_t keep) noexcept = 0;

 protected:
  ~Evictor() = default;
};

/// Says whose messages go when memory or blocks run out. It speaks for one process.
///
/// The asker is the publisher whose loan or whose message grows. It may be a maker without a topic,
/// which has no messages to give.
///
///   1. What can never be met evicts nothing. So first a look over the tags: is there an aligned
///      run of granules that are free, or belong to messages that rules 2 to 4 can free? Free ones
///      that were never used count while the file system has room for them.
///   2. The oldest message goes of the publisher that holds most, while that one keeps at least as
///      much as the asker will have. So publishers end with equal shares.
///   3. Where no other can give, the asker's own oldest goes, whatever it is.
///   4. For another topic these never go: the newest two messages of a publisher (a latched one is
///      among them), a message in a block that reserve() made, one that is kept or borrowed, or
///      whose going frees nothing. When it is the oldest, those behind it stay, too. Memory that
///      reserve() made and that is idle stays as well (Pool::trim).
///
/// Weights are counted when there is need, by a walk over the rings. So no push counts anything.
///
/// Threads: all members may be called at once.
/// Memory:  one bit for each block, private to the process.
class Eviction {
 public:
  explicit Eviction(Holder& holder) : holder_(holder) {}
  /// REQUIRES: before the first call of the others. `publishers` may come at most.
  void prepare(std::uint32_t blocks, std::uint32_t publishers) {
    marked_.resize(blocks);
    evictors_.reserve(publishers);
  }

  void add(Evictor& evictor);
  void remove(Evictor& evictor) noexcept;

  /// Each publisher frees what needs no giving up. True: some had something.
  bool settle() noexcept;
  /// Evictor::look() of the publisher with this pool, if it is one that can give messages up.
  std::size_t look(std::uint32_t pool, std::span<std::uint32_t> foreign) noexcept;
  /// Rule 1, for a run of 2^order granules.
  bool can_free_run(std::uint32_t asker, unsigned order) noexcept;
  /// Rules 2 to 4: one message goes. `need`: what the asker will have more. False: none may go.
  bool evict(std::uint32_t asker, std::uint64_t need, Shortage shortage) noexcept;

 private:
  bool has_run(unsigned order) const noexcept;

  Holder& holder_;
  std::mutex mutex_;
  std::vector<Evictor*> evictors_;
  std::vector<bool> marked_;  ///< by block
};

}  // namespace lot::transport
