// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>

namespace lot::chaos {

/// What a topic carries (message.hpp).
enum class Kind : std::uint8_t { Plain, Frame, Seen };

/// What its publishers may do about slow readers; each of them chooses by itself.
enum class Queueing : std::uint8_t { Overwrite, Block, Either };

enum TopicId : std::uint32_t {
  kCount,
  kLossless,
  kMixed,
  kRefuse,
  kCamera,
  kPoints,
  kTwin,
  kSeen,
  kCameraRelay,
  kPointsRelay,
  kSecondRelay,
  kSeenRelay,
  kJobs,
  kParcels,
  kDone,
  kTasks,
  kErrands,
  kPlainShape,
  kFrameShape,
  kTopics,
  kFirstRelay = kCameraRelay,
  kFirstTaken = kJobs,
  kFirstTask = kTasks,
  kFirstShape = kPlainShape
};

struct Topic {
  const char* name;
  Kind kind;
  Queueing queueing;
  std::array<std::uint32_t, 3> depths;  ///< one of them, by chance
};

inline constexpr std::array<Topic, kTopics> kTopic{{
    {"/count", Kind::Plain, Queueing::Overwrite, {1, 5, 64}},
    {"/lossless", Kind::Plain, Queueing::Block, {2, 7, 32}},
    {"/mixed", Kind::Plain, Queueing::Either, {2, 3, 16}},
    {"/refuse", Kind::Plain, Queueing::Block, {1, 1, 3}},
    {"/camera", Kind::Frame, Queueing::Overwrite, {1, 3, 8}},
    {"/points", Kind::Frame, Queueing::Block, {2, 3, 4}},
    {"/twin", Kind::Frame, Queueing::Overwrite, {2, 2, 5}},
    {"/seen", Kind::Seen, Queueing::Either, {2, 3, 9}},
    {"/camera/relay", Kind::Frame, Queueing::Either, {2, 3, 5}},
    {"/points/relay", Kind::Frame, Queueing::Block, {2, 4, 4}},
    {"/camera/relay/relay", Kind::Frame, Queueing::Overwrite, {1, 3, 3}},
    {"/seen/relay", Kind::Seen, Queueing::Overwrite, {2, 4, 4}},
    {"/jobs", Kind::Plain, Queueing::Either, {1, 4, 32}},
    {"/parcels", Kind::Frame, Queueing::Either, {2, 3, 8}},
    {"/jobs/done", Kind::Plain, Queueing::Block, {1, 3, 9}},
    {"/tasks", Kind::Plain, Queueing::Block, {1, 4, 32}},
    {"/errands", Kind::Frame, Queueing::Block, {2, 3, 8}},
    {"/shape", Kind::Plain, Queueing::Either, {2, 5, 16}},
    {"/shape", Kind::Frame, Queueing::Either, {2, 3, 8}},
}};

/// Topics on which messages of others are published again, each by one node.
constexpr bool is_relayed(std::uint32_t topic) {
  return topic >= kFirstRelay && topic < kFirstTaken;
}
/// Queues whose items are each for one of their readers.
constexpr bool is_put(std::uint32_t topic) { return topic >= kFirstTaken && topic < kFirstShape; }
/// Of these, those whose items are tasks: they come back until a worker has finished them.
constexpr bool has_tasks(std::uint32_t topic) { return topic >= kFirstTask && topic < kFirstShape; }
/// One name, and two types: it carries the one or the other. Each has its own books.
constexpr std::uint32_t other_shape(std::uint32_t topic) {
  return topic == kPlainShape ? kFrameShape : kPlainShape;
}

}  // namespace lot::chaos
