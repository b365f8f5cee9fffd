// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include "lot/detail/arena.hpp"
#include "lot/detail/control.hpp"
#include "lot/detail/wait.hpp"
#include "lot/error.hpp"
#include "lot/options.hpp"

namespace lot::transport {
class Participant;
}

/// The untyped halves of engine, pusher and puller. They live in the library; the typed halves are
/// thin templates in the public headers.
namespace lot::detail {

using Clock = std::chrono::steady_clock;

/// So much later; the last time_point, where that would be after it: nanoseconds::max() is a way to
/// say "for ever".
inline Clock::time_point after(std::chrono::nanoseconds timeout) {
  const auto now = Clock::now();  // not before the epoch, so only the other end can be passed
  return timeout < Clock::time_point::max() - now ? now + timeout : Clock::time_point::max();
}

/// Where a message is to be built.
struct Loan {
  ControlCell* cell = nullptr;  ///< null: out of memory
  void* root = nullptr;
  Arena* arena = nullptr;
};

/// A message that is borrowed: readable until the borrow ends.
struct Borrowed {
  ControlCell* cell = nullptr;  ///< null: none
  const void* root = nullptr;
  /// Messages lost to this reader just before this one; without a message, since the last look.
  std::uint64_t missed = 0;
};

/// What a publisher knows of a subscriber that it serves by its ring, where it serves some only.
struct Served {
  std::uint32_t participant = 0;
  std::uint32_t cell = 0;
  std::uint64_t round = 0;
};

/// A message's place in one publisher's queue.
struct Origin {
  std::uint32_t channel = 0;
  std::uint32_t generation = 0;
  std::uint64_t sequence = 0;
};

/// A message that a worker has and has not finished yet.
struct Claim {
  Borrowed item;
  Origin origin;
  std::uint32_t slot = 0;
  std::uint32_t deliveries = 0;  ///< with this one
  std::uint64_t word = 0;
};

class PusherCore {
 public:
  virtual ~PusherCore() = default;
  virtual Loan loan(const MessageType& type, bool or_throw) = 0;
  /// Publishes a unique message; on Status::Full it stays with the caller.
  virtual Status push_unique(ControlCell* cell, std::chrono::nanoseconds block_for) = 0;
  /// Publishes a message that is shared; the caller keeps its pointer, which is to `object`. Throws
  /// lot::Error when that is not the message itself. The message can not grow from then on.
  virtual Status push_shared(const ControlCell* cell, const void* object,
                             std::chrono::nanoseconds block_for) = 0;
  virtual std::size_t readers() = 0;
  virtual bool wait_for_readers(std::size_t count, std::chrono::nanoseconds timeout) = 0;
  /// Makes `count` blocks with `bytes` of touched memory each.
  virtual void reserve(std::size_t count, std::size_t bytes) = 0;

  // For those who tell each reader which messages are for it.

  /// Serves the one reader of the node of that name that wants it, from the next message on, or
  /// from the last `back` ones. Nothing: there is none, it is not clear which, or these messages
  /// are not there.
  /// `answer`: only one that has joined anew with that (PullerCore::rejoin).
  virtual std::optional<Served> serve(std::string_view node, std::size_t back,
                                      std::optional<std::uint64_t> answer = {}) = 0;
  /// True when there is such a reader, served or not.
  virtual bool is_read_by(std::string_view node) = 0;
  /// True when a process of that name wants the topic's messages, whether it reads here yet or not.
  virtual bool expects(std::string_view node) = 0;
  /// Nothing more; and not the last `back` messages, if it has not read them yet.
  virtual void stop(const Served& served, std::size_t back) = 0;
  /// False when it wants to be served another way, or is gone.
  virtual bool wants(const Served& served) = 0;
  /// False when push_shared() would refuse it: the message lies in another segment, or `object` is
  /// not the message itself.
  virtual bool has(const ControlCell& cell, const void* object) const = 0;
  /// True when it has said that it does not need to be served another way, too; and that is to be
  /// said anew.
  virtual bool is_content(const Served& served) = 0;
  virtual void ask(const Served& served) = 0;
};

class PullerCore {
 public:
  virtual ~PullerCore() = default;
  /// Deadline: none = only look.
  virtual Status borrow(Borrowed& borrowed, bool wait, Clock::time_point deadline,
                        bool forever) = 0;
  virtual void done() noexcept = 0;
  /// A pointer hold on the borrowed message. Throws as refuse_to_hold() where the quota is full.
  virtual ControlCell* keep() = 0;
  /// Says what a status of HoldsTooMuch means: lot::Error, EDQUOT.
  [[noreturn]] virtual void refuse_to_hold() const = 0;
  /// borrow, keep and done in one.
  virtual Status pull(Borrowed& kept, bool wait, Clock::time_point deadline, bool forever) = 0;

  // Where messages are to be finished. A puller stays where it has a claim.

  /// Of the message that was pulled last.
  virtual void describe(Claim& claim) const = 0;
  /// No worker gets the message any more; or the next worker that looks does. The caller has the
  /// item.
  virtual void finish(const Claim& claim) noexcept = 0;
  virtual void give_back(const Claim& claim) noexcept = 0;
  virtual std::size_t publishers() = 0;
  /// Messages that are there to be read.
  virtual std::size_t size() = 0;
  /// True when a look may find something. Costs a load for each publisher.
  virtual bool ready() = 0;

  // For those whose publishers tell each reader which messages are for it.

