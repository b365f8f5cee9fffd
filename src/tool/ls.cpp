// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdio>

#include "tool/rates.hpp"
#include "tool/report.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

/// Nothing is known when the publisher has gone, or its queue is younger than the first look.
Rate rate_of(const Channel& c, const Rates& rates) {
  const auto found = rates.find({c.channel, c.generation});
  return found != rates.end() && !c.orphan ? found->second : Rate();
}
Json or_null(const std::optional<double>& value) { return value ? Json(*value) : Json(nullptr); }
std::string text_of(const Rate& rate) {
  if (rate.per_second) return rate_text(*rate.per_second);
  return rate.below ? below_text(*rate.below) : "";
}

const char* engine_of(const Channel& c) {
  return c.engine == QueueEngine::Mutex ? "mutex" : "ring";
}
const char* policy_of(const Channel& c) {
  switch (c.policy) {
    case Policy::Overwrite:
      return "overwrite";
    case Policy::Block:
      return "block";
    case Policy::Refuse:
      return "refuse";
  }
  return "?";
}

double age_of(const Process& p) {
  const auto now = static_cast<std::uint64_t>(std::chrono::system_clock::now().time_since_epoch() /
                                              std::chrono::nanoseconds(1));
  return now > p.since_ns ? static_cast<double>(now - p.since_ns) * 1e-9 : 0.0;
}

void list_processes(const Observation& seen, Report& report, Json& entry) {
  Table table({"PROCESS", "PID", "SINCE", "MEMORY", ""});
  entry["processes"] = Json::array();
  for (const auto& p : seen.processes) {
    table.add({printable(seen.who(p.index)), std::to_string(p.pid), age_text(age_of(p)),
               bytes_text(p.bytes), p.alive ? "" : "dead"});
    entry["processes"].push_back({{"index", p.index},
                                  {"name", p.name},
                                  {"pid", p.pid},
                                  {"since_unix", static_cast<double>(p.since_ns) * 1e-9},
                                  {"alive", p.alive},
                                  {"bytes", p.bytes}});
  }
  if (!table.empty()) report.print(table.text() + "\n");
}

class TopicList {
 public:
  TopicList(const Observation& seen, const Rates& rates)
      : seen_(seen), rows_(rows(seen.channels)), rates_(rates) {}

  void list(Report& report, Json& entry) {
    entry["topics"] = Json::array();
    for (const auto& topic : seen_.topics) entry["topics"].push_back(list(topic));
    if (!table_.empty()) report.print(table_.text());
  }

 private:
  Json list(const Topic& topic) {
    Json out = {{"name", topic.name},
                {"type", topic.type},
                {"type_bytes", topic.type_size},
                {"publishers", Json::array()},
                {"subscribers", Json::array()}};
    first_ = {printable(topic.name, 40), printable(topic.type, 32)};
    for (const auto& c : seen_.channels) {
      if (c.topic == topic.index) enter(c, out);
    }
    for (const auto& row : rows_) {
      if (row.channel.topic == topic.index) list(row);
    }
    for (const std::uint32_t k : topic.subscribers) {
      if (!reads_a_queue(topic, k)) list_waiting(topic, k, out);
    }
    return out;
  }

  void enter(const Channel& c, Json& out) const {
    const Rate rate = rate_of(c, rates_);
    out["publishers"].push_back({{"process", c.publisher},
                                 {"channel", c.channel},
                                 {"gone", c.orphan},
                                 {"engine", engine_of(c)},
                                 {"policy", policy_of(c)},
                                 {"to", c.taken ? "one" : "all"},
                                 {"depth", c.depth},
                                 {"held", c.queue.size()},
                                 {"unfinished", c.unfinished},
                                 {"published", c.published},
                                 {"per_second", or_null(rate.per_second)},
                                 {"per_second_below", or_null(rate.below)},
                                 {"arrived", rate.messages},
                                 {"arrived_seconds", rate.seconds},
                                 {"waits_for_room", c.waits}});
    for (const auto& r : c.readers) {
      out["subscribers"].push_back({{"process", r.process},
                                    {"channel", c.channel},
                                    {"joining", r.joining},
                                    {"lag", r.lag},
                                    {"lost", r.lost},
                                    {"holds_back", r.holds_back}});
    }
  }

