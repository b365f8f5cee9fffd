// SPDX-License-Identifier: Apache-2.0

// lot record, lot info, lot play: what they print, write and publish, and how they end.

#include <chrono>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <iterator>
#include <string>
#include <thread>
#include <unistd.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>
#include <lot/recording.hpp>

#include "mcap/reader.hpp"
#include "stage.hpp"
#include "support/janitor.hpp"
#include "support/users.hpp"
#include "terminal.hpp"

namespace {

using namespace lot::testing;
namespace mcap = lot::mcap;

[[maybe_unused]] const bool has_janitor = start_janitor();

bool says(const std::string& text, const std::string& what) {
  return text.find(what) != std::string::npos;
}

struct Other {
  std::uint64_t count = 0;
};
/// With a message of its own behind it, which no file of one topic can have.
struct Pointer {
  lot::ShmRef<const Other> to;
};

TEST_SUITE_BEGIN("record");

TEST_CASE("lot record writes what comes until Ctrl-C, and says what it was") {
  const Watchdog watchdog(120);
  Stage stage;
  const Ran ran = stage.record_ten();
  CHECK(ran.exit == 0);
  CHECK(ran.out.find("/pose") != std::string::npos);
  CHECK(ran.out.find("10") != std::string::npos);
  CHECK(payloads(stage.file()).size() == 10);
}

TEST_CASE("lot record waits for a segment, and for topics") {
  const Watchdog watchdog(120);
  const Room room;
  const Directory directory;
  const lot::EngineOptions options = room.options();
  Running recorder(on(options, {"record", "--all", "-o", directory.file()}));
  REQUIRE(recorder.says("waiting"));
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Pose>("/pose");
  put(pusher, 1);
  std::this_thread::sleep_for(300ms);
  const Ran ran = recorder.interrupt();
  CHECK(ran.exit == 0);
  CHECK(payloads(directory.file()).size() == 1);
}

TEST_CASE("lot record says what is wrong: no topics, a file that is there, nothing that came") {
  const Watchdog watchdog(120);
  Stage stage;
  CHECK(run_lot(stage.record({})).exit == 2);
  CHECK(run_lot(stage.record({"--all", "/pose"})).exit == 2);
  CHECK(run_lot(stage.record({"--all", "--after", "1"})).exit == 2);
  CHECK(run_lot(stage.record({"--all", "--compression", "rar"})).exit == 2);
  write_file(stage.file(), "mine");
  const Ran ran = run_lot(stage.record({"--all"}));
  CHECK(ran.exit == 1);
  CHECK(ran.err.find("never overwritten") != std::string::npos);
  CHECK(read_file(stage.file()) == "mine");
  std::filesystem::remove(stage.file());
  const Ran nothing = run_lot(stage.record({"--all", "--duration", "0.2"}));
  CHECK(nothing.exit == 1);
  CHECK(nothing.out.find("nothing was recorded") != std::string::npos);
}

TEST_CASE("lot record says which topics are not there and which are, and leaves no empty file") {
  const Watchdog watchdog(120);
  Stage stage;
  const auto pusher = stage.engine.advertise<Pose>("/pose");
  Running recorder(stage.record({"/psoe"}));
  REQUIRE(recorder.says("* no topic is called /psoe; there is /pose: waiting"));
  const Ran ran = recorder.interrupt();
  CHECK(ran.exit == 1);
  CHECK(ran.out.find("nothing was recorded") != std::string::npos);
  CHECK(ran.out.find("* no topic is called /psoe; there is /pose\n") != std::string::npos);
  CHECK(ran.out.find("was removed") != std::string::npos);
  CHECK_FALSE(std::filesystem::exists(stage.file()));
  CHECK(stage.record_ten().exit == 0);  // into the same file
}

TEST_CASE("lot record of several topics says which one never came: a name ends it with 1") {
  const Watchdog watchdog(200);
  const struct {
    std::vector<std::string> words;
    int exit;
    std::string says;
  } parts[] = {{{"/psoe"}, 1, "no topic is called /psoe; there is /pose"},
               {{"pose"}, 1, "no topic is called pose; there is /pose"},
               {{"/none*"}, 0, "no topic fits /none*; there is /pose"},
               {{"po*"}, 0, "no topic fits po*; /po* fits /pose"},
               {{"/po["}, 0, "no topic fits /po[; its [ has no ]"},
               {{"/po\\"}, 0, "it ends with a backslash"},
               {{"--except", "/psoe"}, 0, "--except: no topic is called /psoe; there is /pose"},
               {{"--last", "9", "--trigger", "/fault"}, 0, "--trigger: no topic is called /fault"}};
  for (const auto& [words, exit, says] : parts) {
    CAPTURE(words);
    Stage stage;
    auto pusher = stage.engine.advertise<Pose>("/pose");
    put(pusher, 1);
    std::vector<std::string> all = words;
    all.insert(all.end(), {"/pose", "--duration", "1.5"});
    const Ran ran = run_lot(stage.record(all));
    CHECK(ran.exit == exit);
    CHECK(ran.err.find(says) != std::string::npos);
    CHECK(ran.out.find(says) != std::string::npos);
  }
}

TEST_CASE("lot record says for which segment or directory it waits") {
  const Watchdog watchdog(120);
  const Stage stage;
  const auto record = [&](const std::string& directory, const std::string& segment) {
    std::vector<std::string> words = {"record", "--all",      "--json", "--duration", "0.3",
                                      "-o",     stage.file(), "--dir",  directory};
    if (!segment.empty()) words.insert(words.end(), {"--segment", segment});
    return run_lot(std::move(words));
  };
  const Ran no_directory = record(stage.directory.file("none"), "");
  CHECK(no_directory.err.find("there is no directory " + stage.directory.file("none")) !=
        std::string::npos);
  CHECK(no_directory.exit == 1);
  CHECK(no_directory.json().at("files").empty());
  CHECK(no_directory.json().at("unmatched").at(0) == "*");
  const Ran other = record(stage.options.directory, "other");
  CHECK(other.err.find("there is no segment other in ") != std::string::npos);
  CHECK(other.err.find("; there is " + stage.options.segment) != std::string::npos);
  const Room empty;
  CHECK(record(empty.path(), "").err.find("there is no segment in ") != std::string::npos);
}

TEST_CASE("lot record says why its file cannot be made") {
  const Watchdog watchdog(120);
  const Stage stage;
  const auto record = [&](const std::string& file) {
    return run_lot(on(stage.options, {"record", "--all", "-o", file})).err;
  };
  CHECK(record(stage.directory.file("")).find("it is a directory") != std::string::npos);
  CHECK(record(stage.directory.file("none/a")).find("make its directory") != std::string::npos);
  CHECK(record("/proc/a.mcap").find("takes no new files") != std::string::npos);
  std::filesystem::create_symlink(stage.directory.file("none"), stage.file());
  CHECK(record(stage.file()).find("a symbolic link that leads nowhere") != std::string::npos);
  CHECK(record("").find("a file has a name") != std::string::npos);
  CHECK(record("-").find("a recording is no stream") != std::string::npos);
}

TEST_CASE("lot record --last says at its begin why no file can be made, and leaves none there") {
  const Watchdog watchdog(120);
  Stage stage;
  for (const std::string& file : {stage.directory.file("none/a"), std::string("/proc/a.mcap")}) {
    CAPTURE(file);
    const std::vector<std::string> words =
        on(stage.options, {"record", "--all", "--json", "-o", file});
    std::vector<std::string> keeps = words;
    keeps.insert(keeps.end(), {"--last", "5"});
    const Ran kept = run_lot(keeps);
    CHECK(kept.exit == 1);
    CHECK(kept.json().at("exit") == 1);
    CHECK(kept.json().at("hints").size() == 1);
    if (file.starts_with("/tmp")) CHECK(says(kept.err, "make its directory first"));
    CHECK_FALSE(says(kept.out, "no trigger came"));
  }
  Running recorder(stage.record({"/pose", "--last", "1000"}));
  REQUIRE(recorder.says("keeps the last"));
  CHECK(std::filesystem::is_empty(stage.directory.file("")));
  CHECK(recorder.interrupt().exit == 1);
}

TEST_CASE("lot record --last does not say that no trigger came where its file was not made") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  const std::string room = stage.directory.file("room");
  std::filesystem::create_directory(room);
  Running recorder(
      on(stage.options, {"record", "/pose", "--last", "1000", "-o", room + "/a.mcap"}));
  REQUIRE(recorder.says("keeps the last"));
  put(pusher, 1);
  std::filesystem::remove_all(room);
  REQUIRE(eventually([&] {
    recorder.child().send(SIGUSR1);
    return says(recorder.err(), "make its directory first");
  }));
  const Ran ran = recorder.interrupt();
  CHECK(ran.exit == 1);
  CHECK_FALSE(says(ran.out, "no trigger came"));
  CHECK(says(ran.out, "a trigger came, and its file could not be written"));
  // The line of the moment is the one of the end.
  CHECK(says(ran.out, room + "/a_0.mcap: cannot open the file to write it"));
  CHECK(says(ran.err, room + "/a_0.mcap: cannot open the file to write it"));
}

