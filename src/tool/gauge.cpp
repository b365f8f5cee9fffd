// SPDX-License-Identifier: Apache-2.0
#include "tool/gauge.hpp"

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <unistd.h>
#include <utility>

#include "lot/error.hpp"
#include "lot/signals.hpp"

#include "lockfree_ring/ring.hpp"
#include "tool/output.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// Between two looks whether a process still reads what is printed.
constexpr std::chrono::milliseconds kLookAtReader = 500ms;

/// Rows of columns, as text.
///
/// Threads: one.
class Columns {
 public:
  explicit Columns(Gauge::Row head) : head_(std::move(head)), stays_(isatty(STDOUT_FILENO) != 0) {}

  std::string text_of(const std::vector<Gauge::Row>& rows) {
    std::string text;
    for (const auto& row : rows) {
      if (row.size() == 1) {
        text += row.front() + "\n";
        continue;
      }
      if (since_head_ == 0) text += line(head_);
      text += line(row);
      ++since_head_;
    }
    if (stays_ && since_head_ >= kScreen) since_head_ = 0;
    return text;
  }

 private:
  static constexpr std::size_t kWidth = 10;
  static constexpr unsigned kScreen = 20;  ///< on a terminal the head comes again after these

  static std::string line(const Gauge::Row& row) {
    std::string text;
    for (std::size_t i = 0; i < row.size(); ++i) {
      if (i != 0) text += "  ";
      const bool is_number = i + 1 < row.size();
      if (is_number && row[i].size() < kWidth) text += std::string(kWidth - row[i].size(), ' ');
      text += row[i];
    }
    text.erase(text.find_last_not_of(' ') + 1);
    return text + "\n";
  }

  Gauge::Row head_;
  bool stays_;
  unsigned since_head_ = 0;
};

/// Counts what each publisher pushes, by the sequences of what is seen.
///
/// Threads: one.
class Sequences {
 public:
  /// Seen::n
  std::uint64_t see(const Postmark& mark) {
    const auto is_it = [&](const Last& one) { return one.publisher == mark.publisher; };
    if (last_ >= all_.size() || !is_it(all_[last_])) {  // most are of the publisher of the last one
      const auto found = std::find_if(all_.begin(), all_.end(), is_it);
      last_ = static_cast<std::size_t>(found - all_.begin());
      if (found == all_.end()) {
        all_.push_back({mark.publisher, mark.sequence});
        return 1;
      }
    }
    const auto n =
        ring::distance(mark.sequence, std::exchange(all_[last_].sequence, mark.sequence));
    return static_cast<std::uint64_t>(std::max<std::int64_t>(1, n));  // damage could lead back
  }
  void keep(const std::vector<std::uint64_t>& publishers) {
    std::erase_if(all_, [&](const Last& one) {
      return std::find(publishers.begin(), publishers.end(), one.publisher) == publishers.end();
    });
  }
  void forget() { all_.clear(); }

 private:
  struct Last {
    std::uint64_t publisher;
    std::uint64_t sequence;
  };
  std::vector<Last> all_;
  std::size_t last_ = 0;
};

/// One run of a gauge.
class Run {
 public:
  Run(const char* command, const Settings& settings, const GaugeOptions& options, Gauge& gauge)
      : command_(command),
        settings_(settings),
        options_(options),
        gauge_(gauge),
        onlooker_(settings.where, options.topic, std::string("lot ") + command),
        columns_(gauge.head()) {}

  Exit go() {
    std::signal(SIGPIPE, SIG_IGN);  // so that it leaves the segment as at any other end
    look();
    tell(true);
    return graver(complaints_.exit(), gauge_.has_seen_any() ? kWell : kWrong);
  }

 private:
  void look() {
    const auto begin = Clock::now();
    const auto end = options_.duration > std::chrono::nanoseconds(0) ? begin + options_.duration
                                                                     : Clock::time_point::max();
    auto line = begin + options_.interval;
    auto reader = begin + kLookAtReader;
    std::uint64_t messages = 0;
    while (!stop_.stop_requested() && !is_closed_) {
      const AnyBorrow message = next(std::min({line, reader, end}));
      const auto now = Clock::now();
      if (message) {
        see(message, now);
        if (++messages == options_.count) return;
      }
      if (now >= end) return;
      if (now >= reader) {
        is_closed_ = output_is_gone();
        reader = now + kLookAtReader;
      }
      if (now < line) continue;
      tell(false);
      line += options_.interval;
      if (line <= now) line = now + options_.interval;  // this process was stopped
    }
  }

