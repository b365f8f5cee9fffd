// SPDX-License-Identifier: Apache-2.0

// lot play: which messages it publishes, where, when, and how it is paused by a key.

#include <chrono>
#include <cstdint>
#include <limits>
#include <map>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>
#include <lot/recording.hpp>

#include "recordings.hpp"
#include "stage.hpp"
#include "support/janitor.hpp"
#include "terminal.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const bool has_janitor = start_janitor();

/// As words, which a failing check shows.
std::string words_of(const std::vector<std::uint64_t>& numbers) {
  std::string text;
  for (const std::uint64_t n : numbers) text += (text.empty() ? "" : " ") + std::to_string(n);
  return text;
}

constexpr std::uint64_t kSecond = 1'000'000'000;

bool says(const std::string& text, const std::string& what) {
  return text.find(what) != std::string::npos;
}

/// A segment whose topics are there, with a reader of each that has all that is published.
struct Audience {
  explicit Audience(const std::string& file, const std::vector<std::string>& topics) {
    const lot::Recording recording(file);
    const lot::AnyType type = recording.type_of(recording.topics().at(0));
    for (const std::string& topic : topics) {
      pushers.push_back(stage.engine.advertise_any(topic, type));
      pullers.emplace(topic, stage.engine.subscribe_any(topic));
    }
  }
  /// What has come on a topic.
  std::vector<std::uint64_t> numbers(const std::string& topic) {
    std::vector<std::uint64_t> all;
    while (const auto message = pullers.at(topic).try_pull()) {
      all.push_back(message.root()["n"].as<std::uint64_t>());
    }
    return all;
  }
  std::string heard(const std::string& topic) { return words_of(numbers(topic)); }
  Ran play(const std::string& file, std::vector<std::string> words) const {
    words.insert(words.begin(), {"play", file, "--json"});
    return run_lot(on(stage.options, std::move(words)));
  }

  Stage stage;
  std::vector<lot::AnyPusher> pushers;
  std::map<std::string, lot::AnyPuller> pullers;
};

/// Five messages, half a second from each other.
std::string five(const Directory& directory) {
  return file_of_others(directory, {{"/count", kCount}},
                        {kSecond, kSecond * 3 / 2, kSecond * 2, kSecond * 5 / 2, kSecond * 3});
}

TEST_SUITE_BEGIN("record");

TEST_CASE("lot play --start and --end: a part of the time, both ends included") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = five(directory);
  Audience audience(file, {"/count"});
  const struct {
    std::vector<std::string> words;
    std::string numbers;
  } parts[] = {{{}, "1 2 3 4 5"},
               {{"--start", "1"}, "3 4 5"},
               {{"--start", "1.2"}, "4 5"},
               {{"--end", "1"}, "1 2 3"},
               {{"--end", "0"}, "1"},
               {{"--start", "0.5", "--end", "1.5"}, "2 3 4"},
               {{"--end", "100"}, "1 2 3 4 5"},
               {{"--start", "100"}, ""},
               {{"--start", "2", "--end", "1"}, ""}};
  for (const auto& [words, numbers] : parts) {
    CAPTURE(words);
    std::vector<std::string> all = words;
    all.insert(all.end(), {"--rate", "1000"});
    const Ran ran = audience.play(file, all);
    CHECK(ran.exit == (numbers.empty() ? 1 : 0));
    CHECK(audience.heard("/count") == numbers);
    const Json hints = ran.json().at("hints");
    CHECK(hints.size() == (numbers.empty() ? 2 : 1));  // the first one names the audience
    if (numbers.empty()) CHECK(says(hints.at(1), words.size() == 2 ? "2.000 s" : "--end lies"));
  }
}