TEST_CASE("lot record --last says once how little of the time fits in --memory") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  const std::string memory = "0.00390625";  // 4096 bytes
  Running recorder(stage.record({"/pose", "--last", "1000", "--memory", memory, "--json"}));
  REQUIRE(recorder.says("keeps the last"));
  while (!says(recorder.err(), "* of the last 1000 s only ")) {
    put(pusher, 1);
    std::this_thread::sleep_for(1ms);
  }
  const Ran ran = recorder.interrupt();
  const std::string end = " fit in --memory " + memory;
  CHECK(says(ran.err, end + "\n"));
  CHECK(ran.err.find(end) == ran.err.rfind(end));
  const std::string hints = ran.json().at("hints").dump();
  CHECK(says(hints, end + ": "));
  CHECK(says(hints, " went before the time was over"));
}

TEST_CASE("SIGUSR1 does not end a lot record without --last") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  Running recorder(stage.record({"/pose"}));
  REQUIRE(recorder.says("writes"));
  put(pusher, 1);
  recorder.child().send(SIGUSR1);
  REQUIRE(recorder.says("* SIGUSR1 is a trigger with --last alone"));
  CHECK(recorder.interrupt().exit == 0);
  CHECK(payloads(stage.file()).size() == 1);
}

TEST_CASE("lot record without a file's name takes the next one where another takes it") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  put(pusher, 1);
  std::string command =
      "cd '" + stage.directory.file("") + "'; for i in 1 2 3; do " + lot::testing::command();
  for (const std::string& word : on(stage.options, {"record", "/pose", "--duration", "0.5"})) {
    command += " '" + word + "'";
  }
  const Ran ran = run_program({"sh", "-c", command + " & done; wait"});
  CHECK_FALSE(says(ran.err, "never overwritten"));
  const std::filesystem::directory_iterator all(stage.directory.file(""));
  CHECK(std::distance(begin(all), end(all)) == 3);
}

