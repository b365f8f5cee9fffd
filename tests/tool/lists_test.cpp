// SPDX-License-Identifier: Apache-2.0

// `lot ls` and `lot who`, word by word, for scenes in which everything is known. They run within
// the test.

#include <chrono>
#include <fcntl.h>
#include <functional>
#include <regex>
#include <string>
#include <sys/mman.h>
#include <unistd.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "scene.hpp"
#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "tool/commands.hpp"

namespace {

using namespace lot::testing;
namespace tool = lot::tool;

[[maybe_unused]] const bool has_janitor = start_janitor();

/// What the verb prints, and how it ends.
std::pair<std::string, tool::Exit> printed(const std::function<tool::Exit()>& verb) {
  std::fflush(stdout);
  const int before = dup(STDOUT_FILENO);
  const int file = memfd_create("printed", MFD_CLOEXEC);
  must(before != -1 && file != -1 && dup2(file, STDOUT_FILENO) != -1, "standard output");
  const tool::Exit exit = verb();
  dup2(before, STDOUT_FILENO);
  close(before);
  std::string text(static_cast<std::size_t>(lseek(file, 0, SEEK_END)), '\0');
  must(pread(file, text.data(), text.size(), 0) == static_cast<ssize_t>(text.size()), "a text");
  close(file);
  return {text, exit};
}

/// What differs from run to run: the room, pids, times, what the system gave. More than one blank
/// is two.
std::string steady(std::string text, const std::string& room) {
  for (auto at = text.find(room); at != text.npos; at = text.find(room)) {
    text.replace(at, room.size(), "ROOM");
  }
  const std::pair<const char*, const char*> kWords[] = {
      {R"((\n  \S[^\n]*  )\d+(  +)(\d+ s|\d+ min)(  ))", "$1PID$2AGE$4"},
      {R"(( processes \S+  +)(\d+ s|\d+ min)(  ))", "$1AGE$3"},
      {R"(, [0-9.]+ (KiB|MiB) taken from)", ", MEMORY taken from"},
      {R"((< \d+ s|\?|\d+ s)\n)", "AGE\n"},
      {R"x(("(seconds|at_most_seconds|since_unix|arrived_seconds)":)[0-9.e-]+)x", "$1TIME"},
      {R"x(("(seconds|at_most_seconds)":)(null|TIME))x", "$1TIME"},
      {R"x(("(pid|taken_bytes)":)\d+)x", "$1NUMBER"},
      {R"("instance":"[0-9a-f]{16}")", "\"instance\":HEX"},
      {"   +", "  "}};
  for (const auto& [what, with] : kWords) text = std::regex_replace(text, std::regex(what), with);
  return "\n" + text;
}

/// A document in few lines.
std::string compact(const std::string& text) {
  std::string line = nlohmann::ordered_json::parse(text).dump();
  for (const char* const begin : {R"(,{"index")", R"(,{"name")", R"(,{"block")", R"("publishers")",
                                  R"("subscribers")", R"("behind")", R"("hints")"}) {
    for (auto at = line.find(begin); at != line.npos; at = line.find(begin, at + 2)) {
      line.insert(at + (*begin == ',' ? 1 : 0), "\n");
    }
  }
  return line + "\n";
}

struct Shown {
  const Room& room;
  tool::Settings settings{{room.path(), "", {}}, false};

  std::string ls(tool::Exit exit = tool::kWell, bool each = false) const {
    return ran([&] { return tool::ls(settings, std::chrono::milliseconds(0), each); }, exit);
  }
  std::string who(bool all = false, tool::Exit exit = tool::kWell) const {
    return ran([&] { return tool::who(settings, all); }, exit);
  }

