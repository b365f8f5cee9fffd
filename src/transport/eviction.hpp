// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <span>
#include <vector>

#include "transport/pool.hpp"
#include "transport/survey.hpp"

namespace lot::transport {

/// A publisher that can give messages up.
class Evictor {
 public:
  /// What the messages in its ring weigh: bytes, or, where blocks are short, one a block. Only what
  /// dies counts: no kept message does, and what a message refers to does with the last one that
  /// refers to it, if nothing else has it. What is
  /// reserved counts apart.
  struct Stock {
    std::uint64_t held = 0;      ///< all of them
    std::uint64_t unread = 0;    ///< those of them that nobody gets: readers must not lose them
    std::uint64_t oldest = 0;    ///< the oldest of them, if another topic may have it; else 0
    std::uint64_t reserved = 0;  ///< beside them, what only the publisher itself may give up
    std::uint32_t block = 0;     ///< that `oldest` is in

    /// What the publisher can free for itself.
    std::uint64_t own() const noexcept { return held - unread + reserved; }
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
  /// `unread`: those too that readers have yet to read.
  virtual void mark(bool own, std::uint64_t keep, bool unread,
                    std::vector<bool>& blocks) noexcept = 0;
  /// Gives its oldest message up, whatever it is, for its own need. False: there is none.
  virtual bool give_up() noexcept = 0;
  /// Gives the oldest of its messages that count up to another topic, if that one may have it still
  /// and `keep` remain: since stock() said so a message may have come, or that one may have been
  /// kept. False: not.
  virtual bool give_up_to_other(Shortage shortage, std::uint64_t keep) noexcept = 0;
  /// How long its own need waits for readers of what it must not lose.
  virtual std::chrono::nanoseconds patience() const noexcept { return {}; }

 protected:
  ~Evictor() = default;
};

/// Says whose messages go when memory or blocks run out.
///
/// The asker is the publisher whose loan or whose message grows. It may be a maker without a topic,
/// or a new publisher whose ring needs memory: those have no messages to give.
///
///   1. What can never be met evicts nothing. So first a look over the tags: is there a
///      run of granules that are free, or belong to messages that rules 2 to 4 can free? Free ones
///      that were never used count while the file system has room for them.
///   2. What publishers have left that have gone goes first, but for the newest two of each:
///   readers
///      that had subscribed have not read it. Then the oldest message of the publisher that holds
///      most, in whatever process, while that one keeps at least as much as the asker will have. So
///      publishers end with equal shares. Another process is asked: a ring is changed by its own
///      publisher only; when that has gone, by the process that acts for the orphanage.
///   3. Where no other can give, the asker's own oldest goes, whatever it is. Where it has none,
///      the rest of what publishers have left that have gone.
///   4. For another topic these never go: the newest two messages of a publisher (a latched one is
///      among them), a message in a block that reserve() made, one that is kept or borrowed. Those
///      behind it do. A message whose going frees nothing stays, and so do those behind it. Memory
///      that reserve() made and that is idle stays as well (Pool::trim).
///   5. Of a publisher with Policy::Block or Refuse nothing ever goes that a reader has yet to
///      read. It counts: who waits for slow readers has its share. Tasks that wait for a worker do
///      not go, either. One with Policy::Block waits for readers, its own and others', as for room.
///
/// Weights are counted when there is need, by a walk over the rings. So no push counts anything.
///
/// Threads: all members may be called at once.
/// Memory:  one bit for each block, private to the process; and the survey's.
class Eviction {
 public:
  Eviction(Holder& holder, segment::Segment& segment) : holder_(holder), survey_(segment) {}
  /// REQUIRES: before the first call of the others. `publishers` may come at most.
  void prepare(std::uint32_t blocks, std::uint32_t publishers) {
    marked_.resize(blocks);
    evictors_.reserve(publishers);
    survey_.prepare();
  }

  void add(Evictor& evictor);
  void remove(Evictor& evictor) noexcept;

  /// Each publisher frees what needs no giving up. True: some had something.
  bool settle() noexcept;
  /// Evictor::look() of the publisher with this pool, if it is one that can give messages up.
  std::size_t look(std::uint32_t pool, std::span<std::uint32_t> foreign) noexcept;
  /// Rule 3 alone: the publisher with this pool gives its oldest message up. False: it has none, or
  /// may lose none.
  bool give_up(std::uint32_t pool) noexcept;
  /// How much it would free if it gave up all that it may: bytes or blocks.
  std::uint64_t could_give(std::uint32_t pool, Shortage shortage) noexcept;
  /// True when readers have yet to read something that may go then.
  bool has_unread(Shortage shortage) noexcept;
  /// Evictor::patience() of the publisher with this pool.
  std::chrono::nanoseconds patience(std::uint32_t pool) noexcept;
  /// Looks what the publishers of other processes hold.
  void look_at_others(Shortage shortage) noexcept;
  /// Which other processes give, by participant: those that are stopped do not. Of kOrphanage:
  /// whether ended rings do.
  using Givers = std::array<bool, segment::kMaxParticipants>;
  /// Where the run's memory comes from that the file system has not given yet: it is asked for it;
  /// or it is only said what could be: it would give all, or none.
  enum class Backing { Asked, All, None };
  /// Rule 1, for a run of so many granules. For an asker that waits for readers what they have yet
  /// to read counts, too.
  bool can_free_run(std::uint32_t asker, std::uint32_t granules, const Givers& givers,
                    Backing backing = Backing::Asked) noexcept;

  /// What became of rules 2 to 4.
  struct Turn {
    enum class What { Nothing, Given, Ask, TakeOut } what = What::Nothing;
    std::uint32_t from = 0;   ///< Ask: the participant; TakeOut: the channel of an ended ring
    Request request{};        ///< Ask: for what
    std::uint32_t block = 0;  ///< TakeOut: of the message
  };
  /// One message goes, if it is one of ours. `need`: what the asker will have more, in bytes or
  /// blocks.
  Turn evict(std::uint32_t asker, std::uint64_t need, Shortage shortage,
             const Givers& givers) noexcept;
  /// What another process asks for, or a part of it: that one asks again. True: something was
  /// given.
  bool give(const Request& request) noexcept;

 private:
  bool has_run(std::uint32_t granules, Backing backing) const noexcept;
  /// Of our publishers but `asker`, the one that rule 2 chooses; its stock. REQUIRES: mutex_.
  Evictor* richest(std::uint32_t asker, std::uint64_t keep, Shortage shortage,
                   Evictor::Stock& stock) noexcept;
  /// The survey, which another thread may have made for another shortage. REQUIRES: mutex_.
  Survey& survey(Shortage shortage) noexcept;

  Holder& holder_;
  std::mutex mutex_;
  std::vector<Evictor*> evictors_;
  std::vector<bool> marked_;  ///< by block
  Survey survey_;
};

}  // namespace lot::transport
