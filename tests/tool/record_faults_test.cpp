// SPDX-License-Identifier: Apache-2.0

// lot record that is stopped, killed, or has no place to write; lot record, lot info and lot play
// with files that are cut, of other formats, or of types that they do not know.

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <fcntl.h>
#include <filesystem>
#include <map>
#include <random>
#include <string>
#include <sys/stat.h>
#include <thread>
#include <unistd.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>
#include <lot/recording.hpp>

#include "recordings.hpp"
#include "stage.hpp"
#include "support/janitor.hpp"
#include "support/seed.hpp"
#include "support/small_disk.hpp"
#include "tool/commands.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const bool has_janitor = start_janitor();

struct Numbered {
  std::uint64_t number = 0;
};
struct Picture {
  std::uint64_t number = 0;
  lot::ShmVector<std::uint8_t> pixels;
};

void put(lot::ShmPusher<Numbered>& pusher, std::uint64_t number) {
  must_go(pusher.push(pusher.loan(Numbered{number})));
}
void put(lot::ShmPusher<Picture>& pusher, std::uint64_t number, std::size_t bytes) {
  auto picture = pusher.loan();
  picture->number = number;
  picture->pixels.resize(bytes, static_cast<std::uint8_t>(number));
  must_go(pusher.push(std::move(picture)));
}

bool says(const std::string& text, const std::string& what) {
  return text.find(what) != std::string::npos;
}

/// Reads a file of numbered messages of one publisher a topic, and requires that each gap in their
/// numbers is one in the file's. How many there are.
std::uint64_t read_numbered(const std::string& file) {
  lot::Recording recording(file);
  std::map<std::string, std::uint64_t> ahead;  // of the publisher's numbers
  std::uint64_t count = 0;
  auto messages = recording.messages();
  while (const auto message = messages.next()) {
    const auto number = message->root()["number"].as<std::uint64_t>();
    const auto [first, is_new] = ahead.emplace(message->topic().name, number - message->sequence());
    REQUIRE(number - message->sequence() == first->second);
    ++count;
  }
  return count;
}

/// In the order in which they were made.
std::vector<std::string> files_in(const std::string& directory) {
  std::vector<std::string> files;
  for (const auto& entry : std::filesystem::directory_iterator(directory)) {
    files.push_back(entry.path());
  }
  std::ranges::sort(files, [](const std::string& a, const std::string& b) {
    return std::pair(a.size(), a) < std::pair(b.size(), b);
  });
  return files;
}

/// Reads what a recorder that was killed has left, before and behind --recover. How many messages
/// there are in it.
std::uint64_t read_killed(const std::vector<std::string>& files, bool splits) {
  std::uint64_t read = 0;
  for (const std::string& file : files) {
    CAPTURE(file);
    const Ran told = run_lot({"info", "--json", file});
    const Json content = told.json().at("files").at(0);
    if (content.contains("error")) {  // it was killed before this was a recording
      CHECK(told.exit == 3);
      CHECK(std::filesystem::file_size(file) < 64);
      continue;
    }
    const std::uint64_t there = read_numbered(file);
    CHECK(content.at("messages") == there);
    const bool is_last = file == files.back();
    const bool is_cut = content.at("damage").at("is_cut").get<bool>();
    CHECK((is_last || !is_cut));
    if (!splits) CHECK(is_cut);
    CHECK(run_lot({"info", "--recover", file}).exit == 0);
    CHECK(read_numbered(file) == there);
    CHECK_FALSE(lot::Recording(file).damage().is_cut);
    read += there;
  }
  return read;
}

TEST_SUITE_BEGIN("record");

// ---- lot record
// -----------------------------------------------------------------------------------

