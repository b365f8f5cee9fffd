// SPDX-License-Identifier: Apache-2.0

// What the tool's documents look like, how it ends, and that looking changes nothing.

#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <sys/stat.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "actor.hpp"
#include "command.hpp"
#include "liveness/lock_file.hpp"
#include "scene.hpp"
#include "support/error_of.hpp"
#include "support/janitor.hpp"
#include "support/lock_owner.hpp"
#include "support/must_go.hpp"
#include "support/users.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const bool has_janitor = start_janitor();

bool says(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

struct Refers {
  lot::ShmRef<const Letter> to;
};

/// All paths to values in a document; "[]" stands for each element of a list.
void collect_keys(const Json& value, const std::string& path, std::set<std::string>& keys) {
  if (value.is_object()) {
    for (const auto& [key, inner] : value.items()) collect_keys(inner, path + "." + key, keys);
  } else if (value.is_array() && !value.empty()) {
    for (const auto& inner : value) collect_keys(inner, path + "[]", keys);
  } else {
    keys.insert(path);
  }
}
std::set<std::string> keys_of(const Json& document) {
  std::set<std::string> keys;
  collect_keys(document, "", keys);
  return keys;
}

}  // namespace

TEST_SUITE_BEGIN("look");

TEST_CASE("lot says that its output can not be written") {
  const Room room;
  for (const char* verb : {"ls", "who", "doctor", "--version", "--help", "--help-all"}) {
    CAPTURE(verb);
    for (const bool is_full : {false, true}) {
      CAPTURE(is_full);
      std::vector<std::string> words = on(room.options(), {verb});
      words.insert(words.begin(), command());
      const Ran ran = run_by(words, [&](char** arguments) {
        const int full = is_full ? open("/dev/full", O_WRONLY) : -1;
        is_full ? dup2(full, STDOUT_FILENO) : close(STDOUT_FILENO);
        fexecve(command_file(), arguments, environ);
      });
      CHECK(ran.exit == 1);
      CHECK(says(ran.err, is_full ? "No space left" : "Bad file descriptor"));
    }
  }
}

TEST_CASE("lot ls as a document has these keys") {
  const Watchdog watchdog(60);
  const Scene scene;
  const Json document = run_lot(on(scene.options, {"ls", "--json"})).json();
  CHECK(keys_of(document) == std::set<std::string>{
                                 ".command",
                                 ".exit",
                                 ".hints[]",
                                 ".segments[].blocks.total",
                                 ".segments[].blocks.used",
                                 ".segments[].bytes",
                                 ".segments[].condition",
                                 ".segments[].damage",
                                 ".segments[].instance",
                                 ".segments[].memory.held_back_bytes",
                                 ".segments[].memory.taken_bytes",
                                 ".segments[].memory.total_bytes",
                                 ".segments[].memory.used_bytes",
                                 ".segments[].name",
                                 ".segments[].path",
                                 ".segments[].persist",
                                 ".segments[].processes[].alive",
                                 ".segments[].processes[].bytes",
                                 ".segments[].processes[].index",
                                 ".segments[].processes[].name",
                                 ".segments[].processes[].pid",
                                 ".segments[].processes[].since_unix",
                                 ".segments[].reason",
                                 ".segments[].topics[].name",
                                 ".segments[].topics[].publishers[].arrived",
                                 ".segments[].topics[].publishers[].arrived_seconds",
                                 ".segments[].topics[].publishers[].channel",
                                 ".segments[].topics[].publishers[].depth",
                                 ".segments[].topics[].publishers[].engine",
                                 ".segments[].topics[].publishers[].gone",
                                 ".segments[].topics[].publishers[].held",
                                 ".segments[].topics[].publishers[].per_second",
                                 ".segments[].topics[].publishers[].per_second_below",
                                 ".segments[].topics[].publishers[].policy",
                                 ".segments[].topics[].publishers[].process",
                                 ".segments[].topics[].publishers[].published",
                                 ".segments[].topics[].publishers[].to",
                                 ".segments[].topics[].publishers[].unfinished",
                                 ".segments[].topics[].publishers[].waits_for_room",
                                 ".segments[].topics[].subscribers[].channel",
                                 ".segments[].topics[].subscribers[].holds_back",
                                 ".segments[].topics[].subscribers[].joining",
                                 ".segments[].topics[].subscribers[].lag",
                                 ".segments[].topics[].subscribers[].lost",
                                 ".segments[].topics[].subscribers[].observes",
                                 ".segments[].topics[].subscribers[].process",
                                 ".segments[].topics[].type",
                                 ".segments[].topics[].type_bytes",
                             });
}

