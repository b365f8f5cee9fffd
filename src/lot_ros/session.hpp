// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <thread>

#include <boost/shared_ptr.hpp>
#include <ros/datatypes.h>

#include "lot/engine.hpp"
#include "lot/ros/core.hpp"

#include "lot_ros/loop.hpp"

namespace lot::ros {

/// The most places of a publisher's ring.
inline constexpr std::uint32_t kDeepest = 1024;

/// A reader that is only just joining gets messages of a ring before the publisher has said that
/// they are for it. There may be so many of these: all places but the one that makes room for the
/// next message.
constexpr std::size_t most_undecided(std::size_t depth) { return depth - 1; }
/// So many when the decision takes long: a peer hangs, and must not keep more memory.
inline constexpr std::size_t kMostUndecidedLater = 15;

/// What LOT has in this process while the process publishes or subscribes: the segment, and LOT's
/// thread. The user's handles own it. So it ends in one of the user's threads, and with it the
/// segment's files, if this was the last process.
///
/// Threads: all members may be called at once.
class Session {
 public:
  /// The session of the process; makes it when there is none. Reads the parameters and opens the
  /// segment. If that fails, ROS_WARN says why, and messages go over TCPROS alone.
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
  /// A topic's name in the segment: it names the ROS graph, too, since other graphs may have a
  /// topic of that name.
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
  std::shared_ptr<Loop> loop_;  ///< LOT's thread has it, too: it may destroy this
  std::thread thread_;
};

/// A frame of one byte is no message. This byte is a probe: does the process have subscribers
/// beside LOT's on this link?
constexpr std::uint8_t kProbe = 0;
/// The other bytes are numbers of invitations: "when you have all messages before this frame, join
/// my ring anew, with this number as the answer".
constexpr std::uint8_t kLastInvitation = 255;

/// A node's name as its participant has it: a name that is too long ends in a hash.
std::string participant_name(std::string_view node);

/// What the header of a link to that publisher says of the topic.
boost::shared_ptr<::ros::M_string> link_header(const detail::Kind& kind, const std::string& topic,
                                               const std::string& publisher);

/// FNV-1a, as 16 hexadecimal digits.
std::string hash_of(std::string_view text);

}  // namespace lot::ros
