// SPDX-License-Identifier: Apache-2.0

// What lot pub publishes, to which processes it comes, and what it says where it can not.

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <sys/stat.h>
#include <thread>
#include <type_traits>
#include <unistd.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "command.hpp"
#include "segment/segment.hpp"
#include "support/error_of.hpp"
#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "support/raw.hpp"
#include "support/secret.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const bool has_janitor = start_janitor();

struct Label {
  lot::ShmString name;
  float score = 0.5F;
};
struct Goal {
  std::uint32_t number = 7;
  double x = 0;
  lot::ShmVector<Label> labels;
  lot::ShmVector<std::uint8_t> data;
  lot::ShmRef<const Label> best;
};

struct Char {
  char c;
};
struct Chars {
  Char each[256];
};

/// Whether a process is the command already, and has a handler for a signal.
bool catches(pid_t pid, int signal) {
  const std::string process = "/proc/" + std::to_string(pid);
  if (!std::filesystem::equivalent(process + "/exe", command())) return false;
  std::ifstream status(process + "/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("SigCgt:", 0) == 0) {
      return (std::stoull(line.substr(7), nullptr, 16) >> (signal - 1) & 1) != 0;
    }
  }
  return false;
}

/// A subscriber of goals in a segment of its own.
struct Robot {
  Robot() : engine(options), puller(engine.subscribe<Goal>("/goal")) {}

  std::vector<std::string> pub(std::vector<std::string> words) const {
    words.insert(words.begin(), {"pub", "/goal"});
    return on(options, std::move(words));
  }
  Ran run(std::vector<std::string> words) const { return run_lot(pub(std::move(words))); }
  /// The next goal, also where publishers have come and gone. It throws where none comes.
  lot::ShmSharedPtr<const Goal> pull() {
    for (;;) {
      auto goal = puller.pull(20s);
      if (goal) return goal;
      must(puller.status() == lot::Status::PublisherGone, "a goal comes");
    }
  }
  std::uint32_t next() { return pull()->number; }
  /// With this for standard input.
  Ran run_with(const std::string& input, const std::string& words) const {
    std::ofstream(room.path() + "/input") << input;
    return run_program({"sh", "-c",
                        command() + " pub /goal --dir " + room.path() + " --segment s " + words +
                            " < " + room.path() + "/input"});
  }

  /// A pipe with a name, for standard input that comes by and by.
  std::string pipe() const {
    const std::string path = room.path() + "/pipe";
    must(mkfifo(path.c_str(), 0600) == 0, "a pipe");
    return path;
  }

  Room room;
  lot::EngineOptions options = room.options();
  lot::ShmEngine engine;
  lot::ShmPuller<Goal> puller;
};

}  // namespace

TEST_SUITE_BEGIN("pub");

TEST_CASE("lot pub publishes what the YAML says, and the rest is zero") {
  const Watchdog watchdog(60);
  Robot robot;
  const Ran ran = robot.run({"{number: 3, labels: [{name: left}, {score: -1e3}], data: [1, 2]}"});
  CHECK(ran.exit == 0);
  CHECK(ran.out.starts_with("pushed 1 message on /goal ("));
  CHECK(names(ran.out, "Goal) to 1 subscriber\n"));
  const auto goal = robot.pull();
  REQUIRE(goal);
  CHECK(goal->number == 3);
  CHECK(goal->x == 0);
  REQUIRE(goal->labels.size() == 2);
  CHECK(goal->labels[0].name == "left");
  CHECK(goal->labels[0].score == 0);
  CHECK(goal->labels[1].score == -1000);
  CHECK(goal->data == lot::ShmVector<std::uint8_t>{1, 2});
  CHECK(goal->best == nullptr);
  CHECK(robot.puller.envelope().publisher == "lot pub");
  CHECK(robot.puller.envelope().pushed.has_value());
  CHECK(robot.run({"{}"}).exit == 0);
  CHECK(robot.next() == 0);
}

TEST_CASE("a subscriber that has not looked yet gets the message after lot pub has left") {
  const Watchdog watchdog(60);
  Robot robot;
  const Json told = robot.run({"{number: 3}", "--json"}).json();
  CHECK(told["pushed"] == 1);
  CHECK(told["subscribers"] == 1);
  CHECK(told["unread"] == 1);
  CHECK(told["exit"] == 0);
  CHECK(robot.next() == 3);
  CHECK(names(robot.run({"{number: 4}"}).out, "subscribers get it when they look"));
  CHECK(robot.next() == 4);
  CHECK(robot.puller.missed_total() == 0);
}