TEST_CASE("lot record that is stopped holds no publisher up, and counts what it missed") {
  const Watchdog watchdog(120);
  Stage stage;
  lot::PusherOptions lossless;
  lossless.policy = lot::Policy::Refuse;
  auto numbers = stage.engine.advertise<Numbered>("/numbers", lossless);
  auto pictures = stage.engine.advertise<Picture>("/pictures");
  auto reader = stage.engine.subscribe<Numbered>("/numbers");
  Running recorder(stage.record({"--all", "--json"}));
  REQUIRE(recorder.says("writes"));
  constexpr std::uint64_t kAll = 440;
  const auto publish = [&](std::uint64_t from, std::uint64_t until) {
    for (std::uint64_t n = from; n < until; ++n) {
      put(numbers, n);
      put(pictures, n, 10'000);
      const auto got = reader.try_pull();
      REQUIRE((got && got->number == n));
    }
  };
  publish(0, 20);
  stop(recorder.child());
  for (std::uint64_t round = 1; round <= 20; ++round) {  // two seconds
    publish(20 * round, 20 * (round + 1));
    std::this_thread::sleep_for(100ms);
  }
  recorder.child().send(SIGCONT);
  publish(420, kAll);
  const Ran ran = recorder.interrupt();
  CHECK(ran.exit == 0);
  CHECK(says(ran.err, "writes"));
  std::uint64_t messages = 0;
  const Json told = ran.json();
  CHECK(told.at("topics").size() == 2);
  for (const Json& topic : told.at("topics")) {
    CAPTURE(topic.at("name"));
    CHECK(topic.at("missed") > 0);
    CHECK(topic.at("messages").get<std::uint64_t>() + topic.at("missed").get<std::uint64_t>() ==
          kAll);
    messages += topic.at("messages").get<std::uint64_t>();
  }
  CHECK(read_numbered(stage.file()) == messages);
  const Json json = run_lot({"info", "--json", stage.file()}).json();
  for (const Json& topic : json.at("files").at(0).at("topics")) CHECK(topic.at("missed") > 0);
}

TEST_CASE("lot record that is killed at any moment leaves files that are right") {
  const Watchdog watchdog(300);
  std::mt19937_64 random(seed());
  Stage stage;
  auto numbers = stage.engine.advertise<Numbered>("/numbers");
  auto pictures = stage.engine.advertise<Picture>("/pictures");
  std::uint64_t number = 0;
  const auto publish_for = [&](std::chrono::microseconds time) {
    const auto end = std::chrono::steady_clock::now() + time;
    do {
      put(numbers, number);
      put(pictures, number, number % 7 == 0 ? 1'200'000 : 20'000);
      ++number;
      std::this_thread::sleep_for(1ms);
    } while (std::chrono::steady_clock::now() < end);
  };
  const std::vector<std::vector<std::string>> kinds = {
      {},
      {"--compression", "lz4", "--split-size", "0.01"},
      {"--compression", "zstd", "--no-crc"},
      {"--last", "1000", "--after", "1000"}};
  std::uint64_t read = 0;
  std::size_t split_files = 0;
  for (std::size_t round = 0; round < 20; ++round) {
    CAPTURE(round);
    const Directory directory;
    std::vector<std::string> words = kinds[round % kinds.size()];
    words.insert(words.begin(), {"record", "--all", "-o", directory.file()});
    Running recorder(on(stage.options, words));
    const bool begins = round % 5 != 0;  // else it is killed while it begins
    const bool splits = round % kinds.size() == 1;
    const bool keeps = round % kinds.size() == 3;
    if (begins) REQUIRE(recorder.says(keeps ? "keeps the last" : "writes"));
    publish_for(std::chrono::microseconds(random() % (begins ? 150'000 : 30'000)));
    if (begins && keeps) {
      REQUIRE(eventually([&] {
        recorder.child().send(SIGUSR1);
        publish_for(1ms);
        return says(recorder.err(), ".mcap");
      }));
      publish_for(std::chrono::microseconds(random() % 50'000));
    }
    recorder.child().send(SIGKILL);
    publish_for(1ms);
    CHECK(recorder.finish().exit == 128 + SIGKILL);
    const std::vector<std::string> files = files_in(directory.file(""));
    if (splits) split_files = std::max(split_files, files.size());
    read += read_killed(files, splits);
  }
  CHECK(read > 0);
  CHECK(split_files > 2);
}

TEST_CASE("what a recorder held that was killed is freed") {
  const Watchdog watchdog(120);
  Stage stage;
  {
    auto pictures = stage.engine.advertise<Picture>("/pictures");
    Running recorder(stage.record({"--all", "--compression", "zstd"}));
    REQUIRE(recorder.says("writes"));
    for (std::uint64_t n = 0; n < 50; ++n) put(pictures, n, 300'000);
  }
  CHECK(leak_in(stage.engine.path()) == "");
}

TEST_CASE("two lot record on one file: the second one is refused, and so is --recover meanwhile") {
  const Watchdog watchdog(120);
  Stage stage;
  auto numbers = stage.engine.advertise<Numbered>("/numbers");
  Running recorder(stage.record({"--all"}));
  REQUIRE(recorder.says("writes"));
  put(numbers, 0);
  const Ran second = run_lot(stage.record({"--all"}));
  CHECK(second.exit == 1);
  CHECK(says(second.err, "never overwritten"));
  const Ran recovery = run_lot({"info", "--recover", stage.file()});
  CHECK(recovery.exit == 1);
  CHECK(says(recovery.out, "another process writes it"));
  put(numbers, 1);
  CHECK(recorder.interrupt().exit == 0);
  CHECK(read_numbered(stage.file()) == 2);
}

TEST_CASE("lot record on a disk that is full says so, counts it, and ends with 1") {
  const Watchdog watchdog(120);
  const SmallDisk disk("size=2M");
  if (disk.path.empty()) {
    std::printf("skipped: can not mount a tmpfs\n");
    return;
  }
  const Stage stage;
  lot::ShmEngine engine(stage.options);
  auto pictures = engine.advertise<Picture>("/pictures");
  const std::string file = disk.path + "/a.mcap";
  Running recorder(on(stage.options, {"record", "--all", "--json", "-o", file}));
  REQUIRE(recorder.says("writes"));
  std::uint64_t n = 0;
  for (; !says(recorder.err(), "No space left"); ++n) {
    put(pictures, n, 400'000);
    std::this_thread::sleep_for(20ms);
  }
  const Ran ran = recorder.interrupt();
  CHECK(ran.exit == 1);
  const Json topic = ran.json().at("topics").at(0);
  CHECK(topic.at("lost") > 0);
  CHECK(topic.at("messages").get<std::uint64_t>() + topic.at("lost").get<std::uint64_t>() +
            topic.at("missed").get<std::uint64_t>() ==
        n);
  CHECK(read_numbered(file) == topic.at("messages"));
  std::filesystem::remove(file);
}

TEST_CASE("lot record on a disk that is full from the begin: no file stays") {
  const Watchdog watchdog(120);
  const SmallDisk disk("size=64k");
  if (disk.path.empty()) {
    std::printf("skipped: can not mount a tmpfs\n");
    return;
  }
  const Stage stage;
  lot::ShmEngine engine(stage.options);
  auto pictures = engine.advertise<Picture>("/pictures");
  const std::string room(48 << 10, 'x');  // a page or two stay free: a file's begin has room there
  for (const std::size_t more : {std::size_t{8} << 10, std::size_t{16} << 10}) {
    CAPTURE(more);
    write_file(disk.path + "/full", room + std::string(more, 'x'));
    const std::string file = disk.path + "/a.mcap";
    Running recorder(
        on(stage.options, {"record", "--all", "--json", "--split-time", "1000", "-o", file}));
    const bool begins = more < 16 << 10;
    if (begins) {
      REQUIRE(recorder.says("writes"));
      put(pictures, 0, 400'000);
      REQUIRE(recorder.says("No space left"));
    }
    const Ran ran = begins ? recorder.interrupt() : recorder.finish();
    CHECK(ran.exit == 1);
    CHECK(ran.json().at("exit") == 1);
    CHECK(says(ran.err, "No space left"));
    CHECK(says(ran.err, "make room, or record to another disk"));
    CHECK_FALSE(says(ran.err, "can be read"));
    CHECK(files_in(disk.path) == std::vector<std::string>{disk.path + "/full"});
    std::filesystem::remove(disk.path + "/full");
  }
}

TEST_CASE("lot record whose directory vanishes says so, and ends with 1") {
  const Watchdog watchdog(120);
  Stage stage;
  auto pictures = stage.engine.advertise<Picture>("/pictures");
  const std::string room = stage.directory.file("room");
  std::filesystem::create_directory(room);
  Running recorder(on(stage.options, {"record", "--all", "--json", "-o", room + "/a.mcap"}));
  REQUIRE(recorder.says("writes"));
  std::filesystem::remove_all(room);
  std::uint64_t n = 0;
  for (; !says(recorder.err(), "/a.mcap: "); ++n) {  // it is removed, or cannot be made anew
    put(pictures, n, 400'000);
    std::this_thread::sleep_for(20ms);
  }
  const Ran ran = recorder.interrupt();
  CHECK(ran.exit == 1);
  const Json topic = ran.json().at("topics").at(0);
  CHECK(topic.at("messages") == 0);
  CHECK(topic.at("lost").get<std::uint64_t>() + topic.at("missed").get<std::uint64_t>() == n);
  const Ran none = run_lot(on(stage.options, {"record", "--all", "-o", room + "/a.mcap"}));
  CHECK(none.exit == 1);
  CHECK(says(none.err, "make its directory first"));
}

// ---- files
// ----------------------------------------------------------------------------------------

/// Runs a command in this process, and drops what it prints.
template <class Command>
int quietly(Command&& command) {
  std::fflush(stdout);
  const int kept = dup(STDOUT_FILENO);
  const int nothing = open("/dev/null", O_WRONLY | O_CLOEXEC);
  must(kept != -1 && nothing != -1 && dup2(nothing, STDOUT_FILENO) != -1, "standard output");
  close(nothing);
  const int exit = command();
  std::fflush(stdout);
  dup2(kept, STDOUT_FILENO);
  close(kept);
  return exit;
}

TEST_CASE("lot info of a file that is cut at any byte: what is left, or an error") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string whole = read_file(file_of_others(directory, {{"/count", kCount}}));
  const std::string cut = directory.file("cut.mcap");
  lot::tool::InfoOptions options;
  options.files = {cut};
  const lot::tool::Settings settings;
  bool is_read = false;
  for (std::size_t size = 0; size < whole.size(); ++size) {
    CAPTURE(size);
    write_file(cut, std::string_view(whole).substr(0, size));
    const int exit = quietly([&] { return lot::tool::info(settings, options); });
    CHECK((exit == lot::tool::kWrong || exit == lot::tool::kDamaged));
    is_read = is_read || exit == lot::tool::kWrong;  // it ends behind a record
  }
  CHECK(is_read);
}

TEST_CASE("lot play of a file that is cut: what is left is published, and no byte more") {
  const Watchdog watchdog(120);
  std::mt19937_64 random(seed());
  Stage stage;
  const std::string others = file_of_others(stage.directory, {{"/count", kCount}});
  const std::string whole = read_file(others);
  const lot::Recording uncut(others);
  const auto pusher = stage.engine.advertise_any(  // the topic is there: no wait for subscribers
      "/count", uncut.type_of(uncut.topics().at(0)));
  for (int round = 0; round < 20; ++round) {
    const std::size_t size = round == 0 ? whole.size() - 1 : random() % whole.size();
    CAPTURE(size);
    write_file(stage.file(), std::string_view(whole).substr(0, size));
    std::uint64_t there = 0;
    bool is_one = true;
    bool is_damaged = false;
    try {
      lot::Recording recording(stage.file());
      auto messages = recording.messages();
      while (messages.next()) ++there;
      is_damaged = !recording.damage().first.empty();
    } catch (const lot::Error&) {
      is_one = false;
    }
    const Ran ran = run_lot(stage.play({"--json", "--rate", "1000"}));
    if (!is_one) {
      CHECK(ran.exit == 3);
      CHECK_FALSE(ran.err.empty());
      continue;
    }
    std::uint64_t pushed = 0;
    const Json told = ran.json();
    for (const Json& topic : told.at("topics")) {
      pushed += topic.at("pushed").get<std::uint64_t>();
    }
    CHECK(pushed == there);
    CHECK(ran.exit == (is_damaged ? 3 : there == 0 ? 1 : 0));
  }
}

TEST_CASE("files of other formats, and what is no file, are refused by lot info and lot play") {
  const Watchdog watchdog(120);
  Stage stage;
  const auto file = [&](const std::string& name) { return stage.directory.file(name); };
  write_file(file("empty"), "");
  write_file(file("text"), "some text that is long enough to be a recording by its size alone");
  write_file(file("bag"), "#ROSBAG V2.0\n" + std::string(5000, '\1'));
  write_file(file("db3"), std::string("SQLite format 3\0", 16) + std::string(5000, '\0'));
  write_file(file("zeros"), std::string(5000, '\0'));
  write_file(file("magic"), std::string("\x89MCAP0\r\n", 8));
  write_file(file("version"), std::string("\x89MCAP1\r\n", 8) + std::string(500, '\0'));
  std::filesystem::create_directory(file("directory"));
  REQUIRE(mkfifo(file("fifo").c_str(), 0600) == 0);
  for (const char* name : {"empty", "text", "bag", "db3", "zeros", "magic", "version"}) {
    CAPTURE(name);
    const Ran told = run_lot({"info", file(name)});
    CHECK(told.exit == 3);
    CHECK(says(told.out, file(name)));
    const Ran played = run_lot(on(stage.options, {"play", file(name)}));
    CHECK(played.exit == 3);
    const std::size_t path = played.err.find(file(name));
    CHECK(path != std::string::npos);
    CHECK(played.err.find(file(name), path + 1) == std::string::npos);  // it is said once
  }
  for (const char* name : {"none", "directory", "fifo"}) {
    CAPTURE(name);
    const Ran told = run_lot({"info", file(name)});
    CHECK(told.exit != 0);
    CHECK(says(told.out, file(name)));
    const Ran played = run_lot(on(stage.options, {"play", file(name)}));
    CHECK(played.exit != 0);
    CHECK(says(played.err, file(name)));
  }
}

TEST_CASE("topics that cannot be decoded: lot info says why, lot play leaves them out") {
  const Watchdog watchdog(120);
  Stage stage;
  const std::string file =
      file_of_others(stage.directory, {{"/count", kCount},
                                       {"/json", {"json", "jsonschema", "{}"}},
                                       {"/idl", {"cdr", "ros2idl", "struct Count { long n; };"}},
                                       {"/unknown", {"cdr", "ros2msg", "other_msgs/Unknown n\n"}},
                                       {"/wide", {"cdr", "ros2msg", "wstring n\n"}},
                                       {"/none", {"cdr", "", ""}}});
  const Ran told = run_lot({"info", "--json", file});
  CHECK(told.exit == 0);
  std::size_t refused = 0;
  const Json content = told.json();
  for (const Json& topic : content.at("files").at(0).at("topics")) {
    CHECK(topic.at("messages") == 3);
    CHECK(topic.at("objection").get<std::string>().empty() == (topic.at("name") == "/count"));
    refused += !topic.at("objection").get<std::string>().empty();
  }
  CHECK(refused == 5);
  CHECK(says(run_lot({"info", file}).out, "other_msgs/Unknown"));
  const Ran played = run_lot(on(stage.options, {"play", "--json", "--rate", "1000", file}));
  CHECK(played.exit == 1);
  const Json json = played.json();
  REQUIRE(json.at("topics").size() == 1);
  CHECK(json.at("topics").at(0).at("name") == "/count");
  CHECK(json.at("topics").at(0).at("pushed") == 3);
  CHECK(json.at("left_out").size() == 5);
  for (const Json& topic : json.at("left_out")) CHECK_FALSE(topic.at("why").empty());
}

}  // namespace
