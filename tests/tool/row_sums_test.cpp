// SPDX-License-Identifier: Apache-2.0

// What a row says of several queues, readers or processes, from numbers that the test makes up.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <unistd.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "tool/report.hpp"
#include "tool/rows.hpp"

namespace {

using namespace lot::tool;

Channel queue(std::uint32_t channel, std::uint32_t publisher, std::vector<Reader> readers = {}) {
  Channel c;
  c.channel = channel;
  c.generation = 1;
  c.publisher = publisher;
  c.depth = 10;
  c.unfinished = 1;
  c.queue = {{1, 1}, {2, 2}};
  c.readers = std::move(readers);
  return c;
}

Reader reader(std::uint32_t process, std::uint64_t lag, std::uint64_t lost = 0) {
  Reader r{process};
  r.lag = lag;
  r.lost = lost;
  return r;
}

std::string text(const Reader& r) {
  return std::to_string(r.process) + ":" + std::to_string(r.lag) + "/" + std::to_string(r.lost) +
         (r.joining ? " joins" : "") + (r.observes ? " observes" : "") +
         (r.awaited ? " awaited" : "") + (r.holds_back ? " holds" : "");
}

std::string text(const std::vector<Row>& rows) {
  std::string all;
  for (const Row& row : rows) {
    all += "\n" + std::to_string(row.channels.size()) + ": " +
           std::to_string(row.sum.queue.size()) + " of " + std::to_string(row.sum.depth) + ", " +
           std::to_string(row.sum.unfinished) + " unfinished";
    for (const Reader& r : row.sum.readers) all += ", " + text(r);
  }
  return all;
}

Observation seen() {
  Observation o;
  o.processes = {{1, "camera", 11, 0, true, 0},
                 {2, "a_process_with_a_name_of_more_than_24_letters", 12, 0, true, 0}};
  o.memory = {3 << 20, 64 << 20};
  o.blocks = {7, 512};
  return o;
}

/// What a report writes to standard output; each line ends in a blank. In text, its exit and its
/// hints stand behind a bar.
template <class F>
std::string report_of(F&& fill, bool json = false) {
  Settings settings;
  settings.json = json;
  Report report(settings);
  fill(report);
  std::fflush(stdout);
  const int before = dup(STDOUT_FILENO);
  std::FILE* const file = std::tmpfile();
  REQUIRE(file != nullptr);
  dup2(fileno(file), STDOUT_FILENO);
  const Exit exit = report.finish();
  dup2(before, STDOUT_FILENO);
  close(before);
  std::string all;
  std::rewind(file);
  for (int c; (c = std::fgetc(file)) != EOF;) all += static_cast<char>(c);
  std::fclose(file);
  std::replace(all.begin(), all.end(), '\n', ' ');
  if (json) return all;
  const bool has_hints = all.ends_with(' ') && all.find(" * ") != all.npos;
  const std::size_t hints = has_hints ? all.find(" * ") : all.size();
  return all.substr(0, hints) + "|" + std::to_string(exit) +
         (has_hints ? all.substr(hints, all.size() - 1 - hints) : "");
}

std::string clean() { return "`lot clean --dir /nowhere --segment S`"; }

/// What a report says of a segment in which this is seen.
std::string judged(const Observation& o) {
  const Sight sight{"S", "/nowhere/S", Sight::Condition::Sound, "", nullptr};
  Json entry = Json::object();
  const std::string text = report_of([&](Report& report) { judge(sight, o, report, entry); });
  CHECK(entry == Json{{"damage", o.damage}});
  return text;
}

}  // namespace

TEST_SUITE_BEGIN("row_sums");