// ---- what lies beside the segment
// ------------------------------------------------------------------

/// A file that lot cannot look into: it begins as a segment does.
void make_damaged(const std::string& path) {
  write_file(path, "LOTSHM\r\n" + std::string(8184, 'x'));
  std::filesystem::permissions(path, std::filesystem::perms(0600));
}
std::vector<std::string> in(const std::string& directory, std::vector<std::string> words) {
  words.insert(words.end(), {"--dir", directory});
  return words;
}

TEST_CASE("lot record says which segments it cannot look into beside the one that it records") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  put(pusher, 1);
  const std::string damaged = stage.room.path() + "/damaged";
  make_damaged(damaged);
  std::string stranger;
  if (can_be_another_user()) {
    stranger = stage.room.path() + "/stranger";
    auto options = stage.room.options("stranger");
    options.permissions = 0660;
    options.persist = true;
    { const lot::ShmEngine engine(options); }
    for (const char* suffix : {"", ".lock"}) {
      REQUIRE(chown((stranger + suffix).c_str(), kBob, kOtherGroup) == 0);
    }
  }
  const Ran ran = run_lot(in(
      stage.room.path(), {"record", "--all", "--json", "--duration", "0.5", "-o", stage.file()}));
  CHECK(ran.exit == 0);
  CHECK(ran.json().at("segments") == Json::array({stage.options.segment}));
  const std::string hints = ran.json().at("hints").dump();
  for (const std::string& text : {ran.err, hints}) {
    CHECK(says(text, damaged + ": damaged: "));
    if (stranger.empty()) continue;
    CHECK(says(text, stranger + ": not trusted: "));
    CHECK(says(text, "it belongs to uid 65532"));  // and no part is cut
    CHECK(says(text, "if you trust its users, set LOT_GROUP=65530; else have it removed"));
    CHECK(says(text, "for a segment of your own set LOT_SEGMENT or LOT_DIR"));
  }
  CHECK(ran.err.find(damaged) == ran.err.rfind(damaged));  // it is said once
  const Ran alone = run_lot(on(stage.options, {"record", "/pose", "--duration", "0.3", "-o",
                                               stage.directory.file("b.mcap")}));
  CHECK(says(alone.out, "  segment " + stage.engine.path() + "\n"));
  CHECK_FALSE(says(alone.err, damaged));  // the user has named one
}

