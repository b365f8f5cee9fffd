// SPDX-License-Identifier: Apache-2.0

// What lot echo prints of a topic, for how long, and what it does where something is wrong.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <optional>
#include <string>
#include <sys/stat.h>
#include <sys/wait.h>
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
#include "support/users.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const bool has_janitor = start_janitor();

struct Label {
  lot::ShmString name;
  float score = 0;
};
struct Frame {
  std::uint32_t number = 0;
  lot::ShmString encoding;
  lot::ShmVector<Label> labels;
  lot::ShmVector<std::uint8_t> data;
};
struct Note {
  std::uint64_t number;
};
struct Chain {
  lot::ShmRef<const Chain> left, right;
};
/// A type whose description is too large for the segment: its names are long.
#define LONG(n) \
  a_field_whose_name_is_long_so_that_nine_times_twenty_of_them_are_more_than_a_description_has_##n
template <int N>
struct Part {
  std::uint8_t LONG(00), LONG(01), LONG(02), LONG(03), LONG(04), LONG(05), LONG(06), LONG(07),
      LONG(08), LONG(09), LONG(10), LONG(11), LONG(12), LONG(13), LONG(14), LONG(15), LONG(16),
      LONG(17), LONG(18), LONG(19);
};
#undef LONG
struct Huge {
  Part<0> p0;
  Part<1> p1;
  Part<2> p2;
  Part<3> p3;
  Part<4> p4;
  Part<5> p5;
  Part<6> p6;
  Part<7> p7;
  Part<8> p8;
};

lot::PusherOptions stamping(lot::Policy policy = lot::Policy::Overwrite, std::uint32_t depth = 64) {
  lot::PusherOptions options;
  options.policy = policy;
  options.depth = depth;
  options.stamp = true;
  return options;
}

/// A publisher of frames in a segment of its own.
struct Camera {
  explicit Camera(const lot::PusherOptions& how = stamping(), const std::string& segment = "s")
      : options(named(room.options(segment))),
        engine(options),
        pusher(engine.advertise<Frame>("/frames", how)) {}

  static lot::EngineOptions named(lot::EngineOptions options) {
    options.name = "camera";
    return options;
  }
  void push(std::uint32_t number, std::size_t labels = 1, std::size_t bytes = 3) {
    auto frame = pusher.loan();
    frame->number = number;
    frame->encoding = "mono8";
    frame->labels.resize(labels);
    for (auto& label : frame->labels) label.name = "left";
    frame->data.assign(bytes, static_cast<std::uint8_t>(number));
    must_go(pusher.push(std::move(frame)));
  }
  std::vector<std::string> echo(std::vector<std::string> words) const {
    words.insert(words.begin(), {"echo", "/frames"});
    return on(options, std::move(words));
  }
  Ran run(std::vector<std::string> words) const { return run_lot(echo(std::move(words))); }

  Room room;
  lot::EngineOptions options;
  lot::ShmEngine engine;
  lot::ShmPusher<Frame> pusher;
};

/// Each of them ends by itself where no process uses the topic.
const std::vector<std::vector<std::string>> kVerbsOfATopic = {
    {"echo", "/notes", "--timeout", "0"},
    {"pub", "/notes", "{}"},
    {"hz", "/notes", "--duration", "0.1"},
    {"bw", "/notes", "--duration", "0.1"},
    {"delay", "/notes", "--duration", "0.1"}};

bool has(const std::string& text, const std::string& part) { return text.find(part) != text.npos; }

/// The words with a directory, and no segment.
std::vector<std::string> words_at(const std::string& directory, std::vector<std::string> words) {
  words.insert(words.end(), {"--dir", directory});
  return words;
}

/// What a message of Frame is on its own, as a document.
std::string document_of(unsigned number) {
  const std::string n = std::to_string(number);
  return "number: " + n +
         "\nencoding: \"mono8\"\nlabels:\n  - name: \"left\"\n    score: 0\ndata: [" + n + ", " +
         n + ", " + n + "]\n";
}

/// True when no process that reads keeps or borrows a message.
bool is_held_by_a_reader(const lot::EngineOptions& options) {
  const Json who = run_lot(on(options, {"who", "--json"})).json();
  for (const Json& message : who.at("segments").at(0).at("messages")) {
    for (const Json& holder : message.at("holders")) {
      if (holder.at("how") == "borrows" || holder.at("how") == "keeps") return true;
    }
  }
  return false;
}

}  // namespace