TEST_CASE("a row adds the numbers of its queues, and of each reader in them") {
  std::vector<Channel> all;
  for (std::uint32_t n = 0; n < 4; ++n)
    all.push_back(queue(n, n + 1, {reader(9, n, 1), reader(8, 1)}));
  CHECK(text(rows(all, false)) == "\n4: 8 of 40, 4 unfinished, 9:6/4, 8:4/0");
  all.pop_back();
  const std::string each =
      "\n1: 2 of 10, 1 unfinished, 9:0/1, 8:1/0"
      "\n1: 2 of 10, 1 unfinished, 9:1/1, 8:1/0"
      "\n1: 2 of 10, 1 unfinished, 9:2/1, 8:1/0";
  CHECK(text(rows(all, false)) == each);
  CHECK(text(rows(all, true)) == each);
  for (Channel& c : all) c.orphan = true;  // they share a row, however few they are
  CHECK(text(rows(all, false)) == "\n3: 6 of 30, 3 unfinished, 9:3/3, 8:3/0");
  CHECK(text(rows(all, true)) == each);
  all.resize(1);
  CHECK(text(rows(all, false)) == "\n1: 2 of 10, 1 unfinished, 9:0/1, 8:1/0");
  CHECK(rows({}, false).empty());
}

TEST_CASE("a process with several places in a queue has as many readers in the row") {
  Channel first = queue(0, 1, {reader(9, 1), reader(9, 2)});
  Channel second = queue(1, 2, {reader(9, 10), reader(8, 5), reader(9, 20), reader(9, 40)});
  first.orphan = second.orphan = true;
  CHECK(text(rows({first, second}, false)) ==
        "\n2: 4 of 20, 2 unfinished, 9:11/0, 9:22/0, 8:5/0, 9:40/0");
  Reader& a = first.readers[0];
  Reader& b = second.readers[0];
  first.readers.resize(1);
  second.readers.resize(1);
  const auto sum = [&] { return text(rows({first, second}, false)[0].sum.readers[0]); };
  CHECK(sum() == "9:11/0");
  b.joining = b.awaited = b.holds_back = b.observes = true;
  CHECK(sum() == "9:11/0 joins awaited holds");
  a.observes = true;
  CHECK(sum() == "9:11/0 joins observes awaited holds");
  b.joining = b.awaited = b.holds_back = b.observes = false;
  a.joining = a.awaited = a.holds_back = true;
  CHECK(sum() == "9:11/0 joins awaited holds");
}

TEST_CASE("groups of readers and processes keep the order of the first of each kind") {
  const auto sizes = [](const auto& groups) {
    std::string all;
    for (const auto& group : groups) all += std::to_string(group.size());
    return all;
  };
  std::vector<Reader> readers;
  for (std::uint32_t n = 0; n < 9; ++n) readers.push_back(reader(n, n));
  CHECK(sizes(groups(readers, false)) == "9");
  CHECK(sizes(groups(readers, true)) == "111111111");
  const auto with = [&](auto&& change) {
    auto changed = readers;
    for (std::size_t n = 1; n < 5; ++n) change(changed[n]);
    return sizes(groups(changed, false));
  };
  CHECK(with([](Reader& r) { r.joining = true; }) == "54");
  CHECK(with([](Reader& r) { r.observes = true; }) == "54");
  CHECK(with([](Reader& r) { r.awaited = true; }) == "54");
  CHECK(with([](Reader& r) { r.holds_back = true; }) == "54");
  CHECK(with([](Reader& r) { r.lost = r.process; }) == "54");
  CHECK(with([](Reader& r) { r.lag = 1; }) == "9");
  readers.resize(3);
  CHECK(sizes(groups(readers, false)) == "111");
  std::vector<Process> processes;
  for (const char* name : {"a1", "a2", "b", "a33", "a", "b7", "4", "5", "a6"}) {
    processes.push_back({1, name, 0, 0, true, 0});
  }
  CHECK(sizes(groups(processes, false)) == "51111");
  processes[1].alive = false;
  CHECK(sizes(groups(processes, false)) == "411111");
  CHECK(common_name(processes) == "a*");
  CHECK(common_name({processes[0], processes[0]}) == "a1");
  CHECK(common_name({processes[6], processes[7]}) == "4*");
  CHECK(common_name({processes[2]}) == "b");
}

