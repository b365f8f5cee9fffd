// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <span>
#include <vector>

#include "lot/detail/mutex.hpp"

#include "transport/pool.hpp"
#include "transport/survey.hpp"

namespace lot::transport {

/// A publisher that can give messages up.
class Evictor {
 public:
  /// What the messages in its ring weigh: bytes, or, where blocks are short, one for each block.
  /// Only what dies counts. A kept message does not. What a message refers to counts with the last
  /// message that refers to it, if nothing else has it, whatever process has made it. What is
  /// reserved counts apart.
  struct Stock {
    std::uint64_t held = 0;    ///< all messages that count
    std::uint64_t unread = 0;  ///< those of them that stay, since readers must not lose them
    /// the oldest of them that frees something, if another topic may have its memory; else 0
    std::uint64_t oldest = 0;
    std::uint64_t reserved = 0;  ///< besides them, what only the publisher itself may give up
    std::uint32_t block = 0;     ///< what goes next: that one, or an older one that frees nothing
    std::uint64_t frees = 0;     ///< what that frees

    /// What the publisher can free for itself.
    std::uint64_t own() const noexcept { return held - unread + reserved; }
  };

  /// The index of its pool, which names the publisher.
  virtual std::uint32_t pool() const noexcept = 0;
  /// Frees what needs no giving up: messages that were taken, or overwritten. True: there were
  /// some.
  virtual bool settle() noexcept = 0;
  /// Looks which of the messages that have left its ring are free of readers. Blocks of other pools
  /// come out in `foreign`, and the caller releases them. Returns how many. If it is as many as
  /// there is room for, the caller calls again.
  virtual std::size_t look(std::span<std::uint32_t> foreign) noexcept = 0;
  virtual Stock stock(Shortage shortage) noexcept = 0;
  /// Marks the blocks that the rules can free: all (`own`), or the oldest, while `keep` bytes
  /// remain. `unread`: also those that readers have yet to read.
  virtual void mark(bool own, std::uint64_t keep, bool unread,
                    std::vector<bool>& blocks) noexcept = 0;
  /// Gives up its oldest message, whatever it is, for its own need. False: there is none.
  virtual bool give_up() noexcept = 0;
  /// Gives up the oldest of its messages that count, for another topic. False: that message may not
  /// go any more, or less than `keep` would remain. Since stock() said so, a message may have come,
  /// or that one may have been kept.
  virtual bool give_up_to_other(Shortage shortage, std::uint64_t keep) noexcept = 0;
  /// How long its own need waits for readers of what it must not lose.
  virtual std::chrono::nanoseconds patience() const noexcept { return {}; }

 protected:
  ~Evictor() = default;
};

/// Decides whose messages go when memory or blocks run out.
///
/// The asker is the publisher that needs memory or a block, for a loan or for a message that grows.
/// It may be a maker without a topic, or a new publisher whose ring needs memory. Those have no
/// messages to give.
///
///   1. A need that can never be met evicts nothing. So the tags are looked at first. Is there a
///      run of granules that are free, or belong to messages that rules 2 to 4 can free? Free
///      granules that were never used count while the file system has room for them.
///   2. What publishers that have gone have left goes first, but for the newest two messages of
///      each: readers that had subscribed have not read them. Then the oldest message goes of the
///      publisher that holds most, in whatever process, while that publisher keeps at least as much
///      as the asker will have. So publishers end with equal shares. Another process is asked,
///      since only its own publisher changes a ring. When that has gone, the process that acts for
///      the orphanage changes it.
///   3. Where no other publisher can give, the asker's own oldest message goes, whatever it is.
///      That may free nothing yet, since messages of another publisher refer to it: it weighs there
///      from then on. Where the asker has none, the rest goes of what publishers that have gone
///      have left.
///   4. For another topic these never go: the newest two messages of a publisher (a latched message
///      is among them), a message in a block that reserve() made, a message that is kept or
///      borrowed. The messages behind a kept, borrowed or reserved one do go. A message whose going
///      frees nothing goes only if one behind it may go that frees something. Idle memory that
///      reserve() made stays as well (Pool::trim).
///   5. Of a publisher with Policy::Block or Refuse, no message ever goes that a reader has yet to
///      read. It counts: a publisher that waits for slow readers has its share. Tasks that wait for
///      a worker do not go, either. A publisher with Policy::Block waits for readers, its own and
///      others', as it does for room.
///
/// Weights are counted when there is need, by a walk over the rings. So no push counts anything.
///
/// Threads: all members may be called at once.
/// Memory:  one bit for each block, private to the process; and the survey's.
class Eviction {
 public:
  Eviction(Holder& holder, segment::Segment& segment) : holder_(holder), survey_(segment) {}
  /// REQUIRES: before the first call of the others. At most `publishers` may come.
  void prepare(std::uint32_t blocks, std::uint32_t publishers) {
    marked_.resize(blocks);
    evictors_.reserve(publishers);
    survey_.prepare();
  }