 private:
  std::string ran(const std::function<tool::Exit()>& verb, tool::Exit exit) const {
    const auto [text, ended] = printed(verb);
    CHECK(ended == exit);
    return steady(settings.json ? compact(text) : text, room.path());
  }
};

struct Refers {
  lot::ShmRef<const Letter> to;
};

/// A process that has joined, and done `what`; until it is killed.
Child resident(const lot::EngineOptions& options, const std::string& name,
               const std::function<void(lot::ShmEngine&, const std::function<void()>&)>& what) {
  Steps ready;
  Child child([&] {
    lot::EngineOptions mine = options;
    mine.name = name;
    lot::ShmEngine engine(mine);
    what(engine, [&] {
      ready.tell();
      pause();
    });
  });
  must(ready.next() == '.', "it is ready");
  return child;
}

}  // namespace

TEST_SUITE_BEGIN("lists");

TEST_CASE("lot ls and lot who of two processes with messages in queues and in hands") {
  const Watchdog watchdog(60);
  const Scene scene;
  Shown shown{scene.room};
  CHECK(shown.ls() == R"(
s  ROOM/s: 56 KiB of 11 MiB, 12 of 512 messages; 8 KiB held back, MEMORY taken from the system

  PROCESS  PID  SINCE  MEMORY
  1 publisher  PID  AGE  50 KiB
  2 reader  PID  AGE  0 B

  TOPIC  PROCESS  POLICY  HELD  RATE  LAG  LOST
  /letters  lot::testing::Letter
  publisher  1 publisher  overwrite  4 of 4
  subscriber  2 reader  5  1
  /parcels  lot::testing::Parcel
  publisher  1 publisher  block, mutex  4 of 4  waits for room
  subscriber  2 reader  4  holds it back

* publisher 1 publisher waits for room: `lot who --dir ROOM --segment s` says for which readers
)");
  CHECK(shown.who() == R"(
s  ROOM/s

  TOPIC  MESSAGE  SIZE  MADE BY  HOLDER  HOW  SINCE
  /letters  64  256 B  1 publisher  2 reader  keeps  AGE
  /letters  65  256 B  1 publisher  2 reader  borrows  AGE
  /parcels  70  8 KiB  1 publisher  2 reader  keeps  AGE

  BEHIND  TOPIC  PUBLISHER  LAG  LOST
  2 reader  /letters  1 publisher  5 of 4  1
  2 reader  /parcels  1 publisher  4 of 4

* publisher 1 publisher on /parcels waits for room until 2 reader has read
)");
  CHECK(shown.who(true) == R"(
s  ROOM/s

  TOPIC  MESSAGE  SIZE  MADE BY  HOLDER  HOW  SINCE
  /letters  64  256 B  1 publisher  2 reader  keeps  AGE
  /letters  65  256 B  1 publisher  2 reader  borrows  AGE
  /letters  66  256 B  1 publisher  1 publisher  queues
  /letters  67  256 B  1 publisher  1 publisher  queues
  /letters  68  256 B  1 publisher  1 publisher  queues
  /letters  69  256 B  1 publisher  1 publisher  queues
  /parcels  70  8 KiB  1 publisher  2 reader  keeps  AGE
  /parcels  71  8 KiB  1 publisher  1 publisher  queues
  /parcels  72  8 KiB  1 publisher  1 publisher  queues
  /parcels  73  8 KiB  1 publisher  1 publisher  queues
  /parcels  74  8 KiB  1 publisher  1 publisher  queues
  /parcels  75  8 KiB  1 publisher  1 publisher  spare

  BEHIND  TOPIC  PUBLISHER  LAG  LOST
  2 reader  /letters  1 publisher  5 of 4  1
  2 reader  /parcels  1 publisher  4 of 4

* publisher 1 publisher on /parcels waits for room until 2 reader has read
)");
  shown.settings.json = true;
  CHECK(shown.ls() == R"(
{"command":"ls","segments":[{"name":"s","path":"ROOM/s","condition":"sound","reason":"","bytes":12582912,"instance":HEX,"persist":false,"memory":{"used_bytes":57344,"held_back_bytes":8192,"total_bytes":11137024,"taken_bytes":NUMBER},"blocks":{"used":12,"total":512},"processes":[{"index":1,"name":"publisher","pid":NUMBER,"since_unix":TIME,"alive":true,"bytes":50688},
{"index":2,"name":"reader","pid":NUMBER,"since_unix":TIME,"alive":true,"bytes":0}],"topics":[{"name":"/letters","type":"lot::testing::Letter","type_bytes":24,
"publishers":[{"process":1,"channel":0,"gone":false,"engine":"ring","policy":"overwrite","to":"all","depth":4,"held":4,"unfinished":0,"published":6,"per_second":null,"per_second_below":null,"arrived":0,"arrived_seconds":TIME,"waits_for_room":false}],
"subscribers":[{"process":2,"channel":0,"joining":false,"lag":5,"lost":1,"holds_back":false,"observes":false}]},
{"name":"/parcels","type":"lot::testing::Parcel","type_bytes":6024,
"publishers":[{"process":1,"channel":1,"gone":false,"engine":"mutex","policy":"block","to":"all","depth":4,"held":4,"unfinished":0,"published":5,"per_second":null,"per_second_below":null,"arrived":0,"arrived_seconds":TIME,"waits_for_room":true}],
"subscribers":[{"process":2,"channel":1,"joining":false,"lag":4,"lost":0,"holds_back":true,"observes":false}]}],"damage":[]}],
"hints":["publisher 1 publisher waits for room: `lot who --dir ROOM --segment s` says for which readers"],"exit":0}
)");
  CHECK(shown.who(true) == R"(
{"command":"who","segments":[{"name":"s","path":"ROOM/s","condition":"sound","reason":"","bytes":12582912,"processes":[{"index":1,"name":"publisher","pid":NUMBER,"alive":true},
{"index":2,"name":"reader","pid":NUMBER,"alive":true}],"messages":[{"block":64,"generation":0,"topic":"/letters","bytes":256,"made_by":1,"holders":[{"process":2,"how":"keeps","seconds":TIME,"at_most_seconds":TIME,"sequence":null,"topic":null}]},
{"block":65,"generation":0,"topic":"/letters","bytes":256,"made_by":1,"holders":[{"process":2,"how":"borrows","seconds":TIME,"at_most_seconds":TIME,"sequence":null,"topic":"/letters"}]},
{"block":66,"generation":0,"topic":"/letters","bytes":256,"made_by":1,"holders":[{"process":1,"how":"queues","seconds":TIME,"at_most_seconds":TIME,"sequence":6,"topic":"/letters"}]},
{"block":67,"generation":0,"topic":"/letters","bytes":256,"made_by":1,"holders":[{"process":1,"how":"queues","seconds":TIME,"at_most_seconds":TIME,"sequence":7,"topic":"/letters"}]},
{"block":68,"generation":0,"topic":"/letters","bytes":256,"made_by":1,"holders":[{"process":1,"how":"queues","seconds":TIME,"at_most_seconds":TIME,"sequence":8,"topic":"/letters"}]},
{"block":69,"generation":0,"topic":"/letters","bytes":256,"made_by":1,"holders":[{"process":1,"how":"queues","seconds":TIME,"at_most_seconds":TIME,"sequence":9,"topic":"/letters"}]},
{"block":70,"generation":0,"topic":"/parcels","bytes":8192,"made_by":1,"holders":[{"process":2,"how":"keeps","seconds":TIME,"at_most_seconds":TIME,"sequence":null,"topic":null}]},
{"block":71,"generation":0,"topic":"/parcels","bytes":8192,"made_by":1,"holders":[{"process":1,"how":"queues","seconds":TIME,"at_most_seconds":TIME,"sequence":5,"topic":"/parcels"}]},
{"block":72,"generation":0,"topic":"/parcels","bytes":8192,"made_by":1,"holders":[{"process":1,"how":"queues","seconds":TIME,"at_most_seconds":TIME,"sequence":6,"topic":"/parcels"}]},
{"block":73,"generation":0,"topic":"/parcels","bytes":8192,"made_by":1,"holders":[{"process":1,"how":"queues","seconds":TIME,"at_most_seconds":TIME,"sequence":7,"topic":"/parcels"}]},
{"block":74,"generation":0,"topic":"/parcels","bytes":8192,"made_by":1,"holders":[{"process":1,"how":"queues","seconds":TIME,"at_most_seconds":TIME,"sequence":8,"topic":"/parcels"}]},
{"block":75,"generation":0,"topic":"/parcels","bytes":8192,"made_by":1,"holders":[{"process":1,"how":"spare","seconds":TIME,"at_most_seconds":TIME,"sequence":null,"topic":null}]}],
"behind":[{"process":2,"topic":"/letters","publisher":1,"channel":0,"depth":4,"joining":false,"lag":5,"lost":1,"holds_back":false},{"process":2,"topic":"/parcels","publisher":1,"channel":1,"depth":4,"joining":false,"lag":4,"lost":0,"holds_back":true}],"waiting":[{"process":1,"topic":"/parcels","channel":1,"waits_for":[2]}],"damage":[]}],
"hints":["publisher 1 publisher on /parcels waits for room until 2 reader has read"],"exit":0}
)");
}

