// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdio>
#include <utility>

#include "tool/rates.hpp"
#include "tool/report.hpp"
#include "tool/rows.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

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

void list_processes(const Observation& seen, bool each, Report& report, Json& entry) {
  entry["processes"] = Json::array();
  for (const auto& p : seen.processes) {
    entry["processes"].push_back({{"index", p.index},
                                  {"name", p.name},
                                  {"pid", p.pid},
                                  {"since_unix", static_cast<double>(p.since_ns) * 1e-9},
                                  {"alive", p.alive},
                                  {"bytes", p.bytes}});
  }
  Table table({"PROCESS", "PID", "SINCE", "MEMORY", ""}, {0});
  for (const auto& group : groups(seen.processes, each)) {
    const Process& first = group.front();
    std::uint64_t bytes = 0;
    double age = 0;
    for (const auto& p : group) {
      bytes += p.bytes;
      age = std::max(age, age_of(p));
    }
    const bool one = group.size() == 1;
    table.add({one ? printable(seen.who(first.index))
                   : std::to_string(group.size()) + " processes " + printable(common_name(group)),
               one ? std::to_string(first.pid) : "", age_text(age), bytes_text(bytes),
               first.alive ? "" : "dead"});
  }
  if (!table.empty()) report.print(table.text() + "\n");
}

/// "0-12"
std::string range_text(std::uint64_t least, std::uint64_t most) {
  return least == most ? count_text(most) : count_text(least) + "-" + count_text(most);
}

class TopicList {
 public:
  TopicList(const Observation& seen, const Rates& rates, bool each)
      : seen_(seen), rows_(rows(seen.channels, each)), rates_(rates), each_(each) {}

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
    table_.add_line(printable(topic.name) + "  " + printable(topic.type, 32));
    for (const auto& c : seen_.channels) {
      if (c.topic == topic.index) enter(c, out);
    }
    for (const auto& row : rows_) {
      if (row.sum.topic == topic.index) list(row);
    }
    list_waiting(topic, out);
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
                                    {"holds_back", r.holds_back},
                                    {"observes", r.observes}});
    }
  }

  void list(const Row& row) {
    const Channel& c = row.sum;
    std::vector<std::uint32_t> publishers;
    for (const auto& each : row.channels) publishers.push_back(each.publisher);
    const bool alone = row.channels.size() == 1 || c.orphan;
    add({alone ? "publisher" : publisher_text(seen_, row),
         alone ? publisher_text(seen_, row) : processes_text(seen_, publishers),
         policy_of(c) + std::string(c.taken ? ", to one" : "") +
             (c.engine == QueueEngine::Mutex ? ", mutex" : ""),
         count_text(c.queue.size()) + " of " + count_text(c.depth),
         text_of(rate_of(row.channels, rates_)), "", "",
         c.waits             ? "waits for room"
         : c.unfinished != 0 ? count_text(c.unfinished) + " unfinished"
                             : ""});
    for (const auto& readers : groups(c.readers, each_)) list(readers);
  }

  void list(const Readers& group) {
    const Reader& first = group.front();
    std::vector<std::uint32_t> processes;
    for (const auto& r : group) processes.push_back(r.process);
    const auto [least_lag, most_lag] = std::minmax_element(
        group.begin(), group.end(), [](auto& a, auto& b) { return a.lag < b.lag; });
    const auto [least_lost, most_lost] = std::minmax_element(
        group.begin(), group.end(), [](auto& a, auto& b) { return a.lost < b.lost; });
    add({subscribers_text(group.size()), processes_text(seen_, processes), "", "", "",
         first.joining ? "" : range_text(least_lag->lag, most_lag->lag),
         first.lost != 0 ? range_text(least_lost->lost, most_lost->lost) : "",
         first.joining      ? "joining"
         : first.observes   ? "observes"
         : first.holds_back ? "holds it back"
         : first.awaited    ? "not looked yet"
                            : ""});
  }

  static std::string subscribers_text(std::size_t n) {
    return n == 1 ? "subscriber" : std::to_string(n) + " subscribers";
  }

  /// Subscribers that are in no queue yet.
  void list_waiting(const Topic& topic, Json& out) {
    const bool published =
        std::any_of(seen_.channels.begin(), seen_.channels.end(),
                    [&](const Channel& c) { return c.topic == topic.index && !c.orphan; });
    list_waiting(topic, topic.subscribers, false, published ? "not looked yet" : "no publisher",
                 out);
    list_waiting(topic, topic.observers, true, published ? "observes" : "observes, no publisher",
                 out);
  }

  void list_waiting(const Topic& topic, const std::vector<std::uint32_t>& processes, bool observe,
                    const char* state, Json& out) {
    std::vector<std::uint32_t> waiting;
    for (const std::uint32_t k : processes) {
      if (reads_a_queue(topic, k, observe)) continue;
      waiting.push_back(k);
      out["subscribers"].push_back({{"process", k},
                                    {"channel", nullptr},
                                    {"joining", false},
                                    {"lag", 0},
                                    {"lost", 0},
                                    {"holds_back", false},
                                    {"observes", observe}});
    }
    const auto list_them = [&](const std::vector<std::uint32_t>& alike) {
      add({subscribers_text(alike.size()), processes_text(seen_, alike), "", "", "", "", "",
           state});
    };
    if (waiting.size() > kMostAlike && !each_) return list_them(waiting);
    for (const std::uint32_t k : waiting) list_them({k});
  }

  bool reads_a_queue(const Topic& topic, std::uint32_t k, bool observe) const {
    const auto is_its = [&](const Reader& r) {
      return r.process == k && (r.observes == observe || r.joining);
    };
    return std::any_of(seen_.channels.begin(), seen_.channels.end(), [&](const Channel& c) {
      return c.topic == topic.index && std::any_of(c.readers.begin(), c.readers.end(), is_its);
    });
  }

  void add(std::vector<std::string> cells) {
    cells.front() = "  " + cells.front();
    table_.add(std::move(cells));
  }

  const Observation& seen_;
  const std::vector<Row> rows_;
  const Rates& rates_;
  const bool each_;
  Table table_{{"TOPIC", "PROCESS", "POLICY", "HELD", "RATE", "LAG", "LOST", ""}, {1, 2}};
};