TEST_CASE("lot record says that another segment has come, and is not recorded") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  Running recorder(in(stage.room.path(), {"record", "--all", "--json", "-o", stage.file()}));
  REQUIRE(recorder.says("writes"));
  put(pusher, 1);
  const lot::ShmEngine later(stage.room.options("later"));
  REQUIRE(recorder.says("* " + later.path() +
                        " is there, too, and is not recorded: `lot record --segment later`"));
  const Ran ran = recorder.interrupt();
  CHECK(ran.exit == 0);
  CHECK(ran.err.find(later.path()) == ran.err.rfind(later.path()));
  CHECK(says(ran.json().at("hints").dump(), later.path()));
}

TEST_CASE("lot record that waits says why it cannot look into a segment that comes") {
  const Watchdog watchdog(120);
  for (const bool is_named : {false, true}) {
    CAPTURE(is_named);
    const Room room;
    const Directory directory;
    std::vector<std::string> words = in(room.path(), {"record", "--all", "-o", directory.file()});
    if (is_named) words.insert(words.end(), {"--segment", "s"});
    Running recorder(words);
    REQUIRE(recorder.says(": waiting (Ctrl-C ends)"));
    const std::string path = room.path() + "/s";
    make_damaged(path + "_");
    std::filesystem::rename(path + "_", path);
    REQUIRE(recorder.says("* " + path + ": damaged: "));
    const Ran ran = recorder.interrupt();
    CHECK(ran.exit == 1);
    CHECK(says(ran.out, "* " + path + ": damaged: "));
    CHECK_FALSE(says(ran.out, "there is no segment"));
    const Ran again = run_lot([&] {  // it is there at the begin
      std::vector<std::string> all = words;
      all.insert(all.end(), {"--duration", "0.3", "--json"});
      return all;
    }());
    CHECK(again.exit == 1);
    CHECK(again.json().at("exit") == 1);
    CHECK(says(again.err, "* " + path + ": damaged: "));
    CHECK(says(again.json().at("hints").dump(), path + ": damaged: "));
  }
}

TEST_CASE("lot record of a segment that is there and is not trusted: named it ends, else it waits" *
          doctest::skip(!can_be_another_user())) {
  const Watchdog watchdog(120);
  const Room room;
  const Directory directory;
  auto options = room.options();
  options.permissions = 0660;
  options.persist = true;
  { const lot::ShmEngine engine(options); }
  const std::string path = room.path() + "/s";
  for (const char* suffix : {"", ".lock"}) {
    REQUIRE(chown((path + suffix).c_str(), kBob, kOtherGroup) == 0);
  }
  std::vector<std::string> words =
      in(room.path(), {"record", "--all", "--json", "--duration", "0.3", "-o", directory.file()});
  for (const bool is_named : {false, true}) {
    CAPTURE(is_named);
    if (is_named) words.insert(words.end(), {"--segment", "s"});
    const Ran ran = run_lot(words);
    CHECK(ran.exit == 1);
    CHECK(ran.json().at("exit") == 1);
    CHECK(ran.json().at("segments").empty());
    CHECK(says(ran.err, ": waiting (Ctrl-C ends)") == !is_named);
    for (const std::string& text : {ran.err, ran.json().at("hints").dump()}) {
      CHECK(says(text, "it belongs to uid 65532"));
      CHECK(says(text, "if you trust its users, set LOT_GROUP=65530"));
    }
  }
}