TEST_SUITE_BEGIN("echo");

TEST_CASE("lot echo prints each message as a YAML document, with --- between two") {
  const Watchdog watchdog(60);
  Camera camera;
  for (unsigned n = 1; n <= 3; ++n) camera.push(n);
  const Ran ran = camera.run({"--history", "3", "--count", "3"});
  CHECK(ran.exit == 0);
  CHECK(ran.out == document_of(1) + "---\n" + document_of(2) + "---\n" + document_of(3));
  CHECK(ran.err.empty());
}

TEST_CASE("lot echo prints messages as they come, each at once, and Ctrl-C ends it well") {
  const Watchdog watchdog(60);
  Camera camera;
  Running echo(camera.echo({"--json", "--field", "number"}));
  const auto observes = [&] {
    const Json ls = run_lot(on(camera.options, {"ls", "--json", "--interval", "1"})).json();
    const Json subscribers = ls["segments"][0]["topics"][0]["subscribers"];
    return subscribers.size() == 1 && subscribers[0]["observes"] == true;
  };
  CHECK(eventually(observes));
  CHECK(camera.pusher.readers() == 0);
  for (unsigned n = 0; n < 5; ++n) {
    camera.push(n);
    CHECK(echo.line() == std::to_string(n));
  }
  const Ran ran = echo.interrupt();
  CHECK(ran.exit == 0);
  CHECK(ran.out.empty());
  CHECK(!observes());
}

TEST_CASE("a topic that has one message from before shows it, whatever its policy is") {
  const Watchdog watchdog(60);
  for (const lot::Policy policy : {lot::Policy::Overwrite, lot::Policy::Block}) {
    lot::PusherOptions latched = stamping(policy, 4);
    latched.history = 1;
    Camera camera(latched);
    const auto reader = camera.engine.subscribe<Frame>("/frames");
    camera.push(7);
    CHECK(camera.run({"--count", "1"}).out == document_of(7));
    CHECK(camera.run({"--timeout", "0"}).out == document_of(7));
    const Ran ran = camera.run({"--history", "0", "--timeout", "0.05"});
    CHECK(ran.exit == 1);
    CHECK(ran.out.empty());
    CHECK(names(ran.err, "* /frames: no message came in time\n"));
  }
}

TEST_CASE("lot echo ends with 1 where less messages came than it was to print") {
  const Watchdog watchdog(60);
  Camera camera;
  camera.push(1);
  CHECK(camera.run({"--count", "2", "--timeout", "0.05"}).exit == 1);
  CHECK(camera.run({"--count", "1", "--timeout", "0.05"}).exit == 0);
  CHECK(camera.run({"--timeout", "0.05"}).exit == 0);
  Running echo(on(camera.options, {"echo", "/none"}));
  CHECK(echo.says("* /none: no process uses this topic yet: waiting"));
  CHECK(echo.interrupt().exit == 1);
  Running waits(camera.echo({"--field", "number", "--count", "2"}));
  CHECK(waits.line() == "1");
  CHECK(waits.interrupt().exit == 1);
}

TEST_CASE("a topic that other processes only look at in two segments is found in a third") {
  const Watchdog watchdog(60);
  const Room room;
  lot::PullerOptions looks;
  looks.observer = true;
  lot::ShmEngine a(room.options("a"));
  lot::ShmEngine b(room.options("b"));
  lot::ShmEngine c(room.options("c"));
  const auto in_a = a.subscribe<Note>("/notes", looks);
  const auto in_b = b.subscribe<Note>("/notes", looks);
  auto pusher = c.advertise<Note>("/notes");
  must_go(pusher.push(pusher.loan(Note{3})));
  const std::vector<std::string> words = {"echo", "/notes", "--dir", room.path(), "--count", "1"};
  CHECK(run_lot(words).out == "number: 3\n");
  const auto reader = b.subscribe<Note>("/notes");
  const Ran ran = run_lot(words);
  CHECK(ran.exit == 1);
  CHECK(names(ran.err, "the segments b and c have this topic"));
}

