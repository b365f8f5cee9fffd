// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <thread>
#include <unordered_map>

#include "lot/any_pusher.hpp"
#include "lot/any_type.hpp"
#include "lot/engine.hpp"

#include "codec/program.hpp"
#include "gateway/cdr_type.hpp"
#include "gateway/counts.hpp"
#include "gateway/domain.hpp"
#include "gateway/entity.hpp"
#include "gateway/ledger.hpp"
#include "gateway/rate_limit.hpp"
#include "gateway/settings.hpp"
#include "record/stream.hpp"

namespace lot::gateway {

/// What an incoming route needs besides its settings.
struct IncomingTopic {
  std::string topic;         ///< in the segment
  std::string dds_topic;     ///< in the domain
  AnyType type;              ///< its messages
  std::uint64_t max_size;    ///< of a sample
  std::string place;         ///< place_of() the segment
  std::uint64_t most_bytes;  ///< of the segment, where the settings do not say it
};

/// Carries one topic of a DDS domain into a segment: it decodes each sample straight into a loan,
/// and pushes that. It is a publisher as long as the topic has a writer, so that subscribers see
/// when the last one has gone.
///
/// Threads: told() may be called at any time; it has a thread of its own.
/// Errors:  lot::Error of the constructor: EINVAL, EBADMSG for types that have no CDR; what
///          CycloneDDS says. Later ones are counted, and the last one is in told().
/// Memory:  of the segment at most Limits::max_bytes; buffers for the samples that CycloneDDS has.
/// Crash:   as a publisher.
class IncomingRoute {
 public:
  /// `entry` outlives the route; null: it has none.
  IncomingRoute(ShmEngine& engine, const Domain& domain, IncomingTopic what,
                const RouteSettings& settings, Ledger::Entry* entry);
  ~IncomingRoute() { end(); }
  IncomingRoute(const IncomingRoute&) = delete;
  IncomingRoute& operator=(const IncomingRoute&) = delete;

  /// Ends it: what was there before is carried, and told() does not change any more.
  void end() noexcept;
  const RouteSettings& settings() const noexcept { return settings_; }
  const std::string& topic() const noexcept { return what_.topic; }
  const std::string& dds_topic() const noexcept { return what_.dds_topic; }
  const std::string& dds_type() const noexcept { return dds_type_; }
  /// Its reader in the domain.
  dds_entity_t entity() const noexcept { return reader_.get(); }
  Counts told() const;

 private:
  /// What is to be done with a writer's samples.
  enum class Writer { IsCarried, IsOfThisSegment, IsOfAnotherType };
  struct Known {
    Writer what;
    std::uint64_t line;    ///< of Progress: its gateway's ledger. 0: it has none
    std::uint64_t before;  ///< samples of that line before its first one
    /// The number of its next sample, where it has no line. 0: none has come.
    std::uint64_t next;
  };

  void run() noexcept;
  /// What had come before the route was to end.
  void take_the_rest() noexcept;
  void note(const std::exception& error) noexcept;
  /// What came besides samples.
  void look_at_writers();
  /// Some samples; false: there are none.
  bool take_some();
  void carry(const CdrSample& sample, dds_instance_handle_t writer);
  /// What a gateway that comes after a kill has to know.
  void write_down() noexcept;
  Known& known(dds_instance_handle_t writer);
  /// Forgets those that are not there any more. `about`: as many as there are.
  void forget_writers(std::size_t about);
  /// What the writer has sent before this sample, and what has not come.
  void count_lost(Known& writer, std::uint64_t number);
  Known judge(dds_instance_handle_t writer) const;
  void begin_to_publish();

  ShmEngine& engine_;
  const IncomingTopic what_;
  const RouteSettings settings_;
  const record::Stream stream_;
  const std::string dds_type_;
  const CdrTopic cdr_;
  Ledger::Entry* const entry_;
  Progress progress_;
  const std::array<std::uint64_t, kNumbers.size()> counts_before_;  ///< of earlier routes
  Entity stopping_;                                                 ///< a guard condition
  Entity reader_;
  Entity waiting_;
  RateLimit rate_;
  /// While the topic has a writer.
  struct Publishing {
    AnyPusher pusher;
    codec::Program program;  ///< of the pusher's type
  };
  std::optional<Publishing> publishing_;
  std::unordered_map<dds_instance_handle_t, Known> writers_;  ///< whose samples have come
  std::uint64_t too_large_ = 0;                               ///< those of cdr_ that are counted
  Tally tally_;
  std::thread thread_;  ///< the last member: it uses the others
};

}  // namespace lot::gateway
