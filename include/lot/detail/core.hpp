// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>

#include "lot/detail/arena.hpp"
#include "lot/detail/control.hpp"
#include "lot/detail/stop_word.hpp"
#include "lot/detail/wait.hpp"
#include "lot/envelope.hpp"
#include "lot/error.hpp"
#include "lot/options.hpp"
#include "lot/stop_token.hpp"

namespace lot::transport {
class Participant;
}
namespace lot::waiting {
class EarOwner;
}

/// The untyped halves of engine, pusher and puller. They live in the library. The typed halves are
/// thin templates in the public headers.
namespace lot::detail {

using Clock = std::chrono::steady_clock;

/// The time point that is `timeout` from now. If that overflows, the last time_point:
/// nanoseconds::max() means "for ever".
inline Clock::time_point after(std::chrono::nanoseconds timeout) {
  // The clock never reads less than the epoch, so the sum overflows only at the upper end.
  const auto now = Clock::now();
  return timeout < Clock::time_point::max() - now ? now + timeout : Clock::time_point::max();
}

/// How long a look for something waits for it, and what ends the wait before that.
class Limit {
 public:
  /// It looks once, and does not wait.
  static Limit now() noexcept { return {Clock::time_point::min(), nullptr}; }
  static Limit forever(const StopToken& stop) noexcept {
    return {Clock::time_point::max(), stop.word()};
  }
  /// The last time_point means for ever.
  static Limit until(Clock::time_point deadline, const StopToken& stop) noexcept {
    return {std::max(deadline, kFirst), stop.word()};
  }

  bool waits() const noexcept { return deadline_ >= kFirst; }
  bool is_stopped() const noexcept { return is_set(stop_); }
  /// REQUIRES: it waits. None: for ever.
  std::optional<Clock::time_point> deadline() const noexcept {
    if (deadline_ == Clock::time_point::max()) return std::nullopt;
    return deadline_;
  }
  /// Null: nothing ends it. The caller's token keeps the word.
  const StopWord* stop() const noexcept { return stop_; }

 private:
  static constexpr Clock::time_point kFirst = Clock::time_point::min() + Clock::duration(1);

  Limit(Clock::time_point deadline, const StopWord* stop) noexcept
      : deadline_(deadline), stop_(stop) {}

  Clock::time_point deadline_;
  const StopWord* stop_;
};

/// How long a push waits for room, and what ends the wait before that.
struct RoomLimit {
  std::chrono::nanoseconds time;
  const StopWord* stop = nullptr;

  bool is_stopped() const noexcept { return is_set(stop); }
};

/// The pointer, loaded by itself. A compiler that vectorises loads two neighbours at once. Where
/// the library has stored them one by one just before, such a load waits until all earlier stores
/// have left the core, also one to a line that another core has: some 20 ns a message.
template <class T>
T* alone(T* pointer) noexcept {
  asm("" : "+r"(pointer));
  return pointer;
}

/// Where the publisher builds a message.
struct Loan {
  ControlBlock* control = nullptr;  ///< null: out of memory
  void* root = nullptr;
  Arena* arena = nullptr;
};

/// A message that is borrowed. The reader may read it until the borrow ends.
struct Borrowed {
  /// Null: there is no message, or it has no block: it was borrowed from its slot.
  ControlBlock* control = nullptr;
  const void* root = nullptr;
  /// How many messages this reader lost just before this one. Without a message: how many since its
  /// last look.
  std::uint64_t missed = 0;
};

/// A message that is kept: with a pointer hold on its block.
struct Kept {
  ControlBlock* control;
  const void* root;
};

/// A message's place in one publisher's queue.
struct Origin {
  std::uint32_t channel = 0;
  std::uint32_t generation = 0;
  std::uint64_t sequence = 0;
};

/// A message that a worker has taken and has not finished yet.
struct Claim {
  Borrowed item;
  Origin origin;
  std::uint32_t slot = 0;
  std::uint32_t deliveries = 0;  ///< how often workers have got it, with this time
  std::uint64_t word = 0;
};

class PusherCore {
 public:
  virtual ~PusherCore() = default;
  virtual Loan loan(const MessageType& type, bool or_throw) = 0;
  /// Publishes a unique message. If it says anything but Ok, the caller keeps it.
  virtual Status push_unique(ControlBlock* control, RoomLimit limit) = 0;
  /// Publishes a shared message. The caller keeps its pointer, which is to `object`. Throws
  /// lot::Error when `object` is not the message itself. The message can not grow from then on.
  virtual Status push_shared(ControlBlock* control, const void* object, RoomLimit limit) = 0;
  virtual std::size_t readers() = 0;
  virtual bool wait_for_readers(std::size_t count, Limit limit) = 0;
  /// Makes `count` blocks with `bytes` of touched memory each.
  virtual void reserve(std::size_t count, std::size_t bytes) = 0;
};

/// What a WaitSet and a descriptor wait for.
class Waitable {
 public:
  virtual ~Waitable() = default;
  /// True when a look may find something. Costs a load for each publisher.
  virtual bool ready() = 0;
  /// Appends the futex words to sleep on until something comes, or has the words' hearer listen for
  /// that. Returns when to look again in any case, or nothing when the caller should look now.
  virtual std::optional<Clock::time_point> arm(FutexWaits& waits) = 0;
  /// Whose ears hear for it, in its segment. Null: none do.
  virtual std::shared_ptr<waiting::EarOwner> ear_owner() noexcept { return nullptr; }
};

class PullerCore : public Waitable {
 public:
  /// Borrows the next message.
  virtual Status borrow(Borrowed& borrowed, Limit limit) = 0;
  virtual void done() noexcept = 0;
  /// Takes a pointer hold on the borrowed message, or on a copy of it where it travels in its slot.
  /// Throws as refuse_to_hold() when the quota is full, or there is no block for a copy.
  virtual Kept keep() = 0;
  /// Throws what Status::HoldsTooMuch means: lot::Error, EDQUOT; lot::OutOfMemory where the segment
  /// has no block for a copy.
  [[noreturn]] virtual void refuse_to_hold() const = 0;
  /// borrow, keep and done in one.
  virtual Status pull(Borrowed& kept, Limit limit) = 0;
  /// The envelope of the message that was borrowed or pulled last, but for `missed`. Without one, a
  /// default-constructed one. Throws lot::Error (ECHILD, ESTALE), std::bad_alloc.
  virtual Envelope envelope() const = 0;

