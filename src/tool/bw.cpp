// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <cstdint>
#include <optional>
#include <vector>

#include "tool/gauge.hpp"
#include "tool/message_bytes.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

/// How many bytes come, and how large a message is.
class Bandwidth final : public Gauge {
 public:
  Bandwidth(std::chrono::nanoseconds window, Time begin) : all_(window, begin) {}

  Row head() const override {
    return {"BANDWIDTH", "RATE", "MIN", "MEAN", "MAX", "MESSAGES", "MISSED", "SIZES"};
  }

  void begin(const AnyType& type) override {
    all_.forget();
    type_ = type;  // which has the description
    bytes_ = MessageBytes(type.description());
  }

  std::optional<std::int64_t> figure(const Seen& seen) override {
    return static_cast<std::int64_t>(size_of(seen));
  }

  void see(const Seen& seen, std::optional<std::int64_t> bytes) override {
    all_.see(seen.mark.publisher, seen.mark.pushed.value_or(seen.now), seen.now, seen.n,
             seen.message.missed(), bytes);
  }

  void keep(const std::vector<std::uint64_t>& publishers) override { all_.keep(publishers); }

  std::vector<Row> rows(Time now, bool all) override {
    const FlowTold told = all ? all_.all(now) : all_.now(now);
    if (told.is_silent) return {{silence_text(told)}};
    const Moments& m = told.figures.moments;
    const bool has = m.count() != 0;
    const auto text = [](double bytes) { return bytes_text(static_cast<std::uint64_t>(bytes)); };
    const auto bandwidth = bytes_per_second(told);
    return {{bandwidth ? bandwidth_text(*bandwidth) : "-",
             told.rate ? precise_rate_text(*told.rate) : "-", has ? text(m.least()) : "-",
             has ? text(m.mean()) : "-", has ? text(m.most()) : "-", count_text(told.messages),
             count_text(told.missed), bytes_.is_exact() ? "exact" : "memory"}};
  }

  Json document(Time now, bool all) override {
    const FlowTold told = all ? all_.all(now) : all_.now(now);
    Json document = {{"bytes_per_second", or_null(bytes_per_second(told))}};
    document.update(flow_json(told));
    document["message_bytes"] = figures_json(told.figures, 1);
    document["sizes"] = bytes_.is_exact() ? "exact" : "memory";
    return document;
  }

  bool has_seen_any() const override { return all_.has_begun(); }

 private:
  std::uint64_t size_of(const Seen& seen) const {
    if (bytes_.is_constant()) return bytes_.type_size();
    if (bytes_.is_exact()) return bytes_.of(seen.message.root());
    return bytes_by_memory(seen.from.memory(), bytes_.type_size());
  }
  /// Of those that were missed nothing is known: they count as the mean of the others.
  static std::optional<double> bytes_per_second(const FlowTold& told) {
    if (!told.rate || told.figures.empty()) return std::nullopt;
    return *told.rate * told.figures.moments.mean();
  }

  Flow all_;
  AnyType type_;
  MessageBytes bytes_;
};

}  // namespace

Exit bw(const Settings& settings, const GaugeOptions& options) {
  Bandwidth bandwidth(options.window, std::chrono::steady_clock::now());
  return run("bw", settings, options, bandwidth);
}

}  // namespace lot::tool