TEST_CASE("lot echo shows each message of a lot pub that leaves at once") {
  const Watchdog watchdog(120);
  Robot robot;
  Running echo(on(robot.options, {"echo", "/goal", "--json", "--field", "number"}));
  const auto observes = [&] {
    return names(run_lot(on(robot.options, {"ls", "--interval", "1"})).out, "lot echo");
  };
  CHECK(eventually(observes));
  std::thread reads([&] {
    for (unsigned n = 0; n < 20; ++n) must(robot.next() == n, "the goals come in turn");
  });
  for (unsigned n = 0; n < 20; ++n) {
    const Ran ran = robot.run({"{number: " + std::to_string(n) + "}", "--json"});
    CHECK(ran.json()["subscribers"] == 1);
    CHECK(ran.json()["observers"] == 1);
    CHECK(ran.json()["unread"] == 0);
    CHECK(ran.json()["hints"].empty());
    CHECK(echo.line() == std::to_string(n));
  }
  reads.join();
}

TEST_CASE("several documents are several messages, as fast as the slowest subscriber reads") {
  const Watchdog watchdog(60);
  Robot robot;
  std::string yaml;
  for (int n = 0; n < 300; ++n) yaml += "---\nnumber: " + std::to_string(n) + "\n";
  Ran ran;
  std::thread publishes([&] { ran = robot.run_with(yaml, "-"); });
  std::uint32_t expected = 0;
  for (; expected < 300 && robot.next() == expected; ++expected) usleep(100);
  CHECK(expected == 300);
  publishes.join();
  CHECK(ran.exit == 0);
  CHECK(names(ran.out, "pushed 300 messages"));
}

TEST_CASE("each document of standard input is published when its end comes") {
  const Watchdog watchdog(60);
  Robot robot;
  const std::string pipe = robot.pipe();
  const std::string pub =
      command() + " pub /goal - --dir " + robot.room.path() + " --segment s < " + pipe;
  Ran ran;
  std::thread publishes([&] { ran = run_program({"sh", "-c", pub}); });
  std::ofstream input(pipe);
  input << "# three\nnumber: 1\n---\n" << std::flush;
  CHECK(robot.next() == 1);
  input << "{number: 2}\n...\n" << std::flush;
  CHECK(robot.next() == 2);
  input << "---\n---\nnumber: 3";
  input.close();
  CHECK(robot.next() == 3);
  publishes.join();
  CHECK(ran.exit == 0);
  CHECK(names(ran.out, "pushed 3 messages"));

  publishes = std::thread([&] { ran = run_program({"sh", "-c", pub}); });
  input.open(pipe);
  input << "number: 4\n---\nnumber: 5\n---\n- [\n";
  input.close();
  CHECK(robot.next() == 4);
  CHECK(robot.next() == 5);
  publishes.join();
  CHECK(ran.exit == 1);
  CAPTURE(ran.err);
  CHECK(names(ran.err, "lot: document 3: the YAML: line 6, column"));
  CHECK(names(ran.err, "; 2 messages were pushed\n"));
}

TEST_CASE("a document that is no message is named, and JSON says how many came before") {
  const Watchdog watchdog(60);
  Robot robot;
  const std::string text = "# one\nnumber: 4\n---\n---\nnumber: 5\n---\nnumber: 6\nnumbr: 7\n";
  const Ran plain = robot.run_with(text, "-");
  CHECK(plain.exit == 1);
  CHECK(plain.out.empty());
  CHECK(names(plain.err, "lot: document 3, from line 7 on: message: there is no field \"numbr\""));
  CHECK(names(plain.err, "; 2 messages were pushed\n"));
  for (const unsigned number : {4U, 5U}) CHECK(robot.next() == number);
  const Ran ran = robot.run_with(text, "- --json");
  CHECK(ran.exit == 1);
  CHECK(ran.err == plain.err);
  const Json told = ran.json();
  CHECK(told["pushed"] == 2);
  CHECK(told["exit"] == 1);
  CHECK(told["segment"] == "s");
  CHECK(told["subscribers"] == 1);
  CHECK(told["hints"].at(0).get<std::string>() + "\n" == ran.err);
  for (const unsigned number : {4U, 5U}) CHECK(robot.next() == number);
  const Json unknown = run_lot(on(robot.options, {"pub", "/none", "{}", "--json"})).json();
  CHECK(unknown["pushed"] == 0);
  CHECK(unknown["segment"].is_null());
  CHECK(unknown["type"].is_null());
  CHECK(unknown["exit"] == 1);
}