TEST_CASE("lot ls says what is used, what is held back, and what was taken from the system") {
  const Watchdog watchdog(60);
  const Room room;
  lot::ShmEngine engine(room.options());
  const auto memory = [&] {
    const Json document = run_lot(on(room.options(), {"ls", "--json"})).json();
    return document.at("segments").at(0).at("memory");
  };
  const auto du = [&] {
    struct stat status {};
    REQUIRE(stat(engine.path().c_str(), &status) == 0);
    return 512.0 * static_cast<double>(status.st_blocks);
  };
  const auto number = [](const Json& json, const char* key) { return json.at(key).get<double>(); };
  constexpr double kMiB = 1 << 20;
  const Json empty = memory();
  CHECK(number(empty, "used_bytes") == 0);
  CHECK(number(empty, "held_back_bytes") == 0);
  struct Frame {
    lot::ShmVector<std::uint8_t> data;
  };
  auto pusher = engine.advertise<Frame>("/frames", {lot::Policy::Overwrite, 2, {}});
  for (int n = 0; n < 4; ++n) {
    auto frame = pusher.loan();
    frame->data.resize(1 << 20);
    must_go(pusher.push(std::move(frame)));
  }
  auto loaned = pusher.loan();
  loaned->data.resize(1 << 20);
  const Json busy = memory();
  CHECK(number(busy, "used_bytes") >= 3 * kMiB);
  CHECK(number(busy, "held_back_bytes") >= kMiB);
  CHECK(number(busy, "held_back_bytes") <= number(busy, "used_bytes") - 2 * kMiB);
  CHECK(number(busy, "taken_bytes") >= number(busy, "used_bytes"));
  CHECK(std::abs(number(busy, "taken_bytes") - du()) <= du() / 100);
}

TEST_CASE("lot ls says which subscribers only observe") {
  const Watchdog watchdog(60);
  struct Note {
    int number;
  };
  const Room room;
  lot::ShmEngine engine(room.options());
  lot::PusherOptions lossless;
  lossless.depth = 2;
  lossless.policy = lot::Policy::Refuse;
  auto pusher = engine.advertise<Note>("/notes", lossless);
  lot::PullerOptions observing;
  observing.observer = true;
  const auto observer = engine.subscribe<Note>("/notes", observing);
  const auto reader = engine.subscribe<Note>("/notes");
  for (int n = 0; n < 2; ++n) CHECK(pusher.push(pusher.loan(Note{n})) == lot::Status::Ok);
  CHECK(pusher.push(pusher.loan(Note{2})) == lot::Status::Full);
  const Json document = run_lot(on(room.options(), {"ls", "--json"})).json();
  const Json subscribers = document["segments"][0]["topics"][0]["subscribers"];
  REQUIRE(subscribers.size() == 2);
  for (const Json& one : subscribers) {
    CHECK(one["lag"] == 2);
    CHECK(one["observes"] != one["holds_back"]);  // nothing waits for the observer
  }
  CHECK(subscribers[0]["observes"] != subscribers[1]["observes"]);
  const std::string text = run_lot(on(room.options(), {"ls"})).out;
  CHECK(text.find("observes") != std::string::npos);
  CHECK(text.find("holds it back") != std::string::npos);
}

TEST_CASE("lot ls shows an observer that is in no queue, also where the topic has nothing else") {
  const Watchdog watchdog(60);
  struct Note {
    int number;
  };
  const Room room;
  lot::EngineOptions named = room.options();
  named.name = "onlooker";
  lot::ShmEngine engine(named);
  lot::PullerOptions observing;
  observing.observer = true;
  std::optional reader(engine.subscribe<Note>("/notes"));
  const auto observer = engine.subscribe_any("/notes", observing);
  const auto topic = [&] {
    const Json document = run_lot(on(room.options(), {"ls", "--json"})).json();
    CHECK(document["segments"][0]["damage"].empty());
    REQUIRE(document["segments"][0]["topics"].size() == 1);
    return document["segments"][0]["topics"][0];
  };
  const auto text = [&] { return run_lot(on(room.options(), {"ls"})).out; };
  Json subscribers = topic()["subscribers"];
  REQUIRE(subscribers.size() == 2);
  CHECK(subscribers[0]["observes"] == false);
  CHECK(subscribers[1]["observes"] == true);
  CHECK(subscribers[1]["channel"].is_null());
  CHECK(says(text(), "observes, no publisher\n"));

  reader.reset();
  const Json alone = topic();
  CHECK(alone["name"] == "/notes");
  CHECK(alone["publishers"].empty());
  REQUIRE(alone["subscribers"].size() == 1);
  CHECK(alone["subscribers"][0]["observes"] == true);
  CHECK(says(text(), "1 onlooker"));
  CHECK(!says(run_lot(on(room.options(), {"top", "--once", "--interval", "1"})).out, "/notes"));

  const auto pusher = engine.advertise<Note>("/notes");
  subscribers = topic()["subscribers"];  // it has not looked since
  REQUIRE(subscribers.size() == 1);
  CHECK(subscribers[0]["observes"] == true);
  CHECK(says(text(), "  observes\n"));
}