  /// Where the message that is borrowed comes from.
  virtual Origin origin() = 0;
  /// Whether it is for us; who is told so delivers it. Nothing: that may be said yet, also when the
  /// borrow has ended.
  virtual std::optional<bool> is_ours(const Origin& origin) = 0;
  /// The name of the process that publishes there; empty when that has been forgotten.
  virtual std::string_view publisher(const Origin& origin) = 0;
  /// How many messages that publisher's queue has; 0 when that has been forgotten.
  virtual std::size_t depth(const Origin& origin) = 0;
  /// True when a publisher of that name is there, or something of it is not read yet.
  virtual bool has_publisher(std::string_view publisher) = 0;
  /// The rings of publishers of that name; sequences are 0.
  virtual std::vector<Origin> rings_of(std::string_view publisher) = 0;
  /// True when a publisher of that name has nothing more for us than what is not read yet.
  virtual bool has_last_ones(std::string_view publisher) = 0;
  /// How many messages that have been delivered the publishers of that name take back, since they
  /// send them another way; told once.
  virtual std::size_t taken_back(std::string_view publisher) = 0;
  /// Joins the queues of publishers of that name anew that do not serve us, and so tells them this
  /// answer. Returns those; their messages are read once more. REQUIRES: no message is borrowed.
  virtual std::vector<Origin> rejoin(std::string_view publisher, std::uint64_t answer) = 0;
  /// Wants no message of those who choose their readers; or says that it needs them no other way.
  virtual void decline() = 0;
  virtual void content() = 0;

  /// A descriptor that is readable from when a message may have come until a look finds none.
  virtual int fd() = 0;
  /// Appends the words to sleep on until a message comes. Returns when to look again in any case,
  /// or nothing when there is something to look at now.
  virtual std::optional<Clock::time_point> arm(FutexWaits& waits) = 0;
};

std::shared_ptr<transport::Participant> join(const EngineOptions& options);
/// Names of processes, and of topics, are shorter than this.
inline constexpr std::size_t kProcessNameBytes = 48;
inline constexpr std::size_t kTopicNameBytes = 200;
/// What the others call this process from now on.
void rename(transport::Participant& participant, std::string_view name) noexcept;
/// Who gets a message: each reader, or one of them, which takes it; or works on it, and it comes
/// back if that one does not finish.
enum class Delivery { ToAll, ToOne, ToWorker };

/// The untyped half of a ShmQueue.
///
/// Threads: all members may be called at once.
class QueueCore {
 public:
  virtual ~QueueCore() = default;
  virtual Loan loan(const MessageType& type) = 0;
  virtual Status put_unique(ControlCell* cell, Clock::time_point deadline) = 0;
  virtual Status put_shared(const ControlCell* cell, const void* object,
                            Clock::time_point deadline) = 0;
  enum class Wait { Never, Until, Forever };
  /// An item to work on; false when there was none in time.
  virtual bool take(Claim& claim, Wait wait, Clock::time_point deadline) = 0;
  /// It is done: no worker gets it any more. Throws lot::Error in a forked child.
  virtual void finish(const Claim& claim) = 0;
  /// Another worker may have it.
  virtual void give_back(const Claim& claim) noexcept = 0;
  /// An item with a pointer hold on it; false when there was none in time. `may_come_back`: the
  /// caller says by copied() or hand_back() how it ends, once for each item.
  virtual bool pop(Borrowed& item, Wait wait, Clock::time_point deadline, bool may_come_back) = 0;
  virtual void copied() noexcept = 0;
  /// The item, with its hold, is there for the next pop. Needs no memory.
  virtual void hand_back(const Borrowed& item) noexcept = 0;
  virtual void listen() = 0;
  virtual std::size_t size() = 0;
  virtual std::size_t capacity() const noexcept = 0;
};
std::unique_ptr<QueueCore> make_queue(std::shared_ptr<transport::Participant> participant,
                                      std::string_view name, const MessageType& type,
                                      const PusherOptions& putting, const PullerOptions& popping,
                                      Delivery delivery);

std::unique_ptr<PusherCore> make_pusher(std::shared_ptr<transport::Participant> participant,
                                        std::string_view topic, const MessageType& type,
                                        const PusherOptions& options, Delivery delivery);
std::unique_ptr<PullerCore> make_puller(std::shared_ptr<transport::Participant> participant,
                                        std::string_view topic, const MessageType& type,
                                        const PullerOptions& options, Delivery delivery);
/// A message that belongs to no topic.
std::unique_ptr<PusherCore> make_maker(std::shared_ptr<transport::Participant> participant);

/// Makes the message that is built in `arena` hold another one, of which `object` is a part, until
/// unrefer() is called as often or the message dies. Returns the target's block. Throws lot::Error
/// when they are in different segments, when `object` is no part of the target, and when the
/// message that is built belongs to another process or is published.
std::uint32_t refer(Arena& arena, ControlCell* target, const void* object, std::size_t bytes);
/// Takes one refer() back. Does nothing where the message is not built any more: what it refers to
/// is let go when it dies.
void unrefer(Arena& arena, std::uint32_t block) noexcept;
/// The cell of what a reference refers to, in the participant that has mapped the reference; null
/// when nobody has, since it lies in private memory. Throws lot::Error when nobody has mapped the
/// message that it is in, and when it is damaged: the target must lie in the same segment.
ControlCell* cell_of(const void* reference, bool in_message, std::uint32_t block,
                     const void* target, std::size_t bytes);
/// Another pointer hold on a block that the caller protects. Returns the cell.
ControlCell* acquire_block(ControlCell* cell);

}  // namespace lot::detail