TEST_CASE("Ctrl-C ends a lot pub that waits for standard input") {
  const Watchdog watchdog(60);
  Robot robot;
  const std::string pipe = robot.pipe();
  std::fstream input(pipe);  // for both: it has no end
  const int before = dup(STDIN_FILENO);
  const int end = open(pipe.c_str(), O_RDONLY | O_CLOEXEC);
  REQUIRE(dup2(end, STDIN_FILENO) == STDIN_FILENO);
  {
    Running waits(robot.pub({"-"}));
    CHECK(eventually([&] { return catches(waits.child().pid(), SIGINT); }));
    CHECK(waits.interrupt().exit == 1);
    Running pub(robot.pub({"-"}));
    input << "null\n---\nnumber: 1\n---\n" << std::flush;
    CHECK(robot.next() == 1);
    const Ran ran = pub.interrupt();
    CHECK(ran.exit == 0);
    CHECK(names(ran.out, "pushed 1 message"));
  }
  dup2(before, STDIN_FILENO);
  close(before);
  close(end);
}

TEST_CASE("an observer sees what came before a document that is no message") {
  const Watchdog watchdog(60);
  Robot robot;
  Running echo(on(robot.options, {"echo", "/goal", "--json", "--field", "number"}));
  CHECK(eventually([&] {
    return names(run_lot(on(robot.options, {"ls", "--interval", "1"})).out, "lot echo");
  }));
  CHECK(robot.run_with("number: 1\n---\n- [\n", "- --wait 50").exit == 1);
  CHECK(echo.line() == "1");
}

TEST_CASE("a lot pub whose output no process reads leaves the segment well") {
  const Watchdog watchdog(60);
  Robot robot;
  Running pub(robot.pub({"{number: 6}", "--latch"}));
  pub.close_output();
  CHECK(robot.next() == 6);
  lot::PullerOptions latched;
  latched.history = 1;
  auto late = robot.engine.subscribe<Goal>("/goal", latched);
  const auto goal = late.pull(20s);
  REQUIRE(goal);
  CHECK(goal->number == 6);
  CHECK(pub.interrupt().exit == 1);
}

TEST_CASE("lot pub reads what lot echo prints") {
  const Watchdog watchdog(60);
  Robot robot;
  auto pusher = robot.engine.advertise<Goal>("/goal");
  auto goal = pusher.loan();
  goal->x = 0.1;
  goal->labels.resize(1);
  goal->labels[0].name = "\xff\x1b: \"";
  goal->data.assign(1000, 200);
  must_go(pusher.push(std::move(goal)));
  const std::string yaml =
      run_lot(on(robot.options, {"echo", "/goal", "--full", "--count", "1"})).out;
  REQUIRE(robot.pull());
  CHECK(robot.run_with(yaml, "-").exit == 0);
  const auto again = robot.pull();
  REQUIRE(again);
  CHECK(again->number == 7);
  CHECK(again->x == 0.1);
  CHECK(again->labels[0].name == "\xff\x1b: \"");
  CHECK(again->data == lot::ShmVector<std::uint8_t>(1000, 200));
}

TEST_CASE("each char goes from lot echo to lot pub and comes as the same byte") {
  const Watchdog watchdog(60);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto pusher = engine.advertise<Chars>("/chars");
  auto puller = engine.subscribe<Chars>("/chars");
  auto bytes = pusher.loan();
  for (int i = 0; i < 256; ++i) bytes->each[static_cast<std::size_t>(i)].c = static_cast<char>(i);
  must_go(pusher.push(std::move(bytes)));
  REQUIRE(puller.pull(10s));
  for (const char* format : {"", "--json"}) {
    const std::string pipe = command() + " echo /chars --count 1 --full " + format + " --dir " +
                             room.path() + " | " + command() + " pub /chars - --dir " + room.path();
    CHECK(run_program({"sh", "-c", pipe}).exit == 0);
    const auto again = puller.pull(10s);
    REQUIRE(again);
    for (int i = 0; i < 256; ++i) {
      CAPTURE(i);
      CHECK(again->each[static_cast<std::size_t>(i)].c == static_cast<char>(i));
    }
  }
}