TEST_CASE("lot ls says that a segment stays, how many items wait there, and what to do") {
  const Watchdog watchdog(60);
  const Room room;
  lot::EngineOptions options = room.options();
  const auto ls = [&](bool json) {
    return run_lot(on(
        options, json ? std::vector<std::string>{"ls", "--json"} : std::vector<std::string>{"ls"}));
  };
  {
    lot::ShmEngine engine(options);
    CHECK(ls(true).json().at("segments").at(0).at("persist") == false);
    CHECK(!says(ls(false).out, "; persist"));
    options.persist = true;
    const lot::ShmEngine again(options);
    CHECK(ls(true).json().at("segments").at(0).at("persist") == true);
    CHECK(says(ls(false).out, "; persist\n"));
    auto jobs = engine.queue<std::uint64_t>("jobs");
    for (std::uint64_t n = 0; n < 12; ++n) CHECK(jobs.put(n) == lot::Status::Ok);
    CHECK(ls(true).exit == 0);
  }
  for (const char* command : {"ls", "top", "who"}) {
    CAPTURE(command);
    const Ran ran = run_lot(on(options, {command, "--json"}));
    CHECK(ran.exit == 1);
    REQUIRE(ran.json().at("hints").size() == 1);
    CHECK(ran.json().at("hints").at(0) ==
          "no process lives in s; 12 items wait in jobs: start a process that takes them, or drop "
          "them "
          "by `lot clean --with-items --dir " +
              room.path() + " --segment s`");
  }
  {
    lot::ShmEngine engine(options);
    auto jobs = engine.queue<std::uint64_t>("jobs");
    while (jobs.try_pop()) {
    }
  }
  CHECK(says(ls(false).out, "no process lives in s, which was to stay: `lot clean --dir " +
                                room.path() + " --segment s` removes it"));
}

/// What stands between back quotes, in the last line that has them.
std::string advised_command(const std::string& text) {
  const auto end = text.rfind('`');
  const auto begin = end == 0 || end == text.npos ? text.npos : text.rfind('`', end - 1);
  return begin == text.npos ? "" : text.substr(begin + 1, end - begin - 1);
}

TEST_CASE("the command of a hint does what it says when a shell runs it" *
          doctest::skip(!can_be_another_user())) {
  const Watchdog watchdog(60);
  const Room room;
  const auto shell = [](const std::string& command) {
    const std::string program = "lot() { " + lot::testing::command() + " \"$@\"; }; ";
    return std::system(("{ " + program + command + "; } > /dev/null").c_str());
  };
  for (const char* name : {"", "/it's two words"}) {
    const std::string directory = room.path() + name;
    std::filesystem::create_directories(directory);
    for (const auto& [group, permissions] :
         {std::pair("", 0U), std::pair("65533", 0U), std::pair("", 0666U), std::pair("", 0660U)}) {
      CAPTURE(name);
      CAPTURE(group);
      CAPTURE(permissions);
      auto options = room.options();
      options.directory = directory;
      options.group = group;
      options.permissions = permissions;
      options.persist = true;
      { const lot::ShmEngine engine(options); }
      const Variable its_group("LOT_GROUP", group);
      char octal[8];
      std::snprintf(octal, sizeof(octal), "0%o", permissions);
      const Variable its_permissions("LOT_PERMISSIONS", permissions != 0 ? octal : "");
      const std::string command = advised_command(run_lot(on(options, {"ls"})).out);
      CAPTURE(command);
      unsetenv("LOT_GROUP");
      unsetenv("LOT_PERMISSIONS");
      CHECK(says(command, "lot clean --dir"));
      CHECK(shell(command) == 0);
      CHECK(std::filesystem::is_empty(directory));
    }
  }
}

TEST_CASE("a name that no segment can have is wrong usage, and a file of such a name none of LOT") {
  const Watchdog watchdog(120);
  const Room room;
  const std::vector<std::vector<std::string>> verbs = {{"ls"},
                                                       {"top"},
                                                       {"who"},
                                                       {"clean"},
                                                       {"doctor"},
                                                       {"echo", "/a"},
                                                       {"pub", "/a", "{}"},
                                                       {"hz", "/a"},
                                                       {"bw", "/a"},
                                                       {"delay", "/a"}};
  for (const auto& verb : verbs) {
    for (const char* name : {"../../etc", "a/b", ".", "..", "", "a b", "s.lock"}) {
      CAPTURE(verb.front());
      CAPTURE(name);
      auto words = verb;
      words.insert(words.end(), {"--dir", room.path(), "--segment", name});
      const Ran ran = run_lot(words);
      CHECK(ran.exit == 2);
      CHECK_MESSAGE(says(ran.err, "not a name for a segment"), ran.err);
      CHECK(ran.out.empty());
    }
    prefix();
    const Variable variable("LOT_SEGMENT", "a/b");
    auto words = verb;
    words.insert(words.end(), {"--dir", room.path()});
    const Ran ran = run_lot(words);
    CHECK(ran.exit == (verb.front() == "doctor" ? 1 : 2));
    CHECK_MESSAGE(says(ran.out + ran.err, "a/b: not a name for a segment"), ran.err);
  }
  auto options = room.options();
  options.persist = true;
  { const lot::ShmEngine engine(options); }
  std::filesystem::rename(room.path() + "/s", room.path() + "/s (copy)");
  std::filesystem::remove(room.path() + "/s.lock");
  CHECK(says(run_lot({"ls", "--dir", room.path()}).out, "no segments in "));
  CHECK(run_lot({"clean", "--dir", room.path()}).exit == 0);
  CHECK(room.files() == 1);
}

