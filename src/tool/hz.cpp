// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <iterator>
#include <optional>
#include <string>
#include <vector>

#include "tool/gauge.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

/// How often messages come, and the time between two messages of one publisher.
class Frequency final : public Gauge {
 public:
  Frequency(std::chrono::nanoseconds window, bool each, Time begin)
      : window_(window), each_(each), all_(window, begin) {}

  Row head() const override {
    Row row = {"RATE", "MIN", "MAX", "DEVIATION", "MESSAGES", "MISSED", "TIMES"};
    if (each_) row.push_back("PUBLISHER");
    return row;
  }

  void begin(const AnyType&) override {
    all_.forget();
    publishers_.clear();
    has_pushes_ = has_arrivals_ = false;
  }

  std::optional<std::int64_t> figure(const Seen& seen) override {
    const Publisher& its = publisher_of(seen);
    if (!its.has_last || seen.n != 1) return std::nullopt;
    return (time_of(seen) - its.at).count();
  }

  void see(const Seen& seen, std::optional<std::int64_t> since) override {
    Publisher& its = publisher_of(seen);
    const Time at = time_of(seen);
    (seen.mark.pushed ? has_pushes_ : has_arrivals_) = true;
    its.flow.see(its.id, at, seen.now, seen.n, seen.n - 1, since);
    all_.see(its.id, at, seen.now, seen.n, seen.message.missed(), since);
    its.has_last = true;
    its.at = at;
  }

  void keep(const std::vector<std::uint64_t>& publishers) override {
    all_.keep(publishers);
    std::erase_if(publishers_, [&](const Publisher& p) {
      return std::find(publishers.begin(), publishers.end(), p.id) == publishers.end();
    });
    last_ = 0;
  }

  std::vector<Row> rows(Time now, bool all) override {
    const FlowTold told = tell(all_, now, all);
    std::vector<Row> rows = {told.is_silent ? Row{silence_text(told)} : row(told, times())};
    if (!each_) {
      if (!told.is_silent && !all && told.silence > kLongAgo) {
        rows.back().back() += ", the last " + span_text(seconds(told.silence)) + " ago";
      }
      return rows;
    }
    if (!told.is_silent) rows.back().push_back("all");
    for (Publisher& p : publishers_) {
      const FlowTold its = tell(p.flow, now, all);
      const std::string name = printable(p.name);
      if (its.is_silent) {
        rows.push_back({name + ": " + silence_text(its)});
      } else {
        rows.push_back(row(its, p.times()));
        rows.back().push_back(name);
      }
    }
    return rows;
  }

  Json document(Time now, bool all) override {
    Json document = json_of(tell(all_, now, all), times());
    document["publishers"] = Json::array();
    for (Publisher& p : publishers_) {
      Json entry = {{"publisher", p.name}, {"publisher_id", id_text(p.id)}};
      entry.update(json_of(tell(p.flow, now, all), p.times()));
      document["publishers"].push_back(std::move(entry));
    }
    return document;
  }

  bool has_seen_any() const override { return all_.has_begun(); }

 private:
  struct Publisher {
    std::uint64_t id;
    std::string name;
    bool stamps;
    Flow flow;
    bool has_last = false;
    Time at{};  ///< of the last message

    const char* times() const { return stamps ? "pushes" : "arrivals"; }
  };
  static constexpr std::chrono::seconds kLongAgo{2};

  static Time time_of(const Seen& seen) { return seen.mark.pushed.value_or(seen.now); }
  static double seconds(std::chrono::nanoseconds span) {
    return std::chrono::duration<double>(span).count();
  }
  /// A name, since many JSON readers keep numbers only up to 2^53.
  static std::string id_text(std::uint64_t id) {
    char text[17];
    std::snprintf(text, sizeof(text), "%016llx", static_cast<unsigned long long>(id));
    return text;
  }
  static FlowTold tell(Flow& flow, Time now, bool all) {
    return all ? flow.all(now) : flow.now(now);
  }
  static Row row(const FlowTold& told, const char* times) {
    const auto text = [&](double value) { return span_text(value * 1e-9); };
    const Moments& m = told.figures.moments;
    const bool has = m.count() != 0;
    return {told.rate ? precise_rate_text(*told.rate) : "-",
            has ? text(m.least()) : "-",
            has ? text(m.most()) : "-",
            has ? text(m.deviation()) : "-",
            count_text(told.messages),
            count_text(told.missed),
            times};
  }
  static Json json_of(const FlowTold& told, const char* times) {
    Json document = flow_json(told);
    document["interval_seconds"] = figures_json(told.figures, 1e-9);
    document["times"] = times;
    return document;
  }
  const char* times() const {
    return has_pushes_ ? (has_arrivals_ ? "both" : "pushes") : "arrivals";
  }

  /// Most messages come from the publisher of the last one.
  Publisher& publisher_of(const Seen& seen) {
    const auto is_it = [&](const Publisher& p) { return p.id == seen.mark.publisher; };
    if (last_ < publishers_.size() && is_it(publishers_[last_])) return publishers_[last_];
    auto found = std::find_if(publishers_.begin(), publishers_.end(), is_it);
    if (found == publishers_.end()) {
      publishers_.push_back({seen.mark.publisher, seen.from.publisher(),
                             seen.mark.pushed.has_value(), Flow(window_, seen.now)});
      found = std::prev(publishers_.end());
    }
    last_ = static_cast<std::size_t>(found - publishers_.begin());
    return *found;
  }

  std::chrono::nanoseconds window_;
  bool each_;
  Flow all_;
  std::vector<Publisher> publishers_;
  std::size_t last_ = 0;       ///< place of the publisher of the last message
  bool has_pushes_ = false;    ///< a time was that of a push
  bool has_arrivals_ = false;  ///< a time was that of an arrival here
};

}  // namespace

Exit hz(const Settings& settings, const GaugeOptions& options) {
  Frequency frequency(options.window, options.each, std::chrono::steady_clock::now());
  return run("hz", settings, options, frequency);
}

}  // namespace lot::tool
