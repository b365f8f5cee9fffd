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
    return {detail::make_pusher(participant_, topic, detail::message_type<T>(), options),
            options.block_for};
  }
  /// Messages that are published after this call are received, or counted as missed.
  template <class T>
  ShmPuller<T> subscribe(std::string_view topic, const PullerOptions& options = PullerOptions()) {
    assert_message<T>();
    return ShmPuller<T>(
        detail::make_puller(participant_, topic, detail::message_type<T>(), options));
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