TEST_CASE("the rate of several queues is their sum, or a bound where one is silent") {
  const auto rate = [](std::optional<double> per_second, std::optional<double> below) {
    return Rate{per_second, below, 0, 0};
  };
  const Rates rates = {{{0, 1}, rate(10, {})},   {{1, 1}, rate(20, {})},  {{2, 1}, rate({}, 2)},
                       {{3, 1}, rate({}, 0.09)}, {{4, 1}, rate({}, 0.1)}, {{5, 1}, rate({}, {})},
                       {{6, 2}, rate(7, {})}};
  const auto of = [&](std::vector<std::uint32_t> channels) {
    std::vector<Channel> all;
    for (const std::uint32_t c : channels) all.push_back(queue(c, 1));
    return text_of(rate_of(all, rates));
  };
  CHECK(of({}).empty());
  CHECK(of({0}) == "10.0/s");
  CHECK(of({0, 1}) == "30.0/s");
  CHECK(of({2}) == "< 2/s");
  CHECK(of({0, 2}) == "< 12/s");
  CHECK(of({2, 2}) == "< 4/s");
  CHECK(of({0, 3}) == "10.0/s");  // less than a hundredth
  CHECK(of({0, 4}) == "< 10.1/s");
  CHECK(of({0, 5}).empty());
  CHECK(of({5}).empty());
  CHECK(of({0, 6}).empty());  // another generation
  Channel gone = queue(0, 1);
  gone.orphan = true;
  CHECK(text_of(rate_of(gone, rates)).empty());
  CHECK(text_of(rate_of(queue(0, 1), rates)) == "10.0/s");
}

TEST_CASE("processes, publishers and what is used are told in a few words") {
  const Observation o = seen();
  CHECK(processes_text(o, {1}) == "1 camera");
  CHECK(processes_text(o, {1, 1}) == "1 camera");
  CHECK(processes_text(o, {2}) == "2 a_process.._24_letters");
  CHECK(processes_text(o, {1, 2, 1}) == "2 processes");
  CHECK(fill_text(o) == "3 MiB of 64 MiB, 7 of 512 messages");
  const auto publisher = [&](std::size_t n, bool orphan, std::uint32_t of) {
    Row row;
    row.channels.resize(n);
    row.sum.orphan = orphan;
    row.sum.publisher = of;
    return publisher_text(o, row);
  };
  CHECK(publisher(1, false, 1) == "1 camera");
  CHECK(publisher(1, true, 0) == "(gone)");
  CHECK(publisher(2, true, 0) == "(2 gone)");
  CHECK(publisher(2, false, 1) == "2 publishers");
  CHECK(publisher(1, false, 3) == "3");
  CHECK(o.process(3) == nullptr);
  CHECK(o.process(1)->name == "camera");
  CHECK(o.topic(0) == nullptr);
  using How = Holder::How;
  for (const auto& [how, word] :
       {std::pair(How::Keeps, "keeps"), std::pair(How::Borrows, "borrows"),
        std::pair(How::Queues, "queues"), std::pair(How::Refers, "refers"),
        std::pair(How::Spare, "spare"), std::pair(static_cast<How>(99), "?")}) {
    CHECK(std::string(to_string(how)) == word);
  }
}

TEST_CASE("five queues are named with the items that wait, and the others counted") {
  const auto told = [](const Waiting& items) {
    return waiting_text(items) + " " + waiting_json(items).dump();
  };
  CHECK(told({}) == " []");
  CHECK(told({{"jobs", 1}}) == R"(1 item waits in jobs [{"queue":"jobs","items":1}])");
  CHECK(waiting_text({{"jobs", 12}, {"logs", 3}}) == "12 items wait in jobs, 3 in logs");
  Waiting items = {{"a", 2}, {"b", 1}, {"c", 1}, {"d", 1}, {"e", 4}};
  CHECK(waiting_text(items) == "2 items wait in a, 1 in b, 1 in c, 1 in d, 4 in e");
  items["f"] = 5;
  CHECK(waiting_text(items) ==
        "2 items wait in a, 1 in b, 1 in c, 1 in d, 4 in e, 5 in other queues");
  items["g"] = 6;
  CHECK(waiting_text(items) ==
        "2 items wait in a, 1 in b, 1 in c, 1 in d, 4 in e, 11 in other queues");
  CHECK(waiting_text({{std::string(41, 'x'), 1}}) ==
        "1 item waits in " + std::string(19, 'x') + ".." + std::string(19, 'x'));
}

