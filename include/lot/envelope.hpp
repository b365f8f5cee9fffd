// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

namespace lot {

/// Where a message comes from: what its publisher's queue says of it, beside the message itself.
///
///     if (auto frame = puller.try_pull()) {
///       const lot::Envelope envelope = puller.envelope();
///       log(envelope.publisher, envelope.sequence, envelope.missed);
///     }
///
/// Use it to log, to measure, to tell publishers apart. A copy: it stays as it is when the message
/// and the puller have gone. A default-constructed one is the envelope of no message.
///
/// All of it is what the publisher's process has written: a faulty one can have written anything,
/// also a time in the future.
struct Envelope {
  /// How many messages the publisher had pushed before this one: 0 for its first. Between two
  /// messages of one publisher that this reader gets one after the other it grows by 1 and by what
  /// the reader missed. From 2^42 - 1 it goes on to 0.
  std::uint64_t sequence = 0;
  /// Messages that this reader missed just before this one, of all publishers together.
  std::uint64_t missed = 0;
  /// The name that the publisher's process had when it advertised (EngineOptions::name): up to 47
  /// bytes. It stays right when that process has gone. Two processes may have one name.
  std::string publisher;
  /// Tells apart all publishers that the segment has, also those of one process and topic. Not 0.
  /// Another publisher gets the number only after 2^32 uses of its place in the segment.
  std::uint64_t publisher_id = 0;
  /// When the message was pushed, by the clock of the machine that all processes share
  /// (CLOCK_MONOTONIC). Of one in a block (PusherOptions::fast_lane) that was pushed several
  /// times, the last time. None: its publisher does not stamp (PusherOptions::stamp); or you ask
  /// when its borrow has ended, or when no process has the message any more.
  ///
  /// A process in another time namespace reads another clock: there the difference to now() means
  /// nothing.
  std::optional<std::chrono::steady_clock::time_point> pushed;
};

}  // namespace lot