TEST_CASE("lot record names each file of a split, also the last one") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  Running recorder(stage.record({"/pose", "--split-time", "0.001", "--json"}));
  REQUIRE(recorder.says("writes"));
  for (int i = 0; i < 20; ++i) {
    put(pusher, i);
    std::this_thread::sleep_for(5ms);
  }
  const Ran ran = recorder.interrupt();
  const Json json = ran.json();
  CHECK(json.at("files").size() > 2);
  for (const Json& file : json.at("files")) {
    CHECK(ran.err.find("* writes " + file.get<std::string>() + "\n") != std::string::npos);
  }
}

TEST_CASE("lot record --max-rate and lot info say what was left out, in a column of its own") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  Running recorder(stage.record({"/pose", "--max-rate", "0.001"}));
  REQUIRE(recorder.says("writes"));
  for (int i = 0; i < 10; ++i) put(pusher, i);
  const Ran ran = recorder.interrupt();
  CHECK(ran.out.find("LEFT OUT") != std::string::npos);
  CHECK(run_lot({"info", stage.file()}).out.find("LEFT OUT") != std::string::npos);
}

TEST_CASE("lot record --last without a trigger says what it kept, and ends with 0 by SIGTERM") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  Running recorder(stage.record({"/pose", "--last", "1000"}));
  REQUIRE(recorder.says("keeps the last"));
  for (int i = 0; i < 10; ++i) put(pusher, i);
  recorder.child().send(SIGTERM);
  const Ran ran = recorder.finish();
  CHECK(ran.exit == 0);
  CHECK(ran.out.find("no trigger came: 10 messages") != std::string::npos);
  CHECK(ran.err.find("held") == std::string::npos);  // no terminal, no line that is renewed
}

TEST_CASE("lot record names topics that it cannot record, and fails where one was asked for") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  auto pointers = stage.engine.advertise<Pointer>("/pointer");
  for (const bool is_named : {false, true}) {
    const std::string file = stage.file() + (is_named ? ".named" : ".all");
    const std::vector<std::string> topics = is_named ? std::vector<std::string>{"/pose", "/pointer"}
                                                     : std::vector<std::string>{"--all"};
    std::vector<std::string> words = {"record", "-o", file};
    words.insert(words.end(), topics.begin(), topics.end());
    Running recorder(on(stage.options, words));
    REQUIRE(recorder.says("/pointer is left out"));
    REQUIRE(recorder.says("writes"));
    put(pusher, 1);
    const Ran ran = recorder.interrupt();
    CHECK(ran.exit == (is_named ? 1 : 0));
    CHECK(says(ran.out, "/pointer is left out: "));
    CHECK(!payloads(file).empty());
  }
}

TEST_CASE("lot record on a terminal has a line that says how it goes") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  std::string command = lot::testing::command();
  for (const std::string& word : stage.record({"/pose"})) command += " '" + word + "'";
  const Terminal terminal(stage.room, 100, 20, command + "; sleep 100");
  REQUIRE(terminal.shows("* writes"));
  REQUIRE(terminal.shows("0 messages, 0 B, 0 B/s; 0 missed, 0 lost; 0 B held"));
  for (int i = 0; i < 10; ++i) put(pusher, i);
  CHECK(terminal.shows(": 10 messages"));
  terminal.press("C-c");
  CHECK(terminal.shows("MESSAGES"));
  CHECK(terminal.shows_no("held"));
}

TEST_CASE("lot record says where the messages of ROS may be when none came") {
  const Watchdog watchdog(120);
  Stage stage;
  const auto pusher = stage.engine.advertise<Pose>("0123abcd /pose");
  const Ran ran = run_lot(stage.record({"--all", "--duration", "0.2"}));
  CHECK(ran.exit == 1);
  CHECK(ran.out.find("/pose is a topic of ROS") != std::string::npos);
}

