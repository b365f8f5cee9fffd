// SPDX-License-Identifier: Apache-2.0

// `lot top` in a real terminal, with processes that publish and subscribe.

#include <algorithm>
#include <cctype>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "scene.hpp"
#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "support/variable.hpp"
#include "terminal.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const bool has_janitor = start_janitor();

bool says(const std::string& text, const std::string& what) {
  return text.find(what) != std::string::npos;
}

struct Image {
  std::uint64_t number;
  lot::ShmVector<std::uint8_t> data;
};

/// Publishes at an even rate until it is killed.
template <class T, class Fill>
Child publisher(lot::EngineOptions options, const std::string& name, const std::string& topic,
                double per_second, Fill&& fill) {
  options.name = name;
  return Child([=] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<T>(topic);
    const auto begin = std::chrono::steady_clock::now();
    for (std::uint64_t n = 1;; ++n) {
      auto message = pusher.loan();
      fill(*message);
      must_go(pusher.push(std::move(message)));
      std::this_thread::sleep_until(begin + std::chrono::nanoseconds(static_cast<long>(
                                                static_cast<double>(n) * 1e9 / per_second)));
    }
  });
}
Child letters(const lot::EngineOptions& options, const std::string& name, const std::string& topic,
              double per_second) {
  return publisher<Letter>(options, name, topic, per_second, [](Letter&) {});
}
Child images(const lot::EngineOptions& options, const std::string& name, const std::string& topic,
             double per_second, std::size_t bytes) {
  return publisher<Image>(options, name, topic, per_second,
                          [bytes](Image& image) { image.data.resize(bytes); });
}
/// Reads all that comes, or keeps what it got first and looks no more.
Child reader(lot::EngineOptions options, const std::string& name, const std::string& topic,
             bool lags = false) {
  options.name = name;
  return Child([=] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Image>(topic);
    const auto first = puller.pull();
    if (lags) pause();
    while (puller.pull()) {
    }
  });
}

std::string top(const std::string& options) { return command() + " top --interval 200 " + options; }
std::string top_of(const lot::EngineOptions& options, const std::string& more = "") {
  return top("--dir " + options.directory + " --segment " + options.segment + " " + more);
}

/// The number of a cell such as "30.0/s" in the line; nothing when there is none.
std::optional<double> rate_in(const std::string& line) {
  std::istringstream words(line);
  for (std::string word; words >> word;) {
    if (word.size() > 2 && word.substr(word.size() - 2) == "/s" && std::isdigit(word[0]) != 0) {
      return std::stod(word);
    }
  }
  return std::nullopt;
}

/// Two cameras, a slow topic, a reader that reads and one that lags.
struct Traffic {
  explicit Traffic(const Room& room) : options(room.options()) {
    options.size_bytes = 64 << 20;
    options.processes = 9;
    front = images(options, "front", "/camera/front", 50, 300000);
    left = images(options, "left", "/camera/left", 20, 100000);
    pose = letters(options, "odometry", "/pose", 2);
    detector = reader(options, "detector", "/camera/front");
    recorder = reader(options, "recorder", "/camera/left", true);
  }
  lot::EngineOptions options;
  Child front, left, pose, detector, recorder;
};

}  // namespace

TEST_SUITE_BEGIN("top");

TEST_CASE("lot top shows topics and processes, with their rates and bandwidths") {
  const Watchdog watchdog(100);
  const Room room;
  const Traffic traffic(room);
  const Terminal terminal(room, 110, 30, top_of(traffic.options));
  for (const std::string words : {"TOPIC", "PROCESS", "BANDWIDTH", "/camera/front", "/camera/left",
                                  "/pose", " front", "odometry", "detector", "recorder", "s: "}) {
    CAPTURE(words);
    CHECK(terminal.shows(words));
  }
  const auto has_rate = [&](const std::string& name, double least, double most) {
    return eventually(
        [&] {
          const auto rate = rate_in(terminal.line_with(name));
          return rate && *rate > least && *rate < most;
        },
        30s);
  };
  CHECK_MESSAGE(has_rate("/camera/front", 25, 75), terminal.text());
  CHECK_MESSAGE(has_rate("/camera/left", 10, 30), terminal.text());
  CHECK_MESSAGE(has_rate("/pose", 1, 3), terminal.text());
  CHECK_MESSAGE(has_rate("odometry", 1, 3), terminal.text());
  CHECK(eventually([&] { return says(terminal.line_with("/camera/front"), "MiB/s"); }, 30s));
  CHECK(
      eventually([&] { return says(terminal.line_with("/camera/left"), "recorder loses"); }, 30s));
}