TEST_CASE("a number beyond its type is not published") {
  const Watchdog watchdog(60);
  Robot robot;
  for (const char* yaml : {"{x: 1e400}", "{x: -1e400}", "{labels: [{score: 3.5e38}]}"}) {
    CAPTURE(yaml);
    const Ran ran = robot.run({yaml});
    CHECK(ran.exit == 1);
    CHECK(names(ran.err, "does not fit a float"));
  }
  CHECK(robot.puller.try_pull() == nullptr);
}

TEST_CASE("--rate publishes nothing before it is due, and several messages take turns") {
  const Watchdog watchdog(60);
  Robot robot;
  const auto before = std::chrono::steady_clock::now();
  const Ran ran = robot.run({"--- {number: 1}\n--- {number: 2}", "--rate", "200", "--count", "41"});
  CHECK(ran.exit == 0);
  CHECK(names(ran.out, "pushed 41 messages"));
  for (std::uint32_t n = 0; n < 41; ++n) {
    const auto goal = robot.pull();
    REQUIRE(goal);
    CHECK(goal->number == 1 + n % 2);
    const lot::Envelope envelope = robot.puller.envelope();
    CHECK(envelope.sequence == n);
    REQUIRE(envelope.pushed);
    CHECK(*envelope.pushed - before >= n * std::chrono::milliseconds(5));
  }
}

TEST_CASE("at a rate, all documents of standard input take turns") {
  const Watchdog watchdog(60);
  Robot robot;
  const Ran ran = robot.run_with("number: 1\n---\nnumber: 2\n", "- --rate 200 --count 4");
  CHECK(ran.exit == 0);
  for (const unsigned number : {1U, 2U, 1U, 2U}) CHECK(robot.next() == number);
}

TEST_CASE("--rate makes up for a delay: each message has a time of its own") {
  const Watchdog watchdog(60);
  Robot robot;
  Running pub(robot.pub({"{number: 1}", "--rate", "200"}));
  const auto lateness = [&] {  // of the next message, on a scale of its own
    REQUIRE(robot.next() == 1);
    const lot::Envelope envelope = robot.puller.envelope();
    return envelope.pushed.value().time_since_epoch() -
           static_cast<std::int64_t>(envelope.sequence) * std::chrono::milliseconds(5);
  };
  auto least = lateness();
  for (int n = 0; n < 20; ++n) least = std::min(least, lateness());
  stop(pub.child());
  std::this_thread::sleep_for(500ms);
  pub.child().send(SIGCONT);
  while (lateness() > least + 250ms) {
  }
  CHECK(pub.interrupt().exit == 0);
}

TEST_CASE("Ctrl-C ends --rate well") {
  const Watchdog watchdog(60);
  Robot robot;
  Running pub(robot.pub({"{number: 5}", "--rate", "100"}));
  for (int n = 0; n < 5; ++n) CHECK(robot.next() == 5);
  const Ran ran = pub.interrupt();
  CHECK(ran.exit == 0);
  CHECK(ran.out.starts_with("pushed "));
  CHECK(robot.room.files() == 2);
}

TEST_CASE("a topic that no process uses gets the type of --like, and --wait waits for one") {
  const Watchdog watchdog(60);
  Robot robot;
  const auto pub = [&](std::vector<std::string> words) {
    words.insert(words.begin(), "pub");
    return run_lot(on(robot.options, std::move(words)));
  };
  Ran ran = pub({"/new", "{number: 1}"});
  CHECK(ran.exit == 1);
  CHECK(names(ran.err, "lot: /new: no process uses this topic, so its type is not known"));
  CHECK(names(ran.err, "--like TOPIC"));
  ran = pub({"/new", "{number: 1}", "--like", "/nothing"});
  CHECK(ran.exit == 1);
  CHECK(names(ran.err, "lot: /nothing: no process uses this topic either"));
  ran = pub({"/new", "{number: 1}", "--like", "/goal"});
  CHECK(ran.exit == 0);
  CHECK(names(ran.out, "to 0 subscribers\n"));
  CHECK(names(ran.out, "* no process subscribes to it: --wait SECONDS waits for one"));

  {
    Running observer(on(robot.options, {"echo", "/new"}));
    REQUIRE(observer.says("waiting"));
    ran = pub({"/new", "{number: 1}", "--like", "/goal"});
    CHECK(names(ran.out, "to 0 subscribers and 1 observer\n"));
  }
  ran = pub({"/new", "{number: 1}", "--like", "/goal", "--wait", "0.05"});
  CHECK(ran.exit == 1);
  CHECK(names(ran.err, "lot: /new: no process subscribes to it; nothing was published"));
  CHECK(pub({"/new", "{number: 1}", "--wait", "0.05"}).exit == 1);

  Running waits(on(robot.options, {"pub", "/new", "{number: 9}", "--wait", "60"}));
  auto late = robot.engine.subscribe<Goal>("/new");
  const auto goal = late.pull(20s);
  REQUIRE(goal);
  CHECK(goal->number == 9);
  CHECK(waits.finish().exit == 0);
}