TEST_CASE("lot who as a document has these keys") {
  const Watchdog watchdog(60);
  const Scene scene;
  const Json document = run_lot(on(scene.options, {"who", "--json"})).json();
  CHECK(keys_of(document) == std::set<std::string>{
                                 ".command",
                                 ".exit",
                                 ".hints[]",
                                 ".segments[].behind[].channel",
                                 ".segments[].behind[].depth",
                                 ".segments[].behind[].holds_back",
                                 ".segments[].behind[].joining",
                                 ".segments[].behind[].lag",
                                 ".segments[].behind[].lost",
                                 ".segments[].behind[].process",
                                 ".segments[].behind[].publisher",
                                 ".segments[].behind[].topic",
                                 ".segments[].bytes",
                                 ".segments[].condition",
                                 ".segments[].damage",
                                 ".segments[].messages[].block",
                                 ".segments[].messages[].bytes",
                                 ".segments[].messages[].generation",
                                 ".segments[].messages[].holders[].at_most_seconds",
                                 ".segments[].messages[].holders[].how",
                                 ".segments[].messages[].holders[].process",
                                 ".segments[].messages[].holders[].seconds",
                                 ".segments[].messages[].holders[].sequence",
                                 ".segments[].messages[].holders[].topic",
                                 ".segments[].messages[].made_by",
                                 ".segments[].messages[].topic",
                                 ".segments[].name",
                                 ".segments[].path",
                                 ".segments[].processes[].alive",
                                 ".segments[].processes[].index",
                                 ".segments[].processes[].name",
                                 ".segments[].processes[].pid",
                                 ".segments[].reason",
                                 ".segments[].waiting[].channel",
                                 ".segments[].waiting[].process",
                                 ".segments[].waiting[].topic",
                                 ".segments[].waiting[].waits_for[]",
                             });
}

TEST_CASE("lot clean as a document has these keys") {
  const Watchdog watchdog(60);
  const Room room;
  {
    Actor actor(room.options(), "actor");
    actor.kill9();
  }
  const Json document = run_lot(on(room.options(), {"clean", "--json"})).json();
  CHECK(keys_of(document) == std::set<std::string>{".command", ".dry_run", ".exit", ".given_back",
                                                   ".hints", ".in_use", ".left_alone", ".reaped",
                                                   ".removed[].bytes", ".removed[].files[]",
                                                   ".removed[].path", ".removed[].why"});
}

TEST_CASE("lot ls and lot who change no byte of a segment, and take no memory that is unused") {
  const Watchdog watchdog(60);
  const Scene scene;
  scene.stop_all();  // their wardens write
  const std::string path = scene.options.directory + "/" + scene.options.segment;
  struct stat before {
  }, after{};
  REQUIRE(stat(path.c_str(), &before) == 0);
  const auto bytes = bytes_of(path);
  const auto lock_bytes = bytes_of(path + ".lock");
  CHECK(run_lot(on(scene.options, {"ls"})).exit == 0);
  CHECK(run_lot(on(scene.options, {"who", "--all"})).exit == 0);
  CHECK(run_lot(on(scene.options, {"clean", "--dry-run"})).exit == 0);
  CHECK(bytes == bytes_of(path));
  CHECK(lock_bytes == bytes_of(path + ".lock"));
  REQUIRE(stat(path.c_str(), &after) == 0);
  CHECK(after.st_blocks == before.st_blocks);
  CHECK(after.st_mtim.tv_nsec == before.st_mtim.tv_nsec);
  CHECK(scene.room.files() == 2);
}

TEST_CASE("the text names the process that waits, for which one, and since when each keeps what") {
  const Watchdog watchdog(60);
  const Scene scene;
  const std::string ls = run_lot(on(scene.options, {"ls"})).out;
  CHECK(says(ls, "1 publisher"));
  CHECK(says(ls, "/parcels"));
  CHECK(says(ls, "block"));
  CHECK(says(ls, "4 of 4"));
  CHECK(says(ls, "publisher 1 publisher waits for room"));
  const std::string who = run_lot(on(scene.options, {"who"})).out;
  CHECK(says(who, "keeps"));
  CHECK(says(who, "borrows"));
  CHECK(says(who, "publisher 1 publisher on /parcels waits for room until 2 reader has read"));
}