TEST_CASE("keys of lot top choose the order, its direction, and the tables") {
  const Watchdog watchdog(100);
  const Room room;
  const Traffic traffic(room);
  const Terminal terminal(room, 110, 30, top_of(traffic.options));
  REQUIRE(terminal.shows("/pose"));
  REQUIRE(terminal.shows("by BANDWIDTH"));
  const auto are_sorted = [&](const std::vector<std::string>& names) {
    return eventually(
        [&] {
          std::vector<int> places;
          for (const auto& name : names) places.push_back(terminal.place_of(name));
          return places.front() >= 0 && std::is_sorted(places.begin(), places.end());
        },
        30s);
  };
  CHECK_MESSAGE(are_sorted({"/camera/front", "/camera/left", "/pose"}), terminal.text());
  terminal.press("-");
  CHECK(terminal.shows("by BANDWIDTH, reversed"));
  CHECK_MESSAGE(are_sorted({"/pose", "/camera/left", "/camera/front"}), terminal.text());
  terminal.press("n");
  CHECK(terminal.shows_no("reversed"));
  CHECK(terminal.shows("by TOPIC"));
  CHECK_MESSAGE(are_sorted({"/camera/front", "/camera/left", "/pose"}), terminal.text());
  terminal.press("Right");  // there is one segment: it has no column
  CHECK(terminal.shows("by RATE"));
  terminal.press("Right");
  CHECK(terminal.shows("by BANDWIDTH"));
  terminal.press("Left");
  terminal.press("Left");
  terminal.press("Left");
  CHECK(terminal.shows("by STATE"));
  CHECK_MESSAGE(are_sorted({"/camera/left", "/camera/front"}), terminal.text());  // recorder loses
  terminal.press("t");
  CHECK(terminal.shows_no("PROCESS"));
  CHECK(terminal.shows("TOPIC"));
  terminal.press("t");
  CHECK(terminal.shows("PROCESS"));
  CHECK(terminal.shows_no("TOPIC"));
  terminal.press("t");
  CHECK(terminal.shows("TOPIC"));
  terminal.press("h");
  CHECK(terminal.shows("reverses the order"));
  CHECK(terminal.shows_no("/camera/front"));
  terminal.press("?");
  CHECK(terminal.shows("/camera/front"));
}

TEST_CASE("lot top pauses: what comes meanwhile is shown when it goes on") {
  const Watchdog watchdog(100);
  const Room room;
  auto options = room.options();
  const Child first = letters(options, "first", "/first", 10);
  const Terminal terminal(room, 100, 20, top_of(options));
  REQUIRE(terminal.shows("/first"));
  terminal.press("p");
  REQUIRE(terminal.shows("paused"));
  const Child second = letters(options, "second", "/second", 10);
  REQUIRE(eventually([&] {
    return says(run_lot(on(options, {"ls", "--interval", "1"})).out, "/second");
  }));
  std::this_thread::sleep_for(1s);  // five intervals
  CHECK(!says(terminal.text(), "/second"));
  terminal.press("Space");
  CHECK(terminal.shows("/second"));
}

