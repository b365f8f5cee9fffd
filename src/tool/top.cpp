// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <chrono>
#include <thread>
#include <unistd.h>

#include "tool/board.hpp"
#include "tool/report.hpp"
#include "tool/rows.hpp"
#include "tool/terminal.hpp"
#include "tool/text.hpp"
#include "tool/watch.hpp"

namespace lot::tool {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// Between two looks at what has come: the error of a moment of arrival.
constexpr std::chrono::milliseconds kLookPeriod = 10ms;
/// The first screen has no rates yet, so the second one follows soon.
constexpr std::chrono::milliseconds kSecond = 500ms;
constexpr std::chrono::milliseconds kLeastWindow = 300ms;
/// Of a text that no terminal cuts: all of STATE is in it.
constexpr std::size_t kWide = 200;

Json json_of(const Activity& a) {
  return {{"name", a.name},
          {"publishers", a.publishers},
          {"subscribers", a.subscribers},
          {"per_second", or_null(a.rate.per_second)},
          {"per_second_below", or_null(a.rate.below)},
          {"bytes_per_second", or_null(a.bytes_per_second)},
          {"memory_bytes", a.memory},
          {"lag", a.lag},
          {"lost", a.lost},
          {"delay_seconds", or_null(a.delay)},
          {"state", a.state}};
}

void add(const Watched& segment, Report& report) {
  Json entry;
  if (introduce(segment.sight, report, entry)) {
    report.print(": " + fill_text(segment.seen) + "\n");
    entry["topics"] = Json::array();
    for (const auto& topic : segment.topics) entry["topics"].push_back(json_of(topic));
    entry["processes"] = Json::array();
    for (std::size_t i = 0; i < segment.processes.size(); ++i) {
      const Process& process = segment.seen.processes[i];
      Json row = {{"index", process.index}, {"pid", process.pid}, {"alive", process.alive}};
      row.update(json_of(segment.processes[i]));
      row["name"] = process.name;
      entry["processes"].push_back(std::move(row));
    }
    judge(segment.sight, segment.seen, report, entry);
  }
  report.document()["segments"].push_back(std::move(entry));
}

/// One screen as text.
Exit once(const Settings& settings, std::chrono::milliseconds interval) {
  Report report(settings);
  report.document()["command"] = "top";
  report.document()["segments"] = Json::array();
  const auto found = sights(settings.where);  // says why the directory can not be read
  if (found.empty()) {
    nothing_found(settings, report);
  } else {
    Watch watch(settings.where);
    watch.refresh();
    const auto begin = Clock::now();
    for (auto passed = 0ns; passed < interval; passed = Clock::now() - begin) {
      if (passed >= kLeastWindow && watch.has_enough()) break;
      std::this_thread::sleep_for(std::min<Clock::duration>(kLookPeriod, interval - passed));
      watch.look();
    }
    watch.refresh();
    if (watch.segments().empty()) nothing_found(settings, report);
    for (const auto& segment : watch.segments()) add(segment, report);
    std::string text;
    for (const auto& line : Board().tables(watch.segments(), kWide)) {
      text += text_of(line) + "\n";
    }
    if (!text.empty()) report.print("\n" + text);
  }
  look_for_obstacles(settings, found, report);
  return report.finish();
}

/// The screen that stays until the user ends it.
Exit live(const Settings& settings, std::chrono::milliseconds interval) {
  Watch watch(settings.where);
  Board board;
  Terminal terminal;
  watch.refresh();
  auto next = Clock::now() + std::min(interval, kSecond);
  for (bool is_new = true; !terminal.has_ended();) {
    if (is_new) terminal.show(board.screen(watch, terminal.width(), terminal.height()));
    is_new = false;
    for (auto key = terminal.key(kLookPeriod); key; key = terminal.key(0ms)) {
      if (*key == 'q') return kWell;
      is_new |= board.press(*key);
    }
    watch.look();
    if (board.is_paused() || Clock::now() < next) continue;
    watch.refresh();
    next = Clock::now() + interval;
    is_new = true;
  }
  return kWell;
}

}  // namespace

Exit top(const Settings& settings, std::chrono::milliseconds interval, bool only_once) {
  const bool has_terminal = isatty(STDIN_FILENO) != 0 && isatty(STDOUT_FILENO) != 0;
  if (only_once || settings.json || !has_terminal) return once(settings, interval);
  return live(settings, interval);
}

}  // namespace lot::tool