  // For queues whose workers finish messages. A puller stays in a ring while it has a claim there.

  /// Describes the message that was pulled last.
  virtual void describe(Claim& claim) const = 0;
  /// finish(): no worker gets the message any more. give_back(): the next worker that looks gets
  /// it. The caller has the item.
  virtual void finish(const Claim& claim) noexcept = 0;
  virtual void give_back(const Claim& claim) noexcept = 0;
  virtual std::size_t publishers() = 0;
  /// Rings the ears that listen to its rings: for what changes no word of them.
  virtual void ring_own_ears() noexcept = 0;
  /// How many messages the reader can read now.
  virtual std::size_t size() = 0;
  /// A descriptor that becomes readable when a message may have come. It stays so until a look
  /// finds none.
  virtual int fd() = 0;
};

std::shared_ptr<transport::Participant> join(const EngineOptions& options);
/// Names of processes, and of topics, are shorter than this.
inline constexpr std::size_t kProcessNameBytes = 48;
inline constexpr std::size_t kTopicNameBytes = 200;
/// Sets the name that other processes see of this process.
void rename(transport::Participant& participant, std::string_view name) noexcept;
/// Which readers get a message. ToAll: each reader. ToOne: one reader, which takes it. ToWorker:
/// one worker, which works on it; the message comes back if that worker does not finish it.
enum class Delivery { ToAll, ToOne, ToWorker };

/// The untyped half of a ShmQueue.
///
/// Threads: all members may be called at once.
class QueueCore : public Waitable {
 public:
  virtual Loan loan(const MessageType& type) = 0;
  virtual Status put_unique(ControlBlock* control, Limit limit) = 0;
  virtual Status put_shared(ControlBlock* control, const void* object, Limit limit) = 0;
  /// Takes an item to work on. False when none came in time.
  virtual bool take(Claim& claim, Limit limit) = 0;
  /// Finishes the item: no worker gets it any more. Throws lot::Error in a forked child.
  virtual void finish(const Claim& claim) = 0;
  /// Gives the item back: another worker may take it.
  virtual void give_back(const Claim& claim) noexcept = 0;
  /// Pops an item, with a pointer hold on it. False when none came in time. `may_come_back`: the
  /// caller then calls copied() or hand_back(), once for each item, when it is done with it.
  virtual bool pop(Borrowed& item, Limit limit, bool may_come_back) = 0;
  virtual void copied() noexcept = 0;
  /// Keeps the item, with its hold, for the next pop. Needs no memory.
  virtual void hand_back(const Borrowed& item) noexcept = 0;
  virtual void listen() = 0;
  /// As PullerCore::fd().
  virtual int fd() = 0;
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
/// Makes messages that belong to no topic.
std::unique_ptr<PusherCore> make_maker(std::shared_ptr<transport::Participant> participant);

/// Makes the message that is built in `arena` hold another message, of which `object` is a part.
/// The hold lasts until unrefer() is called as often, or the message dies. Returns the target's
/// block. Throws lot::Error when the two are in different segments, when `object` is no part of the
/// target, and when the message that is built belongs to another process or is published.
std::uint32_t refer(Arena& arena, ControlBlock* target, const void* object, std::size_t bytes);

/// True when a message of one type may be taken for a message of the other. Throws std::bad_alloc.
bool is_same(const MessageType& a, const MessageType& b);
/// Throws lot::Error (EINVAL) unless the message is of that type, which two libraries of a process
/// may each describe.
void require_type(const ControlBlock& control, const MessageType& type);
/// Takes one refer() back. Does nothing if the message is not being built any more: its references
/// end when it dies.
void unrefer(Arena& arena, std::uint32_t block) noexcept;
/// The control block of what a reference refers to, in the participant that has mapped the
/// reference. Null when the reference lies in private memory, which no participant has mapped.
/// Throws lot::Error when no participant has mapped the message that the reference is in, and when
/// the reference is damaged: the target must lie in the same segment.
ControlBlock* control_of(const void* reference, bool in_message, std::uint32_t block,
                         const void* target, std::size_t bytes);
/// Takes another pointer hold on a block that the caller protects. Returns the control block.
ControlBlock* acquire_block(ControlBlock* control);

}  // namespace lot::detail