  void list(const Row& shown) {
    const Channel& c = shown.channel;
    row({"publisher", printable(seen_.publisher(shown), 24), engine_of(c),
         policy_of(c) + std::string(c.taken ? ", to one" : ""),
         std::to_string(c.queue.size()) + " of " + std::to_string(c.depth),
         text_of(rate_of(c, rates_)), "", "",
         c.waits             ? "waits for room"
         : c.unfinished != 0 ? std::to_string(c.unfinished) + " unfinished"
                             : ""});
    for (const auto& r : c.readers) {
      row({"subscriber", printable(seen_.who(r.process), 24), "", "", "", "",
           r.joining ? "" : std::to_string(r.lag), r.lost != 0 ? count_text(r.lost) : "",
           r.joining      ? "joining"
           : r.holds_back ? "holds the publisher back"
           : r.awaited    ? "has not looked yet"
                          : ""});
    }
  }

  void list_waiting(const Topic& topic, std::uint32_t k, Json& out) {
    out["subscribers"].push_back({{"process", k},
                                  {"channel", nullptr},
                                  {"joining", false},
                                  {"lag", 0},
                                  {"lost", 0},
                                  {"holds_back", false}});
    const bool published =
        std::any_of(seen_.channels.begin(), seen_.channels.end(),
                    [&](const Channel& c) { return c.topic == topic.index && !c.orphan; });
    row({"subscriber", printable(seen_.who(k), 24), "", "", "", "", "", "",
         published ? "has not looked yet" : "sees no publisher"});
  }

  bool reads_a_queue(const Topic& topic, std::uint32_t k) const {
    return std::any_of(seen_.channels.begin(), seen_.channels.end(), [&](const Channel& c) {
      return c.topic == topic.index && std::any_of(c.readers.begin(), c.readers.end(),
                                                   [k](const Reader& r) { return r.process == k; });
    });
  }

  void row(std::vector<std::string> cells) {
    cells.insert(cells.begin(), first_.begin(), first_.end());
    table_.add(std::move(cells));
    first_ = {"", ""};
  }

  const Observation& seen_;
  const std::vector<Row> rows_;
  const Rates& rates_;
  std::vector<std::string> first_;
  Table table_{
      {"TOPIC", "TYPE", "ROLE", "PROCESS", "ENGINE", "POLICY", "HELD", "RATE", "LAG", "LOST", ""}};
};

void list(const Sight& sight, const Rates& rates, Report& report) {
  Json entry;
  if (introduce(sight, report, entry)) {
    const Observation seen = observe(*sight.window);
    char instance[17];  // a name, since many JSON readers keep numbers only up to 2^53
    std::snprintf(instance, sizeof(instance), "%016llx",
                  static_cast<unsigned long long>(seen.instance));
    entry["instance"] = instance;
    entry["persist"] = seen.persists;
    const std::uint64_t taken = bytes_on_disk(sight.path);
    entry["memory"] = {{"used_bytes", seen.memory.used},
                       {"held_back_bytes", seen.held_back},
                       {"total_bytes", seen.memory.total},
                       {"taken_bytes", taken}};
    entry["blocks"] = {{"used", seen.blocks.used}, {"total", seen.blocks.total}};
    report.print(": " + bytes_text(seen.memory.used) + " of " + bytes_text(seen.memory.total) +
                 ", " + std::to_string(seen.blocks.used) + " of " +
                 std::to_string(seen.blocks.total) + " messages; " + bytes_text(seen.held_back) +
                 " held back, " + bytes_text(taken) + " taken from the system" +
                 (seen.persists ? "; persist" : "") + "\n\n");
    list_processes(seen, report, entry);
    TopicList(seen, rates).list(report, entry);
    judge(sight, seen, report, entry);
    for (const auto& c : seen.channels) {
      if (!c.waits) continue;
      report.hint("publisher " + printable(seen.who(c.publisher)) +
                  " waits for room: " + command("who", sight.path) + " says for whom");
    }
  }
  report.document()["segments"].push_back(std::move(entry));
}

}  // namespace

Exit ls(const Settings& settings, std::chrono::milliseconds interval) {
  Report report(settings);
  report.document()["segments"] = Json::array();
  const auto found = sights(settings.where);
  if (found.empty()) nothing_found(settings, report);
  std::vector<Window*> windows;
  for (const auto& sight : found) windows.push_back(sight.window.get());
  const std::vector<Rates> rates = measure(windows, interval);
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (i != 0) report.print("\n");
    list(found[i], rates[i], report);
  }
  look_for_obstacles(settings, found, report);
  return report.finish();
}

}  // namespace lot::tool