TEST_CASE("--envelope says where a message comes from") {
  const Watchdog watchdog(60);
  Camera camera;
  for (unsigned n = 0; n < 3; ++n) camera.push(n);
  const Json line = Json::parse(camera.run({"--json", "--envelope", "--count", "1"}).out);
  CHECK(line["command"] == "echo");
  CHECK(line["topic"] == "/frames");
  CHECK(line["sequence"] == 2);
  CHECK(line["missed"] == 0);
  CHECK(line["publisher"] == "camera");
  CHECK(line["publisher_id"].get<std::string>().size() == 16);
  CHECK(line["message"]["number"] == 2);
  CHECK(line["age_seconds"].get<double>() >= 0);
  const std::chrono::duration<double> now = std::chrono::steady_clock::now().time_since_epoch();
  CHECK(line["pushed_seconds"].get<double>() <= now.count());
  CHECK(line["pushed_seconds"].get<double>() > now.count() - 60);
  const std::string yaml = camera.run({"--envelope", "--field", "number", "--count", "1"}).out;
  CHECK(yaml.starts_with("sequence: 2\nmissed: 0\npublisher: \"camera\"\npublisher_id: \""));
  CHECK(yaml.ends_with("\nmessage: 2\n"));

  Camera silent(lot::PusherOptions{});
  silent.push(1);
  const Json unstamped = Json::parse(silent.run({"--json", "--envelope", "--count", "1"}).out);
  CHECK(unstamped["pushed_seconds"].is_null());
  CHECK(unstamped["age_seconds"].is_null());
}

TEST_CASE("long lists and texts are shortened, unless --full says otherwise") {
  const Watchdog watchdog(60);
  Camera camera;
  camera.push(5, 1, 1 << 20);
  CHECK(camera.run({"--count", "1"}).out.size() < 500);
  CHECK(camera.run({"--field", "data", "--elements", "2", "--count", "1"}).out ==
        "elements: 1048576\nfirst: [5, 5]\n");
  CHECK(camera.run({"--field", "data", "--elements", "0", "--count", "1"}).out ==
        "elements: 1048576\nfirst: []\n");
  CHECK(camera.run({"--field", "encoding", "--characters", "4", "--count", "1", "--json"}).out ==
        "{\"bytes\":5,\"first\":\"mono\"}\n");
  const Json whole = Json::parse(camera.run({"--full", "--json", "--count", "1"}).out);
  CHECK(whole["data"].size() == 1 << 20);
  CHECK(whole["data"][(1 << 20) - 1] == 5);
}

TEST_CASE("--field prints a part; a message without it is told of once, and ends nothing") {
  const Watchdog watchdog(60);
  Camera camera;
  camera.push(1, 2);
  Running echo(camera.echo({"--field", "labels[1].name"}));
  CHECK(echo.line() == "\"left\"");
  camera.push(2, 1);
  CHECK(echo.says("* /frames: labels: it has 1 elements, and no [1]"));
  camera.push(3, 0);
  camera.push(4, 3);
  CHECK(echo.line() == "---");
  CHECK(echo.line() == "\"left\"");
  const Ran ran = echo.interrupt();
  CHECK(ran.exit == 0);
  CHECK(ran.err.find("labels") == ran.err.rfind("labels"));
}

TEST_CASE("messages that can not be printed do not keep lot echo from its end, and are counted") {
  const Watchdog watchdog(60);
  Camera camera;
  camera.push(1, 2);
  std::atomic<bool> has_ended = false;
  std::thread sends([&] {
    auto pusher = camera.engine.advertise<Frame>("/frames", stamping());
    while (!has_ended) {
      must_go(pusher.push(pusher.loan()));
      std::this_thread::sleep_for(1ms);
    }
  });
  const Ran some = camera.run({"--field", "labels[1].name", "--count", "2", "--timeout", "0.2"});
  CHECK(some.exit == 1);
  CHECK(names(some.err, "* /frames: no message that can be printed came in time\n"));
  CHECK(names(some.err, " could not be printed so far\n"));
  Running waits(camera.echo({"--field", "labels[1].name"}));
  CHECK(waits.line() == "\"left\"");
  CHECK(waits.says("* /frames: labels: it has 0 elements, and no [1]"));
  const Ran ran = waits.interrupt();
  CHECK(ran.exit == 0);
  CHECK(names(ran.err, " could not be printed so far\n"));
  has_ended = true;
  sends.join();
}