TEST_CASE("lot ls and lot who of subscribers that observe, have not looked, have no publisher") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  const Child first = resident(options, "first", [](auto& engine, auto&& stay) {
    lot::PusherOptions how;
    how.depth = 4;
    how.stamp = true;
    auto pusher = engine.template advertise<Letter>("/stamped", how);
    auto idle = engine.template subscribe<Letter>("/nothing");
    for (int n = 0; n < 6; ++n) must_go(pusher.push(pusher.loan()));
    stay();
  });
  const Child second = resident(options, "second", [](auto& engine, auto&& stay) {
    lot::PullerOptions how;
    how.observer = true;
    auto watching = engine.template subscribe<Letter>("/stamped", how);
    must(!watching.try_pull(), "it begins behind");
    auto idle = engine.template subscribe<Letter>("/nothing", how);
    stay();
  });
  const Child third = resident(options, "third", [](auto& engine, auto&& stay) {
    auto late = engine.template subscribe<Letter>("/stamped");
    lot::PullerOptions how;
    how.history = 2;
    auto reads = engine.template subscribe<Letter>("/stamped", how);
    must(bool(reads.try_pull()), "one of two");
    stay();
  });
  Shown shown{room};
  CHECK(shown.ls() == R"(
s  ROOM/s: 4 KiB of 11 MiB, 2 of 512 messages; 0 B held back, MEMORY taken from the system

  PROCESS  PID  SINCE  MEMORY
  1 first  PID  AGE  256 B
  2 second  PID  AGE  0 B
  3 third  PID  AGE  256 B

  TOPIC  PROCESS  POLICY  HELD  RATE  LAG  LOST
  /stamped  lot::testing::Letter
  publisher  1 first  overwrite  4 of 4
  subscriber  2 second  0  observes
  subscriber  3 third  0
  subscriber  3 third  1
  /nothing  lot::testing::Letter
  subscriber  1 first  no publisher
  subscriber  2 second  observes, no publisher
)");
  CHECK(shown.who() == R"(
s  ROOM/s

  no process keeps or borrows a message

  BEHIND  TOPIC  PUBLISHER  LAG  LOST
  3 third  /stamped  1 first  1 of 4
)");
  shown.settings.json = true;
  CHECK(shown.ls() == R"(
{"command":"ls","segments":[{"name":"s","path":"ROOM/s","condition":"sound","reason":"","bytes":12582912,"instance":HEX,"persist":false,"memory":{"used_bytes":4096,"held_back_bytes":0,"total_bytes":11137024,"taken_bytes":NUMBER},"blocks":{"used":2,"total":512},"processes":[{"index":1,"name":"first","pid":NUMBER,"since_unix":TIME,"alive":true,"bytes":256},
{"index":2,"name":"second","pid":NUMBER,"since_unix":TIME,"alive":true,"bytes":0},
{"index":3,"name":"third","pid":NUMBER,"since_unix":TIME,"alive":true,"bytes":256}],"topics":[{"name":"/stamped","type":"lot::testing::Letter","type_bytes":24,
"publishers":[{"process":1,"channel":0,"gone":false,"engine":"ring","policy":"overwrite","to":"all","depth":4,"held":4,"unfinished":0,"published":6,"per_second":null,"per_second_below":null,"arrived":0,"arrived_seconds":TIME,"waits_for_room":false}],
"subscribers":[{"process":2,"channel":0,"joining":false,"lag":0,"lost":0,"holds_back":false,"observes":true},{"process":3,"channel":0,"joining":false,"lag":0,"lost":0,"holds_back":false,"observes":false},{"process":3,"channel":0,"joining":false,"lag":1,"lost":0,"holds_back":false,"observes":false}]},
{"name":"/nothing","type":"lot::testing::Letter","type_bytes":24,
"publishers":[],
"subscribers":[{"process":1,"channel":null,"joining":false,"lag":0,"lost":0,"holds_back":false,"observes":false},{"process":2,"channel":null,"joining":false,"lag":0,"lost":0,"holds_back":false,"observes":true}]}],"damage":[]}],
"hints":[],"exit":0}
)");
}

