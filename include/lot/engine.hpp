// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include "lot/compliance.hpp"
#include "lot/detail/core.hpp"
#include "lot/message.hpp"
#include "lot/options.hpp"
#include "lot/puller.hpp"
#include "lot/pusher.hpp"
#include "lot/queue.hpp"
#include "lot/wait_set.hpp"

namespace lot {

/// A process's place in a segment: makes publishers and subscribers.
///
///     lot::ShmEngine engine;                                   // segment LOTROS, made if absent
///     auto pusher = engine.advertise<Frame>("/camera/front");
///     auto puller = engine.subscribe<Frame>("/camera/front");
///
/// Several engines of a process on one segment share one participant. Pushers, pullers and pointers
/// may outlive their engine; the process leaves the segment when the last of them has gone, and the
/// last process removes it.
///
/// Threads: all members may be called at once. In a forked child everything inherited is inert.
/// Errors:  lot::Error, which says what to do.
class ShmEngine {
 public:
  explicit ShmEngine(const EngineOptions& options = EngineOptions());
  ~ShmEngine();
  ShmEngine(ShmEngine&&) noexcept = default;
  ShmEngine& operator=(ShmEngine&&) noexcept = default;

  /// Errors: another type on the topic, the segment's tables or memory full, a bad name or depth.
  template <class T>
  ShmPusher<T> advertise(std::string_view topic, const PusherOptions& options = PusherOptions()) {
    assert_message<T>();
    return {detail::make_pusher(participant_, topic, detail::message_type<T>(), options,
                                detail::Delivery::ToAll),
            options.block_for};
  }
  /// Messages that are published after this call are received, or counted as missed, however late
  /// the puller looks, also when their publisher has left or was killed.
  /// Errors: as advertise(); EUSERS when a publisher has all the readers that it can have.
  template <class T>
  ShmPuller<T> subscribe(std::string_view topic, const PullerOptions& options = PullerOptions()) {
    assert_message<T>();
    return ShmPuller<T>(detail::make_puller(participant_, topic, detail::message_type<T>(), options,
                                            detail::Delivery::ToAll));
  }
  /// Subscribes, and calls callback(const ShmSharedPtr<const T>&) for each message on a thread of
  /// its own, until the listener is destroyed.
  template <class T, class Callback>
  ShmListener listen(std::string_view topic, Callback&& callback,
                     const PullerOptions& options = PullerOptions(),
                     const ThreadOptions& thread = ThreadOptions()) {
    return {subscribe<T>(topic, options), std::forward<Callback>(callback), options.wait, thread};
  }
  /// One end, or both, of a queue of items of type T. Errors: as advertise().
  template <class T>
  ShmQueue<T> queue(std::string_view name, const QueueOptions& options = QueueOptions()) {
    using Item = detail::QueueItem<T>;
    using Element = typename Item::Element;
    assert_message<Element>();
    PusherOptions putting;
    putting.depth = options.depth;
    putting.policy = options.policy;
    putting.engine = options.engine;
    PullerOptions popping;
    popping.wait = options.wait;
    return ShmQueue<T>(detail::make_queue(participant_, name, detail::queue_type<T>(options),
                                          putting, popping, detail::delivery_of<T>(options)));
  }
  /// A message that belongs to no topic: to be pushed on several, or referred to by others.
  template <class T, class... Args>
  ShmUniquePtr<T> make(Args&&... args) {
    assert_message<T>();
    return detail::build<T>(maker_->loan(detail::message_type<T>(), true),
                            std::forward<Args>(args)...);
  }

  /// The file that the segment is.
  const std::string& path() const noexcept;

 private:
  std::shared_ptr<transport::Participant> participant_;
  std::unique_ptr<detail::PusherCore> maker_;
};

}  // namespace lot