TEST_CASE("the exit status: 0 well, 1 nothing or something wrong, 2 usage, 3 damaged") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  const auto exit_of = [&](std::vector<std::string> words) {
    return run_lot(on(options, std::move(words))).exit;
  };
  CHECK(exit_of({"ls"}) == 1);  // nothing there
  CHECK(exit_of({"who"}) == 1);
  CHECK(exit_of({"clean"}) == 0);
  CHECK(run_lot({"ls", "--dir", room.path() + "/none"}).exit == 1);
  CHECK(run_lot({}).exit == 2);
  const Ran unknown = run_lot({"fly", "--json"});
  CHECK(unknown.exit == 2);
  CHECK(says(unknown.err, "not expected: fly"));
  CHECK(run_lot({"ls", "--interval", "soon"}).exit == 2);
  CHECK(run_lot({"--help"}).exit == 0);
  CHECK(run_lot({"--version"}).exit == 0);
  CHECK(says(run_lot({"--version"}).out, "layout " + std::to_string(lot::segment::kLayoutVersion)));
  {
    Actor actor(options, "actor");
    CHECK(exit_of({"ls"}) == 0);
    CHECK(exit_of({"who"}) == 0);
    CHECK(exit_of({"clean"}) == 0);
    actor.kill9();
  }
  CHECK(exit_of({"ls"}) == 1);
  CHECK(exit_of({"who"}) == 1);
  const int file = open((options.directory + "/" + options.segment).c_str(), O_RDWR);
  REQUIRE(file != -1);
  const std::uint32_t other = 999;
  REQUIRE(pwrite(file, &other, sizeof(other), 8) == sizeof(other));
  close(file);
  CHECK(exit_of({"ls"}) == 3);
  CHECK(says(run_lot(on(options, {"ls"})).out, "layout version 999"));
  CHECK(exit_of({"clean"}) == 0);
  CHECK(room.files() == 0);
}

TEST_CASE("all segments of a directory are listed, and nothing else") {
  const Watchdog watchdog(60);
  const Room room;
  const Actor one(room.options("one"), "first");
  const Actor two(room.options("two"), "second");
  std::ofstream(room.path() + "/text") << "LOTSHM is not how this begins";
  std::filesystem::create_directory(room.path() + "/directory");
  REQUIRE(mkfifo((room.path() + "/fifo").c_str(), 0600) == 0);
  std::filesystem::create_symlink("one", room.path() + "/link");
  const Json document = run_lot({"ls", "--json", "--dir", room.path()}).json();
  REQUIRE(document.at("segments").size() == 2);
  CHECK(document.at("segments").at(0).at("name") == "one");
  CHECK(document.at("segments").at(1).at("name") == "two");
  CHECK(document.at("exit") == 0);
}

TEST_CASE("lot ls, top, who and clean say what lies in the place of a segment or its lock file") {
  const Watchdog watchdog(60);
  for (const char* name : {"s", "LOTROS"}) {
    for (const std::string suffix : {"", ".lock"}) {
      CAPTURE(name);
      CAPTURE(suffix);
      const Room room;
      const std::string path = room.path() + "/" + name + suffix;
      const auto check = [&](const std::string& what, int error) {
        for (const char* command : {"ls", "top", "who", "clean"}) {
          CAPTURE(command);
          const Ran ran = run_lot(on(room.options(name), {command}));
          CHECK(ran.exit == 1);
          CHECK_MESSAGE(says(ran.out, path + ": it is " + what), ran.out);
          CHECK(says(ran.out, "remove it if it is yours"));
          const Ran of_all = run_lot({command, "--dir", room.path()});
          CHECK(says(of_all.out, what) == (std::string(name) == "LOTROS"));
        }
        const auto [number, text] =
            error_of([&] { const lot::ShmEngine engine(room.options(name)); });
        CHECK(number == error);
        CHECK_MESSAGE(says(text, path), text);
        CHECK_MESSAGE(says(text, "remove it if it is yours"), text);
        if (what[2] != 'f') CHECK_MESSAGE(says(text, "it is " + what + ", no file of LOT"), text);
        CHECK(room.files() == 1);
        std::filesystem::remove(path);
      };
      REQUIRE(mkfifo(path.c_str(), 0600) == 0);
      check("a FIFO", EINVAL);
      REQUIRE(mkdir(path.c_str(), 0700) == 0);
      check("a directory", EISDIR);
      REQUIRE(symlink("/etc/passwd", path.c_str()) == 0);
      check("a symbolic link", ELOOP);
      std::ofstream(path) << "mine!\n";
      REQUIRE(chmod(path.c_str(), 0600) == 0);
      check(suffix.empty() ? "a file of 6 bytes, and no segment"
                           : "a file of 6 bytes, and no lock file",
            EINVAL);
      CHECK(room.files() == 0);
    }
  }
}

TEST_CASE("lot ls, top, who and clean say what keeps a new segment from being made") {
  const Watchdog watchdog(60);
  const Room room;
  const std::string path = room.path() + "/s.new";
  const auto check = [&](const std::string& what) {
    for (const char* command : {"ls", "top", "who", "clean"}) {
      const Ran ran = run_lot(on(room.options("s"), {command}));
      CHECK(ran.exit == 1);
      CHECK_MESSAGE(says(ran.out, path + ": it " + what), ran.out);
    }
    CHECK(error_of([&] { const lot::ShmEngine engine(room.options("s")); }).first == EEXIST);
    std::filesystem::remove(path);
    std::filesystem::remove(room.path() + "/s.lock");
  };
  REQUIRE(mkdir(path.c_str(), 0700) == 0);
  check("is a directory");
  if (!can_be_another_user()) return;
  std::ofstream(path) << "not yours";
  REQUIRE(chown(path.c_str(), 65532, 65532) == 0);
  check("belongs to uid 65532");
}

