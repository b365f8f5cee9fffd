// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "lot/any_puller.hpp"
#include "lot/engine.hpp"
#include "lot/recorder.hpp"
#include "lot/stop_token.hpp"
#include "lot/wait_set.hpp"

#include "codec/encode.hpp"
#include "record/backlog.hpp"
#include "record/clock.hpp"
#include "record/ledger.hpp"
#include "record/stream.hpp"
#include "record/visits.hpp"
#include "transport/participant.hpp"
#include "transport/ring_ends.hpp"

namespace lot::record {

using Join = std::function<std::shared_ptr<transport::Participant>()>;

/// Finds the topics that are recorded, and puts their messages into the backlog.
///
/// Edges
///   D1  the directory's version, as a puller looks at it (registry/registry.hpp)
///       carries nothing: the registry's lock carries the topics.
///
/// Threads: one.
/// Errors:  they are noted in the ledger. The first look throws them.
/// Memory:  a subscription for each topic.
/// Crash:   as an observer.
class Observer {
 public:
  Observer(const RecorderOptions& options, Join join, Ledger& ledger, const Clock& clock,
           Backlog& backlog);
  ~Observer();
  Observer(const Observer&) = delete;
  Observer& operator=(const Observer&) = delete;

  /// Joins, and subscribes to what is there. Throws lot::Error, but where there is no segment.
  void begin();
  /// Observes until the token stops, and then takes what was pushed before.
  void run(const StopToken& stop);

 private:
  struct Subscription {
    explicit Subscription(AnyPuller its_puller)
        : puller(std::move(its_puller)), core(&detail::PullerAccess::core(puller)) {}
    std::string topic;
    AnyPuller puller;
    transport::RingPuller* core;           ///< of puller
    std::shared_ptr<const Stream> stream;  ///< null: it is a trigger
    std::uint64_t told = 0;                ///< of what it missed
    Visits visits;
    bool is_listening = false;        ///< `set_` has the puller
    Clock::Steady::time_point due{};  ///< with a rate: not before this time the next one
    /// Rings that were there before it, of publishers that came after the begin: what left them
    /// before the subscription was missed, too.
    std::vector<registry::ChannelName> fresh;
    std::size_t rest = 0;  ///< at the end: messages that are to be taken
    bool has_gone = false;
  };

  void join();
  void leave();
  bool must_leave();
  /// Finds topics that have come, and takes out what has gone.
  void look();
  void look_and_note() noexcept;
  void find_topics();
  void consider(const std::string& topic);
  bool is_chosen(const std::string& name) const;
  void subscribe(const std::string& topic, bool is_trigger);
  /// From now on pushes to its queues wake the observer.
  void listen(Subscription& s);
  void deafen(Subscription& s) noexcept;
  /// Decides which topics are visited by the timer, and begins or ends that.
  void choose_visits();
  void visit() noexcept;
  std::shared_ptr<const Stream> stream_of(const std::string& topic, const AnyType& type);
  void forget_those_that_have_gone();

  /// At the end: what all topics have at one moment, with the log time of that moment. A disk that
  /// is slow holds the observer up, and else the topic whose turn is last would go on for longer.
  void take_the_rest() noexcept;
  /// Takes messages, so many at most, and notes what goes wrong. How many it took.
  std::size_t take_some(Subscription& s, std::size_t most) noexcept;
  /// False: there is none now.
  bool take(Subscription& s);
  void put_in(Subscription& s, AnyBorrow& message);
  std::uint64_t missed_before(Subscription& s, const AnyBorrow& message);
  void put_encoded(const Stream& stream, const Value& message, Entry& entry);
  void note(Subscription& s, const std::exception& error) noexcept;
  void find_faulty() noexcept;
  std::uint64_t limit() const;

  const RecorderOptions& options_;
  const Join join_;
  Ledger& ledger_;
  const Clock& clock_;
  Backlog& backlog_;
  std::shared_ptr<transport::Participant> participant_;
  std::optional<ShmEngine> engine_;
  WaitSet set_;
  std::optional<WaitSet::Timer> visiting_;  ///< where some topics are visited
  std::list<Subscription> subscriptions_;
  std::map<std::string, std::string> refused_;  ///< topics, and what they carried
  std::vector<std::shared_ptr<const Stream>> streams_;
  std::optional<std::uint32_t> version_;  ///< of the directory, at the last look
  bool again_ = false;                    ///< some topic could not be subscribed to
  bool has_begun_ = false;                ///< what comes now comes later
  /// When the recording ends, as soon as that is known. What comes then is a nanosecond behind the
  /// message before, so that its log time says its order.
  std::optional<Clock::Steady::time_point> end_;
  std::vector<Entry> batch_;
  std::uint64_t batch_held_ = 0;
  codec::Encoded encoded_;
};

}  // namespace lot::record