TEST_CASE("lot top takes each width: columns go in their order, and below 20 some words say why") {
  const Watchdog watchdog(100);
  const Room room;
  const Traffic traffic(room);
  const Terminal terminal(room, 120, 30, top_of(traffic.options));
  REQUIRE(terminal.shows("STATE"));
  REQUIRE(terminal.shows("PID"));
  // The last columns of one width are gone at the next.
  const std::vector<std::pair<unsigned, std::pair<std::string, std::string>>> steps = {
      {76, {"STATE", "PID"}},        {60, {"LOST", "SUB"}},         {44, {"MEMORY", "LAG"}},
      {36, {"BANDWIDTH", "MEMORY"}}, {20, {"RATE", "BANDWIDTH  "}},
  };
  for (const auto& [width, words] : steps) {
    CAPTURE(width);
    terminal.resize(width, 30);
    CHECK_MESSAGE(terminal.shows_no(words.second), terminal.text());
    CHECK_MESSAGE(terminal.shows(words.first), terminal.text());
    CHECK(terminal.shows("/cam"));  // the names are cut
    for (const auto& line : terminal.lines()) CHECK(line.size() <= width);
  }
  terminal.resize(10, 10);
  CHECK(terminal.shows("narrow:"));
  CHECK(terminal.shows("columns"));
  CHECK(terminal.shows_no("TOPIC"));
  terminal.resize(120, 30);
  CHECK(terminal.shows("STATE"));
  CHECK(terminal.shows_no("narrow:"));
}

TEST_CASE("lot top scrolls where the rows are too many") {
  const Watchdog watchdog(100);
  const Room room;
  const Traffic traffic(room);
  const Terminal terminal(room, 100, 30, top_of(traffic.options));
  for (const char* name : {"/pose", " front", " left", " odometry", " detector", " recorder"}) {
    REQUIRE(terminal.shows(name));
  }
  terminal.resize(100, 7);
  REQUIRE(terminal.shows("lines 1-5 of "));
  REQUIRE(terminal.shows_no("PROCESS"));
  terminal.press("NPage");
  CHECK(terminal.shows("lines 5-9 of "));
  terminal.press("Down");
  CHECK(terminal.shows("lines 6-10 of "));
  terminal.press("Up");
  CHECK(terminal.shows("lines 5-9 of "));
  terminal.press("End");
  CHECK(terminal.shows("recorder"));
  // More lines above it: the end stays in sight.
  const Child late = letters(traffic.options, "late", "/late", 10);
  CHECK(terminal.shows("late"));
  CHECK(terminal.shows("recorder"));
  terminal.press("Home");
  CHECK(terminal.shows("lines 1-5 of "));
}

TEST_CASE("q, Ctrl-C and a signal end lot top, and leave the terminal as it was") {
  const Watchdog watchdog(100);
  const Room room;
  const auto options = room.options();
  const Child child = letters(options, "child", "/letters", 10);
  const std::string before = room.path() + "/before";
  const std::string after = room.path() + "/after";
  const std::string pid = room.path() + "/pid";
  const auto ends = [&](const char* key, int signal) {
    std::filesystem::remove(after);
    const Terminal terminal(room, 100, 20,
                            "trap : INT; ulimit -c 0; stty -g >" + before +
                                "; echo plain; sh -c \"echo \\$\\$ >" + pid + "; exec " +
                                top_of(options) + "\"; echo ended by $?; stty -g >" + after +
                                "; exec sleep 100");
    REQUIRE(terminal.shows("/letters"));
    CHECK(!says(terminal.text(), "plain"));  // it is a screen of its own
    if (signal != 0) {
      REQUIRE(kill(std::stoi(bytes_of(pid)), signal) == 0);
    } else {
      terminal.press(key);
    }
    CHECK_MESSAGE(terminal.shows("ended by " + std::to_string(signal != 0 ? 128 + signal : 0)),
                  terminal.text());
    CHECK(terminal.shows("plain"));
    CHECK(terminal.shows_no("/letters"));
    CHECK(terminal.cursor_is_visible());
    REQUIRE(eventually([&] { return !bytes_of(after).empty(); }));
    CHECK(bytes_of(before) == bytes_of(after));
  };
  ends("q", 0);
  ends("C-c", 0);
  for (const int signal : {SIGTERM, SIGHUP, SIGSEGV, SIGABRT}) ends("", signal);
}

