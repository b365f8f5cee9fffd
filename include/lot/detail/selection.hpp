// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include "lot/detail/core.hpp"

/// The untyped halves of a publisher that selects its readers, and of a reader that it may select.
/// The publisher says to each reader of its ring which messages are for that reader, and sends it
/// the others by a second path. lot::ros works like that (docs/ros.md); the second path is TCPROS.
///
/// Use it where each message must reach a reader once, by one of two paths. All pushers and pullers
/// of the topic are then of this kind, but for observers (PullerOptions::observer): these get all
/// that goes into the rings, for any reader, and no publisher selects them.
namespace lot::detail {

/// A reader that a publisher has selected.
struct SelectedReader {
  std::uint32_t participant = 0;
  std::uint32_t cell = 0;
  std::uint64_t round = 0;
};

class SelectingPusher {
 public:
  virtual ~SelectingPusher() = default;
  /// The pusher itself. It lives as long as this.
  virtual PusherCore& core() noexcept = 0;
  /// False when push_shared() would refuse the message: it lies in another segment, or `object` is
  /// not the message itself.
  virtual bool accepts(const ControlBlock& control, const void* object) const = 0;

  /// Selects the one reader that belongs to the node of that name and wants the ring. It gets the
  /// next message and all later ones, and before them the last `back` ones. Returns nothing if
  /// there is no such reader, if several readers could be meant, if the reader has not read yet
  /// what an earlier selection gave it, or if the last `back` messages are not in the ring.
  /// `answer`: selects only a reader that has joined anew with this answer
  /// (SelectingPuller::join_anew).
  virtual std::optional<SelectedReader> select(std::string_view node, std::size_t back,
                                               std::optional<std::uint64_t> answer = {}) = 0;
  /// Ends the selection: the reader gets no further message, and of the last `back` messages none
  /// that it has not read yet.
  virtual void deselect(const SelectedReader& reader, std::size_t back) = 0;
  /// True when the node has such a reader, selected or not.
  virtual bool is_read_by(std::string_view node) = 0;
  /// True when a process of that name wants the topic's messages. It may not read this ring yet.
  virtual bool expects(std::string_view node) = 0;
  /// False when the reader needs its messages by the second path, or is gone.
  virtual bool wants(const SelectedReader& reader) = 0;
  /// True when the reader has confirmed that it needs no second path. Call ask() to make it confirm
  /// again.
  virtual bool has_confirmed(const SelectedReader& reader) = 0;
  virtual void ask(const SelectedReader& reader) = 0;
};

class SelectingPuller {
 public:
  virtual ~SelectingPuller() = default;
  /// The puller itself. It lives as long as this.
  virtual PullerCore& core() noexcept = 0;

  /// Where the borrowed message comes from.
  virtual Origin origin() = 0;
  /// Whether the message is for this reader. A caller that gets true must deliver it. Returns
  /// nothing while the publisher may still decide. May be called after the borrow has ended.
  virtual std::optional<bool> is_ours(const Origin& origin) = 0;
  /// The name of the process that publishes there. Empty when the puller has forgotten that ring.
  virtual std::string_view publisher(const Origin& origin) = 0;
  /// How many places that publisher's ring has. 0 when the puller has left that ring.
  virtual std::size_t depth(const Origin& origin) = 0;
  /// True when this reader is in a ring of a publisher of that name: the publisher lives, or has
  /// left messages that are not read yet.
  virtual bool has_publisher(std::string_view publisher) = 0;
  /// The rings of publishers of that name. Their sequences are 0.
  virtual std::vector<Origin> rings_of(std::string_view publisher) = 0;
  /// True when a publisher of that name has ended its selection of this reader, and the reader has
  /// not read yet all that it was given.
  virtual bool has_remaining(std::string_view publisher) = 0;
  /// How many delivered messages the publishers of that name send once more, by the second path.
  /// Each is counted in one call only.
  virtual std::size_t resent(std::string_view publisher) = 0;
  /// Joins anew the rings of publishers of that name that have not selected this reader, and so
  /// tells them this answer. Returns those rings: this reader reads their messages once more.
  /// REQUIRES: no message is borrowed.
  virtual std::vector<Origin> join_anew(std::string_view publisher, std::uint64_t answer) = 0;
  /// The replies of this process to all publishers of the topic. decline(): it needs their messages
  /// by the second path. confirm(): it needs no second path. A new puller of the process begins
  /// with neither.
  virtual void decline() = 0;
  virtual void confirm() = 0;
};

/// As make_pusher() and make_puller(). Each reader gets the messages that are for it.
std::unique_ptr<SelectingPusher> make_selecting_pusher(
    std::shared_ptr<transport::Participant> participant, std::string_view topic,
    const MessageType& type, const PusherOptions& options);
std::unique_ptr<SelectingPuller> make_selecting_puller(
    std::shared_ptr<transport::Participant> participant, std::string_view topic,
    const MessageType& type, const PullerOptions& options);

}  // namespace lot::detail