TEST_CASE("a process that is stopped where other processes must pass is named, and what to do") {
  const Watchdog watchdog(60);
  const Room room;
  const Steps inside;
  const auto is_named = [&](const Child& child, const std::string& where) {
    stop(child);
    const std::string pid = std::to_string(child.pid());
    for (const char* command : {"ls", "top", "who"}) {
      CAPTURE(command);
      const Ran ran = run_lot(on(room.options(), {command}));
      CHECK(ran.exit == 1);
      CHECK_MESSAGE(says(ran.out, "process " + pid + " ("), ran.out);
      CHECK_MESSAGE(says(ran.out, "is stopped while it " + where + " " + room.path() + "/s"),
                    ran.out);
      CHECK_MESSAGE(says(ran.out, "kill -CONT " + pid), ran.out);
    }
    child.send(SIGCONT);
  };
  const auto in_gate = [&] {
    lot::liveness::LockFile file(room.path() + "/s.lock");
    must(file.enter_gate(5s), "the gate");
    inside.tell();
    pause();
  };
  {
    Child alone(in_gate);  // there is no segment yet
    REQUIRE(inside.next() == '.');
    is_named(alone, "opens or closes");
  }
  const lot::ShmEngine engine(room.options());
  CHECK(run_lot(on(room.options(), {"ls"})).exit == 0);
  {
    Child beside(in_gate);
    REQUIRE(inside.next() == '.');
    is_named(beside, "opens or closes");
  }
  Child in_registry([&] {
    const lot::ShmEngine mine(room.options());
    const lot::segment::Segment s(mine.path());
    RegistryLock lock(s);
    must(lock.lock(), "the registry");
    inside.tell();
    pause();
  });
  REQUIRE(inside.next() == '.');
  is_named(in_registry, "has the registry's lock of");
}

TEST_CASE("what can not be read is told with its path and the system's words once") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  const lot::ShmEngine engine(options);
  const std::string path = options.directory + "/" + options.segment;
  REQUIRE(chmod(path.c_str(), 0666) == 0);  // open to too many
  const auto count = [](const std::string& text, const std::string& what) {
    std::size_t n = 0;
    for (auto at = text.find(what); at != text.npos; at = text.find(what, at + 1)) ++n;
    return n;
  };
  const std::string kReason = "Operation not permitted";
  const Ran ls = run_lot(on(options, {"ls"}));
  CAPTURE(ls.out);
  CHECK(ls.exit == 1);
  CHECK(says(ls.out, "s  " + path + "\n  not trusted: "));
  CHECK(count(ls.out, path) == 1);
  CHECK(count(ls.out, kReason) == 1);
  const Ran echo = run_lot(on(options, {"echo", kLetters, "--timeout", "0"}));
  CAPTURE(echo.err);
  CHECK(echo.exit == 1);
  CHECK(echo.err.starts_with("lot: " + path + ": "));
  CHECK(count(echo.err, path) == 1);
  CHECK(count(echo.err, kReason) == 1);
}

TEST_CASE("an unknown command is told which ones there are") {
  const Ran ran = run_lot({"foo"});
  CHECK(ran.exit == 2);
  CHECK(says(ran.err, "foo"));
  CHECK(says(ran.err,
             "The commands are: ls top who echo pub hz bw delay record info play clean doctor\n"));
}

TEST_CASE("a segment that is left while lot ls looks at it is not there") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  std::optional<lot::ShmEngine> engine(options);
  std::optional pusher(engine->advertise<Letter>(kLetters));
  Running ls(on(options, {"ls", "--interval", "2000"}));
  const std::string path = options.directory + "/" + options.segment;
  const std::string maps = "/proc/" + std::to_string(ls.child().pid()) + "/maps";
  REQUIRE(eventually([&] { return says(bytes_of(maps), path); }));
  // Between its two looks, however long it takes to leave.
  REQUIRE(kill(ls.child().pid(), SIGSTOP) == 0);
  pusher.reset();
  engine.reset();
  REQUIRE(kill(ls.child().pid(), SIGCONT) == 0);
  const Ran ran = ls.finish();
  CHECK(ran.exit == 1);
  CHECK(ran.out == "no segment " + path + "\n");
  CHECK(ran.err.empty());
}

