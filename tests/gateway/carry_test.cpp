// SPDX-License-Identifier: Apache-2.0

// lot_gateway between two segments of this machine, by the loopback interface.

#include <chrono>
#include <cstdint>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "gateway/program.hpp"
#include "support/processes.hpp"

namespace geometry_msgs {

struct Point {
  float x, y;
};

}  // namespace geometry_msgs

namespace lot::testing {
namespace {

struct Note {
  std::uint64_t number = 0;
  ShmString text;
  ShmVector<double> values;
};

struct Order {
  std::uint64_t number = 0;
};

struct Host {
  EngineOptions where = fresh();
  ShmEngine engine{where};
};

/// A file of settings.
struct File {
  explicit File(const std::string& text) { write_file(path, text); }
  Directory directory;
  std::string path = directory.file("gateway.yaml");
};

/// Pushes messages with the number 0 until one comes through.
template <class T>
void wait_until_carried(ShmPusher<T>& from, ShmPuller<T>& to) {
  REQUIRE(eventually(
      [&] {
        (void)from.push(from.loan());
        return static_cast<bool>(to.pull(20ms));
      },
      30s));
}

/// The next message with a number, also of a gateway that has yet to come.
template <class T>
ShmSharedPtr<const T> next_numbered(ShmPuller<T>& puller) {
  for (;;) {
    auto message = puller.pull(20s);
    const bool is_over = !message && puller.status() != Status::PublisherGone;
    if (is_over || (message && message->number != 0)) return message;
  }
}

void push_note(ShmPusher<Note>& pusher, std::uint64_t number) {
  auto note = pusher.loan();
  note->number = number;
  note->text = "note " + std::to_string(number);
  note->values.resize(number % 1000);
  for (std::size_t i = 0; i < note->values.size(); ++i) {
    note->values[i] = static_cast<double>(number + i);
  }
  REQUIRE(pusher.push(std::move(note)) == Status::Ok);
}

void check_note(const Note& note, std::uint64_t number) {
  CHECK(note.number == number);
  CHECK(std::string(note.text) == "note " + std::to_string(number));
  REQUIRE(note.values.size() == number % 1000);
  for (std::size_t i = 0; i < note.values.size(); ++i) {
    CHECK(note.values[i] == static_cast<double>(number + i));
  }
}

TEST_SUITE_BEGIN("gateway");

TEST_CASE("messages of one segment come into another one, whole and in their order") {
  const Watchdog watchdog(110);
  Host a;
  Host b;
  auto pusher = a.engine.advertise<Note>("/notes");
  auto puller = b.engine.subscribe<Note>("/notes");
  Gateway out(a.where, {"--out", "/notes"});
  Gateway in(b.where, {"--in", "/notes"});
  wait_until_carried(pusher, puller);
  constexpr std::uint64_t kNotes = 500;
  constexpr std::uint64_t kAhead = 16;  // fewer than any queue on the way has
  for (std::uint64_t i = 1; i <= kNotes + kAhead; ++i) {
    if (i <= kNotes) push_note(pusher, i);
    if (i <= kAhead) continue;
    const auto note = next_numbered(puller);
    REQUIRE(note);
    check_note(*note, i - kAhead);
  }
  const auto sent = out.end()["out /notes"];
  const auto got = in.end()["in /notes"];
  CHECK(out.exit() == 0);
  CHECK(in.exit() == 0);
  CHECK(sent.carried >= kNotes);
  CHECK(got.carried >= kNotes);
  CHECK(sent.missed + sent.damaged + got.damaged + got.refused + got.lost == 0);
}

TEST_CASE("a topic has the name between the hosts that the settings of both say") {
  const Watchdog watchdog(110);
  Host a;
  Host b;
  const File of_a("out:\n  - {topics: my-notes, dds_topic: rt/between}");
  const File of_b("in:\n  - {topics: /notes_of_a, dds_topic: rt/between}");
  auto pusher = a.engine.advertise<Note>("my-notes");
  auto puller = b.engine.subscribe<Note>("/notes_of_a");
  Gateway out(a.where, {"--config", of_a.path});
  Gateway in(b.where, {"--config", of_b.path});
  wait_until_carried(pusher, puller);
  CHECK(out.end()["out my-notes"].carried != 0);
  CHECK(in.end()["in /notes_of_a"].carried != 0);
}

TEST_CASE("a gateway prints its table once for a signal, and begins its errors with its name") {
  const Watchdog watchdog(110);
  Host a;
  Host b;
  auto pusher = a.engine.advertise<Note>("/notes");
  auto puller = b.engine.subscribe<Note>("/notes");
  Gateway out(a.where, {"--out", "/notes"});
  Gateway in(b.where, {"--in", "/notes"});
  wait_until_carried(pusher, puller);
  CHECK(out.look()["out /notes"].carried != 0);
  for (int i = 0; i < 3; ++i) {  // it goes on, for some of its turns
    wait_until_carried(pusher, puller);
    std::this_thread::sleep_for(100ms);
  }
  CHECK(out.tables() == 1);
  (void)out.end();
  CHECK(out.tables() == 2);
  const File mistaken("out: 5");
  Gateway wrong(a.where, {"--config", mistaken.path});
  CHECK(wrong.ends() != 0);
  CHECK(wrong.said().starts_with("lot_gateway: " + mistaken.path));
}

TEST_CASE("a gateway encodes no message that no reader wants, unless its topic is latched") {
  const Watchdog watchdog(60);
  Host a;
  const File file("out:\n  - {topics: /map, durability: transient_local}\n  - /notes");
  auto notes = a.engine.advertise<Note>("/notes");
  auto maps = a.engine.advertise<Note>("/map");
  Gateway out(a.where, {"--config", file.path});
  REQUIRE(out.says("out /notes -> rt/notes"));
  REQUIRE(out.says("out /map -> rt/map"));
  for (std::uint64_t i = 1; i <= 5; ++i) {
    push_note(notes, i);
    push_note(maps, i);
  }
  CHECK(eventually([&] { return out.look()["out /notes"].unheard == 5; }));
  CHECK(eventually([&] { return out.look()["out /map"].carried == 5; }));
  auto lines = out.end();
  CHECK(lines["out /notes"].carried == 0);
  CHECK(lines["out /map"].unheard == 0);
}

TEST_CASE("a gateway takes the type of a topic from the gateway of the other segment") {
  const Watchdog watchdog(60);
  Host a;
  Host b;
  auto pusher = a.engine.advertise<Note>("/notes");
  Gateway in(b.where, {"--in", "/n*"});
  Gateway out(a.where, {"--out", "/n*"});
  REQUIRE(eventually(
      [&] {
        push_note(pusher, 7);
        return static_cast<bool>(b.engine.type_of("/notes"));
      },
      30s));
  auto puller = b.engine.subscribe<Note>("/notes");
  push_note(pusher, 7);
  const auto note = next_numbered(puller);
  REQUIRE(note);
  check_note(*note, 7);
}

TEST_CASE("no message comes back, or twice, where both gateways carry everything both ways") {
  const Watchdog watchdog(110);
  Host a;
  Host b;
  const std::vector<std::string> everything = {"--out", "/*", "--in", "/*"};
  auto orders_a = a.engine.advertise<Order>("/orders");
  auto orders_b = b.engine.advertise<Order>("/orders");
  auto seen_a = a.engine.subscribe<Order>("/orders");
  auto seen_b = b.engine.subscribe<Order>("/orders");
  Gateway one(a.where, everything);
  Gateway other(b.where, everything);
  Gateway second_in(a.where, {"--in", "/orders"});
  const auto until_carried = [](auto& from, auto& to, std::uint64_t number) {
    return eventually(
        [&] {
          auto order = from.loan();
          order->number = number;
          (void)from.push(std::move(order));
          for (auto seen = to.pull(20ms); seen; seen = to.try_pull()) {
            if (seen->number == number) return true;
          }
          return false;
        },
        30s);
  };
  REQUIRE(until_carried(orders_a, seen_b, 1));
  REQUIRE(until_carried(orders_b, seen_a, 2));
  std::this_thread::sleep_for(300ms);  // what loops goes around meanwhile
  while (seen_a.try_pull()) {
  }
  while (seen_b.try_pull()) {
  }
  constexpr std::uint64_t kFirst = 100;
  constexpr std::uint64_t kLast = 120;
  for (std::uint64_t i = kFirst; i <= kLast; ++i) {
    for (auto* pusher : {&orders_a, &orders_b}) {
      auto order = pusher->loan();
      order->number = i;
      REQUIRE(pusher->push(std::move(order)) == Status::Ok);
    }
    std::this_thread::sleep_for(5ms);
  }
  std::this_thread::sleep_for(500ms);
  std::string tables;
  for (Gateway* gateway : {&one, &other, &second_in}) {
    const auto lines = gateway->end();
    tables += gateway->said();
    for (const auto& [name, line] : lines) {
      tables += name + ": " + std::to_string(line.carried) + " carried, " +
                std::to_string(line.missed) + " missed, " + std::to_string(line.lost) + " lost, " +
                std::to_string(line.looped) + " looped, " + std::to_string(line.unheard) +
                " unheard\n";
    }
  }
  CAPTURE(tables);
  for (auto* puller : {&seen_a, &seen_b}) {
    std::vector<int> times(kLast + 1);
    while (const auto seen = puller->try_pull()) ++times[seen->number];
    for (std::uint64_t i = kFirst; i <= kLast; ++i) {
      CAPTURE(i);
      // Its own segment's, and the other one's. second_in brings the other one's a second time.
      CHECK(times[i] == (puller == &seen_a ? 3 : 2));
    }
  }
}

TEST_CASE("a gateway that was killed is started again, and goes on") {
  const Watchdog watchdog(110);
  Host a;
  Host b;
  auto pusher = a.engine.advertise<Note>("/notes");
  auto puller = b.engine.subscribe<Note>("/notes");
  Gateway out(a.where, {"--out", "/notes"});
  Gateway in(b.where, {"--in", "/notes"});
  wait_until_carried(pusher, puller);
  for (const bool is_out : {true, false}) {
    CAPTURE(is_out);
    Gateway& killed = is_out ? out : in;
    killed.kill9();
    killed = Gateway(is_out ? a.where : b.where, {is_out ? "--out" : "--in", "/notes"});
    const std::uint64_t number = is_out ? 5 : 6;  // what came before the kill has another one
    REQUIRE(eventually(
        [&] {
          push_note(pusher, number);
          auto note = puller.pull(20ms);
          while (note && note->number != number) note = puller.try_pull();
          if (note) check_note(*note, number);
          return static_cast<bool>(note);
        },
        30s));
  }
  CHECK(out.end()["out /notes"].before != 0);
}

/// Notes from one segment to the other: how many were pushed, and how many have come.
struct Stream {
  Host a;
  Host b;
  ShmPusher<Note> pusher = a.engine.advertise<Note>("/notes");
  ShmPuller<Note> puller = b.engine.subscribe<Note>("/notes");
  std::uint64_t pushed = 0;
  std::uint64_t came = 0;
  std::uint64_t last = 0;  ///< the number of the last one that has come