TEST_CASE("lot record --last: SIGUSR1 writes what is kept") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  Running recorder(stage.record({"/pose", "--last", "1000"}));
  REQUIRE(recorder.says("SIGUSR1 writes them"));
  for (int i = 0; i < 10; ++i) put(pusher, i);
  CHECK_FALSE(std::filesystem::exists(stage.directory.file("a_0.mcap")));
  CHECK(eventually([&] {  // one that comes before the first message writes nothing
    recorder.child().send(SIGUSR1);
    return recorder.err().find("a_0.mcap") != std::string::npos;
  }));
  CHECK(recorder.interrupt().exit == 0);
  CHECK(payloads(stage.directory.file("a_0.mcap")).size() >= 1);
}

TEST_CASE("lot info says what a file holds") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  const Ran ran = run_lot({"info", stage.file()});
  CHECK(ran.exit == 0);
  CHECK(ran.out.find("/pose") != std::string::npos);
  const Json json = run_lot({"info", "--json", stage.file()}).json();
  CHECK(json.at("command") == "info");
  const Json& file = json.at("files").at(0);
  const mcap::Reader reader(stage.file());
  CHECK(file.at("path") == stage.file());
  CHECK(file.at("bytes") == std::filesystem::file_size(stage.file()));
  CHECK(file.at("library") == reader.header().library);
  CHECK(file.at("profile") == reader.header().profile);
  CHECK(file.at("checked") == true);
  CHECK(file.at("chunks") == reader.chunks().size());
  CHECK(file.at("compression") == Json::array({"none"}));
  CHECK(file.at("begin_ns") == reader.statistics().start);
  CHECK(file.at("end_ns") == reader.statistics().end);
  CHECK(ran.out.starts_with(stage.file() + "  "));
  CHECK(ran.out.find(", by " + reader.header().library + "\n  from ") != std::string::npos);
  CHECK(ran.out.find("compression none\n") != std::string::npos);
  CHECK(run_lot({"info", stage.file(), stage.file()}).out == ran.out + "\n" + ran.out);
  CHECK(run_lot({"info", "--quick", stage.file()})
            .out.find("compression none, not read (--quick)\n") != std::string::npos);
  CHECK(file.at("messages") == 10);
  CHECK(file.at("topics").at(0).at("name") == "/pose");
  CHECK(file.at("topics").at(0).at("missed") == 0);
  CHECK(file.at("has_summary") == true);
  CHECK(file.at("damage").at("is_cut") == false);
}

TEST_CASE("lot info of a file that is cut off says what is left, and --recover makes it whole") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  const std::string whole = read_file(stage.file());
  write_file(stage.file(), std::string_view(whole).substr(0, whole.size() - 100));
  const Ran cut = run_lot({"info", stage.file()});
  CHECK(cut.exit != 0);
  CHECK(cut.out.find("--recover") != std::string::npos);
  CHECK(cut.out.find("/pose") != std::string::npos);
  CHECK(run_lot({"info", "--recover", stage.file()}).exit == 0);
  const Json json = run_lot({"info", "--json", stage.file()}).json();
  CHECK(json.at("exit") == 0);
  CHECK(json.at("files").at(0).at("messages") == 10);
}

TEST_CASE("lot info finds wrong bytes within a chunk, and --quick says that it has not looked") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  std::string bytes = read_file(stage.file());
  const std::size_t at = bytes.rfind(std::string("map\0", 4));  // in the last chunk with a message
  REQUIRE(at != std::string::npos);
  bytes.replace(at, 3, "rat");
  write_file(stage.file(), bytes);
  const Ran told = run_lot({"info", stage.file()});
  CHECK(told.exit == 3);
  CHECK(told.out.find("cannot be read") != std::string::npos);
  const Json damage = run_lot({"info", "--json", stage.file()}).json().at("files").at(0);
  CHECK(damage.at("damage").at("chunks") == 1);
  CHECK(damage.at("checked") == true);
  CHECK(run_lot({"info", "--recover", stage.file()}).exit == 3);
  const Ran quick = run_lot({"info", "--quick", stage.file()});
  CHECK(quick.exit == 0);
  CHECK(quick.out.find("not read (--quick)") != std::string::npos);
}

