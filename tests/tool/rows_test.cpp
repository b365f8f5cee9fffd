// SPDX-License-Identifier: Apache-2.0

// Many publishers and subscribers are few rows, and a table fits a screen.

#include "tool/rows.hpp"

#include <algorithm>
#include <sstream>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "actor.hpp"
#include "command.hpp"
#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "tool/text.hpp"

namespace {

using namespace lot::testing;
namespace tool = lot::tool;

[[maybe_unused]] const bool has_janitor = start_janitor();

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

/// Of the tables: their rows begin with blanks.
std::size_t width_of(const std::string& text) {
  std::size_t width = 0;
  for (const auto& line : lines_of(text)) {
    if (line.compare(0, 2, "  ") == 0) width = std::max(width, line.size());
  }
  return width;
}

/// How many lines begin so, after blanks.
std::size_t count(const std::string& text, const std::string& begin) {
  const auto lines = lines_of(text);
  return static_cast<std::size_t>(std::count_if(lines.begin(), lines.end(), [&](auto& line) {
    const auto first = line.find_first_not_of(' ');
    return first != line.npos && line.compare(first, begin.size(), begin) == 0;
  }));
}

/// The line that begins so, with one blank between cells.
std::string line_with(const std::string& text, const std::string& begin) {
  for (const auto& line : lines_of(text)) {
    std::istringstream words(line);
    std::string all;
    for (std::string word; words >> word;) all += (all.empty() ? "" : " ") + word;
    if (all.compare(0, begin.size(), begin) == 0) return all;
  }
  return "";
}

tool::Channel channel(std::uint32_t publisher, std::vector<tool::Reader> readers) {
  tool::Channel c;
  c.publisher = publisher;
  c.depth = 4;
  c.queue = {{1, 1}, {2, 2}};
  c.readers = std::move(readers);
  return c;
}

tool::Reader reader(std::uint32_t process, std::uint64_t lag, std::uint64_t lost = 0) {
  tool::Reader r{process};
  r.lag = lag;
  r.lost = lost;
  return r;
}

constexpr unsigned kMany = 10;

/// Ten processes that publish on ten topics each, and ten that subscribe to all of them.
struct Crowd {
  Crowd() {
    options.processes = 2 * kMany + 2;
    options.channels = kMany * kMany;
    options.topics = kMany;
    options.readers = kMany + 2;
    options.blocks = 2048;
    options.size_bytes = 24 << 20;
    for (unsigned n = 0; n < kMany; ++n) {
      publishers.emplace_back([this, n] { publish(n); });
      REQUIRE(ready.next(30s) == '.');
    }
    for (unsigned n = 0; n < kMany; ++n) {
      subscribers.emplace_back([this, n] { subscribe(n); });
      REQUIRE(ready.next(30s) == '.');
    }
    for (unsigned n = 0; n < kMany; ++n) go.tell();
    for (unsigned n = 0; n < kMany; ++n) REQUIRE(ready.next(30s) == '.');
  }

  static std::string topic(unsigned n) {
    return "/a/topic/with/a/name/that/is/much/longer/than/a/name/should/be/" + std::to_string(n);
  }

  lot::EngineOptions mine(const std::string& name, unsigned n) const {
    lot::EngineOptions o = options;
    o.name = name + std::to_string(n);
    return o;
  }

  void publish(unsigned n) {
    lot::ShmEngine engine(mine("/a_publisher_with_a_long_name_", n));
    std::vector<lot::ShmPusher<Letter>> pushers;
    for (unsigned t = 0; t < kMany; ++t) {
      pushers.push_back(engine.advertise<Letter>(topic(t), {lot::Policy::Overwrite, kDepth, {}}));
    }
    ready.tell();
    must(go.next(60s) != 0, "go");
    for (auto& pusher : pushers) {
      for (unsigned i = 0; i < 3; ++i) must_go(pusher.push(pusher.loan()));
    }
    ready.tell();
    pause();
  }