TEST_CASE("lot top names the TERM that ncurses does not know") {
  const Watchdog watchdog(100);
  const Room room;
  const lot::ShmEngine engine(room.options());
  const Terminal terminal(room, 150, 20,
                          "TERM= " + top_of(room.options()) + "; echo ended by $?; sleep 100");
  CHECK_MESSAGE(terminal.shows("lot: TERM=: ncurses does not know this terminal; set TERM to"),
                terminal.text());
  CHECK(terminal.shows("ended by 1"));
}

TEST_CASE("a signal ends lot top also where its terminal takes nothing") {
  const Watchdog watchdog(100);
  const Room room;
  const auto options = room.options();
  const Child child = letters(options, "child", "/letters", 10);
  const std::string file = room.path() + "/pid";
  for (const int signal : {SIGTERM, SIGINT}) {
    const Terminal terminal(
        room, 100, 20,
        "sh -c \"echo \\$\\$ >" + file + "; exec " + top_of(options) + "\"; exec sleep 100");
    REQUIRE(terminal.shows("/letters"));
    const pid_t pid = std::stoi(bytes_of(file));
    terminal.press("C-s");
    std::this_thread::sleep_for(600ms);  // three screens
    CHECK(eventually([&] { return kill(pid, signal) != 0; }));
  }
}

TEST_CASE("lot top goes on when a segment goes, comes back, and is damaged") {
  const Watchdog watchdog(100);
  const Room room;
  const auto options = room.options();
  const Terminal terminal(room, 100, 20, top_of(options));
  const std::string segment = options.directory + "/" + options.segment;
  CHECK(terminal.shows("no segment " + segment + ": waiting for it"));
  {
    const Child first = letters(options, "first", "/letters", 10);
    CHECK(terminal.shows("s has come"));
    CHECK(terminal.shows("1 first"));
  }
  CHECK(terminal.shows("no process lives in it"));
  CHECK(terminal.shows("dead"));
  REQUIRE(run_lot(on(options, {"clean"})).exit == 0);
  CHECK(terminal.shows("s has gone"));
  CHECK(terminal.shows_no("1 first"));
  Child second = letters(options, "second", "/letters", 10);
  CHECK(terminal.shows("1 second"));
  CHECK(eventually([&] { return rate_in(terminal.line_with("/letters")).has_value(); }, 30s));
  second.kill9();
  const int file = open(segment.c_str(), O_RDWR | O_CLOEXEC);
  REQUIRE(file != -1);
  const std::uint32_t other = 999;
  REQUIRE(pwrite(file, &other, sizeof(other), 8) == sizeof(other));
  CHECK(terminal.shows("s: damaged: "));
  CHECK(terminal.shows("layout version 999"));
  CHECK(terminal.shows_no("1 second"));
  REQUIRE(ftruncate(file, 5000) == 0);
  close(file);
  CHECK(terminal.shows("s: damaged: "));
  std::filesystem::remove(segment);
  std::filesystem::remove(segment + ".lock");
  const Child third = letters(options, "third", "/letters", 10);
  CHECK(terminal.shows("1 third"));
  CHECK(terminal.shows_no("damaged"));
}

TEST_CASE("lot top sees that another segment has taken the place of one, though it saw no gap") {
  const Watchdog watchdog(100);
  const Room room;
  const auto options = room.options();
  Child first = letters(options, "first", "/letters", 10);
  const Terminal terminal(room, 100, 20, top_of(options));
  REQUIRE(terminal.shows("1 first"));
  terminal.press("p");
  REQUIRE(terminal.shows("paused"));
  first.kill9();
  REQUIRE(run_lot(on(options, {"clean"})).exit == 0);
  const Child second = letters(options, "second", "/letters", 10);
  REQUIRE(eventually([&] {
    return says(run_lot(on(options, {"ls", "--interval", "1"})).out, "1 second");
  }));
  terminal.press("p");
  CHECK(terminal.shows("s has come anew"));
  CHECK(terminal.shows("1 second"));
}