TEST_CASE("lot info of a damaged chunk says how many messages it cost, and calls none missed") {
  const Watchdog watchdog(120);
  Stage stage;
  {
    auto pusher = stage.engine.advertise<Pose>("/pose");
    Running recorder(stage.record({"/pose"}));
    REQUIRE(recorder.says("writes"));
    for (int chunk = 0; chunk < 3; ++chunk) {  // the open chunk is written once a second
      put(pusher, chunk);
      REQUIRE(eventually(
          [&] { return payloads(stage.file()).size() == static_cast<std::size_t>(chunk + 1); }));
    }
    CHECK(recorder.interrupt().exit == 0);
  }
  std::string bytes = read_file(stage.file());
  const std::size_t first = bytes.find(std::string("map\0", 4));
  const std::size_t at = bytes.find(std::string("map\0", 4), first + 1);  // in the second chunk
  REQUIRE(at != std::string::npos);
  bytes.replace(at, 3, "rat");
  write_file(stage.file(), bytes);
  const Ran told = run_lot({"info", "--json", stage.file()});
  const Json file = told.json().at("files").at(0);
  CHECK(file.at("damage").at("messages") == 1);
  CHECK(says(told.json().at("hints").dump(), ", 1 message, cannot be read"));
  CHECK(file.at("topics").at(0).at("missed") == 0);
  const std::size_t third = bytes.find(std::string("map\0", 4), at + 1);
  const std::size_t end = bytes.find("lot.topic", third) - 13;  // a kill leaves no such record
  write_file(stage.file(), std::string_view(bytes).substr(0, end));
  const Json cut = run_lot({"info", "--json", stage.file()}).json().at("files").at(0);
  CHECK(cut.at("messages") == 2);
  CHECK(cut.at("topics").at(0).at("missed") == 0);
  CHECK(cut.at("topics").at(0).at("lost") == 1);
  const Ran quick = run_lot({"info", "--quick", stage.file()});
  CHECK(says(quick.out, "has no index: --quick has read all of it as well"));
}

TEST_CASE("lot info --recover of a file that the user may not write says what he can do" *
          doctest::skip(!can_be_another_user())) {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  const std::string whole = read_file(stage.file());
  write_file(stage.file(), std::string_view(whole).substr(0, whole.size() - 100));
  std::filesystem::permissions(stage.file(), std::filesystem::perms(0644));
  std::filesystem::permissions(stage.directory.file(""), std::filesystem::perms(0755));
  std::vector<std::string> words = {command(), "info", "--recover", stage.file()};
  const Ran ran = run_by(words, [](char** arguments) {
    become(kAnn, kOtherGroup);
    fexecve(command_file(), arguments, environ);
  });
  CHECK(ran.exit == 1);
  CHECK(says(ran.out, "it can be read and played as it is; a copy of it can be recovered"));
}

TEST_CASE("lot record names the directory in which the user may not make its file" *
          doctest::skip(!can_be_another_user())) {
  const Watchdog watchdog(120);
  const Stage stage;
  const std::string directory = stage.directory.file("mine");
  std::filesystem::create_directory(directory);
  std::filesystem::permissions(directory, std::filesystem::perms(0755));
  std::filesystem::permissions(stage.directory.file(""), std::filesystem::perms(0755));
  std::vector<std::string> words = {command(), "record", "--all", "--dir",
                                    stage.directory.file("")};
  const Ran ran = run_by(words, [&](char** arguments) {
    must(chdir(directory.c_str()) == 0, "the directory");
    become(kAnn, kOtherGroup);
    fexecve(command_file(), arguments, environ);
  });
  CHECK(ran.exit == 1);
  CHECK(says(ran.err, "you may not make files in " + directory));
  CHECK(says(ran.err, "-o FILE names the file"));
}