TEST_CASE("lot ls and lot who of queues, whose putters wait and whose workers have items") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  lot::QueueOptions how;
  how.depth = 3;
  how.redeliver = true;
  const Child worker = resident(options, "worker", [&](auto& engine, auto&& stay) {
    auto jobs = engine.template queue<lot::ShmUniquePtr<Parcel>>("jobs", how);
    must(jobs.put(jobs.make()) == lot::Status::Ok, "an item");
    auto job = jobs.try_take();
    must(bool(job), "an item");
    auto listens = engine.template queue<lot::ShmUniquePtr<Parcel>>("full");
    listens.listen();
    stay();
  });
  const Child putter = resident(options, "putter", [&](auto& engine, auto&& stay) {
    auto jobs = engine.template queue<lot::ShmUniquePtr<Parcel>>("jobs", how);
    for (int n = 0; n < 2; ++n) must(jobs.put(jobs.make()) == lot::Status::Ok, "an item");
    {
      auto left = engine.template queue<int>("left");
      (void)left.put(1);
    }
    stay();
  });
  const Child waits = resident(options, "waits", [&](auto& engine, auto&& stay) {
    lot::QueueOptions few;
    few.depth = 1;
    auto full = engine.template queue<lot::ShmUniquePtr<Parcel>>("full", few);
    must(full.put(full.make()) == lot::Status::Ok, "an item");
    std::thread([&] { (void)full.put(full.make()); }).detach();
    stay();
  });
  Shown shown{room};
  REQUIRE(eventually([&] { return shown.who().find("waits for room") != std::string::npos; }));
  CHECK(shown.ls() == R"(
s  ROOM/s: 60 KiB of 11 MiB, 5 of 512 messages; 8 KiB held back, MEMORY taken from the system

  PROCESS  PID  SINCE  MEMORY
  1 worker  PID  AGE  8 KiB
  2 putter  PID  AGE  16 KiB
  3 waits  PID  AGE  16 KiB

  TOPIC  PROCESS  POLICY  HELD  RATE  LAG  LOST
  jobs  ShmQueue with r..testing::Parcel
  publisher  1 worker  block, to one  1 of 3  1 unfinished
  subscriber  1 worker  0
  publisher  2 putter  block, to one  2 of 3
  subscriber  1 worker  2  not looked yet
  full  ShmQueue of lot::testing::Parcel
  publisher  3 waits  block, to one  1 of 1  waits for room
  subscriber  1 worker  1  not looked yet
  left  ShmQueue of int
  publisher  (gone)  block, to one  1 of 64

* publisher 3 waits waits for room: `lot who --dir ROOM --segment s` says for which readers
)");
  CHECK(shown.who() == R"(
s  ROOM/s

  TOPIC  MESSAGE  SIZE  MADE BY  HOLDER  HOW  SINCE
  jobs  64  8 KiB  1 worker  1 worker  keeps  AGE

  BEHIND  TOPIC  PUBLISHER  LAG  LOST
  1 worker  jobs  2 putter  2 of 3
  1 worker  full  3 waits  1 of 1

* publisher 3 waits on full waits for room until 1 worker has looked
)");
  shown.settings.json = true;
  CHECK(shown.ls() == R"(
{"command":"ls","segments":[{"name":"s","path":"ROOM/s","condition":"sound","reason":"","bytes":12582912,"instance":HEX,"persist":false,"memory":{"used_bytes":61440,"held_back_bytes":8192,"total_bytes":11137024,"taken_bytes":NUMBER},"blocks":{"used":5,"total":512},"processes":[{"index":1,"name":"worker","pid":NUMBER,"since_unix":TIME,"alive":true,"bytes":8192},
{"index":2,"name":"putter","pid":NUMBER,"since_unix":TIME,"alive":true,"bytes":16384},
{"index":3,"name":"waits","pid":NUMBER,"since_unix":TIME,"alive":true,"bytes":16384}],"topics":[{"name":"jobs","type":"ShmQueue with redelivery of lot::testing::Parcel","type_bytes":6024,
"publishers":[{"process":1,"channel":0,"gone":false,"engine":"ring","policy":"block","to":"one","depth":3,"held":1,"unfinished":1,"published":1,"per_second":null,"per_second_below":null,"arrived":0,"arrived_seconds":TIME,"waits_for_room":false},{"process":2,"channel":1,"gone":false,"engine":"ring","policy":"block","to":"one","depth":3,"held":2,"unfinished":0,"published":2,"per_second":null,"per_second_below":null,"arrived":0,"arrived_seconds":TIME,"waits_for_room":false}],
"subscribers":[{"process":1,"channel":0,"joining":false,"lag":0,"lost":0,"holds_back":false,"observes":false},{"process":1,"channel":1,"joining":false,"lag":2,"lost":0,"holds_back":false,"observes":false}]},
{"name":"full","type":"ShmQueue of lot::testing::Parcel","type_bytes":6024,
"publishers":[{"process":3,"channel":3,"gone":false,"engine":"ring","policy":"block","to":"one","depth":1,"held":1,"unfinished":0,"published":1,"per_second":null,"per_second_below":null,"arrived":0,"arrived_seconds":TIME,"waits_for_room":true}],
"subscribers":[{"process":1,"channel":3,"joining":false,"lag":1,"lost":0,"holds_back":false,"observes":false}]},
{"name":"left","type":"ShmQueue of int","type_bytes":4,
"publishers":[{"process":0,"channel":2,"gone":true,"engine":"ring","policy":"block","to":"one","depth":64,"held":1,"unfinished":0,"published":1,"per_second":null,"per_second_below":null,"arrived":0,"arrived_seconds":TIME,"waits_for_room":false}],
"subscribers":[]}],"damage":[]}],
"hints":["publisher 3 waits waits for room: `lot who --dir ROOM --segment s` says for which readers"],"exit":0}
)");
}