TEST_CASE("the dead and what is damaged have a hint each, and the living have none") {
  Observation o = seen();
  CHECK(judged(o) == "|0");
  o.processes.push_back({3, "worker", 13, 0, false, 0});
  CHECK(judged(o) == "|1 * process 3 (worker) in S is dead: run " + clean());
  o.processes.push_back({4, "other", 14, 0, false, 0});
  CHECK(judged(o) == "|1 * process 3 (worker) in S is dead: run " + clean() +
                         " * process 4 (other) in S is dead: run " + clean());
  o = seen();
  for (std::uint32_t k = 3; k < 13; ++k) o.processes.push_back({k, "worker", 13, 0, false, 0});
  CHECK(judged(o) == "|1 * 10 processes (worker) in S are dead: run " + clean());
  o = seen();
  o.damage = {"one", "two"};
  CHECK(judged(o) ==
        "  damaged: one   damaged: two |3 * S is damaged: a process has written behind the end of "
        "its messages; stop all that use it and run " +
            clean());
}

TEST_CASE("a segment that is not looked into is introduced with the reason and what to do") {
  const auto told = [](Sight::Condition condition) {
    Sight sight{"S", "/nowhere/S", condition, "the reason", nullptr};
    Json entry = Json::object();
    const std::string text =
        report_of([&](Report& report) { CHECK(!introduce(sight, report, entry)); });
    CHECK(entry.dump() == std::string(R"({"name":"S","path":"/nowhere/S","condition":")") +
                              to_string(condition) + R"(","reason":"the reason"})");
    return text;
  };
  using Condition = Sight::Condition;
  CHECK(told(Condition::OtherBoot) ==
        "S  /nowhere/S   other boot: the reason |1 * S is of another boot: run " + clean());
  CHECK(told(Condition::Unreadable) ==
        "S  /nowhere/S   unreadable: the reason |1 * S can not be read: ask its owner, or look as "
        "root: `lot ls --dir /nowhere --segment S`");
  CHECK(told(Condition::Untrusted) ==
        "S  /nowhere/S   not trusted: the reason |1 * S is not looked into: above stands why, and "
        "what to set if you trust its users");
  CHECK(told(Condition::Damaged) ==
        "S  /nowhere/S   damaged: the reason |3 * S is damaged, cut short, or of another version: "
        "stop what uses it and run " +
            clean());
}

TEST_CASE("nothing found is told of a directory, or of the name in it") {
  const auto told = [](const char* name) {
    Settings settings;
    settings.where.directory = "/nowhere";
    settings.where.name = name;
    return report_of([&](Report& report) { nothing_found(settings, report); });
  };
  CHECK(told("") == "no segments in /nowhere |1");
  CHECK(told("S") == "no segment /nowhere/S |1");
}

TEST_CASE("a report ends as its gravest part, in text and in JSON") {
  const auto fill = [](Report& report) {
    report.print("text\n");
    report.document()["name"] = "a\xff";
    report.hint("first");
    report.ends(kDamaged);
    report.ends(kWrong);
    report.hint("second");
  };
  CHECK(report_of(fill) == "text |3 * first * second");
  CHECK(report_of(fill, true) ==
        "{   \"name\": \"a\xef\xbf\xbd\",   \"hints\": [     \"first\",     \"second\"   ],   "
        "\"exit\": 3 } ");
}

TEST_SUITE_END();
