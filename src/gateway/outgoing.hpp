// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <thread>
#include <unordered_set>

#include "lot/any_puller.hpp"
#include "lot/engine.hpp"
#include "lot/envelope.hpp"
#include "lot/stop_token.hpp"

#include "gateway/cdr_type.hpp"
#include "gateway/counts.hpp"
#include "gateway/domain.hpp"
#include "gateway/entity.hpp"
#include "gateway/ledger.hpp"
#include "gateway/settings.hpp"
#include "record/stream.hpp"

namespace lot::gateway {

/// Carries one topic of a segment into a DDS domain: it looks on, encodes each message where it
/// lies, and writes the bytes.
///
/// Threads: told() may be called at any time; it has a thread of its own.
/// Errors:  lot::Error of the constructor: ENOENT, where no process uses the topic; EAGAIN, where
///          only gateways publish on it; EINVAL, EBADMSG for types that have no CDR, and names that
///          have none in DDS; what CycloneDDS says. Later ones are counted, and the last one is in
///          told(). It ends by itself when the topic's last publisher has gone, or the topic is
///          another one.
/// Memory:  buffers for the samples that CycloneDDS keeps.
/// Crash:   as an observer.
class OutgoingRoute {
 public:
  /// Where it begins in the queues of the topic's publishers.
  enum class From {
    Now,        ///< with what is pushed from now on
    Latched,    ///< with the last message of each
    TheOldest,  ///< with all that they have
  };
  /// `topic`: its name in the segment. `place`: place_of() the segment. `ledger` outlives the
  /// route; null: there is none.
  OutgoingRoute(ShmEngine& engine, const Domain& domain, std::string topic,
                const RouteSettings& settings, From from, const std::string& place, Ledger* ledger);
  ~OutgoingRoute() { end(); }
  OutgoingRoute(const OutgoingRoute&) = delete;
  OutgoingRoute& operator=(const OutgoingRoute&) = delete;

  /// Ends it: what was there before is carried, and told() does not change any more.
  void end() noexcept;
  const RouteSettings& settings() const noexcept { return settings_; }
  const std::string& topic() const noexcept { return topic_; }
  const std::string& dds_topic() const noexcept { return dds_topic_; }
  /// Its writer in the domain.
  dds_entity_t entity() const noexcept { return writer_.get(); }
  Counts told() const { return tally_.told(); }

 private:
  void run() noexcept;
  /// False: the route can do nothing more.
  bool carry_next(const StopToken& stop) noexcept;
  /// What was pushed before the route was to end.
  void carry_the_rest() noexcept;
  /// True: the route can do nothing more.
  bool note(const std::exception& error) noexcept;
  void carry(AnyBorrow& message);
  /// What a gateway that comes after a kill has to know.
  void write_down() noexcept;
  /// Nobody would miss the message: to encode it costs local readers the processor. Where a ledger
  /// counts, a gateway that reads the topic may be one that was killed.
  bool is_unheard() const;
  /// False: no gateway may carry it.
  bool may_carry(const Envelope& from);

  const std::string topic_;
  const RouteSettings settings_;
  const std::string dds_topic_;
  AnyPuller puller_;
  const record::Stream stream_;
  const CdrTopic cdr_;
  Ledger::Entry* const entry_;  ///< null: it has none
  Progress progress_;
  const std::array<std::uint64_t, kNumbers.size()> counts_before_;  ///< of earlier routes
  Entity writer_;
  Tally tally_;
  std::unordered_set<std::uint64_t> publishers_;  ///< those it has met
  StopSource stopping_;
  std::thread thread_;  ///< the last member: it uses the others
};

}  // namespace lot::gateway