  void push(int notes) {
    for (int i = 0; i < notes; ++i) {
      push_note(pusher, ++pushed);
      look(200us);
    }
  }
  /// Pushes until the last note has come: then none is under way.
  void settle() {
    REQUIRE(eventually(
        [&] {
          push(1);
          look(50ms);
          return last == pushed;
        },
        60s));
  }
  void look(std::chrono::microseconds most) {
    for (auto note = puller.pull(most); note; note = puller.try_pull()) {
      check_note(*note, note->number);
      REQUIRE(note->number > last);
      last = note->number;
      ++came;
    }
  }
};

TEST_CASE("what has come and what is counted is all that was published, over kills of either") {
  const Watchdog watchdog(170);
  Stream notes;
  const File out_settings("out:\n  - {topics: /notes, depth: 1000}");
  const File in_settings("in:\n  - {topics: /notes, depth: 1000}");
  const auto begin_out = [&] {
    return Gateway(notes.a.where,
                   {"--config", out_settings.path, "--state", out_settings.path + ".state"});
  };
  const auto begin_in = [&] {
    return Gateway(notes.b.where,
                   {"--config", in_settings.path, "--state", in_settings.path + ".state"});
  };
  Gateway out = begin_out();
  Gateway in = begin_in();
  const auto counted = [&] {
    const Line sent = out.look()["out /notes"];
    const Line got = in.look()["in /notes"];
    return sent.before + sent.missed + sent.lost + sent.damaged + got.lost + got.refused +
           got.damaged;
  };
  notes.settle();
  const std::uint64_t counted_before = counted();
  const std::uint64_t pushed_before = notes.pushed;
  const std::uint64_t came_before = notes.came;
  constexpr std::uint64_t kKills = 4;  // of each
  for (std::uint64_t i = 0; i < kKills; ++i) {
    for (const bool is_out : {true, false}) {
      notes.push(60);
      (is_out ? out : in).kill9();
      notes.push(30);
      (is_out ? out : in) = is_out ? begin_out() : begin_in();
      notes.settle();
    }
  }
  const std::uint64_t published = notes.pushed - pushed_before;
  const std::uint64_t lost = counted() - counted_before;
  const std::uint64_t came = notes.came - came_before;
  CAPTURE(published);
  CAPTURE(lost);
  CAPTURE(came);
  CHECK(notes.puller.missed_total() == 0);
  CHECK(lost != 0);
  CHECK(came + lost >= published);
  CHECK(came + lost <= published + kKills);  // the note whose push a kill cuts may be counted, too
}

TEST_CASE("a latched topic reaches a gateway and a subscriber that come later") {
  const Watchdog watchdog(60);
  Host a;
  Host b;
  const File file("out:\n  - {topics: /map, durability: transient_local, depth: 1}");
  auto pusher = a.engine.advertise<Note>("/map");
  push_note(pusher, 3);
  push_note(pusher, 4);
  Gateway out(a.where, {"--config", file.path});
  REQUIRE(out.says("out /map -> rt/map"));
  Gateway in(b.where, {"--in", "/map"});
  REQUIRE(eventually([&] { return static_cast<bool>(b.engine.type_of("/map")); }, 30s));
  PullerOptions latched;
  latched.history = 1;
  auto puller = b.engine.subscribe<Note>("/map", latched);
  const auto note = next_numbered(puller);
  REQUIRE(note);
  check_note(*note, 4);
}

TEST_CASE("a subscriber sees PublisherGone when the last publisher of the other segment has left") {
  const Watchdog watchdog(60);
  Host a;
  Host b;
  auto puller = b.engine.subscribe<Order>("/orders");
  Gateway out(a.where, {"--out", "/orders"});
  Gateway in(b.where, {"--in", "/orders"});
  {
    auto pusher = a.engine.advertise<Order>("/orders");
    wait_until_carried(pusher, puller);
  }
  bool has_gone = false;
  while (!has_gone) {
    const auto order = puller.pull(20s);
    has_gone = puller.status() == Status::PublisherGone;
    REQUIRE((order || has_gone));
  }
  auto pusher = a.engine.advertise<Order>("/orders");
  wait_until_carried(pusher, puller);
}

TEST_CASE("what comes in too often is refused and counted") {
  const Watchdog watchdog(60);
  Host a;
  Host b;
  const File file("in:\n  - {topics: /orders, max_rate: 5}");
  auto pusher = a.engine.advertise<Order>("/orders");
  auto puller = b.engine.subscribe<Order>("/orders");
  Gateway out(a.where, {"--out", "/orders"});
  Gateway in(b.where, {"--config", file.path});
  wait_until_carried(pusher, puller);
  for (int i = 0; i < 100; ++i) {
    (void)pusher.push(pusher.loan());
    std::this_thread::sleep_for(1ms);
  }
  CHECK(eventually([&] { return in.look()["in /orders"].refused != 0; }));
  const Line line = in.end()["in /orders"];
  CHECK(line.carried < 100);
}

TEST_CASE("a topic that is of another type there is not carried, and the gateway says so") {
  const Watchdog watchdog(60);
  Host a;
  Host b;
  auto pusher = a.engine.advertise<Note>("/notes");
  auto puller = b.engine.subscribe<Order>("/notes");
  Gateway out(a.where, {"--out", "/notes"});
  Gateway in(b.where, {"--in", "/notes"});
  INFO(out.said(), in.said());
  REQUIRE(in.says("lot_testing_anonymous_namespace::msg::dds_::Note_"));
  push_note(pusher, 1);
  CHECK(in.end()["in /notes"].carried == 0);
}

TEST_CASE("a type that ROS 2 has under its name, with other fields, goes out with a word") {
  const Watchdog watchdog(60);
  Host a;
  auto pusher = a.engine.advertise<geometry_msgs::Point>("/points");
  Gateway out(a.where, {"--out", "/points"});
  REQUIRE(
      out.says("called geometry_msgs/msg/Point and has other fields than that message of ROS 2"));
  CHECK(out.end().count("out /points") == 1);
}

TEST_CASE("SIGHUP reads the file again: topics come and go while it runs") {
  const Watchdog watchdog(60);
  Host a;
  Host b;
  const File file("out: [/notes]");
  auto notes = a.engine.advertise<Note>("/notes");
  auto orders = a.engine.advertise<Order>("/orders");
  auto puller = b.engine.subscribe<Order>("/orders");
  Gateway out(a.where, {"--config", file.path});
  Gateway in(b.where, {"--in", "/orders"});
  REQUIRE(out.says("out /notes -> rt/notes"));
  write_file(file.path, "out: [/orders, {nonsense: 1}]");
  out.send(SIGHUP);
  REQUIRE(out.says("gateway.yaml:1: there is no setting nonsense of a topic"));
  write_file(file.path, "out: [/orders]");
  out.send(SIGHUP);
  REQUIRE(out.says("out /orders -> rt/orders"));
  REQUIRE(out.says("out /notes: ended"));
  wait_until_carried(orders, puller);
}

TEST_SUITE_END();

}  // namespace
}  // namespace lot::testing