TEST_CASE("a path that no message can have is an error, which says what there is") {
  const Watchdog watchdog(60);
  Camera camera;
  camera.push(1, 0);
  const auto why = [&](const char* path) {
    const Ran ran = camera.run({"--field", path, "--count", "1"});
    CHECK(ran.exit == 1);
    CHECK(ran.out.empty());
    return ran.err;
  };
  CHECK(names(why("numbr"), "lot: --field numbr: the message has no field \"numbr\""));
  CHECK(names(why("numbr"), "there are number, encoding, labels, data"));
  CHECK(names(why("labels[0].nam"), "labels[0] has no field \"nam\""));
  CHECK(names(why("labels[0].nam"), "there are name, score"));
  CHECK(names(why("labels.name"), "it has elements, the first of which is [0]"));
  CHECK(names(why("number[0]"), "number has no elements"));
  CHECK(names(why("number.x"), "it is a single value"));
  CHECK(names(why("[0]"), "the message has no elements"));
  for (const char* bad : {"labels[", "labels[x]", "labels[-1]", "labels[0]name", "labels..name",
                          "labels[99999999999999999999]", "."}) {
    CAPTURE(bad);
    CHECK(names(why(bad), "a path looks like labels[2].name"));
  }
  CHECK(names(why("\x1b[2J"), "--field ?[2J: "));
}

TEST_CASE("a topic without its slash, or with one too much, is told what there is") {
  const Watchdog watchdog(60);
  const Room room;
  lot::ShmEngine engine(room.options());
  const auto frames = engine.advertise<Note>("/frames");
  const auto jobs = engine.advertise<Note>("jobs");
  Running echo(on(room.options(), {"echo", "frames"}));
  CHECK(echo.says("* frames: there is /frames\n"));
  Running hz(on(room.options(), {"hz", "/jobs"}));
  CHECK(hz.says("* /jobs: there is jobs\n"));
  Running other(on(room.options(), {"echo", "/frames/left"}));
  CHECK(other.says("* /frames/left: no process uses this topic yet"));
  CHECK(names(run_lot(on(room.options(), {"pub", "frames", "{}"})).err, "; there is /frames"));
  CHECK(!names(other.interrupt().err, "there is"));
}

TEST_CASE("lot echo waits for segment, topic and publisher, and says so") {
  const Watchdog watchdog(60);
  const Room room;
  Running echo(on(room.options(), {"echo", "/notes"}));
  CHECK(echo.says("* /notes: no process uses this topic yet: waiting"));
  lot::ShmEngine engine(room.options());
  const auto reader = engine.subscribe<Note>("/notes");
  CHECK(echo.says("* /notes: it has no publisher yet: waiting"));
  auto pusher = engine.advertise<Note>("/notes");
  must_go(pusher.push(pusher.loan(Note{1})));
  CHECK(echo.line() == "number: 1");
  CHECK(echo.interrupt().exit == 0);
}

TEST_CASE("lot echo goes on when the publisher is killed and started again") {
  const Watchdog watchdog(60);
  const Room room;
  Steps go;
  const auto start = [&](std::uint64_t number) {
    return Child([&, number] {
      lot::ShmEngine engine(room.options());
      auto pusher = engine.advertise<Note>("/notes");
      must_go(pusher.push(pusher.loan(Note{number})));
      (void)go.next(60s);
    });
  };
  Child first = start(1);
  Running echo(on(room.options(), {"echo", "--json", "/notes"}));
  CHECK(echo.json()["number"] == 1);
  first.kill9();
  CHECK(echo.says("* /notes: it has no publisher now: waiting"));
  Child second = start(2);
  CHECK(echo.json()["number"] == 2);
  second.kill9();
  CHECK(echo.interrupt().exit == 0);
  CHECK(room.files() == 0);
}