TEST_CASE("names that would steer a terminal are printed harmless, and whole as a document") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.name = "a\033[2Jb\xff";
  const std::string topic = "/t\n\033]0;x\a";
  Steps ready;
  Child child([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Letter>(topic);
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() == '.');
  const Ran text = run_lot(on(options, {"ls"}));
  CHECK(text.exit == 0);
  CHECK(!says(text.out, "\033"));
  CHECK(!says(text.out, "\a"));
  CHECK(says(text.out, "a?[2Jb?"));
  const Json document = run_lot(on(options, {"ls", "--json"})).json();
  CHECK(document.at("segments").at(0).at("topics").at(0).at("name") == topic);
}

TEST_CASE("a queue whose items are taken: the process that has one, and those that wait") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  Steps ready;
  Steps go;
  Child child([&] {
    lot::ShmEngine engine(options);
    lot::QueueOptions how;
    how.depth = 3;
    auto queue = engine.queue<lot::ShmUniquePtr<Parcel>>("/queue", how);
    for (int n = 0; n < 3; ++n) must(queue.try_put(queue.make()) == lot::Status::Ok, "put");
    must(queue.try_put(queue.make()) == lot::Status::Full, "full");
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() == '.');
  Child taker([&] {
    lot::ShmEngine engine(options);
    lot::QueueOptions how;
    how.depth = 3;
    auto queue = engine.queue<lot::ShmUniquePtr<Parcel>>("/queue", how);
    queue.listen();
    ready.tell();
    must(go.next() != 0, "go");
    const auto item = queue.try_pop();
    must(item.has_value(), "an item");
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() == '.');
  const auto publisher = [&] {
    const Json document = run_lot(on(options, {"ls", "--json", "--interval", "1"})).json();
    return document.at("segments").at(0).at("topics").at(0).at("publishers").at(0);
  };
  const auto who = [&] {
    return run_lot(on(options, {"who", "--json"})).json().at("segments").at(0);
  };
  CHECK(publisher().at("to") == "one");
  CHECK(publisher().at("held") == 3);
  CHECK(who().at("messages").empty());
  go.tell();
  REQUIRE(ready.next() == '.');
  CHECK(publisher().at("held") == 2);
  const Json seen = who();
  REQUIRE(seen.at("messages").size() == 1);
  CHECK(seen.at("messages").at(0).at("made_by") == 1);
  CHECK(seen.at("messages").at(0).at("holders").size() == 1);
  CHECK(seen.at("messages").at(0).at("holders").at(0).at("process") == 2);
  CHECK(seen.at("messages").at(0).at("holders").at(0).at("how") == "keeps");
}

TEST_CASE("a process that puts into a full queue waits for any of those that take from it") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  lot::QueueOptions how;
  how.depth = 3;
  lot::ShmEngine engine(options);
  auto taken = engine.queue<lot::ShmUniquePtr<Parcel>>("/queue", how);
  taken.listen();
  Child putter([&] {
    lot::ShmEngine mine(options);
    auto queue = mine.queue<lot::ShmUniquePtr<Parcel>>("/queue", how);
    for (;;) (void)queue.put(queue.make());
  });
  Json waiting;
  REQUIRE(eventually([&] {
    const Json document = run_lot(on(options, {"who", "--json"})).json();
    waiting = document.at("segments").at(0).value("waiting", Json::array());
    return !waiting.empty();
  }));
  REQUIRE(waiting.size() == 1);
  CHECK(waiting.at(0).at("process") == 2);
  CHECK(waiting.at(0).at("topic") == "/queue");
  CHECK(waiting.at(0).at("waits_for") == Json::array({1}));
  const Json document = run_lot(on(options, {"ls", "--json", "--interval", "1"})).json();
  const Json& processes = document.at("segments").at(0).at("processes");
  REQUIRE(processes.size() == 2);
  CHECK(processes.at(0).at("bytes") == 0);  // it has made no message
  CHECK(processes.at(1).at("bytes") >= 4 * sizeof(Parcel));
}

TEST_CASE("a message that another one refers to has its maker for a holder") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  lot::ShmEngine engine(options);
  Steps ready;
  Child child([&] {
    lot::ShmEngine mine(options);
    auto letters = mine.subscribe<Letter>("/others");
    auto out = mine.advertise<Refers>("/refers");
    ready.tell();
    auto message = out.loan();
    message->to = letters.pull();
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() == '.');
  auto pusher = engine.advertise<Letter>("/others");
  must_go(pusher.push(pusher.loan()));
  REQUIRE(ready.next() == '.');
  const Json seen = run_lot(on(options, {"who", "--json"})).json().at("segments").at(0);
  std::set<std::string> how;
  for (const auto& message : seen.at("messages")) {
    for (const auto& holder : message.at("holders")) {
      if (holder.at("process") == 2) how.insert(holder.at("how"));
    }
  }
  CHECK(how.count("refers") == 1);
}

