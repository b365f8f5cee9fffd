// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <thread>

#include "lot/engine.hpp"
#include "lot/ros/core.hpp"

#include "lot_ros/loop.hpp"

namespace lot::ros {

/// No publisher's ring has more places.
inline constexpr std::uint32_t kDeepest = 1024;

/// So many messages of a publisher may be in its ring before it has said to a reader that they are
/// for it, since that one is only just coming: all but the one that makes room for the next.
constexpr std::size_t most_undecided(std::size_t depth) { return depth - 1; }
/// And so many when that takes long: somebody hangs, and memory is not to be his.
inline constexpr std::size_t kMostUndecidedLater = 15;

/// What LOT is in this process while somebody publishes or subscribes: the segment, and LOT's
/// thread. The user's handles own it, so that it ends in the user's threads, and with it the
/// segment's files, if this was the last process.
///
/// Threads: all members may be called at once.
class Session {
 public:
  /// The process's; made when there is none. Reads the parameters and opens the segment; what
  /// cannot be opened is said by ROS_WARN, and messages then go over TCPROS alone.
  static std::shared_ptr<Session> get();
  ~Session();
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  /// False when LOT is off: there is no segment.
  bool is_on() const noexcept { return participant_ != nullptr; }
  const std::shared_ptr<transport::Participant>& participant() const noexcept {
    return participant_;
  }
  lot::detail::PusherCore* maker() const noexcept { return maker_.get(); }
  QueueEngine queue_engine() const noexcept { return queue_engine_; }
  /// A topic's name in the segment: other graphs may have one of the same name.
  std::string name_of(const std::string& topic) const;

  const std::shared_ptr<Loop>& loop() const noexcept { return loop_; }

 private:
  Session();
  void open();
  std::string graph();

  std::shared_ptr<transport::Participant> participant_;
  std::unique_ptr<lot::detail::PusherCore> maker_;
  QueueEngine queue_engine_ = QueueEngine::Ring;
  std::string run_;
  std::shared_ptr<Loop> loop_;  ///< the thread's own: it may be the one that destroys this
  std::thread thread_;
};

/// What a frame of one byte says, which no message is: is anybody beside LOT's subscribers there?
constexpr std::uint8_t kProbe = 0;
/// The others are numbers of invitations: join my ring anew with this answer, when you have what
/// came before it.
constexpr std::uint8_t kLastInvitation = 255;

/// A node's name as a participant bears it: names that are too long end in a hash.
std::string participant_name(std::string_view node);

/// FNV-1a, as 16 hexadecimal digits.
std::string hash_of(std::string_view text);

}  // namespace lot::ros
