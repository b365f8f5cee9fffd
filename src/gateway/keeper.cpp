// SPDX-License-Identifier: Apache-2.0
#include "gateway/keeper.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <exception>
#include <filesystem>
#include <utility>

#include "lot/error.hpp"

#include "codec/program.hpp"
#include "codec/schema.hpp"
#include "gateway/names.hpp"
#include "gateway/peer.hpp"
#include "gateway/ros_types.hpp"
#include "record/pattern.hpp"
#include "record/stream.hpp"

namespace lot::gateway {
namespace {

constexpr dds_duration_t kLook = DDS_MSECS(100);  ///< between two looks
/// A part of the segment: what one incoming topic takes where the settings do not say it.
constexpr std::uint64_t kPartOfTheSegment = 8;

std::string dds_name_of(const RouteSettings& row) {
  if (!row.dds_topic.empty()) return row.dds_topic;
  return dds_topic_of(row.topics).value_or("");
}

/// What a topic of the domain is called in the segment, by that row. None: the row is not about it.
std::optional<std::string> name_here(const RouteSettings& row, const std::string& dds_topic) {
  if (!record::is_pattern(row.topics)) {
    return dds_name_of(row) == dds_topic ? std::optional(row.topics) : std::nullopt;
  }
  const std::optional<std::string> name = topic_of_dds(dds_topic);
  return name && record::matches(row.topics, *name) ? name : std::nullopt;
}

void add_up(Counts& sum, const Counts& more) {
  for (const auto count : kNumbers) sum.*count += more.*count;
  if (!more.error.empty()) sum.error = more.error;
}

void put_in(std::vector<Report::Route>& routes, Report::Route route) {
  const auto found = std::ranges::find_if(routes, [&](const Report::Route& r) {
    return r.is_out == route.is_out && r.topic == route.topic;
  });
  if (found == routes.end()) {
    routes.push_back(std::move(route));
  } else {
    add_up(found->counts, route.counts);
    if (route.is_there) found->dds_topic = route.dds_topic;
    found->is_there = found->is_there || route.is_there;
  }
}

std::string dds_type_for(const AnyType& type) {
  const codec::Program program(type.description());  // schema_of() wants one that it takes
  return dds_type_of(codec::schema_of(program.description()).name);
}

}  // namespace

Keeper::Keeper(Settings settings, const Join& join)
    : settings_(std::move(settings)),
      join_(join),
      domain_(settings_.domain),
      discovery_(domain_),
      graph_(domain_, settings_.node, settings_.gid_bytes),
      waiting_(dds_create_waitset(domain_.participant()), "discovery", "make a wait set") {
  require(dds_waitset_attach(waiting_.get(), discovery_.get(), 0), "discovery", "wait for it");
  this->join();
  go_on_counting();
}

Keeper::~Keeper() { leave(); }

// ---- the segment
// ---------------------------------------------------------------------------------

void Keeper::join() {
  participant_ = join_();
  engine_.emplace(participant_);
  place_ = place_of(participant_->segment());
  if (!settings_.state.empty()) ledger_.emplace(settings_.state, place_);
}

void Keeper::go_on_counting() {
  if (!ledger_) return;
  ledger_->for_each([&](Ledger::Way way, std::string_view topic, const Progress& progress) {
    Report::Route route{way == Ledger::Way::Out, std::string(topic), "", false, {}};
    for (std::size_t i = 0; i < kNumbers.size(); ++i) {
      route.counts.*kNumbers[i] = progress.counts[i];
    }
    put_in(ended_, std::move(route));
  });
}

void Keeper::leave() {
  for (const auto& [topic, route] : outgoing_) retire(*route);
  for (const auto& [topic, route] : incoming_) retire(*route);
  outgoing_.clear();
  incoming_.clear();
  ledger_.reset();
  engine_.reset();
  participant_.reset();
  version_.reset();
}

/// Others took this process for dead; or the files of the segment were removed, and others have
/// made a new one.
bool Keeper::must_leave() const {
  try {
    participant_->check_usable();
    const segment::Segment& segment = participant_->segment();
    return !segment.is_at_its_path() && std::filesystem::exists(segment.path());
  } catch (const Error& e) {
    if (e.error_number() != ESTALE) throw;
    return true;
  }
}

// ---- what changes
// --------------------------------------------------------------------------------

void Keeper::step() {
  try {
    look();
    error_.clear();
  } catch (const Error& e) {
    error_ = e.what();
    again_ = true;
  }
  (void)dds_waitset_wait(waiting_.get(), nullptr, 0, kLook);
}

void Keeper::change(std::vector<RouteSettings> out, std::vector<RouteSettings> in) {
  settings_.out = std::move(out);
  settings_.in = std::move(in);
  refused_.clear();
  again_ = true;
  has_begun_ = false;
}

void Keeper::look() {
  if (participant_ != nullptr && must_leave()) leave();
  if (participant_ == nullptr) join();
  const bool has_news = discovery_.look();
  // Acquire: D1.
  const std::uint32_t version =
      participant_->segment().directory().version.load(std::memory_order_acquire);
  const auto has_ended = [](const auto& entry) { return entry.second->told().has_ended; };
  const bool is_changed = std::ranges::any_of(outgoing_, has_ended) ||
                          std::ranges::any_of(incoming_, has_ended) || version_ != version ||
                          has_news || std::exchange(again_, false);
  if (!is_changed) return;
  version_ = version;
  end_outgoing();
  find_outgoing();
  find_incoming();
  has_begun_ = true;
  tell_ros();
}

void Keeper::tell_ros() {
  std::vector<dds_guid_t> readers;
  std::vector<dds_guid_t> writers;
  std::vector<dds_entity_t> entities;
  const auto add = [&](std::vector<dds_guid_t>& guids, dds_entity_t entity) {
    entities.push_back(entity);
    require(dds_get_guid(entity, &guids.emplace_back()), "ROS 2", "say which entities there are");
  };
  for (const auto& [topic, route] : incoming_) add(readers, route->entity());
  for (const auto& [topic, route] : outgoing_) add(writers, route->entity());
  if (entities == told_ && !told_.empty()) return;
  graph_.tell(readers, writers);
  told_ = std::move(entities);
}

void Keeper::note(const std::string& topic, const Error& error) {
  if (error.error_number() == EAGAIN) return;  // its first publisher changes the directory
  if (error.error_number() == ENOENT) {
    again_ = true;  // it has just gone
  } else {
    const bool names_it = error.object() == topic;
    refused_[topic] = names_it ? error.what() : topic + " is not carried: " + error.what();
  }
}

// ---- out
// -----------------------------------------------------------------------------------------

namespace {

/// The row that says how the topic goes out; null: it does not.
const RouteSettings* row_for(const std::vector<RouteSettings>& rows, const std::string& name) {
  const auto found = std::ranges::find_if(
      rows, [&](const RouteSettings& row) { return record::matches(row.topics, name); });
  return found == rows.end() ? nullptr : &*found;
}

}  // namespace

void Keeper::end_outgoing() {
  std::erase_if(outgoing_, [&](const auto& entry) {
    const auto& [topic, route] = entry;
    const RouteSettings* const row = row_for(settings_.out, record::name_in_file(topic));
    const bool is_wanted = row != nullptr && *row == route->settings() &&
                           !route->told().has_ended && engine_->type_of(topic);
    if (!is_wanted) retire(*route);
    return !is_wanted;
  });
}

void Keeper::find_outgoing() {
  for (const std::string& topic : participant_->topics().names()) {
    const RouteSettings* const row = row_for(settings_.out, record::name_in_file(topic));
    if (row == nullptr || outgoing_.contains(topic)) continue;
    try {
      if (engine_->type_of(topic)) begin_outgoing(topic, *row);
    } catch (const Error& e) {
      note(topic, e);
    }
  }
}

void Keeper::begin_outgoing(const std::string& topic, const RouteSettings& settings) {
  using From = OutgoingRoute::From;
  const bool is_latched = settings.quality.durability == Durability::TransientLocal;
  const From from = has_begun_ ? From::TheOldest : is_latched ? From::Latched : From::Now;
  outgoing_[topic] = std::make_unique<OutgoingRoute>(*engine_, domain_, topic, settings, from,
                                                     place_, ledger_ ? &*ledger_ : nullptr);
  refused_.erase(topic);
}

void Keeper::retire(OutgoingRoute& route) {
  route.end();
  put_in(ended_, {true, route.topic(), route.dds_topic(), false, route.told()});
}

// ---- in
// ------------------------------------------------------------------------------------------

std::map<std::string, Keeper::Wanted> Keeper::wanted_topics() {
  std::map<std::string, Wanted> wanted;
  for (const RouteSettings& row : settings_.in) {
    if (record::is_pattern(row.topics)) continue;
    const std::string dds_topic = dds_name_of(row);
    if (dds_topic.empty()) {
      refused_[row.topics] =
          row.topics + ": ROS 2 allows no such name of a topic: give it one, dds_topic";
    } else {
      wanted.try_emplace(row.topics, Wanted{row, dds_topic, {}, {}});
    }
  }
  for (const auto& [guid, writer] : discovery_.writers()) want(wanted, writer);
  return wanted;
}

void Keeper::want(std::map<std::string, Wanted>& wanted, const Discovery::Writer& writer) {
  for (const RouteSettings& row : settings_.in) {
    const std::optional<std::string> topic = name_here(row, writer.topic);
    if (!topic) continue;
    try {
      const std::optional<Peer> peer = peer_of(writer.user_data);
      if (peer && peer->segment == place_) return;
      Wanted& its = wanted.try_emplace(*topic, Wanted{row, writer.topic, {}, {}}).first->second;
      its.dds_types.insert(writer.type);
      its.is_reliable = its.is_reliable && writer.is_reliable;
      its.is_latched = its.is_latched && writer.is_latched;
      if (peer && !its.type) its.type = peer->type;
    } catch (const Error& e) {
      note(*topic, e);
    }
    return;
  }
}

void Keeper::choose_quality(Wanted& wanted) {
  Quality& quality = wanted.settings.quality;
  if (quality.reliability == Reliability::AsWriters) {
    quality.reliability = wanted.is_reliable ? Reliability::Reliable : Reliability::BestEffort;
  }
  if (quality.durability == Durability::AsWriters) {
    const bool is_latched = wanted.is_latched && !wanted.dds_types.empty();
    quality.durability = is_latched ? Durability::TransientLocal : Durability::Volatile;
  }
}

bool Keeper::fits(const Wanted& wanted, const std::string& dds_type) {
  return wanted.dds_types.empty() || wanted.dds_types.contains(dds_type);
}

void Keeper::end_incoming(const std::map<std::string, Wanted>& wanted) {
  std::erase_if(incoming_, [&](const auto& entry) {
    const auto& [topic, route] = entry;
    const auto found = wanted.find(topic);
    const bool is_wanted = found != wanted.end() && found->second.settings == route->settings() &&
                           fits(found->second, route->dds_type()) && !route->told().has_ended;
    if (!is_wanted) retire(*route);
    return !is_wanted;
  });
}

void Keeper::find_incoming() {
  std::map<std::string, Wanted> wanted = wanted_topics();
  for (auto& [topic, its] : wanted) choose_quality(its);
  end_incoming(wanted);
  for (const auto& [topic, its] : wanted) {
    if (incoming_.contains(topic)) continue;
    try {
      begin_incoming(topic, its);
    } catch (const Error& e) {
      note(topic, e);
    }
  }
}

AnyType Keeper::incoming_type(const std::string& topic, const Wanted& wanted) {
  if (AnyType type = engine_->type_of(topic)) return type;
  if (!wanted.settings.type.empty()) return type_of_ros(dds_type_of(wanted.settings.type));
  if (wanted.type) return wanted.type;
  for (const std::string& dds_type : wanted.dds_types) {
    if (AnyType type = type_of_ros(dds_type)) return type;
  }
  return {};
}

void Keeper::begin_incoming(const std::string& topic, const Wanted& wanted) {
  AnyType type = incoming_type(topic, wanted);
  if (!type) {
    if (wanted.dds_types.empty()) return;  // neither side is there yet
    throw Error(EINVAL, topic,
                "no process of the segment uses it, and the gateway knows no fields of " +
                    *wanted.dds_types.begin(),
                "it takes the type of the first subscriber");
  }
  const std::string dds_type = dds_type_for(type);
  if (!fits(wanted, dds_type)) {
    throw Error(EPROTOTYPE, topic,
                "it is " + dds_type + " here, and " + *wanted.dds_types.begin() + " there", "");
  }
  if (incoming_.size() >= settings_.most_incoming) {
    throw Error(EUSERS, topic,
                "as many topics come in as may: " + std::to_string(settings_.most_incoming), "");
  }
  IncomingTopic what{topic,           wanted.dds_topic,
                     std::move(type), settings_.domain.max_size,
                     place_,          participant_->segment().size() / kPartOfTheSegment};
  Ledger::Entry* const entry = ledger_ ? ledger_->entry(Ledger::Way::In, topic) : nullptr;
  incoming_[topic] =
      std::make_unique<IncomingRoute>(*engine_, domain_, std::move(what), wanted.settings, entry);
  refused_.erase(topic);
}

void Keeper::retire(IncomingRoute& route) {
  route.end();
  put_in(ended_, {false, route.topic(), route.dds_topic(), false, route.told()});
}

Report Keeper::end() {
  leave();
  return told();
}

// ---- what it tells
// -------------------------------------------------------------------------------

Report Keeper::told() const {
  Report report{ended_, refused_, error_,
                participant_ == nullptr ? "" : participant_->segment().path()};
  for (const auto& [topic, route] : outgoing_) {
    put_in(report.routes, {true, topic, route->dds_topic(), true, route->told()});
  }
  for (const auto& [topic, route] : incoming_) {
    put_in(report.routes, {false, topic, route->dds_topic(), true, route->told()});
  }
  return report;
}

}  // namespace lot::gateway