TEST_CASE("lot info of a closed file whose index is damaged says so, and --recover loses nothing") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  std::string bytes = read_file(stage.file());
  const std::size_t crc = bytes.size() - 9;  // before the magic
  bytes[crc] = static_cast<char>(~bytes[crc]);
  write_file(stage.file(), bytes);
  const Ran told = run_lot({"info", stage.file()});
  CHECK(told.exit == 3);
  CHECK(told.out.find("its index is damaged") != std::string::npos);
  const Ran recovered = run_lot({"info", "--recover", stage.file()});
  CHECK(recovered.exit == 0);
  CHECK(recovered.out.find("no message was there") != std::string::npos);
  CHECK(run_lot({"info", stage.file()}).exit == 0);
  CHECK(payloads(stage.file()).size() == 10);
}

TEST_CASE("lot info of what is none: a status for each kind, and the other files all the same") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  write_file(stage.directory.file("text"), "some text that is long enough to be read");
  CHECK(run_lot({"info", stage.directory.file("none")}).exit == 1);
  const Ran both = run_lot({"info", stage.directory.file("text"), stage.file()});
  CHECK(both.exit == 3);
  CHECK(both.out.find("/pose") != std::string::npos);
}

TEST_CASE("lot play publishes what was recorded to typed subscribers, at its distances") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  auto puller = stage.engine.subscribe<Pose>("/pose");
  const lot::Recording recording(stage.file());
  const auto begin = std::chrono::steady_clock::now();
  Running player(stage.play({"--wait", "60"}));
  for (int i = 0; i < 10; ++i) {
    const auto pose = puller.pull(20s);
    REQUIRE(pose);
    CHECK(pose->x == i);
    CHECK(pose->frame == "map");
  }
  CHECK(std::chrono::steady_clock::now() - begin >= recording.end() - recording.begin());
  const Ran ran = player.finish();
  CHECK(ran.exit == 0);
  CHECK(ran.out.find("10") != std::string::npos);
}

TEST_CASE("lot play: what is recorded meanwhile has the same payloads") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  const std::string again = stage.directory.file("again.mcap");
  Running recorder(on(stage.options, {"record", "/pose", "-o", again}));
  REQUIRE(recorder.says("writes"));
  CHECK(run_lot(stage.play({"--rate", "100"})).exit == 0);
  CHECK(recorder.interrupt().exit == 0);
  CHECK(payloads(again) == payloads(stage.file()));
}

TEST_CASE("lot play: chosen topics, other names, a part of the time") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  auto puller = stage.engine.subscribe<Pose>("/b");
  const Ran part =
      run_lot(stage.play({"--remap", "/pose:=/b", "--start", "0.02", "--rate", "10", "--json"}));
  const auto pushed = part.json().at("topics").at(0).at("pushed").get<std::uint64_t>();
  CHECK(part.exit == 0);
  CHECK(pushed < 10);
  CHECK(pushed > 0);
  CHECK(puller.size() == pushed);
  CHECK(run_lot(stage.play({"--topic", "/none"})).exit == 1);
  CHECK(run_lot(stage.play({"--except", "/p*"})).exit == 1);
  CHECK(run_lot(stage.play({"--remap", "/pose"})).exit == 2);
}

TEST_CASE("lot play --loop goes on until Ctrl-C") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  auto puller = stage.engine.subscribe<Pose>("/pose");
  Running player(stage.play({"--loop", "--rate", "100", "--json"}));
  for (int i = 0; i < 35; ++i) REQUIRE(puller.pull(20s));
  const Ran ran = player.interrupt();
  CHECK(ran.json().at("rounds") >= 4);
}

TEST_CASE("lot play does not publish on a topic of other fields") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  auto other = stage.engine.advertise<Other>("/pose");
  const Ran ran = run_lot(stage.play({}));
  CHECK(ran.exit == 1);
  CHECK(ran.out.find("--remap /pose:=/other") != std::string::npos);
  auto camera = stage.engine.advertise<Other>("/camera");
  const Ran remapped = run_lot(stage.play({"--remap", "/pose:=/camera"}));
  CHECK(remapped.out.find("--remap /pose:=/other") != std::string::npos);
}

TEST_CASE("lot play makes a segment where there is none") {
  const Watchdog watchdog(120);
  Stage stage;
  stage.record_ten();
  const Room room;
  const Ran ran = run_lot(on(room.options("new"), {"play", stage.file()}));
  CHECK(ran.exit == 0);
  CHECK(room.files() == 0);
}

}  // namespace