TEST_CASE("lot play --rate: slower and faster, and no rate that is none") {
  const Watchdog watchdog(100);
  const Directory directory;
  const std::string quick = file_of_others(directory, {{"/count", kCount}}, {0, kSecond / 10});
  const std::string slow =
      file_of_others(directory, {{"/count", kCount}}, {0, 3000 * kSecond}, "slow.mcap");
  Audience audience(quick, {"/count"});
  const auto begin = std::chrono::steady_clock::now();
  CHECK(audience.play(quick, {"--rate", "0.2"}).exit == 0);
  CHECK(std::chrono::steady_clock::now() - begin >= 500ms);
  CHECK(audience.heard("/count") == "1 2");
  CHECK(audience.play(slow, {"--rate", "100000"}).exit == 0);  // else the watchdog ends it
  CHECK(audience.heard("/count") == "1 2");
  for (const char* rate : {"0", "-1", "nan", "inf", "x"}) {
    CHECK(audience.play(quick, {"--rate", rate}).exit == 2);
  }
  CHECK(audience.heard("/count").empty());
}

TEST_CASE("lot play: topics by name and pattern, left out, and under other names") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = file_of_others(
      directory, {{"/a/one", kCount}, {"/a/two", kCount}, {"/b", kCount}}, {1, 2, 3});
  const std::vector<std::string> names = {"/a/one", "/a/two", "/b", "/x", "/y"};
  Audience audience(file, names);
  const struct {
    std::vector<std::string> words;
    std::vector<std::size_t> heard;  ///< how many on each
  } parts[] = {{{}, {3, 3, 3, 0, 0}},
               {{"--topic", "/a/*"}, {3, 3, 0, 0, 0}},
               {{"--topic", "/a/one", "--topic", "/b"}, {3, 0, 3, 0, 0}},
               {{"--topic", "/a/*", "--except", "*/two"}, {3, 0, 0, 0, 0}},
               {{"--except", "/a/*"}, {0, 0, 3, 0, 0}},
               {{"--remap", "/b:=/x"}, {3, 3, 0, 3, 0}},
               {{"--remap", "/a/one:=/x", "--remap", "/a/two:=/y"}, {0, 0, 3, 3, 3}},
               {{"--remap", "/a/one:=/a/two", "--remap", "/a/two:=/a/one"}, {3, 3, 3, 0, 0}},
               {{"--remap", "/a/one:=/b"}, {0, 3, 6, 0, 0}}};
  for (const auto& [words, heard] : parts) {
    CAPTURE(words);
    CHECK(audience.play(file, words).exit == 0);
    for (std::size_t i = 0; i < names.size(); ++i) {
      CAPTURE(names[i]);
      CHECK(audience.numbers(names[i]).size() == heard[i]);
    }
  }
}

TEST_CASE("lot play --remap of a topic that is not in the recording publishes nothing") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = five(directory);
  Audience audience(file, {"/count"});
  const Ran ran = audience.play(file, {"--remap", "/cuont:=/x", "--rate", "1000"});
  CHECK(ran.exit == 1);
  CHECK(says(ran.err, "/cuont"));
  CHECK(audience.heard("/count").empty());
}

TEST_CASE("lot play --topic or --except of what is not in the recording publishes nothing") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = five(directory);
  Audience audience(file, {"/count"});
  for (const char* option : {"--topic", "--except"}) {
    for (const char* name : {"/cuont", "/none*"}) {
      CAPTURE(name);
      const Ran ran = audience.play(file, {option, name, "--topic", "/count", "--rate", "1000"});
      CHECK(ran.exit == 1);
      CHECK(says(ran.err, std::string(name) + ": the recording has no such topic, and " + option));
      CHECK(says(ran.err, "there is /count"));
    }
  }
  CHECK(audience.heard("/count").empty());
}

TEST_CASE("lot play --remap of one topic to two names, and an option twice, are wrong usage") {
  const Watchdog watchdog(60);
  const Directory directory;
  const std::string file = five(directory);
  Audience audience(file, {"/count"});
  const Ran twice = audience.play(file, {"--remap", "/count:=/a", "--remap", "/count:=/b"});
  CHECK(twice.exit == 2);
  CHECK(says(twice.err, "--remap gives /count two names"));
  const Ran end = audience.play(file, {"--end", "1", "--end", "2"});
  CHECK(end.exit == 2);
  CHECK(says(end.err, "--end stands there twice: write it once"));
  CHECK(audience.heard("/count").empty());
}