TEST_CASE("lot top outlives a segment that is cut short, and a directory that goes") {
  const Watchdog watchdog(100);
  const Room room;
  auto options = room.options();
  options.directory = room.path() + "/inner";
  REQUIRE(mkdir(options.directory.c_str(), 0700) == 0);
  const Child child = letters(options, "child", "/letters", 10);
  const Terminal terminal(room, 100, 20, top_of(options));
  REQUIRE(terminal.shows("/letters"));
  child.send(SIGSTOP);
  REQUIRE(truncate((options.directory + "/" + options.segment).c_str(), 4096) == 0);
  CHECK_MESSAGE(terminal.shows("damaged"), terminal.text());
  std::filesystem::remove_all(options.directory);
  CHECK_MESSAGE(terminal.shows("cannot read the segment directory"), terminal.text());
  REQUIRE(mkdir(options.directory.c_str(), 0700) == 0);
  CHECK(terminal.shows("waiting for it"));
}

TEST_CASE("several segments share the tables of lot top") {
  const Watchdog watchdog(100);
  const Room room;
  const Child one = letters(room.options("one"), "a", "/letters", 10);
  const Child two = letters(room.options("two"), "b", "/parcels", 10);
  const Terminal terminal(room, 110, 20, top("--dir " + room.path()));
  CHECK(terminal.shows("one: "));
  CHECK(terminal.shows("two: "));
  CHECK(terminal.shows("SEGMENT"));
  CHECK(eventually([&] { return says(terminal.line_with("/letters"), "one"); }));
  CHECK(eventually([&] { return says(terminal.line_with("/parcels"), "two"); }));
  terminal.press("g");
  CHECK(terminal.shows("by SEGMENT"));
}

TEST_CASE("names that would steer a terminal reach it harmless") {
  const Watchdog watchdog(100);
  const Room room;
  const auto options = room.options();
  const Child child =
      letters(options, "a\033[2Jb\xff\x9b\x31\x6d", "/t\n\033]0;taken\a\xe2\x80\xae\r", 10);
  const Terminal terminal(room, 100, 20, top_of(options));
  CHECK(terminal.shows("1 a?[2Jb??1m"));
  CHECK(terminal.shows("/t??]0;taken?????"));
  CHECK(terminal.shows("TOPIC"));
  CHECK(terminal.title() != "taken");
  const Ran text = run_lot(on(options, {"top", "--once", "--interval", "1"}));
  for (const char c : text.out) {
    const bool is_harmless = c == '\n' || (c >= ' ' && c <= '~');
    REQUIRE(is_harmless);
  }
  CHECK(says(text.out, "1 a?[2Jb??1m"));
}

TEST_CASE("in a terminal, too, lot top --once is text, and so is what goes elsewhere") {
  const Watchdog watchdog(100);
  const Room room;
  const auto options = room.options();
  const Child child = letters(options, "child", "/letters", 10);
  REQUIRE(eventually([&] {
    return says(run_lot(on(options, {"ls", "--interval", "1"})).out, "/letters");
  }));
  const std::string file = room.path() + "/text";
  const Terminal terminal(room, 200, 40,
                          top_of(options, "--once") + "; echo ended by $?; " + top_of(options) +
                              " >" + file + "; echo both ended; exec sleep 100");
  REQUIRE_MESSAGE(terminal.shows("ended by 0"), terminal.text());
  REQUIRE_MESSAGE(terminal.shows("both ended"), terminal.text());
  CHECK(terminal.shows("/letters"));
  CHECK(says(bytes_of(file), "/letters"));
}