TEST_CASE("lot echo goes on in the next segment when the files of this one are removed") {
  const Watchdog watchdog(60);
  const Room room;
  const auto remove_files = [&] {
    std::filesystem::remove(room.path() + "/s");
    std::filesystem::remove(room.path() + "/s.lock");
  };
  const std::string anew = "* /notes: the files of its segment were removed: looking for it anew";
  Running echo(on(room.options(), {"echo", "--json", "/notes"}));
  std::uint64_t number = 0;
  for (const bool publisher_stays : {false, true, true}) {
    CAPTURE(publisher_stays);
    Steps go;
    Child old([&] {
      lot::ShmEngine engine(room.options());
      auto pusher = engine.advertise<Note>("/notes");
      must_go(pusher.push(pusher.loan(Note{number})));
      (void)go.next(60s);
      must_go(pusher.push(pusher.loan(Note{number + 1})));
      (void)go.next(60s);
    });
    CHECK(echo.json()["number"] == number);
    remove_files();
    go.tell();
    CHECK(echo.json()["number"] == number + 1);  // as long as its publisher is there
    if (!publisher_stays) old.kill9();
    std::optional<lot::ShmEngine> other;  // or until another segment is there
    if (publisher_stays) other.emplace(room.options());
    const auto times = [&] {
      const std::string err = echo.err();
      std::size_t n = 0;
      for (auto at = err.find(anew); at != err.npos; at = err.find(anew, at + 1)) ++n;
      return n;
    };
    CHECK(eventually([&] { return times() == number / 2 + 1; }));
    other.reset();
    go.tell();
    number += 2;
  }
  CHECK(echo.interrupt().exit == 0);
}

TEST_CASE("lot echo goes on when the topic gets another type, and says which") {
  const Watchdog watchdog(60);
  const Room room;
  lot::ShmEngine engine(room.options());
  std::optional notes(engine.advertise<Note>("/topic"));
  must_go(notes->push(notes->loan(Note{1})));
  Running echo(on(room.options(), {"echo", "--json", "/topic"}));
  Running part(on(room.options(), {"echo", "--json", "--field", "number", "/topic"}));
  CHECK(echo.json()["number"] == 1);
  CHECK(part.line() == "1");
  notes.reset();
  CHECK(echo.says("no publisher now"));
  std::optional labels(engine.advertise<Label>("/topic"));
  auto label = labels->loan();
  label->name = "left";
  must_go(labels->push(std::move(label)));
  CHECK(echo.json()["name"] == "left");
  CHECK(names(echo.err(), "* /topic: the topic carries "));
  CHECK(names(echo.err(), "Label now\n"));
  CHECK(part.says("the message has no field \"number\""));
  labels.reset();
  CHECK(eventually([&] {
    return error_of([&] { notes.emplace(engine.advertise<Note>("/topic")); }).first == 0;
  }));
  must_go(notes->push(notes->loan(Note{2})));
  CHECK(echo.json()["number"] == 2);
  CHECK(part.line() == "2");
}

TEST_CASE("missed messages are told") {
  const Watchdog watchdog(60);
  Camera camera(stamping(lot::Policy::Overwrite, 4));
  camera.push(0);
  Running echo(camera.echo({"--json", "--envelope"}));
  CHECK(echo.json()["sequence"] == 0);
  CHECK(eventually([&] { return !is_held_by_a_reader(camera.options); }));
  stop(echo.child());
  for (unsigned n = 1; n <= 10; ++n) camera.push(n);
  echo.child().send(SIGCONT);
  const Json next = echo.json();
  CHECK(next["sequence"] == 7);
  CHECK(next["missed"] == 6);
  CHECK(echo.says("* /frames: 6 messages missed\n"));
}