TEST_CASE("lot ls and lot who of messages of no topic, references, readers that are waited for") {
  const Watchdog watchdog(60);
  const Room room;
  const Child one = resident(room.options(), "one", [](auto& engine, auto&& stay) {
    auto parcels = engine.template subscribe<Parcel>("/parcels");
    const lot::ShmSharedPtr<const Letter> kept = engine.template make<Letter>();
    auto refers = engine.template make<Refers>();
    refers->to = kept;
    const lot::ShmSharedPtr<const Refers> more = std::move(refers);
    stay();
  });
  const Child two = resident(room.options(), "two", [](auto& engine, auto&& stay) {
    auto parcels = engine.template subscribe<Parcel>("/parcels");
    stay();
  });
  const Child sender = resident(room.options(), "sender", [](auto& engine, auto&& stay) {
    auto pusher = engine.template advertise<Parcel>("/parcels", {lot::Policy::Block, 2, 60s});
    for (int n = 0; n < 2; ++n) must_go(pusher.push(pusher.loan()));
    std::thread([&] { (void)pusher.push(pusher.loan()); }).detach();
    stay();
  });
  const Child other = resident(room.options("t"), "other", [](auto&, auto&& stay) { stay(); });
  Shown shown{room};
  REQUIRE(eventually([&] { return shown.who().find("waits for room") != std::string::npos; }));
  CHECK(shown.ls() == R"(
s  ROOM/s: 28 KiB of 11 MiB, 5 of 512 messages; 8 KiB held back, MEMORY taken from the system

  PROCESS  PID  SINCE  MEMORY
  1 one  PID  AGE  512 B
  2 two  PID  AGE  0 B
  3 sender  PID  AGE  24 KiB

  TOPIC  PROCESS  POLICY  HELD  RATE  LAG  LOST
  /parcels  lot::testing::Parcel
  publisher  3 sender  block  2 of 2  waits for room
  subscriber  1 one  2  holds it back
  subscriber  2 two  2  holds it back

t  ROOM/t: 0 B of 11 MiB, 0 of 512 messages; 0 B held back, MEMORY taken from the system

  PROCESS  PID  SINCE  MEMORY
  1 other  PID  AGE  0 B


* publisher 3 sender waits for room: `lot who --dir ROOM --segment s` says for which readers
)");
  CHECK(shown.who() == R"(
s  ROOM/s

  TOPIC  MESSAGE  SIZE  MADE BY  HOLDER  HOW  SINCE
  -  64  256 B  1 one  1 one  refers
  1 one  keeps  AGE
  -  65  256 B  1 one  1 one  keeps  AGE

  BEHIND  TOPIC  PUBLISHER  LAG  LOST
  1 one  /parcels  3 sender  2 of 2
  2 two  /parcels  3 sender  2 of 2

t  ROOM/t

  no process keeps or borrows a message

* publisher 3 sender on /parcels waits for room until 1 one, 2 two has looked
)");
  shown.settings.json = true;
  CHECK(shown.who() == R"(
{"command":"who","segments":[{"name":"s","path":"ROOM/s","condition":"sound","reason":"","bytes":12582912,"processes":[{"index":1,"name":"one","pid":NUMBER,"alive":true},
{"index":2,"name":"two","pid":NUMBER,"alive":true},
{"index":3,"name":"sender","pid":NUMBER,"alive":true}],"messages":[{"block":64,"generation":0,"topic":"","bytes":256,"made_by":1,"holders":[{"process":1,"how":"refers","seconds":TIME,"at_most_seconds":TIME,"sequence":null,"topic":null},{"process":1,"how":"keeps","seconds":TIME,"at_most_seconds":TIME,"sequence":null,"topic":null}]},
{"block":65,"generation":0,"topic":"","bytes":256,"made_by":1,"holders":[{"process":1,"how":"keeps","seconds":TIME,"at_most_seconds":TIME,"sequence":null,"topic":null}]}],
"behind":[{"process":1,"topic":"/parcels","publisher":3,"channel":0,"depth":2,"joining":false,"lag":2,"lost":0,"holds_back":true},{"process":2,"topic":"/parcels","publisher":3,"channel":0,"depth":2,"joining":false,"lag":2,"lost":0,"holds_back":true}],"waiting":[{"process":3,"topic":"/parcels","channel":0,"waits_for":[1,2]}],"damage":[]},
{"name":"t","path":"ROOM/t","condition":"sound","reason":"","bytes":12582912,"processes":[{"index":1,"name":"other","pid":NUMBER,"alive":true}],"messages":[],
"behind":[],"waiting":[],"damage":[]}],
"hints":["publisher 3 sender on /parcels waits for room until 1 one, 2 two has looked"],"exit":0}
)");
}