TEST_CASE("a lot echo that waits for a topic gets each message of the lot pub that makes it") {
  const Watchdog watchdog(60);
  Robot robot;
  for (const char* topic : {"/new", "/newer"}) {
    Running echo(on(robot.options, {"echo", topic, "--json", "--field", "number"}));
    CHECK(echo.says("no process uses this topic yet: waiting"));
    const Ran ran = run_lot(on(robot.options, {"pub", topic, "--like", "/goal", "--json",
                                               "{number: 1}\n---\n{number: 2}\n---\n{number: 3}"}));
    CHECK(ran.exit == 0);
    CHECK(ran.json()["observers"] == 1);
    CHECK(ran.json()["unread"] == 0);
    for (const char* number : {"1", "2", "3"}) CHECK(echo.line() == number);
  }
}

TEST_CASE("lot pub begins before the segment is there, with --wait") {
  const Watchdog watchdog(60);
  const Room room;
  Running pub(on(room.options(), {"pub", "/goal", "{number: 2}", "--wait", "60"}));
  usleep(20'000);
  lot::ShmEngine engine(room.options());
  auto puller = engine.subscribe<Goal>("/goal");
  const auto goal = puller.pull(20s);
  REQUIRE(goal);
  CHECK(goal->number == 2);
  CHECK(pub.finish().exit == 0);
}

TEST_CASE("--latch stays for subscribers that come later") {
  const Watchdog watchdog(60);
  Robot robot;
  Running pub(robot.pub({"{number: 6}", "--latch"}));
  CHECK(robot.next() == 6);
  CHECK(names(pub.line(), "pushed 1 message"));
  lot::PullerOptions latched;
  latched.history = 1;
  auto late = robot.engine.subscribe<Goal>("/goal", latched);
  const auto goal = late.pull(20s);
  REQUIRE(goal);
  CHECK(goal->number == 6);
  CHECK(names(run_lot(on(robot.options, {"echo", "/goal", "--count", "1"})).out, "number: 6\n"));
  CHECK(pub.interrupt().exit == 0);
}

TEST_CASE("YAML that is no message of the type is an error that says why, and publishes nothing") {
  const Watchdog watchdog(60);
  Robot robot;
  const auto why = [&](const std::string& yaml) {
    const Ran ran = robot.run({yaml});
    CHECK(ran.exit == 1);
    CHECK(ran.out.empty());
    CHECK(std::count(ran.err.begin(), ran.err.end(), '\n') == 1);
    return ran.err;
  };
  CHECK(names(why("{numbr: 1}"), "there is no field \"numbr\""));
  CHECK(names(why("{numbr: 1}"), "there are number, x, labels, data, best"));
  CHECK(names(why("{labels: [{nam: 1}]}"), "lot: labels[0]: there is no field \"nam\""));
  CHECK(names(why("{number: ten}"), "lot: number: it is a uint32, and the YAML has \"ten\""));
  CHECK(names(why("{number: -1}"), "lot: number: -1 does not fit a uint32"));
  CHECK(names(why("{best: {name: a}}"), "a reference cannot be set"));
  CHECK(names(why("[1]"), "write a map of its fields"));
  CHECK(names(why("5"), "write a map of its fields"));
  CHECK(names(why("{number: ["), "lot: the YAML: line 1, column"));
  CHECK(names(why("a: b: c"), "lot: the YAML: line 1, column"));
  CHECK(names(why(""), "there is no message in it"));
  CHECK(names(why("*unknown"), "lot: the YAML: line 1, column"));
  CHECK(names(why(std::string(100'000, '[')), "lot: the YAML: its lists and maps lie more than "));
  CHECK(names(why("{number: 1}\n---\n{number: x}"),
              "lot: document 2, from line 3 on: number: it is a uint32"));
  CHECK(names(why("{\"\\e[2J\": 1}"), "there is no field \"?[2J\""));
  CHECK(robot.puller.try_pull() == nullptr);
  CHECK(robot.puller.missed_total() == 0);
}

TEST_CASE("a message that the segment has no room for is an error") {
  const Watchdog watchdog(60);
  Robot robot;
  const Ran ran = robot.run_with("data: !!binary \"" + std::string(20 << 20, 'A') + "\"\n", "-");
  CHECK(ran.exit == 1);
  CHECK(names(ran.err, "no room for 15728640 bytes"));
  CHECK(names(ran.err, "raise LOT_SIZE"));
  CHECK(robot.puller.try_pull() == nullptr);
}

TEST_CASE("what lot pub can not build it does not publish: opaque types, items of queues") {
  const Watchdog watchdog(60);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto secrets = engine.subscribe<HasSecret>("/secrets");
  auto jobs = engine.queue<std::uint64_t>("jobs");
  CHECK(jobs.put(1) == lot::Status::Ok);
  Ran ran = run_lot(on(room.options(), {"pub", "/secrets", "{before: 1}"}));
  CHECK(ran.exit == 1);
  CHECK(names(ran.err, "Secret"));
  CHECK(secrets.try_pull() == nullptr);
  ran = run_lot(on(room.options(), {"pub", "jobs", "5"}));
  CHECK(ran.exit == 1);
  CHECK(names(ran.err, "this is a queue, not a topic"));
  CHECK(jobs.try_pop() == 1);
}

TEST_CASE("a damaged description ends lot pub with 3") {
  const Watchdog watchdog(60);
  Robot robot;
  lot::segment::Segment segment(robot.engine.path());
  auto& entry = *std::find_if(segment.topics().begin(), segment.topics().end(),
                              [](const auto& topic) { return std::string(topic.name) == "/goal"; });
  const std::uint64_t word = lot::test::raw(entry.description);
  lot::test::raw(entry.description) = word ^ 1;
  const Ran ran = robot.run({"{number: 1}"});
  CHECK(ran.exit == 3);
  CHECK(names(ran.err, "the description of this type is damaged"));
  lot::test::raw(entry.description) = word;
}

TEST_CASE("a lot pub that is killed leaves its messages to the subscribers") {
  const Watchdog watchdog(60);
  Robot robot;
  {
    Running pub(robot.pub({"{number: 8}", "--latch"}));
    CHECK(names(pub.line(), "pushed 1 message"));
  }
  CHECK(robot.next() == 8);
  CHECK(robot.run({"{number: 9}"}).exit == 0);
  CHECK(robot.next() == 9);
}

TEST_CASE("numbers and texts are messages, too") {
  const Watchdog watchdog(60);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto puller = engine.subscribe<std::int32_t>("/height");
  for (const char* height : {"5", "-5"}) {
    auto words = on(room.options(), {"pub"});
    words.insert(words.end(), {"/height", "--", height});
    CHECK(run_lot(words).exit == 0);
    const auto seen = puller.pull(10s);
    REQUIRE(seen);
    CHECK(std::to_string(*seen) == height);
  }
}

TEST_CASE("wrong words end lot pub with 2") {
  const Watchdog watchdog(60);
  for (const std::vector<std::string>& words :
       std::vector<std::vector<std::string>>{{"pub"},
                                             {"pub", "/a"},
                                             {"pub", "", "{}"},
                                             {"pub", std::string(200, 'x'), "{}"},
                                             {"pub", "/a", "{}", "more"},
                                             {"pub", "/a", "{}", "--count", "3"},
                                             {"pub", "/a", "{}", "--rate", "0"},
                                             {"pub", "/a", "{}", "--rate", "nan"},
                                             {"pub", "/a", "{}", "--rate", "1", "--count", "0"},
                                             {"pub", "/a", "{}", "--rate", "1", "--latch"},
                                             {"pub", "/a", "{}", "--wait", "-1"}}) {
    CAPTURE(words.back());
    CHECK(run_lot(words).exit == 2);
  }
}

TEST_SUITE_END();