TEST_CASE("slow output holds up no publisher and keeps no message, and Ctrl-C ends it") {
  const Watchdog watchdog(60);
  Camera camera(stamping(lot::Policy::Block, 4));
  Running echo(camera.echo({"--full"}));  // of which nothing is read
  camera.push(1, 1, 100'000);
  for (unsigned n = 2; n < 50; ++n) camera.push(n, 1, 100'000);
  CHECK(eventually([&] { return !is_held_by_a_reader(camera.options); }));
  echo.child().send(SIGINT);
  int status = -1;
  CHECK(echo.child().pid() > 0);
  CHECK(waitpid(echo.child().pid(), &status, 0) == echo.child().pid());
  CHECK(WIFEXITED(status));
}

TEST_CASE("lot echo ends when no process reads its output, also while no message comes") {
  const Watchdog watchdog(60);
  Camera camera;
  camera.push(1);
  Running echo(camera.echo({}));
  CHECK(echo.line() == "number: 1");
  echo.close_output();
  const Ran quiet = echo.finish();
  CHECK(quiet.exit == 0);
  CHECK(quiet.err.empty());

  Running busy(camera.echo({}));
  CHECK(busy.line() == "number: 1");
  busy.close_output();
  camera.push(2);
  const Ran ran = busy.finish();
  CHECK(ran.exit == 0);
  CHECK(ran.err.empty());
}

TEST_CASE("where two segments have the topic, the user says which one, before the environment") {
  const Watchdog watchdog(60);
  Camera a(stamping(), "a");
  lot::ShmEngine engine(a.room.options("b"));
  auto pusher = engine.advertise<Note>("/frames");
  must_go(pusher.push(pusher.loan(Note{22})));
  a.push(11);
  const std::vector<std::string> echo = {"echo", "/frames", "--count", "1", "--dir", a.room.path()};
  const auto with = [](std::vector<std::string> words, std::vector<std::string> more) {
    words.insert(words.end(), more.begin(), more.end());
    return words;
  };
  const Ran both = run_lot(echo);
  CHECK(both.exit == 1);
  CHECK(names(both.err, "the segments a and b have this topic"));
  CHECK(names(both.err, "--segment NAME"));
  CHECK(run_lot(with(echo, {"--segment", "a"})).out == document_of(11));
  prefix();
  const Variable variable("LOT_SEGMENT", "a");
  CHECK(run_lot(echo).out == document_of(11));
  CHECK(run_lot(with(echo, {"--segment", "b"})).out == "number: 22\n");
}

TEST_CASE("what a message holds can not steer the terminal, and has no number that breaks JSON") {
  const Watchdog watchdog(60);
  Camera camera;
  auto frame = camera.pusher.loan();
  frame->encoding = "\x1b[2J\xc2\x9b";
  frame->labels.resize(3);
  frame->labels[0].score = std::numeric_limits<float>::infinity();
  frame->labels[1].score = std::nanf("");
  frame->labels[2].name = "\xff\xfe";
  must_go(camera.pusher.push(std::move(frame)));
  const std::string yaml = camera.run({"--count", "1"}).out;
  CHECK(names(yaml, "encoding: \"\\x1b[2J\\x9b\"\n"));
  CHECK(names(yaml, "score: .inf\n"));
  CHECK(names(yaml, "score: .nan\n"));
  CHECK(names(yaml, "name: !!binary \"//4=\"\n"));
  const Json json = Json::parse(camera.run({"--json", "--count", "1"}).out);
  CHECK(json["encoding"] == "\x1b[2J\xc2\x9b");
  CHECK(json["labels"][0]["score"] == "inf");
  CHECK(json["labels"][2]["name"]["base64"] == "//4=");
}

TEST_CASE("references in a ring end, also with --full") {
  const Watchdog watchdog(60);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto pusher = engine.advertise<Chain>("/chain");
  lot::ShmSharedPtr<Chain> chain = engine.make<Chain>();
  chain->left = chain;
  must_go(pusher.push(lot::ShmSharedPtr<const Chain>(chain)));
  for (const char* option : {"--full", "--json"}) {
    const Ran ran = run_lot(on(room.options(), {"echo", "/chain", "--count", "1", option}));
    CHECK(ran.exit == 0);
    CHECK(names(ran.out, "\"...\""));
    CHECK(ran.out.size() < 20'000);
  }
  chain->left = nullptr;
}

TEST_CASE("what only its own programs can read is shown as opaque, with its size and digits") {
  const Watchdog watchdog(60);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto secrets = engine.advertise<HasSecret>("/secrets");
  must_go(secrets.push(secrets.loan()));
  const auto echo = [&](const char* topic, std::vector<std::string> words) {
    words.insert(words.begin(), {"echo", topic, "--count", "1"});
    return run_lot(on(room.options(), std::move(words)));
  };
  const std::string text = echo("/secrets", {}).out;
  CHECK(names(text, "before: 1\nsecret:\n  opaque: \""));
  CHECK(names(text, "Secret\"\n  bytes: 4\n  hex: \"11000000\"\n"));
  CHECK(names(echo("/secrets", {"--field", "secret.value"}).err, "only its own programs know"));

  auto huge = engine.advertise<Huge>("/huge");
  auto message = huge.loan();
  std::memset(message.get(), 0xab, sizeof(Huge));
  must_go(huge.push(std::move(message)));
  const Ran shown = echo("/huge", {});
  CHECK(names(shown.out, "bytes: 180\nhex: \"abab"));
  CHECK(names(shown.err, "* /huge: only its own programs know what is in a message of this type"));
  CHECK(names(shown.err, "larger than 16 KiB"));
  const Ran ran = run_lot(on(room.options(), {"pub", "/huge", "{p0: 1}"}));
  CHECK(ran.exit == 1);
  CHECK(names(ran.err, "lot: /huge: only its own programs know what is in a message of this type"));
  CHECK(echo("/huge", {"--json"}).out.size() < 300);
  CHECK(Json::parse(echo("/huge", {"--json", "--full"}).out)["hex"].get<std::string>().size() ==
        360);
}

TEST_CASE("lot echo takes no items of a queue") {
  const Watchdog watchdog(60);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto queue = engine.queue<std::uint64_t>("jobs");
  CHECK(queue.put(1) == lot::Status::Ok);
  const Ran ran = run_lot(on(room.options(), {"echo", "jobs"}));
  CHECK(ran.exit == 1);
  CHECK(names(ran.err, "this is a queue, not a topic"));
  CHECK(queue.try_pop() == 1);
}

TEST_CASE("a damaged message is told of, the next one is printed, and the end is 3") {
  const Watchdog watchdog(60);
  Camera camera;
  auto frame = camera.pusher.loan();
  std::uint64_t before[sizeof(frame->labels) / 8];
  std::memcpy(before, static_cast<const void*>(&frame->labels), sizeof(before));
  std::memset(static_cast<void*>(&frame->labels), 0x11, sizeof(frame->labels));
  const lot::ShmSharedPtr<Frame> damaged = std::move(frame);
  must_go(camera.pusher.push(damaged));
  Running echo(camera.echo({"--field", "labels"}));
  CHECK(echo.says("* /frames: labels: "));
  CHECK(names(echo.err(), "Bad message"));
  std::memcpy(static_cast<void*>(&damaged->labels), before, sizeof(before));
  camera.push(2);
  CHECK(echo.line() == "- name: \"left\"");
  CHECK(echo.interrupt().exit == 3);
}

TEST_CASE("a bool that is not set is marked, and the rest of the message is printed") {
  const Watchdog watchdog(60);
  enum class Switch : bool { Off, On };
  struct Flags {
    std::uint8_t number;
    bool lit;
    Switch too;
    bool list[2];
  };
  const Room room;
  lot::ShmEngine engine(room.options());
  auto pusher = engine.advertise<Flags>("/flags");
  auto flags = pusher.loan();
  std::memset(static_cast<void*>(flags.get()), 0xaa, sizeof(Flags));
  flags->number = 5;
  flags->list[1] = true;
  must_go(pusher.push(std::move(flags)));
  const auto echo = [&](std::vector<std::string> more) {
    std::vector<std::string> words = {"echo", "/flags", "--count", "1"};
    words.insert(words.end(), more.begin(), more.end());
    return run_lot(on(room.options(), words));
  };
  const Ran ran = echo({});
  CHECK(ran.exit == 3);
  CHECK(ran.out ==
        "number: 5\nlit: \"<damaged>\"\ntoo: \"<damaged>\"\nlist: [\"<damaged>\", true]\n");
  CHECK(names(ran.err, "* /flags: lit: a bool is 170 (Bad message); its publisher has not set it"));
  CHECK(std::count(ran.err.begin(), ran.err.end(), '\n') == 1);
  CHECK(echo({"--json", "--field", "lit"}).out == "\"<damaged>\"\n");
  CHECK(echo({"--field", "number"}).exit == 0);
}

TEST_CASE("a damaged description ends lot echo with 3") {
  const Watchdog watchdog(60);
  Camera camera;
  camera.push(1);
  lot::segment::Segment segment(camera.engine.path());
  auto& entry =
      *std::find_if(segment.topics().begin(), segment.topics().end(),
                    [](const auto& topic) { return std::string(topic.name) == "/frames"; });
  const std::uint64_t word = lot::test::raw(entry.description);
  lot::test::raw(entry.description) = word ^ 1;
  const Ran ran = camera.run({"--count", "1"});
  CHECK(ran.exit == 3);
  CHECK(ran.out.empty());
  CHECK(names(ran.err, "the description of this type is damaged"));
  lot::test::raw(entry.description) = word;
  CHECK(camera.run({"--count", "1"}).exit == 0);
}

TEST_CASE("a segment that is none ends the verbs of a topic, if the user has named it") {
  const Watchdog watchdog(60);
  const Room room;
  const std::string path = room.path() + "/s";
  std::ofstream(path) << std::string(8192, 'x');
  for (const std::vector<std::string>& verb : kVerbsOfATopic) {
    CAPTURE(verb.front());
    Ran ran = run_lot(on(room.options(), verb));
    CHECK(ran.exit == 1);
    CHECK(has(ran.err, "lot: " + path + ": it is a file of 8192 bytes, and no segment"));
    ran = run_lot(words_at(room.path() + "/none", verb));
    CHECK(ran.exit == 1);
    CHECK(names(ran.err, "cannot read the segment directory"));
  }
}

TEST_CASE("the verbs of a topic say once what they can not look into, where no topic is found") {
  const Watchdog watchdog(120);
  const Room room;
  const std::string path = room.path() + "/LOTROS";
  const auto check = [&](const std::string& reason) {
    for (const std::vector<std::string>& verb : kVerbsOfATopic) {
      CAPTURE(verb.front());
      const Ran ran = run_lot(words_at(room.path(), verb));
      CHECK(ran.exit == 1);
      CHECK_MESSAGE(has(ran.err, "* " + path + ": " + reason), ran.err);
      CHECK(ran.err.find(path) == ran.err.rfind(path));
    }
    std::filesystem::remove(path);
  };
  REQUIRE(mkfifo(path.c_str(), 0600) == 0);
  check("it is a FIFO, and no process can join");
  REQUIRE(symlink("/etc/passwd", path.c_str()) == 0);
  check("it is a symbolic link, and no process can join");
  std::ofstream(path) << "LOTSHM\r\n" << std::string(8184, 'x');
  REQUIRE(chmod(path.c_str(), 0600) == 0);
  check("damaged: ");
  if (can_be_another_user()) {
    std::ofstream(path) << "not yours";
    REQUIRE(chmod(path.c_str(), 0600) == 0);
    REQUIRE(chown(path.c_str(), kBob, kGroup) == 0);
    REQUIRE(chmod(room.path().c_str(), 0755) == 0);
    std::vector<std::string> words = words_at(room.path(), {"echo", "/notes", "--timeout", "0"});
    words.insert(words.begin(), command());
    const Ran ran = run_by(words, [](char** arguments) {
      become(kAnn, kOtherGroup);
      fexecve(command_file(), arguments, environ);
    });
    CHECK(ran.exit == 1);
    CHECK_MESSAGE(has(ran.err, "* " + path + ": it cannot be read, and has no lock file"), ran.err);
    std::filesystem::remove(path);
  }

  std::ofstream(path) << "mine!";  // beside a segment that has the topic, it keeps nothing back
  Camera camera;
  camera.push(1);
  std::filesystem::rename(path, camera.room.path() + "/LOTROS");
  const Ran ran = run_lot(words_at(camera.room.path(), {"echo", "/frames", "--count", "1"}));
  CHECK(ran.exit == 0);
  CHECK(ran.err.empty());
}

TEST_CASE("a number that is too small is refused in words that people can read") {
  const Watchdog watchdog(60);
  CHECK(names(run_lot({"echo", "/a", "--count", "0"}).err, "0 is no whole number from 1 on"));
  CHECK(names(run_lot({"echo", "/a", "--history", "-1"}).err, "-1 is no whole number from 0 on"));
  CHECK(names(run_lot({"pub", "/a", "{}", "--rate", "1", "--count", "x"}).err,
              "x is no whole number from 1 on"));
}

TEST_CASE("wrong words end lot echo with 2") {
  const Watchdog watchdog(60);
  for (const std::vector<std::string>& words :
       std::vector<std::vector<std::string>>{{"echo"},
                                             {"echo", ""},
                                             {"echo", std::string(200, 'x')},
                                             {"echo", "/a", "/b"},
                                             {"echo", "/a", "--count", "0"},
                                             {"echo", "/a", "--count", "-1"},
                                             {"echo", "/a", "--count", "many"},
                                             {"echo", "/a", "--timeout", "-1"},
                                             {"echo", "/a", "--elements", "-1"},
                                             {"echo", "/a", "--full", "--elements", "3"},
                                             {"echo", "/a", "--history", "x"}}) {
    CAPTURE(words.back());
    const Ran ran = run_lot(words);
    CHECK(ran.exit == 2);
    CHECK(ran.err.size() < 400);
  }
}

TEST_SUITE_END();