TEST_CASE("lot ls and lot who of four processes that are alike, and of each of them") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.persist = true;
  std::vector<Child> nodes;
  for (const char* name : {"node_1", "node_2", "node_3", "node_4"}) {
    nodes.push_back(resident(options, name, [](auto& engine, auto&& stay) {
      auto pusher = engine.template advertise<Letter>("/many", {lot::Policy::Refuse, 2, {}});
      auto idle = engine.template subscribe<Letter>("/none");
      lot::PullerOptions how;
      how.observer = true;
      auto looks = engine.template subscribe<Letter>("/none", how);
      stay();
    }));
  }
  const Child reader = resident(options, "reader", [](auto& engine, auto&& stay) {
    auto many = engine.template subscribe<Letter>("/many");
    stay();
  });
  Shown shown{room};
  CHECK(shown.ls() == R"(
s  ROOM/s: 16 KiB of 11 MiB, 0 of 512 messages; 0 B held back, MEMORY taken from the system; persist

  PROCESS  PID  SINCE  MEMORY
  4 processes node_*  AGE  0 B
  5 reader  PID  AGE  0 B

  TOPIC  PROCESS  POLICY  HELD  RATE  LAG  LOST
  /many  lot::testing::Letter
  4 publishers  4 processes  refuse  0 of 8
  subscriber  5 reader  0
  /none  lot::testing::Letter
  4 subscribers  4 processes  no publisher
  4 subscribers  4 processes  observes, no publisher
)");
  CHECK(shown.ls(tool::kWell, true) == R"(
s  ROOM/s: 16 KiB of 11 MiB, 0 of 512 messages; 0 B held back, MEMORY taken from the system; persist

  PROCESS  PID  SINCE  MEMORY
  1 node_1  PID  AGE  0 B
  2 node_2  PID  AGE  0 B
  3 node_3  PID  AGE  0 B
  4 node_4  PID  AGE  0 B
  5 reader  PID  AGE  0 B

  TOPIC  PROCESS  POLICY  HELD  RATE  LAG  LOST
  /many  lot::testing::Letter
  publisher  1 node_1  refuse  0 of 2
  subscriber  5 reader  0
  publisher  2 node_2  refuse  0 of 2
  subscriber  5 reader  0
  publisher  3 node_3  refuse  0 of 2
  subscriber  5 reader  0
  publisher  4 node_4  refuse  0 of 2
  subscriber  5 reader  0
  /none  lot::testing::Letter
  subscriber  1 node_1  no publisher
  subscriber  2 node_2  no publisher
  subscriber  3 node_3  no publisher
  subscriber  4 node_4  no publisher
  subscriber  1 node_1  observes, no publisher
  subscriber  2 node_2  observes, no publisher
  subscriber  3 node_3  observes, no publisher
  subscriber  4 node_4  observes, no publisher
)");
}

