// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "tool/gauge.hpp"
#include "tool/text.hpp"
#include "tool/time_field.hpp"

namespace lot::tool {
namespace {

/// How long messages have been under way when this process looks at them: since their push, or
/// since a time in them.
class Delays final : public Gauge {
 public:
  Delays(const GaugeOptions& options, Time begin)
      : path_(options.field), field_(path_), all_(options.window, begin) {}

  Row head() const override {
    return {"MIN",       "MEAN",     "P50",   "P99",    "MAX",
            "DEVIATION", "MESSAGES", "TIMED", "MISSED", "SINCE"};
  }

  void begin(const AnyType& type) override {
    all_.forget();
    has_told_ = false;
    if (!path_.empty()) field_.begin(type.description());
  }

  std::optional<std::int64_t> figure(const Seen& seen) override {
    const auto age = age_of(seen);
    if (!age) {
      tell_what_to_do(seen.from);
      return std::nullopt;
    }
    has_any_ = true;
    return age->count();
  }

  void see(const Seen& seen, std::optional<std::int64_t> age) override {
    all_.see(seen.mark.publisher, seen.now, seen.now, seen.n, seen.message.missed(), age);
  }

  void keep(const std::vector<std::uint64_t>& publishers) override { all_.keep(publishers); }

  std::vector<Row> rows(Time now, bool all) override {
    const FlowTold told = all ? all_.all(now) : all_.now(now);
    if (told.is_silent) return {{silence_text(told)}};
    const Figures& f = told.figures;
    if (f.empty()) return {{plural(told.messages, "message", "messages") + ", without a time"}};
    const auto text = [](double ns) { return span_text(ns * 1e-9); };
    return {{text(f.moments.least()), text(f.moments.mean()), text(f.at(0.5)), text(f.at(0.99)),
             text(f.moments.most()), text(f.moments.deviation()), count_text(told.messages),
             count_text(f.moments.count()), count_text(told.missed), printable(since())}};
  }

  Json document(Time now, bool all) override {
    const FlowTold told = all ? all_.all(now) : all_.now(now);
    Json document = flow_json(told);
    document["with_time"] = told.figures.moments.count();
    document["delay_seconds"] = figures_json(told.figures, 1e-9);
    document["since"] = since();
    const bool is_system = !path_.empty() && field_.clock() == TimeField::Clock::System;
    const bool is_unknown = !path_.empty() && field_.clock() == TimeField::Clock::Unknown;
    document["clock"] = is_unknown ? Json(nullptr) : Json(is_system ? "system" : "steady");
    return document;
  }

  bool has_seen_any() const override { return has_any_; }

 private:
  std::string since() const { return path_.empty() ? "push" : path_; }

  std::optional<std::chrono::nanoseconds> age_of(const Seen& seen) {
    if (!path_.empty()) {
      return field_.age(seen.message.root(), {std::chrono::system_clock::now().time_since_epoch(),
                                              seen.now.time_since_epoch()});
    }
    if (!seen.mark.pushed) return std::nullopt;
    return seen.now - *seen.mark.pushed;
  }

  /// Once for a type.
  void tell_what_to_do(const Onlooker& onlooker) {
    if (std::exchange(has_told_, true)) return;
    const std::string& publisher = onlooker.publisher();
    onlooker.say(path_.empty()
                     ? "its publisher " + publisher +
                           " does not note when it pushes a message: set PusherOptions::stamp "
                           "there, or start it with LOT_STAMP=1; or name a time in the message by "
                           "--field"
                     : path_ + " is zero in a message of " + publisher +
                           ": such messages have no delay");
  }

  std::string path_;  ///< empty: since the push
  TimeField field_;
  Flow all_;
  bool has_any_ = false;
  bool has_told_ = false;
};

}  // namespace

Exit delay(const Settings& settings, const GaugeOptions& options) {
  Delays delays(options, std::chrono::steady_clock::now());
  return run("delay", settings, options, delays);
}

}  // namespace lot::tool