/// Says which publishers wait for room.
void hint_at_waits(const Sight& sight, const Observation& seen, bool each, Report& report) {
  std::vector<std::uint32_t> waiting;
  for (const auto& c : seen.channels) {
    if (c.waits) waiting.push_back(c.publisher);
  }
  const std::string rest = " for room: " + command("who", sight.path) + " says for which readers";
  if (waiting.size() > kMostAlike && !each) {
    return report.hint(std::to_string(waiting.size()) + " publishers wait" + rest);
  }
  for (const std::uint32_t k : waiting) {
    report.hint("publisher " + printable(seen.who(k)) + " waits" + rest);
  }
}

void list(const Sight& sight, const Rates& rates, bool each, Report& report) {
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
    report.print(": " + fill_text(seen) + "; " + bytes_text(seen.held_back) + " held back, " +
                 bytes_text(taken) + " taken from the system" + (seen.persists ? "; persist" : "") +
                 "\n\n");
    list_processes(seen, each, report, entry);
    TopicList(seen, rates, each).list(report, entry);
    judge(sight, seen, report, entry);
    hint_at_waits(sight, seen, each, report);
  }
  report.document()["segments"].push_back(std::move(entry));
}

}  // namespace

Exit ls(const Settings& settings, std::chrono::milliseconds interval, bool each) {
  Report report(settings);
  report.document()["command"] = "ls";
  report.document()["segments"] = Json::array();
  const auto found = sights(settings.where);
  if (found.empty()) nothing_found(settings, report);
  std::vector<Window*> windows;
  for (const auto& sight : found) windows.push_back(sight.window.get());
  const std::vector<Rates> rates = measure(windows, interval);
  bool is_first = true;
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (was_left(found[i])) continue;  // while the rates were measured
    if (!std::exchange(is_first, false)) report.print("\n");
    list(found[i], rates[i], each, report);
  }
  if (is_first && !found.empty()) nothing_found(settings, report);
  look_for_obstacles(settings, found, report);
  return report.finish();
}

}  // namespace lot::tool