TEST_CASE("without a terminal lot top prints one screen as text, and ends as lot ls does") {
  const Watchdog watchdog(100);
  const Room room;
  CHECK(run_lot(on(room.options(), {"top"})).exit == 1);
  {
    const Scene scene;
    const auto words = on(scene.options, {"top", "--interval", "1"});
    const Ran ran = run_lot(words);
    CHECK(ran.exit == 0);
    CHECK(says(ran.out, "TOPIC"));
    CHECK(says(ran.out, "1 publisher waits for 2 reader"));
    CHECK(says(ran.out, "holds /parcels back"));
    CHECK(!says(ran.out, "\033"));
  }
  Child child = letters(room.options(), "child", "/letters", 10);
  REQUIRE(eventually([&] {
    return run_lot(on(room.options(), {"top", "--interval", "1"})).exit == 0;
  }));
  child.kill9();
  const Ran dead = run_lot(on(room.options(), {"top", "--interval", "1"}));
  CHECK(dead.exit == 1);
  CHECK(says(dead.out, "no process lives in s"));
  CHECK(run_lot({"top", "--interval", "0"}).exit == 2);
}

TEST_CASE("the bandwidth of a topic is its rate times the size of its messages") {
  const Watchdog watchdog(100);
  const Room room;
  const auto options = room.options();
  const auto topic = [&] {
    const Json document = run_lot(on(options, {"top", "--json", "--interval", "2000"})).json();
    const Json& segments = document.at("segments");
    if (segments.empty() || !segments.at(0).contains("topics")) return Json();  // it is being made
    const Json& topics = segments.at(0).at("topics");
    return topics.empty() ? Json() : topics.at(0);
  };
  const auto bytes_of_message = [&]() -> double {
    Json seen;
    const bool has_rate = eventually(
        [&] {
          seen = topic();
          return !seen.is_null() && !seen.at("per_second").is_null() &&
                 !seen.at("bytes_per_second").is_null();
        },
        30s);
    REQUIRE(has_rate);
    return seen.at("bytes_per_second").get<double>() / seen.at("per_second").get<double>();
  };
  {
    const Child small = letters(options, "small", "/small", 50);
    CHECK(bytes_of_message() == doctest::Approx(sizeof(Letter)));
  }
  REQUIRE(run_lot(on(options, {"clean"})).exit == 0);
  {
    const Child fixed = publisher<Parcel>(options, "fixed", "/fixed", 50, [](Parcel&) {});
    CHECK(bytes_of_message() == doctest::Approx(sizeof(Parcel)));
  }
  REQUIRE(run_lot(on(options, {"clean"})).exit == 0);
  const Child large = images(options, "large", "/large", 50, 1 << 18);  // whole granules
  const double bytes = bytes_of_message();
  CHECK(bytes >= (1 << 18));
  CHECK(bytes <= (1 << 18) * 17 / 16 + 4096);
}

TEST_CASE("the picture of lot top for the README can be made, and has what the screen has") {
  const Watchdog watchdog(100);
  const Room room;
  const Variable stamps("LOT_STAMP", "1");
  const Traffic traffic(room);
  const Terminal terminal(room, 112, 16, top_of(traffic.options));
  REQUIRE(terminal.shows("recorder loses"));
  for (const std::string name : {"/pose", "/camera/front", "/camera/left"}) {
    CAPTURE(name);
    REQUIRE(eventually([&] { return says(terminal.line_with(name), "B/s"); }, 30s));
  }
  const std::string capture = room.path() + "/capture";
  std::ofstream(capture) << terminal.text({"-e", "-N"});
  const char* const wanted = std::getenv("LOT_PICTURE");
  const std::string picture = wanted != nullptr ? wanted : room.path() + "/picture.svg";
  const Ran ran = run_program({LOT_DRAW, capture, picture});
  CHECK_MESSAGE(ran.exit == 0, ran.err);
  std::string svg = bytes_of(picture);
  for (auto at = svg.find("&#160;"); at != svg.npos; at = svg.find("&#160;", at))
    svg.replace(at, 6, " ");
  CHECK(says(svg, "</svg>"));
  for (const std::string words :
       {"TOPIC", "BANDWIDTH", "DELAY", "/camera/front", "/camera/left", "/pose", "PROCESS",
        "detector", "recorder loses messages", "q quit"}) {
    CAPTURE(words);
    CHECK(says(svg, words));
  }
  CHECK(!says(svg, "https://"));  // it shows itself without the network
  CHECK(run_program({LOT_DRAW, capture}).exit == 2);
}

TEST_SUITE_END();
