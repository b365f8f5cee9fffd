// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "registry/registry.hpp"
#include "segment/segment.hpp"

namespace lot::selection {

/// What the participants of a topic reply to the publishers that select their readers. A
/// participant *declines* while it needs its messages by the second path. It has *confirmed* when
/// it has looked, since a publisher last asked, and needs no second path.
///
/// A participant's reply means something only while the registry says that it has pullers on the
/// topic. So nothing is repaired when a participant dies: its reaper takes its pullers away. The
/// next process of its index begins anew before it announces a puller.
///
/// Edges
///   pullers  (registry/registry.hpp) carries begin() to wants() and has_confirmed(): a publisher
///       that sees the new puller does not take an earlier process's reply for the puller's.
///
/// Threads: all members may be called at once.
/// Memory:  two bits of segment::Replies for each participant. Both are in one word, so that the
///          steps of one participant are seen in their order.
/// Crash:   killed between the steps of confirm(): it declines still, and has confirmed. A
///          publisher asks for that only if the participant does not decline.
class TopicReplies {
 public:
  TopicReplies(segment::Segment& segment, const registry::Registry& registry, std::uint32_t topic)
      : replies_(segment.replies()[topic]), registry_(registry), topic_(topic) {}

  // The participant's own.

  /// Takes its reply back. REQUIRES: it announces a puller only afterwards.
  void begin(std::uint32_t participant) noexcept;
  void decline(std::uint32_t participant) noexcept;
  void confirm(std::uint32_t participant) noexcept;

  // The publishers'.

  /// True when the participant has pullers on the topic and does not decline.
  bool wants(std::uint32_t participant) const noexcept;
  bool has_confirmed(std::uint32_t participant) const noexcept;
  /// Takes the confirmation back: the participant is to look again.
  void ask(std::uint32_t participant) noexcept;

 private:
  auto& word_of(std::uint32_t participant) const noexcept {
    return replies_.words[participant / segment::Replies::kPerWord];
  }
  void set(std::uint64_t bits, std::uint32_t participant) noexcept;
  void take_back(std::uint64_t bits, std::uint32_t participant) noexcept;
  bool has(std::uint64_t bit, std::uint32_t participant) const noexcept;

  segment::Replies& replies_;
  const registry::Registry& registry_;
  const std::uint32_t topic_;
};

}  // namespace lot::selection