TEST_CASE("lot play says which other process publishes on its topic") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = five(directory);
  Audience audience(file, {"/count"});
  const Ran both = audience.play(file, {"--rate", "100"});
  CHECK(both.exit == 0);
  const std::string line = "/count: 1 tool_play publishes on it as well, and its subscribers get";
  CHECK(says(both.err, "* " + line));
  CHECK(says(both.json().at("hints").dump(), line));
  const Ran alone = audience.play(file, {"--rate", "100", "--remap", "/count:=/other"});
  CHECK(alone.exit == 0);
  CHECK_FALSE(says(alone.err, "publishes on it as well"));
}

TEST_CASE("lot play --json has a document, with its status, also where it ends at its begin") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = five(directory);
  const Audience audience(file, {"/count"});
  write_file(directory.file("text"), "some text that is long enough to be read");
  const struct {
    std::string file;
    std::vector<std::string> words;
    int exit;
    std::string says;
  } parts[] = {{directory.file("none"), {}, 1, "No such file"},
               {directory.file("text"), {}, 3, "not an MCAP file"},
               {file, {"--topic", "/conut"}, 1, "there is /count"}};
  for (const auto& [name, words, exit, says_why] : parts) {
    CAPTURE(name);
    const Ran ran = audience.play(name, words);
    CHECK(ran.exit == exit);
    CHECK(ran.json().at("exit") == exit);
    CHECK(ran.json().at("segment").is_null());
    CHECK(says(ran.json().at("hints").at(0).get<std::string>(), says_why));
    CHECK(says(ran.err, says_why));
  }
}

TEST_CASE("lot play of a segment's name that is mistyped says which there are, and makes it") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = five(directory);
  const Audience audience(file, {"/count"});
  auto options = audience.stage.options;
  options.segment = "typo";
  const Ran ran = run_lot(on(options, {"play", file, "--rate", "100"}));
  CHECK(ran.exit == 0);
  CHECK(says(ran.err, "* there is no segment typo in "));
  CHECK(says(ran.err, "; there is " + audience.stage.options.segment + ": it is made\n"));
}

TEST_CASE("lot play --loop plays the same part again and again") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = five(directory);
  Audience audience(file, {"/count"});
  Running player(on(audience.stage.options, {"play", file, "--json", "--loop", "--rate", "1000",
                                             "--start", "0.5", "--end", "1.5"}));
  auto& puller = audience.pullers.at("/count");
  for (int round = 0; round < 5; ++round) {
    for (const std::uint64_t n : {2U, 3U, 4U}) {
      const auto message = puller.pull(20s);
      REQUIRE(message);
      CHECK(message.root()["n"].as<std::uint64_t>() == n);
    }
  }
  CHECK(player.interrupt().json().at("rounds") >= 5);
}

TEST_CASE("lot play of several files plays them as one, by their times") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string odd =
      file_of_others(directory, {{"/odd", kCount}}, {kSecond, 3 * kSecond, 5 * kSecond}, "o.mcap");
  const std::string even =
      file_of_others(directory, {{"/even", kCount}}, {2 * kSecond, 4 * kSecond}, "e.mcap");
  Audience audience(odd, {"/all"});
  CHECK(audience
            .play(odd, {even, "--rate", "1000", "--remap", "/odd:=/all", "--remap", "/even:=/all"})
            .exit == 0);
  CHECK(audience.heard("/all") == "1 1 2 2 3");
}