  AnyBorrow next(Clock::time_point until) {
    try {
      return onlooker_.next(until, stop_);
    } catch (const Error& e) {
      if (!onlooker_.has_topic()) throw;
      complaints_.note(e);  // of one message, or of one publisher
      return {};
    }
  }

  void see(const AnyBorrow& message, Clock::time_point now) {
    if (times_ != onlooker_.times()) begin(message.type());
    if (!is_told_of_) return;
    const Postmark mark = onlooker_.postmark();
    const Seen seen{message, onlooker_, mark, sequences_.see(mark), now};
    std::optional<std::int64_t> figure;
    try {
      figure = gauge_.figure(seen);
      complaints_.forget();
    } catch (const Error& e) {
      complaints_.note(e);
    }
    gauge_.see(seen, figure);
  }

  void begin(const AnyType& type) {
    const bool is_first = std::exchange(times_, onlooker_.times()) == 0;
    type_ = type;
    sequences_.forget();
    is_told_of_ = true;
    try {
      gauge_.begin(type);
    } catch (const Error& e) {
      if (is_first || e.error_number() != EINVAL) throw;
      onlooker_.say(reason_of(e));
      is_told_of_ = false;
    }
  }

  void tell(bool all) {
    const auto now = Clock::now();
    const auto publishers = onlooker_.publishers_read();
    sequences_.keep(publishers);
    gauge_.keep(publishers);
    const std::string lines = settings_.json ? document(now, all) : text(now, all);
    is_closed_ = is_closed_ || !write_out(lines, stop_);
  }
  std::string text(Clock::time_point now, bool all) {
    return (all ? "\nin all:\n" : "") + columns_.text_of(gauge_.rows(now, all));
  }
  std::string document(Clock::time_point now, bool all) {
    Json document = {{"command", command_},
                     {"topic", options_.topic},
                     {"type", type_ ? Json(type_.name()) : Json(nullptr)},
                     {"in_all", all}};
    document.update(gauge_.document(now, all));
    // Names may hold any bytes, and JSON is UTF-8.
    return document.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
  }

  const char* command_;
  const Settings& settings_;
  const GaugeOptions& options_;
  Gauge& gauge_;
  Onlooker onlooker_;
  const StopToken stop_ = stop_on_signals();
  Complaints complaints_{onlooker_};
  Columns columns_;
  Sequences sequences_;
  AnyType type_;
  unsigned times_ = 0;
  bool is_told_of_ = true;  ///< the gauge has something to tell of this type
  bool is_closed_ = false;  ///< no process reads what is printed
};

}  // namespace

Exit run(const char* command, const Settings& settings, const GaugeOptions& options, Gauge& gauge) {
  return Run(command, settings, options, gauge).go();
}

std::string silence_text(const FlowTold& told) {
  const double seconds = std::chrono::duration<double>(told.silence).count();
  return "no message for " + (seconds < 10 ? span_text(seconds) : age_text(seconds));
}

Json flow_json(const FlowTold& told) {
  const auto seconds = [](std::chrono::nanoseconds span) {
    return std::chrono::duration<double>(span).count();
  };
  return {{"messages", told.messages},        {"missed", told.missed},
          {"per_second", or_null(told.rate)}, {"seconds", seconds(told.span)},
          {"silent", told.is_silent},         {"silent_seconds", seconds(told.silence)}};
}

Json figures_json(const Figures& figures, double scale) {
  if (figures.empty()) return nullptr;
  const Moments& m = figures.moments;
  return {{"min", m.least() * scale},       {"mean", m.mean() * scale},
          {"max", m.most() * scale},        {"deviation", m.deviation() * scale},
          {"p50", figures.at(0.5) * scale}, {"p99", figures.at(0.99) * scale}};
}

}  // namespace lot::tool
