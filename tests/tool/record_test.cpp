// SPDX-License-Identifier: Apache-2.0

// lot record, lot info, lot play: what they print, write and publish, and how they end.

#include <chrono>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>
#include <lot/recording.hpp>

#include "stage.hpp"
#include "support/janitor.hpp"
#include "terminal.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const bool has_janitor = start_janitor();

struct Other {
  std::uint64_t count = 0;
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

TEST_CASE("lot record on a terminal has a line that says how it goes") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pusher = stage.engine.advertise<Pose>("/pose");
  std::string command = LOT_COMMAND;
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
  const Json& file = json.at("files").at(0);
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