  void subscribe(unsigned n) {
    lot::ShmEngine engine(mine("/a_subscriber_with_a_long_name_", n));
    std::vector<lot::ShmPuller<Letter>> pullers;
    for (unsigned t = 0; t < kMany; ++t) {
      pullers.push_back(engine.subscribe<Letter>(topic(t)));
      must(!pullers.back().try_pull(), "nothing yet");  // it takes its place in every queue
    }
    ready.tell();
    pause();
  }

  Room room;
  lot::EngineOptions options = room.options();
  Steps ready, go;
  std::vector<Child> publishers;
  std::vector<Child> subscribers;
};

}  // namespace

TEST_SUITE_BEGIN("rows");

TEST_CASE("lot ls shows ten publishers and ten subscribers of a topic in three rows") {
  const Watchdog watchdog(120);
  const Crowd crowd;
  const auto words = [&](std::vector<std::string> more) {
    more.insert(more.end(), {"--interval", "1"});
    return on(crowd.options, std::move(more));
  };
  const std::string few = run_lot(words({"ls"})).out;
  CAPTURE(few);
  CHECK(count(few, "10 publishers") == kMany);
  CHECK(count(few, "10 subscribers") == kMany);
  CHECK(count(few, "publisher") == 0);
  CHECK(count(few, "subscriber") == 0);
  CHECK(count(few, "/a/topic") == kMany);
  CHECK(count(few, "10 processes /a_publisher") == 1);
  CHECK(count(few, "10 processes /a_subscriber") == 1);
  // Many processes have no pid together: behind the name comes since when they are there.
  const std::string together = line_with(few, "10 processes /a_publisher");
  CHECK(std::count(together.begin(), together.end(), ' ') == 6);
  CHECK(line_with(few, "10 publishers").find("10 publishers 10 processes overwrite 30 of 40 <") ==
        0);
  CHECK(line_with(few, "10 subscribers") == "10 subscribers 10 processes 30");
  CHECK(lines_of(few).size() < 3 * kMany + 10);
  CHECK(width_of(few) <= tool::Table::kWidth);

  const std::string each = run_lot(words({"ls", "--all"})).out;
  CHECK(count(each, "publisher") == kMany * kMany);
  CHECK(count(each, "subscriber") == kMany * kMany * kMany);
  CHECK(width_of(each) <= tool::Table::kWidth);

  const Json topics = run_lot(words({"ls", "--json"})).json().at("segments").at(0).at("topics");
  REQUIRE(topics.size() == kMany);
  for (const auto& topic : topics) {
    CHECK(topic.at("publishers").size() == kMany);
    CHECK(topic.at("subscribers").size() == kMany * kMany);
  }
}

TEST_CASE("lot who names a reader that is behind once a topic") {
  const Watchdog watchdog(120);
  const Crowd crowd;
  const std::string few = run_lot(on(crowd.options, {"who"})).out;
  CAPTURE(few);
  const auto behind = few.substr(few.find("BEHIND"));
  CHECK(lines_of(behind).size() == 1 + kMany * kMany);
  CHECK(behind.find("10 publishers") != std::string::npos);
  CHECK(behind.find("30 of 40") != std::string::npos);
  CHECK(width_of(few) <= tool::Table::kWidth);
  const std::string each = run_lot(on(crowd.options, {"who", "--all"})).out;
  CHECK(lines_of(each.substr(each.find("BEHIND"))).size() == 1 + kMany * kMany * kMany);
  CHECK(width_of(each) <= tool::Table::kWidth);
}

TEST_CASE("up to three publishers that are alike have a row each, more share one") {
  std::vector<tool::Channel> channels;
  for (std::uint32_t n = 1; n <= 4; ++n) {
    CHECK(tool::rows(channels, false).size() == channels.size());
    channels.push_back(channel(n, {reader(9, n), reader(8, 0, n)}));
  }
  const auto rows = tool::rows(channels, false);
  REQUIRE(rows.size() == 1);
  CHECK(rows.at(0).channels.size() == 4);
  CHECK(rows.at(0).sum.depth == 16);
  CHECK(rows.at(0).sum.queue.size() == 8);
  REQUIRE(rows.at(0).sum.readers.size() == 2);
  CHECK(rows.at(0).sum.readers.at(0).lag == 1 + 2 + 3 + 4);
  CHECK(rows.at(0).sum.readers.at(1).lag == 0);
  CHECK(rows.at(0).sum.readers.at(1).lost == 1 + 2 + 3 + 4);
  CHECK(tool::rows(channels, true).size() == 4);
}