TEST_CASE("lot ls and lot who of a segment whose last process was killed, and of nothing") {
  const Watchdog watchdog(60);
  const Room room;
  Shown shown{room};
  CHECK(shown.ls(tool::kWrong) == R"(
no segments in ROOM
)");
  CHECK(shown.who(false, tool::kWrong) == R"(
no segments in ROOM
)");
  shown.settings.where.name = "t";
  CHECK(shown.ls(tool::kWrong) == R"(
no segment ROOM/t
)");
  shown.settings.where.name = "";
  Child camera = resident(room.options(), "camera", [](auto& engine, auto&& stay) {
    auto pusher = engine.template advertise<Parcel>("/image");
    must_go(pusher.push(pusher.loan()));
    stay();
  });
  camera.kill9();
  CHECK(shown.ls(tool::kWrong) == R"(
s  ROOM/s: 12 KiB of 11 MiB, 1 of 512 messages; 0 B held back, MEMORY taken from the system

  PROCESS  PID  SINCE  MEMORY
  1 camera  PID  AGE  8 KiB  dead

  TOPIC  PROCESS  POLICY  HELD  RATE  LAG  LOST
  /image  lot::testing::Parcel
  publisher  1 camera  overwrite  1 of 64

* no process lives in s: run `lot clean --dir ROOM --segment s`
)");
  CHECK(shown.who(true, tool::kWrong) == R"(
s  ROOM/s

  TOPIC  MESSAGE  SIZE  MADE BY  HOLDER  HOW  SINCE
  /image  64  8 KiB  1 camera  1 camera  queues

* no process lives in s: run `lot clean --dir ROOM --segment s`
)");
}

TEST_SUITE_END();
