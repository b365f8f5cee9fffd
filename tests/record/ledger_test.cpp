// SPDX-License-Identifier: Apache-2.0

// What a recorder's ledger counts, word by word, and what waits between its two threads.

#include "record/ledger.hpp"

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "record/backlog.hpp"

namespace lot::record {
namespace {

using namespace std::chrono_literals;
using Topic = Ledger::Topic;
using Strings = std::vector<std::string>;

constexpr std::chrono::steady_clock::duration kLong = 1h;

/// All numbers of a line, in the order of RecorderStatus::Topic.
std::vector<std::uint64_t> counts(const Topic& topic) {
  return {topic.messages, topic.bytes, topic.missed, topic.lost, topic.damaged, topic.left_out};
}

std::vector<Entry> entries(std::initializer_list<std::uint64_t> all_held) {
  std::vector<Entry> all;
  for (const std::uint64_t held : all_held) all.emplace_back().held = held;
  return all;
}
std::vector<std::uint64_t> held_of(const std::deque<Entry>& all) {
  std::vector<std::uint64_t> each;
  for (const Entry& one : all) each.push_back(one.held);
  return each;
}

}  // namespace

TEST_SUITE_BEGIN("ledger");

TEST_CASE("a topic has one line for each name, type and content; lines never go") {
  Ledger ledger;
  const mcap::Pairs plain{{"a", "1"}};
  const mcap::Pairs other{{"a", "2"}};
  CHECK(ledger.line_of("/x", "run/x", "T", plain) == 0);
  CHECK(ledger.line_of("/y", "run/y", "T", plain) == 1);
  CHECK(ledger.line_of("/x", "run/x", "U", plain) == 2);
  CHECK(ledger.line_of("/x", "run/x", "T", other) == 3);
  CHECK(ledger.line_of("/x", "again/x", "T", plain) == 0);  // another run of ROS
  CHECK(ledger.line_of("/y", "run/y", "T", plain) == 1);
  CHECK(ledger.line_of("/x", "run/x", "U", plain) == 2);
  CHECK(ledger.line_of("/x", "run/x", "T", other) == 3);
  const RecorderStatus told = ledger.told();
  REQUIRE(told.topics.size() == 4);
  const std::vector<Strings> lines{
      {"/x", "run/x", "T"}, {"/y", "run/y", "T"}, {"/x", "run/x", "U"}, {"/x", "run/x", "T"}};
  for (std::size_t i = 0; i < lines.size(); ++i) {
    CAPTURE(i);
    const Topic& topic = told.topics[i];
    CHECK(Strings{topic.name, topic.in_segment, topic.type} == lines[i]);
    CHECK(counts(topic) == std::vector<std::uint64_t>(6, 0));
  }
}

TEST_CASE("a count changes by what is added and taken, and no other one does") {
  const Ledger::Count all[] = {&Topic::messages, &Topic::bytes,   &Topic::missed,
                               &Topic::lost,     &Topic::damaged, &Topic::left_out};
  for (std::size_t i = 0; i < 6; ++i) {
    CAPTURE(i);
    Ledger ledger;
    (void)ledger.line_of("/x", "/x", "T", {});
    (void)ledger.line_of("/y", "/y", "T", {});
    std::vector<std::uint64_t> expected(6, 0);
    ledger.add(1, all[i], 5);
    ledger.add(1, all[i], 4);
    ledger.take(1, all[i], 2);
    expected[i] = 7;
    CHECK(counts(ledger.topic(1)) == expected);
    CHECK(counts(ledger.topic(0)) == std::vector<std::uint64_t>(6, 0));
  }
}

TEST_CASE("sequence numbers leave out what was missed, for each line alone, and wrap") {
  Ledger ledger;
  (void)ledger.line_of("/x", "/x", "T", {});
  (void)ledger.line_of("/y", "/y", "T", {});
  CHECK(ledger.number(0, 0) == 0);
  CHECK(ledger.number(0, 0) == 1);
  CHECK(ledger.number(0, 3) == 5);
  ledger.miss(0, 2);
  CHECK(ledger.number(0, 0) == 8);
  CHECK(ledger.number(1, 1) == 1);
  CHECK(ledger.topic(0).missed == 5);
  CHECK(ledger.topic(1).missed == 1);
  ledger.miss(1, std::numeric_limits<std::uint32_t>::max() - 2);
  CHECK(ledger.number(1, 0) == std::numeric_limits<std::uint32_t>::max());
  CHECK(ledger.number(1, 0) == 0);
}

TEST_CASE("a topic is refused once, for the last reason") {
  Ledger ledger;
  ledger.refuse("/q", "a queue");
  ledger.refuse("/o", "opaque");
  ledger.refuse("/q", "opaque, too");
  const auto refused = ledger.told().refused;
  REQUIRE(refused.size() == 2);
  CHECK(Strings{refused[0].name, refused[0].why} == Strings{"/q", "opaque, too"});
  CHECK(Strings{refused[1].name, refused[1].why} == Strings{"/o", "opaque"});
}

TEST_CASE("a name or pattern is unmatched until a topic fits it") {
  Ledger ledger;
  CHECK(!ledger.expects_more());
  ledger.expects({"/a", "/camera/*", "/b"});
  CHECK(ledger.expects_more());
  ledger.saw("/c");
  CHECK(ledger.told().unmatched == Strings{"/a", "/camera/*", "/b"});
  ledger.saw("/camera/left");
  CHECK(ledger.told().unmatched == Strings{"/a", "/b"});
  ledger.saw("/b");
  CHECK(ledger.expects_more());
  ledger.saw("/a");
  CHECK(!ledger.expects_more());
  CHECK(ledger.told().unmatched.empty());
}

TEST_CASE("a recording is as open as all of its segments; each segment and file is told once") {
  Ledger ledger;
  CHECK(ledger.mode() == 0666);
  ledger.joined("/dev/shm/a", 0664);
  CHECK(ledger.mode() == 0664);
  ledger.joined("/dev/shm/b", 0606);
  CHECK(ledger.mode() == 0604);
  ledger.joined("/dev/shm/a", 0600);
  CHECK(ledger.mode() == 0600);
  CHECK(ledger.told().segments == Strings{"/dev/shm/a", "/dev/shm/b"});
  for (const char* file : {"a_0", "a_1", "a_0"}) ledger.made(file);
  CHECK(ledger.told().files == Strings{"a_0", "a_1"});
}

TEST_CASE("triggers are counted; the first error stays, and the last one is told") {
  Ledger ledger;
  CHECK(ledger.told().triggers == 0);
  ledger.triggered();
  ledger.triggered();
  CHECK(ledger.told().triggers == 2);
  CHECK(ledger.told().first_error.empty());
  CHECK(ledger.told().error.empty());
  ledger.went_wrong("full");
  ledger.went_wrong("gone");
  CHECK(ledger.told().first_error == "full");
  CHECK(ledger.told().error == "gone");
}

TEST_CASE("what is kept of the last seconds is told as it is") {
  Past past(100, 25);
  for (const std::uint64_t at : {10u, 17u, 40u}) {
    Past::Kept kept{};
    kept.head.log_time = at;
    kept.bytes.resize(at == 40 ? 9 : 12);
    past.add(std::move(kept));
  }
  Ledger ledger;
  ledger.keeps(past);
  const RecorderStatus told = ledger.told();
  CHECK(told.kept_messages == 2);
  CHECK(told.kept_bytes == 21);
  CHECK(told.cut_messages == 1);
  CHECK(told.cut_time == Duration(23ns));
}

TEST_CASE("a backlog has room for what is not held; what was taken counts until it is done") {
  Backlog backlog;
  CHECK(backlog.room(0) == 0);  // one is always allowed
  CHECK(backlog.room(10) == 10);
  auto some = entries({4, 5});
  backlog.put(some);
  CHECK(some.empty());
  CHECK(backlog.held() == 9);
  CHECK(backlog.room(10) == 1);
  CHECK(held_of(backlog.take(kLong)) == std::vector<std::uint64_t>{4, 5});
  CHECK(backlog.held() == 9);
  CHECK(backlog.room(10) == 1);
  backlog.done(4);
  CHECK(backlog.held() == 5);
  CHECK(backlog.room(10) == 5);
  backlog.done(5);
  CHECK(backlog.held() == 0);
  CHECK(backlog.room(10) == 10);
}

TEST_CASE("a backlog that holds its limit lets a thread wait until something is done") {
  for (const std::uint64_t more : {0u, 1u}) {  // at the limit, and beyond it
    CAPTURE(more);
    Backlog backlog;
    auto one = entries({7, 3 + more});
    backlog.put(one);
    std::uint64_t room = 0;
    std::thread asks([&] { room = backlog.room(10); });
    std::this_thread::sleep_for(20ms);  // so that it sleeps, in most runs
    backlog.done(7);
    asks.join();
    CHECK(room == 7 - more);  // without the wait it is 0
  }
}

TEST_CASE("a thread that waits for a backlog's messages wakes by one, and by the end") {
  Backlog backlog;
  std::deque<Entry> got;
  const auto while_it_waits = [&](auto&& act) {
    std::thread takes([&] { got = backlog.take(kLong); });
    std::this_thread::sleep_for(20ms);  // so that it sleeps, in most runs
    act();
    takes.join();
  };
  auto none = entries({});
  backlog.put(none);
  CHECK(backlog.take(0s).empty());
  while_it_waits([&] {
    std::vector<Entry> trigger(1);
    backlog.put(trigger);
  });
  CHECK(got.size() == 1);
  CHECK(backlog.held() == 0);  // a trigger takes nothing
  CHECK(!backlog.is_over());
  while_it_waits([&] { backlog.end(); });
  CHECK(got.empty());
  CHECK(backlog.is_over());
  CHECK(backlog.take(kLong).empty());
}

TEST_CASE("a backlog that has ended is over when its last messages were taken") {
  Backlog backlog;
  auto one = entries({3});
  backlog.put(one);
  CHECK(!backlog.is_over());
  backlog.end();
  CHECK(!backlog.is_over());
  CHECK(held_of(backlog.take(kLong)) == std::vector<std::uint64_t>{3});
  CHECK(backlog.is_over());
}

TEST_SUITE_END();

}  // namespace lot::record
