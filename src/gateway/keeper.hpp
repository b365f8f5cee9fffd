// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "lot/engine.hpp"

#include "gateway/discovery.hpp"
#include "gateway/domain.hpp"
#include "gateway/entity.hpp"
#include "gateway/incoming.hpp"
#include "gateway/ledger.hpp"
#include "gateway/outgoing.hpp"
#include "gateway/ros_graph.hpp"
#include "gateway/settings.hpp"
#include "transport/participant.hpp"

namespace lot::gateway {

/// Joins the segment.
using Join = std::function<std::shared_ptr<transport::Participant>()>;

/// What a gateway tells of itself.
struct Report {
  struct Route {
    bool is_out;
    std::string topic;      ///< in the segment
    std::string dds_topic;  ///< in the domain
    bool is_there;          ///< false: it has ended
    Counts counts;          ///< also of earlier routes of this topic and direction
  };
  std::vector<Route> routes;
  std::map<std::string, std::string> refused;  ///< topics that are not carried, and why
  std::string error;                           ///< the last one that is about no topic
  std::string segment;                         ///< its path; empty: the gateway is in none
};

/// Begins the routes that the settings want, and ends those that they want no more, or whose topic
/// has changed.
///
///     Keeper keeper(settings, join);
///     while (!stop.stop_requested()) keeper.step();
///
/// Edges
///   D1  the directory's version, as a puller looks at it (registry/registry.hpp)
///       carries nothing: the registry's lock carries the topics.
///
/// Threads: one. Each route has a thread of its own.
/// Errors:  lot::Error of the constructor, when there is no segment or no domain. Later ones are in
///          told().
/// Memory:  that of its routes.
/// Crash:   docs/gateway-design.md.
class Keeper {
 public:
  Keeper(Settings settings, const Join& join);
  ~Keeper();
  Keeper(const Keeper&) = delete;
  Keeper& operator=(const Keeper&) = delete;

  /// Looks for what has changed, and waits a tenth of a second, or until the domain has news.
  void step();
  /// Other topics from now on. The domain stays as it is.
  void change(std::vector<RouteSettings> out, std::vector<RouteSettings> in);
  Report told() const;
  /// Ends all routes, and tells what they have done.
  Report end();

 private:
  /// What is to come in on a topic.
  struct Wanted {
    RouteSettings settings;
    std::string dds_topic;
    std::set<std::string> dds_types;  ///< of its writers
    AnyType type;                     ///< of the first of them that is a gateway's
    bool is_reliable = true;          ///< all of them are
    bool is_latched = true;
  };

  void join();
  void leave();
  /// What an earlier gateway with the same ledger has counted.
  void go_on_counting();
  bool must_leave() const;
  void look();
  void find_outgoing();
  void begin_outgoing(const std::string& topic, const RouteSettings& settings);
  void end_outgoing();
  std::map<std::string, Wanted> wanted_topics();
  void want(std::map<std::string, Wanted>& wanted, const Discovery::Writer& writer);
  /// What its settings leave to its writers.
  static void choose_quality(Wanted& wanted);
  /// Whether some of its writers have that type, or there are none.
  static bool fits(const Wanted& wanted, const std::string& dds_type);
  void end_incoming(const std::map<std::string, Wanted>& wanted);
  void find_incoming();
  /// What the topic's messages are here. None: that is not known yet.
  AnyType incoming_type(const std::string& topic, const Wanted& wanted);
  void begin_incoming(const std::string& topic, const Wanted& wanted);
  void retire(OutgoingRoute& route);
  void retire(IncomingRoute& route);
  void tell_ros();
  void note(const std::string& topic, const Error& error);

  Settings settings_;
  const Join join_;
  const Domain domain_;
  Discovery discovery_;
  RosGraph graph_;
  std::vector<dds_entity_t> told_;  ///< the entities that ROS 2 knows
  Entity waiting_;
  std::shared_ptr<transport::Participant> participant_;
  std::optional<ShmEngine> engine_;
  std::string place_;  ///< of the segment
  std::optional<Ledger> ledger_;
  std::optional<std::uint32_t> version_;  ///< of the directory, at the last look
  bool again_ = false;                    ///< the next look looks at everything
  bool has_begun_ = false;                ///< what comes now comes later
  std::map<std::string, std::unique_ptr<OutgoingRoute>> outgoing_;  ///< by their topic
  std::map<std::string, std::unique_ptr<IncomingRoute>> incoming_;
  std::vector<Report::Route> ended_;
  std::map<std::string, std::string> refused_;
  std::string error_;
};

}  // namespace lot::gateway
