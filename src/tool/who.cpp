// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <set>

#include "tool/report.hpp"
#include "tool/rows.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

bool is_shown(const Holder& h, bool all) {
  return all || h.how == Holder::How::Keeps || h.how == Holder::How::Borrows ||
         h.how == Holder::How::Refers;
}

std::string since_text(const Holder& h) {
  if (h.how == Holder::How::Queues || h.how == Holder::How::Spare || h.how == Holder::How::Refers) {
    return "";
  }
  if (h.age.seconds) return age_text(*h.age.seconds);
  // The warden looks around once a second.
  if (!h.age.at_most) return "?";
  std::string text{'<', ' '};  // g++ 12 warns of "< " + text
  return text += age_text(std::max(1.0, *h.age.at_most + 0.5));
}

std::string topic_text(const Observation& seen, const Message& m) {
  if (!m.topic.empty()) return printable(m.topic, 40);
  for (const auto& h : m.holders) {
    const Topic* t = h.topic ? seen.topic(*h.topic) : nullptr;
    if (t != nullptr) return printable(t->name, 40);
  }
  return "-";
}

void list_messages(const Observation& seen, bool all, Report& report, Json& entry) {
  Table table({"TOPIC", "MESSAGE", "SIZE", "MADE BY", "HOLDER", "HOW", "SINCE"}, {0, 3, 4});
  entry["messages"] = Json::array();
  for (const auto& m : seen.messages) {
    Json holders = Json::array();
    std::vector<std::string> first = {topic_text(seen, m), std::to_string(m.block),
                                      bytes_text(m.bytes), printable(seen.who(m.home), 24)};
    for (const auto& h : m.holders) {
      if (!is_shown(h, all)) continue;
      const Topic* topic = h.topic ? seen.topic(*h.topic) : nullptr;
      holders.push_back({{"process", h.process},
                         {"how", to_string(h.how)},
                         {"seconds", or_null(h.age.seconds)},
                         {"at_most_seconds", or_null(h.age.at_most)},
                         {"sequence", h.sequence ? Json(*h.sequence) : Json(nullptr)},
                         {"topic", topic != nullptr ? Json(topic->name) : Json(nullptr)}});
      auto row = first;
      row.insert(row.end(), {printable(seen.who(h.process), 24), to_string(h.how), since_text(h)});
      table.add(std::move(row));
      first = {"", "", "", ""};
    }
    if (holders.empty()) continue;
    entry["messages"].push_back({{"block", m.block},
                                 {"generation", m.generation},
                                 {"topic", m.topic},
                                 {"bytes", m.bytes},
                                 {"made_by", m.home},
                                 {"holders", std::move(holders)}});
  }
  report.print(table.empty() ? "  no process keeps or borrows a message\n" : table.text());
}

void list_readers(const Observation& seen, bool each, Report& report, Json& entry) {
  Table table({"BEHIND", "TOPIC", "PUBLISHER", "LAG", "LOST"}, {0, 1, 2});
  entry["behind"] = Json::array();
  const auto name_of = [&](const Channel& c) {
    const Topic* topic = seen.topic(c.topic);
    return topic != nullptr ? topic->name : std::string();
  };
  for (const auto& c : seen.channels) {
    for (const auto& r : c.readers) {
      if (r.lag == 0 && !r.joining) continue;
      entry["behind"].push_back({{"process", r.process},
                                 {"topic", name_of(c)},
                                 {"publisher", c.publisher},
                                 {"channel", c.channel},
                                 {"depth", c.depth},
                                 {"joining", r.joining},
                                 {"lag", r.lag},
                                 {"lost", r.lost},
                                 {"holds_back", r.holds_back}});
    }
  }
  for (const auto& row : rows(seen.channels, each)) {
    const Channel& c = row.sum;
    for (const auto& r : c.readers) {
      if (r.lag == 0 && !r.joining) continue;
      table.add({printable(seen.who(r.process), 24), printable(name_of(c), 40),
                 publisher_text(seen, row),
                 r.joining ? "joining" : std::to_string(r.lag) + " of " + std::to_string(c.depth),
                 r.lost != 0 ? count_text(r.lost) : ""});
    }
  }
  if (table.empty()) return;
  report.print("\n");
  report.print(table.text());
}

void list_waiting(const Observation& seen, Report& report, Json& entry) {
  entry["waiting"] = Json::array();
  for (const auto& c : seen.channels) {
    if (!c.waits) continue;
    std::set<std::uint32_t> whom;
    bool has_looked = true;
    for (const auto& r : c.readers) {
      if (!r.holds_back && !c.taken) continue;
      whom.insert(r.process);
      has_looked = has_looked && !r.awaited;
    }
    std::string names;
    for (const std::uint32_t k : whom) {
      if (!names.empty()) names += c.taken ? " or " : ", ";
      names += printable(seen.who(k));
    }
    if (names.empty()) names = "a reader";
    const Topic* topic = seen.topic(c.topic);
    const std::string name = topic != nullptr ? topic->name : "";
    report.hint("publisher " + printable(seen.who(c.publisher)) + " on " + printable(name) +
                " waits for room until " + names + (has_looked ? " has read" : " has looked"));
    entry["waiting"].push_back(
        {{"process", c.publisher}, {"topic", name}, {"channel", c.channel}, {"waits_for", whom}});
  }
}

}  // namespace

Exit who(const Settings& settings, bool all) {
  Report report(settings);
  report.document()["command"] = "who";
  report.document()["segments"] = Json::array();
  const auto found = sights(settings.where);
  if (found.empty()) nothing_found(settings, report);
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (i != 0) report.print("\n");
    Json entry;
    if (introduce(found[i], report, entry)) {
      report.print("\n\n");
      const Observation seen = observe(*found[i].window);
      entry["processes"] = Json::array();
      for (const auto& p : seen.processes) {
        entry["processes"].push_back(
            {{"index", p.index}, {"name", p.name}, {"pid", p.pid}, {"alive", p.alive}});
      }
      list_messages(seen, all, report, entry);
      list_readers(seen, all, report, entry);
      list_waiting(seen, report, entry);
      judge(found[i], seen, report, entry);
    }
    report.document()["segments"].push_back(std::move(entry));
  }
  look_for_obstacles(settings, found, report);
  return report.finish();
}

}  // namespace lot::tool