TEST_CASE("lot play of times that no clock has: what is due is published, and the rest is not") {
  const Watchdog watchdog(120);
  const Directory directory;
  constexpr auto kLast = std::numeric_limits<std::uint64_t>::max();
  const std::string file =
      file_of_others(directory, {{"/count", kCount}}, {0, 0, kLast / 2, kLast});
  Audience audience(file, {"/count"});
  for (const char* rate : {"1", "0.001"}) {
    Running player(on(audience.stage.options, {"play", file, "--json", "--rate", rate}));
    auto& puller = audience.pullers.at("/count");
    for (const std::uint64_t n : {1U, 2U}) {
      const auto message = puller.pull(20s);
      REQUIRE(message);
      CHECK(message.root()["n"].as<std::uint64_t>() == n);
    }
    std::this_thread::sleep_for(200ms);
    const Ran ran = player.interrupt();
    CHECK(ran.json().at("topics").at(0).at("pushed") == 2);
    CHECK(says(ran.err, "* the next message comes in "));
    CHECK(audience.heard("/count").empty());
  }
  const std::string end = file_of_others(directory, {{"/count", kCount}}, {kLast, kLast}, "e.mcap");
  CHECK(audience.play(end, {}).exit == 0);
  CHECK(audience.heard("/count") == "1 2");
  CHECK(audience.play(end, {"--start", "1e9"}).exit == 1);
}

// ---- keys
// -----------------------------------------------------------------------------------------

/// The command as a shell's words, and behind it what the terminal is like then.
std::string shell(const std::vector<std::string>& words) {
  std::string text = command();
  for (const std::string& word : words) text += " '" + word + "'";
  return text + "; echo ended with $?; stty -a; sleep 60";
}

TEST_CASE("lot play is paused by the space bar, and goes on by it; the terminal is as before") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = five(directory);
  Audience audience(file, {"/count"});
  auto& puller = audience.pullers.at("/count");
  const Terminal terminal(audience.stage.room, 100, 40,
                          shell(on(audience.stage.options, {"play", file, "--paused", "--loop"})));
  REQUIRE(terminal.shows("* paused: the space bar goes on"));
  terminal.press("x");  // no key of it
  CHECK_FALSE(puller.pull(500ms));
  terminal.press("Space");
  REQUIRE(terminal.shows("* goes on"));
  std::uint64_t last = 0;
  const auto listen = [&](std::chrono::seconds most) {
    const auto message = puller.pull(most);
    if (!message) return false;
    const auto n = message.root()["n"].as<std::uint64_t>();
    CHECK(n == last % 5 + 1);  // the next one
    last = n;
    return true;
  };
  for (int i = 0; i < 3; ++i) REQUIRE(listen(20s));
  terminal.press("Space");
  REQUIRE(eventually(
      [&] {
        const std::string text = terminal.text();
        return text.rfind("* paused") > text.rfind("* goes on");
      },
      30s));
  while (listen(0s)) {
  }
  CHECK_FALSE(listen(2s));
  terminal.press("Space");
  for (int i = 0; i < 7; ++i) REQUIRE(listen(20s));
  terminal.press("C-c");
  REQUIRE(terminal.shows("ended with 0"));
  REQUIRE(terminal.shows(" icanon"));
  CHECK(says(terminal.text(), " echo "));
}

TEST_CASE("lot play ends by Ctrl-C while it is paused, and the terminal is as before") {
  const Watchdog watchdog(120);
  const Directory directory;
  const std::string file = five(directory);
  const Audience audience(file, {"/count"});
  const Terminal terminal(audience.stage.room, 100, 40,
                          shell(on(audience.stage.options, {"play", file, "--loop", "--paused"})));
  REQUIRE(terminal.shows("paused"));
  terminal.press("C-c");
  REQUIRE(terminal.shows("ended with "));
  REQUIRE(terminal.shows(" icanon"));
}

TEST_CASE("lot play --paused where no key can come is wrong usage") {
  const Watchdog watchdog(60);
  const Directory directory;
  const std::string file = five(directory);
  Audience audience(file, {"/count"});
  const Ran ran = audience.play(file, {"--paused"});
  CHECK(ran.exit == 2);
  CHECK(says(ran.err, "terminal"));
  CHECK(audience.heard("/count").empty());
}

}  // namespace