  void add(Evictor& evictor);
  void remove(Evictor& evictor) noexcept;

  /// Each publisher frees what needs no giving up. True: some publisher had something.
  bool settle() noexcept;
  /// Evictor::look() of the publisher with this pool, if there is one.
  std::size_t look(std::uint32_t pool, std::span<std::uint32_t> foreign) noexcept;
  /// Rule 3 only: the publisher with this pool gives up its oldest message. False: it has none, or
  /// may lose none.
  bool give_up(std::uint32_t pool) noexcept;
  /// How much that publisher would free if it gave up all that it may: bytes or blocks.
  std::uint64_t could_give(std::uint32_t pool, Shortage shortage) noexcept;
  /// True when readers have yet to read something that may go afterwards.
  bool has_unread(Shortage shortage) noexcept;
  /// Evictor::patience() of the publisher with this pool.
  std::chrono::nanoseconds patience(std::uint32_t pool) noexcept;
  /// Looks at what the publishers of other processes hold.
  void look_at_others(Shortage shortage) noexcept;
  /// Which other processes give, by participant: stopped ones do not. The entry of kOrphanage:
  /// whether ended rings give.
  using Givers = std::array<bool, segment::kMaxParticipants>;
  /// Where memory comes from that the file system has not given yet. Asked: the file system is
  /// asked for it. All, None: nothing is asked for, and the answer assumes that it would give all,
  /// or none.
  enum class Backing { Asked, All, None };
  /// Rule 1, for a run of so many granules. For an asker that waits for readers, messages that they
  /// have yet to read count, too.
  bool can_free_run(std::uint32_t asker, std::uint32_t granules, const Givers& givers,
                    Backing backing = Backing::Asked) noexcept;

  /// What rules 2 to 4 have decided.
  struct Step {
    /// Left: a message has left the asker's ring, and messages of others may refer to it.
    enum class What { Nothing, Given, Left, Ask, TakeOut } what = What::Nothing;
    std::uint32_t from = 0;   ///< Ask: the participant; TakeOut: the channel of an ended ring
    Request request{};        ///< Ask: what is asked for
    std::uint32_t block = 0;  ///< TakeOut: the block of the message
  };
  /// Lets one message go, if it is one of this process. `need`: what the asker will have more, in
  /// bytes or blocks.
  Step evict(std::uint32_t asker, std::uint64_t need, Shortage shortage,
             const Givers& givers) noexcept;
  /// Gives what another process asks for, or a part of it: that process asks again. True: something
  /// was given.
  bool give(const Request& request) noexcept;

 private:
  bool has_run(std::uint32_t granules, Backing backing) const noexcept;
  /// Of this process's publishers but `asker`, the one that rule 2 chooses; and its stock.
  /// REQUIRES: mutex_.
  Evictor* richest(std::uint32_t asker, std::uint64_t keep, Shortage shortage,
                   Evictor::Stock& stock) noexcept;
  /// The survey for this shortage. Another thread may have made the last one for another shortage.
  /// REQUIRES: mutex_.
  Survey& survey(Shortage shortage) noexcept;

  Holder& holder_;
  detail::Mutex mutex_{detail::Rank::Eviction};
  std::vector<Evictor*> evictors_;
  std::vector<bool> marked_;  ///< [blocks]
  Survey survey_;
};

}  // namespace lot::transport
