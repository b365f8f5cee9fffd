// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "lot/any_puller.hpp"
#include "lot/detail/core.hpp"

#include "lockfree_ring/ring.hpp"
#include "registry/registry.hpp"
#include "robust_mutex/queue_lock.hpp"
#include "segment/segment.hpp"
#include "transport/biased_lock.hpp"

/// Pusher and puller, as modules above this one see them: with their rings.
namespace lot::transport {

class Participant;

/// A pusher whose ring a module above uses, too.
class RingPusher : public detail::PusherCore {
 public:
  /// The pusher's ring. While this lives no other thread of the process pushes there.
  struct Held {
    std::unique_lock<BiasedLock> lock;
    ring::Writer<segment::Atomics>& writer;
  };
  /// REQUIRES: the pusher has a topic.
  virtual Held hold() = 0;
  /// False when push_shared() would refuse the message: it lies in another segment, or `object` is
  /// not the message itself.
  virtual bool accepts(const detail::ControlBlock& control, const void* object) const = 0;
  /// Both REQUIRE that the pusher has a topic.
  virtual const segment::Ring& ring() const noexcept = 0;
  virtual std::uint32_t topic() const noexcept = 0;
};

/// A ring that a puller reads.
struct alignas(64) Source {
  ring::Reader<segment::Atomics> reader;
  registry::ChannelName name;
  mutex_engine::QueueLock lock;
  std::string publisher;  ///< the name of its process
  bool stamps;            ///< its messages have the time of their push
  struct Turn : mutex_engine::QueueGuard {
    explicit Turn(const Source& source) : QueueGuard(source.lock) {}
  };
};

/// Hears of each ring that a puller begins or ends to read.
///
/// Threads: one, the puller's.
class RingWatcher {
 public:
  /// Called before other processes can see that the puller is there. What this writes they see when
  /// they see the puller (edge "pullers").
  virtual void announcing(std::uint32_t topic) noexcept = 0;
  /// Called when the puller has got a cell by joining a ring, before the ring's publisher can see
  /// the reader there: see Reader::join. A puller that was there before the ring was made has its
  /// cell without that.
  virtual void joining(const segment::Ring& ring, std::uint32_t cell) noexcept = 0;
  /// Called before the puller leaves a ring that has ended and that it has read to the end.
  virtual void leaving(const Source& source) = 0;

 protected:
  ~RingWatcher() = default;
};

/// A puller whose rings a module above looks at, too.
class RingPuller : public detail::PullerCore {
 public:
  /// The rings that it reads, until its next look.
  virtual std::span<const Source> sources() const noexcept = 0;
  virtual std::uint32_t topic() const noexcept = 0;
  /// The place of the borrowed message.
  virtual detail::Origin origin() const noexcept = 0;
  /// Envelope::pushed of the borrowed message, without the rest of an envelope. REQUIRES: a message
  /// is borrowed.
  virtual std::optional<detail::Clock::time_point> pushed() const noexcept = 0;
  /// Bytes of the memory that the borrowed message has, in whole granules where it does not fit
  /// into its block. REQUIRES: a message is borrowed.
  virtual std::uint64_t memory() const noexcept = 0;
  /// Joins a ring of sources() anew: takes a new cell, then leaves the old one, so that the ring's
  /// memory is not used again in between. The puller then reads the ring from its oldest message
  /// on, once more. False: the ring has no free cell, or has ended just now. REQUIRES: no message
  /// is borrowed; all readers get the messages.
  virtual bool join_anew(const registry::ChannelName& name) = 0;
};

/// As detail::make_pusher(). `extra`: RingOptions::extra.
std::unique_ptr<RingPusher> make_ring_pusher(std::shared_ptr<Participant> participant,
                                             std::string_view topic,
                                             const detail::MessageType& type,
                                             const PusherOptions& options,
                                             detail::Delivery delivery, std::uint32_t extra);
/// As detail::make_puller(). `watcher` outlives the puller; null: no module above looks.
std::unique_ptr<RingPuller> make_ring_puller(std::shared_ptr<Participant> participant,
                                             std::string_view topic,
                                             const detail::MessageType& type,
                                             const PullerOptions& options,
                                             detail::Delivery delivery, RingWatcher* watcher);

}  // namespace lot::transport

namespace lot::detail {

struct PullerAccess {
  /// The core of what ShmEngine::subscribe_any() has made. It lives as long as the puller.
  static transport::RingPuller& core(AnyPuller& puller) noexcept {
    return static_cast<transport::RingPuller&>(*puller.puller_.core_);
  }
};

}  // namespace lot::detail