TEST_CASE("what waits in a queue is seen when its putter has gone, and what is unfinished") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  lot::ShmEngine engine(options);
  lot::QueueOptions how;
  how.redeliver = true;
  for (unsigned n = 0; n < 3; ++n) {  // by handles that go at once
    auto queue = engine.queue<std::uint64_t>("/tasks", how);
    CHECK(queue.put(n) == lot::Status::Ok);
  }
  const auto queues = [&] {
    const Json document = run_lot(on(options, {"ls", "--json", "--interval", "1"})).json();
    const Json& topics = document.at("segments").at(0).at("topics");
    return topics.empty() ? Json::array() : topics.at(0).at("publishers");
  };
  Json seen = queues();
  REQUIRE(seen.size() == 3);
  for (const Json& queue : seen) {
    CHECK(queue.at("gone") == true);
    CHECK(queue.at("held") == 1);
    CHECK(queue.at("unfinished") == 0);
  }
  auto queue = engine.queue<std::uint64_t>("/tasks", how);
  auto task = queue.try_take();
  REQUIRE(task);
  // People see the three as one row, and their worker once.
  const auto count = [](const std::string& text, const char* part) {
    std::size_t n = 0;
    for (auto at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
    return n;
  };
  const std::string ls = run_lot(on(options, {"ls", "--interval", "1"})).out;
  CAPTURE(ls);
  CHECK(count(ls, "publisher   (3 gone)") == 1);
  CHECK(count(ls, "(gone)") == 0);
  CHECK(says(ls, "3 of 192"));
  CHECK(says(ls, "1 unfinished"));
  CHECK(count(ls, "subscriber") == 1);
  const std::string who = run_lot(on(options, {"who"})).out;
  CAPTURE(who);
  CHECK(count(who, "/tasks  (3 gone)   2 of 192") == 1);
  seen = queues();
  REQUIRE(seen.size() == 3);
  std::size_t unfinished = 0;
  for (const Json& each : seen) {
    CHECK(each.at("held") == 1);
    unfinished += each.at("unfinished").get<std::size_t>();
  }
  CHECK(unfinished == 1);
  task.finish();
  while (auto next = queue.try_take()) next.finish();
  CHECK(eventually([&] { return queues().empty(); }));
}

TEST_CASE("lot ls tells the rate of a publisher, and of a slow one no more than it has seen") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  Steps ready;
  Steps halt;
  Child child([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Letter>(kLetters);
    ready.tell();
    while (halt.next(1ms) == '\0') must_go(pusher.push(pusher.loan()));
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() == '.');
  const auto publisher = [&](const char* interval) {
    const Json document = run_lot(on(options, {"ls", "--json", "--interval", interval})).json();
    return document.at("segments").at(0).at("topics").at(0).at("publishers").at(0);
  };
  Json fast;
  REQUIRE(eventually([&] { return !(fast = publisher("100")).at("per_second").is_null(); }));
  CHECK(fast.at("per_second").get<double>() > 0);
  CHECK(fast.at("per_second").get<double>() < 1100);
  CHECK(fast.at("per_second_below").is_null());
  halt.tell();
  REQUIRE(ready.next() == '.');
  for (const char* interval : {"1", "40"}) {
    CAPTURE(interval);
    const Json slow = publisher(interval);
    CHECK(slow.at("per_second").is_null());
    CHECK(slow.at("arrived") == 0);
    CHECK(slow.at("arrived_seconds").get<double>() > 0);
    CHECK(slow.at("per_second_below").get<double>() * slow.at("arrived_seconds").get<double>() ==
          doctest::Approx(1));
  }
  CHECK(says(run_lot(on(options, {"ls", "--interval", "40"})).out, "  < "));
}

TEST_CASE("a segment at full speed, with queues that come and go, is never called damaged") {
  const Watchdog watchdog(120);
  const Room room;
  const auto options = room.options();
  Steps ready;
  const auto work = [&](unsigned which) {
    lot::ShmEngine engine(options);
    ready.tell();
    for (unsigned round = 0;; ++round) {
      const bool blocks = (round + which) % 2 != 0;
      auto pusher = engine.advertise<Parcel>(
          kParcels, {blocks ? lot::Policy::Block : lot::Policy::Overwrite, kDepth, 1ms});
      auto puller = engine.subscribe<Parcel>(kParcels);
      std::vector<lot::ShmSharedPtr<const Parcel>> kept;
      for (unsigned n = 0; n < 200; ++n) {
        (void)pusher.push(pusher.loan());  // Full as well
        if (n % 3 == 0) kept.push_back(puller.try_pull());
        if (n % 50 == 0) kept.clear();
      }
    }
  };
  std::vector<Child> children;
  for (unsigned n = 0; n < 3; ++n) children.emplace_back([&, n] { work(n); });
  for (unsigned n = 0; n < 3; ++n) REQUIRE(ready.next() == '.');
  for (unsigned n = 0; n < 60; ++n) {
    for (const auto& words : {std::vector<std::string>{"ls", "--json", "--interval", "1"},
                              std::vector<std::string>{"top", "--json", "--interval", "1"},
                              std::vector<std::string>{"who", "--all", "--json"}}) {
      const Ran ran = run_lot(on(options, words));
      CHECK(ran.exit == 0);
      CHECK(ran.json().at("segments").at(0).at("damage").empty());
    }
  }
}

TEST_SUITE_END();