TEST_CASE("publishers that differ in what a row says do not share one") {
  std::vector<tool::Channel> channels(8, channel(1, {}));
  CHECK(tool::rows(channels, false).size() == 1);
  const auto rows_when = [&](auto&& change) {
    auto changed = channels;
    for (std::size_t n = 0; n < 4; ++n) change(changed[n]);
    return tool::rows(changed, false).size();
  };
  CHECK(rows_when([](tool::Channel& c) { c.topic = 1; }) == 2);
  CHECK(rows_when([](tool::Channel& c) { c.orphan = true; }) == 2);
  CHECK(rows_when([](tool::Channel& c) { c.policy = lot::Policy::Block; }) == 2);
  CHECK(rows_when([](tool::Channel& c) { c.engine = lot::QueueEngine::Mutex; }) == 2);
  CHECK(rows_when([](tool::Channel& c) { c.taken = true; }) == 2);
  CHECK(rows_when([](tool::Channel& c) { c.waits = true; }) == 2);
}

TEST_CASE("a subscriber that loses messages or holds its publisher back is not among the others") {
  std::vector<tool::Reader> readers;
  for (std::uint32_t n = 1; n <= 6; ++n) readers.push_back(reader(n, n));
  CHECK(tool::groups(readers, false).size() == 1);
  CHECK(tool::groups(readers, true).size() == 6);
  readers.at(2).lost = 5;
  readers.at(3).holds_back = true;
  const auto groups = tool::groups(readers, false);
  REQUIRE(groups.size() == 3);
  CHECK(groups.at(0).size() == 4);
  CHECK(groups.at(1).at(0).process == 3);
  CHECK(groups.at(2).at(0).process == 4);
}

TEST_CASE("processes whose names differ in a number share a row; the dead have another") {
  std::vector<tool::Process> processes;
  for (std::uint32_t n = 1; n <= 5; ++n) {
    processes.push_back({n, "camera_" + std::to_string(n), 100, 0, true, 0});
  }
  processes.push_back({6, "planner", 100, 0, true, 0});
  auto groups = tool::groups(processes, false);
  REQUIRE(groups.size() == 2);
  CHECK(tool::common_name(groups.at(0)) == "camera_*");
  CHECK(tool::common_name(groups.at(1)) == "planner");
  processes.at(0).alive = false;
  groups = tool::groups(processes, false);
  CHECK(groups.size() == 3);
  CHECK(groups.at(1).size() == 4);
  for (auto& p : processes) p.name = "7";
  CHECK(tool::common_name(processes) == "7");
  for (auto& p : processes) p.name = "";
  CHECK(tool::common_name(processes).empty());
}

TEST_CASE("a table that would be too wide cuts its elastic columns, the widest first") {
  const std::string wide(70, 'w');
  const std::string fixed(30, 'f');
  tool::Table table({"A", "B", "C", ""}, {0, 1});
  table.add({wide, std::string(40, 'm'), fixed, "note"});
  const std::string text = table.text();
  CHECK(width_of(text) == tool::Table::kWidth);
  CHECK(text.find(fixed) != std::string::npos);
  CHECK(text.find("note") != std::string::npos);
  CHECK(text.find("ww..ww") != std::string::npos);
  tool::Table narrow({"A", "B"}, {0});
  narrow.add_line("a line of its own, which may be longer than any cell");
  narrow.add({"short", "cell"});
  CHECK(lines_of(narrow.text()).at(2) == "  short  cell");
}

TEST_SUITE_END();
