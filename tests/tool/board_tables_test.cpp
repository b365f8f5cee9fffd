// SPDX-License-Identifier: Apache-2.0

// The screens of `lot top`, character by character: cells, widths, orders, scrolling.

#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "command.hpp"
#include "segment/layout.hpp"
#include "support/janitor.hpp"
#include "tool/board.hpp"
#include "tool/rows.hpp"

namespace {

using namespace lot::testing;
using namespace lot::tool;

[[maybe_unused]] const bool has_janitor = start_janitor();

/// A line with a letter before each piece that is not plain: its style.
std::string styled(const Line& line) {
  std::string text;
  for (const Piece& piece : line) {
    text += piece.style == Style::Title    ? "T["
            : piece.style == Style::Head   ? "H["
            : piece.style == Style::Sorted ? "S["
            : piece.style == Style::Wrong  ? "W["
                                           : "[";
    text += piece.text + "]";
  }
  return text;
}

std::string plain(const std::vector<Line>& lines) {
  std::string all;
  for (const Line& line : lines) all += text_of(line) + "\n";
  return all;
}

Activity topic(const std::string& name) {
  Activity a;
  a.name = name;
  return a;
}

/// Two topics and two processes, with something in each column.
std::vector<Watched> one_segment() {
  std::vector<Watched> all(1);
  all[0].sight.name = "one";
  Activity cam = topic("/cam");
  cam.rate.per_second = 30;
  cam.bytes_per_second = 30 << 20;
  cam.memory = 64 << 20;
  cam.lag = 5;
  cam.lost = 100000;
  cam.publishers = 1;
  cam.subscribers = 12;
  cam.has_stamps = true;
  cam.delay = 0.25;
  cam.state = "3 viewer loses messages";
  cam.is_wrong = true;
  all[0].topics = {topic("/a_long_name"), cam};
  Activity process = topic("1 camera");
  process.pid = 4711;
  process.rate.below = 2;
  Activity other = topic("2 viewer");
  other.pid = 123456;
  other.memory = 4096;
  all[0].processes = {other, process};
  return all;
}

std::string tables_at(std::size_t width, const std::string& keys = "") {
  Board board;
  for (const char key : keys) CHECK(board.press(key));
  return "\n" + plain(board.tables(one_segment(), width));
}

/// The first letters of the names, in the order of the table, after these keys.
std::string order(const std::vector<Watched>& segments, const std::string& keys) {
  Board board;
  for (const char key : keys) CHECK(board.press(key));
  std::string letters;
  for (const Line& line : board.tables(segments, 200)) {
    if (!line.empty() && line[0].text[0] == '/') letters += line[0].text[1];
  }
  return letters;
}

/// The order of two rows with these rates, by rate.
std::string order_of(double a, double b, const std::string& keys = "r") {
  std::vector<Watched> all(1);
  for (const auto& [name, value] : {std::pair("/a", a), std::pair("/b", b)}) {
    all[0].topics.push_back(topic(name));
    all[0].topics.back().rate.per_second = value;
  }
  return order(all, keys);
}
bool are_alike(double a, double b) {
  return order_of(a, b) == "ab" && order_of(a, b, "r-") == "ab";
}

lot::segment::Capacity capacity_of(const std::string& path) {
  lot::segment::Capacity capacity;
  std::ifstream file(path, std::ios::binary);
  file.seekg(offsetof(lot::segment::Header, capacity));
  file.read(reinterpret_cast<char*>(&capacity), sizeof(capacity));
  return capacity;
}
void write_word(const std::string& path, std::uint64_t at, std::uint32_t word) {
  std::fstream file(path, std::ios::binary | std::ios::in | std::ios::out);
  file.seekp(static_cast<std::streamoff>(at));
  file.write(reinterpret_cast<const char*>(&word), sizeof(word));
}

}  // namespace

TEST_SUITE_BEGIN("board_tables");

TEST_CASE("lot top's tables, at widths that have room for fewer and fewer columns") {
  CHECK(tables_at(200) == R"(
TOPIC             RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  SUB  STATE
/cam            30.0/s    30 MiB/s    64 MiB      5   100k    250 ms    1   12  3 viewer loses messages
/a_long_name                             0 B

PROCESS           RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  SUB     PID  STATE
1 camera         < 2/s                   0 B                                      4711
2 viewer                               4 KiB                                    123456
)");
  CHECK(tables_at(100) == R"(
TOPIC             RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  SUB  STATE
/cam            30.0/s    30 MiB/s    64 MiB      5   100k    250 ms    1   12  3 viewer .. messages
/a_long_name                             0 B

PROCESS         RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  SUB     PID  STATE
1 camera       < 2/s                   0 B                                      4711
2 viewer                             4 KiB                                    123456
)");
  CHECK(tables_at(99) == R"(
TOPIC             RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  SUB  STATE
/cam            30.0/s    30 MiB/s    64 MiB      5   100k    250 ms    1   12  3 viewer..messages
/a_long_name                             0 B

PROCESS           RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  SUB  STATE
1 camera         < 2/s                   0 B
2 viewer                               4 KiB
)");
  CHECK(tables_at(92) == R"(
TOPIC           RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  SUB  STATE
/cam          30.0/s    30 MiB/s    64 MiB      5   100k    250 ms    1   12  3 view..ssages
/a_l..name                             0 B

PROCESS         RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  SUB  STATE
1 camera       < 2/s                   0 B
2 viewer                             4 KiB
)");
  CHECK(tables_at(91) == R"(
TOPIC             RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  STATE
/cam            30.0/s    30 MiB/s    64 MiB      5   100k    250 ms    1  3 viewe..essages
/a_long_name                             0 B

PROCESS           RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY  PUB  STATE
1 camera         < 2/s                   0 B
2 viewer                               4 KiB
)");
  CHECK(tables_at(80) == R"(
TOPIC             RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY
/cam            30.0/s    30 MiB/s    64 MiB      5   100k    250 ms
/a_long_name                             0 B

PROCESS           RATE   BANDWIDTH    MEMORY    LAG   LOST     DELAY
1 camera         < 2/s                   0 B
2 viewer                               4 KiB
)");
  CHECK(tables_at(60) == R"(
TOPIC             RATE   BANDWIDTH    MEMORY    LAG   LOST
/cam            30.0/s    30 MiB/s    64 MiB      5   100k
/a_long_name                             0 B

PROCESS           RATE   BANDWIDTH    MEMORY    LAG   LOST
1 camera         < 2/s                   0 B
2 viewer                               4 KiB
)");
  CHECK(tables_at(40) == R"(
TOPIC             RATE   BANDWIDTH
/cam            30.0/s    30 MiB/s
/a_long_name

PROCESS           RATE   BANDWIDTH
1 camera         < 2/s
2 viewer
)");
  CHECK(tables_at(20) == R"(
TOPIC           RATE
/cam          30.0/s
/a_l..name

PROCESS         RATE
1 camera       < 2/s
2 viewer
)");
  const std::string least = "\nTOPIC\n/cam\n/a_l..name\n\nPROCESS\n1 camera\n2 viewer\n";
  CHECK(tables_at(10) == least);  // narrower than a screen may be
  CHECK(tables_at(5) == least);
  CHECK(tables_at(60, "t") == R"(
TOPIC             RATE   BANDWIDTH    MEMORY    LAG   LOST
/cam            30.0/s    30 MiB/s    64 MiB      5   100k
/a_long_name                             0 B
)");
  CHECK(tables_at(60, "tt") == R"(
PROCESS         RATE   BANDWIDTH    MEMORY    LAG   LOST
1 camera       < 2/s                   0 B
2 viewer                             4 KiB
)");
  CHECK(tables_at(60, "ttt") == tables_at(60));
  CHECK(plain(Board().tables({}, 80)).empty());
}

TEST_CASE("lot top's heads and rows have the styles of what they say") {
  Board board;
  std::string all;
  for (const Line& line : board.tables(one_segment(), 40)) all += styled(line) + "\n";
  CHECK("\n" + all == R"(
H[TOPIC       ]H[  ]H[    RATE]H[  ]S[ BANDWIDTH]
W[/cam        ][  ]W[  30.0/s][  ]W[  30 MiB/s]
[/a_long_name][  ][        ][  ][          ]

H[PROCESS     ]H[  ]H[    RATE]H[  ]S[ BANDWIDTH]
[1 camera    ][  ][   < 2/s][  ][          ]
[2 viewer    ][  ][        ][  ][          ]
)");
}

TEST_CASE("each column of lot top sorts: the largest number first, texts by the alphabet") {
  std::vector<Watched> all(2);
  all[0].sight.name = "y";
  all[1].sight.name = "x";
  const auto number = [](int n) { return static_cast<std::uint64_t>(n); };
  // Each column has another order of the rows a, b, c.
  const auto add = [&](Watched& to, const char* name, int rate, int bytes, int memory, int lag,
                       int lost, double delay, int pub, int sub, const char* state) {
    Activity a = topic(name);
    a.rate.per_second = rate;
    a.bytes_per_second = bytes;
    a.memory = number(memory);
    a.lag = number(lag);
    a.lost = number(lost);
    a.delay = delay;
    a.has_stamps = true;
    a.publishers = number(pub);
    a.subscribers = number(sub);
    a.state = state;
    to.topics.push_back(a);
  };
  add(all[0], "/b", 10, 20, 30, 10, 20, 3, 1, 2, "");
  add(all[1], "/c", 20, 10, 20, 30, 20, 1, 3, 1, "stuck");
  add(all[1], "/a", 30, 30, 10, 20, 10, 2, 3, 1, "loses");
  const std::pair<const char*, const char*> kOrders[] = {{"", "abc"},
                                                         {"n", "abc"},
                                                         {"n-", "cba"},
                                                         {"g", "acb"},
                                                         {"g-", "bac"},
                                                         {"r", "acb"},
                                                         {"r-", "bca"},
                                                         {"b", "abc"},
                                                         {"b-", "cba"},
                                                         {"m", "bca"},
                                                         {"m-", "acb"},
                                                         {"l", "cab"},
                                                         {"l-", "bac"},
                                                         {"o", "bca"},
                                                         {"o-", "abc"},
                                                         {"d", "bac"},
                                                         {"d-", "cab"},
                                                         {"u", "acb"},
                                                         {"u-", "bac"},
                                                         {"s", "bac"},
                                                         {"s-", "acb"},
                                                         {"e", "acb"},
                                                         {"e-", "bca"},
                                                         {"r-n", "abc"},  // another column begins
                                                                          // in its own order
                                                         {"r-r", "bca"},
                                                         {"r--", "acb"}};
  for (const auto& [keys, expected] : kOrders) {
    CAPTURE(std::string(keys));
    CHECK(order(all, keys) == expected);
  }
}

TEST_CASE("rows whose measured numbers have the same two digits are in the order of their names") {
  CHECK(are_alike(30, 30));
  CHECK(are_alike(29.96, 30.04));
  CHECK(are_alike(30.04, 29.96));
  CHECK(are_alike(9.96, 10.04));
  CHECK(are_alike(0.0123, 0.0124));
  CHECK(are_alike(1234, 1240));
  CHECK(are_alike(0, 0));
  for (const auto& [more, less] : {std::pair(31.0, 30.0), std::pair(0.013, 0.012),
                                   std::pair(0.5, 0.0), std::pair(1.1e6, 1e6)}) {
    CHECK(order_of(more, less) == "ab");
    CHECK(order_of(less, more) == "ba");
    CHECK(order_of(more, less, "r-") == "ba");
    CHECK(order_of(less, more, "r-") == "ab");
  }
  std::vector<Watched> same(2);  // and where the names are the same, as they were found
  same[0].sight.name = same[1].sight.name = "s";
  same[0].topics = {topic("/t"), topic("/t")};
  same[1].topics = {topic("/t")};
  for (int n = 0; n < 2; ++n) same[0].topics[static_cast<std::size_t>(n)].pid = n;
  same[0].topics[0].state = "1";
  same[0].topics[1].state = "2";
  same[1].topics[0].state = "3";
  CHECK(plain(Board().tables(same, 200)).find("1\n") <
        plain(Board().tables(same, 200)).find("2\n"));
  CHECK(plain(Board().tables(same, 200)).find("2\n") <
        plain(Board().tables(same, 200)).find("3\n"));
}

TEST_CASE("left and right choose each column in turn that is on the screen") {
  Board board;
  const auto sorted_by = [&] {
    std::string head;
    for (const Line& line : board.tables(one_segment(), 100)) {
      for (const Piece& piece : line) {
        if (piece.style == Style::Sorted && head.empty()) head = piece.text;
      }
    }
    const auto first = head.find_first_not_of(' ');
    return head.substr(first, head.find_last_not_of(' ') + 1 - first);
  };
  CHECK(board.press(kRight));  // before the first screen there is no column to go to
  CHECK(sorted_by() == "BANDWIDTH");
  std::string heads;
  for (int n = 0; n < 12; ++n) {
    CHECK(board.press(kRight));
    heads += sorted_by() + " ";
  }
  CHECK(heads == "MEMORY LAG LOST DELAY PUB SUB PID STATE TOPIC RATE BANDWIDTH MEMORY ");
  heads.clear();
  for (int n = 0; n < 12; ++n) {
    CHECK(board.press(kLeft));
    heads += sorted_by() + " ";
  }
  CHECK(heads == "BANDWIDTH RATE TOPIC STATE PID SUB PUB DELAY LOST LAG MEMORY BANDWIDTH ");
}

TEST_CASE("lot top's screen has a title, a part of what there is, and a foot") {
  const Watch watch({"/a/directory/that/is/not/there", "", {}});
  Board board;
  CHECK(!board.is_paused());
  CHECK(board.press('p'));
  CHECK(board.is_paused());
  const auto screen = [&](std::size_t width, std::size_t height) {
    std::string all;
    for (const Line& line : board.screen(watch, width, height)) all += styled(line) + "\n";
    return "\n" + all;
  };
  const std::string nothing = "no segments in /a/directory/that/is/not/there: waiting for one";
  CHECK(screen(100, 5) == "\nT[" + std::string("lot top  paused  by BANDWIDTH").append(71, ' ') +
                              "]\nW[" + nothing + "]\n\n\nT[" +
                              std::string("q quit  h help  t tables  left/right sort  - reverse  p "
                                          "pause")
                                  .append(39, ' ') +
                              "]\n");
  CHECK(screen(19, 5) == "\nW[too narrow: it]\nW[needs 20 columns]\n");
  CHECK(screen(19, 1) == "\nW[too narrow: it]\n");
  CHECK(screen(19, 0) == "\nW[too narrow: it]\n");
  CHECK(screen(0, 2) == "\nW[t]\nW[o]\n");
  CHECK(screen(20, 9).find("W[no segments in]\nW[/a/directory/that/is]\nW[/not/there: waiting]\n"
                           "W[for one]\n") != std::string::npos);
  CHECK(board.press('n'));
  CHECK(screen(50, 3).find("paused  by TOPIC ") != std::string::npos);
  for (const int key : {int{kDown}, int{kEnd}}) {  // all of it is on the screen: it stays
    CHECK(board.press(key));
    CHECK(screen(100, 9).find("]\nW[" + nothing + "]\n\n") != std::string::npos);
  }
  CHECK(board.press(kBegin));
  CHECK(board.press('-'));
  CHECK(board.press('i'));
  CHECK(board.press('-'));
  CHECK(screen(50, 3) == "\nT[lot top  paused  by PID, reversed                 ]\nW[" +
                             nothing.substr(0, 46) + "]\nT[" +
                             "lines 1-1 of 2  q quit  h help  t tables  left/rig]\n");
  CHECK(screen(50, 2) == "\nT[lot top  paused  by PID, reversed                 ]\nW[" +
                             nothing.substr(0, 46) + "]\n");
  CHECK(screen(50, 1) == "\nW[" + nothing.substr(0, 46) + "]\n");
  CHECK(screen(50, 0) == screen(50, 1));
  CHECK(board.press(' '));
  CHECK(!board.is_paused());
  CHECK(screen(100, 5).substr(0, 12) == "\nT[lot top  ");
  CHECK(screen(100, 5)[14] == ':');
  CHECK(screen(100, 5)[17] == ':');
  CHECK(screen(100, 5).substr(20, 2) == "  ");
}

TEST_CASE("lot top's help fits each width, and is broken between words") {
  const Watch watch({"/", "", {}});
  Board board;
  CHECK(board.press('h'));
  const auto body = [&](std::size_t width) {
    std::string all;
    const auto lines = board.screen(watch, width, 200);
    for (std::size_t n = 1; n + 1 < lines.size() && !text_of(lines[n]).empty(); ++n) {
      all += styled(lines[n]) + "\n";
    }
    return "\n" + all;
  };
  CHECK(body(80) == R"(
[left, right: sort by another column; or type its letter]
[-: reverses the order]
[t: topics, processes, or both]
[space, p: pauses, and goes on]
[up, down: scroll, as page up and page down]
[home, end: to the first line, or to the last one of all that come]
[h, ?: this help, and back]
[q, Ctrl-C: ends]
)");
  CHECK(body(20) == R"(
[left, right: sort by]
[another column; or]
[type its letter]
[-: reverses the]
[order]
[t: topics,]
[processes, or both]
[space, p: pauses,]
[and goes on]
[up, down: scroll, as]
[page up and page]
[down]
[home, end: to the]
[first line, or to]
[the last one of all]
[that come]
[h, ?: this help, and]
[back]
[q, Ctrl-C: ends]
)");
  const std::string all = plain(board.screen(watch, 80, 200));
  CHECK(all.find("n  TOPIC: the topic, or ") != all.npos);
  CHECK(all.find("i  PID: process id, ") != all.npos);
  CHECK(board.press('?'));
  CHECK(plain(board.screen(watch, 80, 200)).find("i  PID") == all.npos);
}

TEST_CASE("keys scroll lot top by lines and pages, and no further than there is anything") {
  const Watch watch({"/", "", {}});
  Board board;
  const auto place = [&](std::size_t height) {
    const auto lines = board.screen(watch, 100, height);
    const std::string foot = text_of(lines.back());
    return foot.substr(0, foot.find("  ")) + " " + text_of(lines.at(1)).substr(0, 4);
  };
  CHECK(board.press(kDown));
  CHECK(board.press('h'));
  const std::pair<int, const char*> kSteps[] = {
      {kResize, "lines 1-5 of 21 left"},     {kDown, "lines 2-6 of 21 -: r"},
      {kDown, "lines 3-7 of 21 t: t"},       {kUp, "lines 2-6 of 21 -: r"},
      {kUp, "lines 1-5 of 21 left"},         {kUp, "lines 1-5 of 21 left"},
      {kPageDown, "lines 5-9 of 21 up, "},   {kPageUp, "lines 1-5 of 21 left"},
      {kPageDown, "lines 5-9 of 21 up, "},   {kPageDown, "lines 9-13 of 21 "},
      {kPageDown, "lines 13-17 of 21 b  B"}, {kPageDown, "lines 17-21 of 21 d  D"},
      {kPageDown, "lines 17-21 of 21 d  D"}, {kUp, "lines 16-20 of 21 o  L"},
      {kBegin, "lines 1-5 of 21 left"},      {kEnd, "lines 17-21 of 21 d  D"},
      {kDown, "lines 17-21 of 21 d  D"},     {kPageUp, "lines 13-17 of 21 b  B"},
      {kEnd, "lines 17-21 of 21 d  D"},      {'p', "lines 17-21 of 21 d  D"}};
  int step = 0;
  for (const auto& [key, expected] : kSteps) {
    CAPTURE(step++);
    CHECK(board.press(key));
    CHECK(place(7) == expected);
  }
  CHECK(place(9) == "lines 15-21 of 21 l  L");  // the end stays in sight
  CHECK(board.press(kUp));
  CHECK(place(9) == "lines 14-20 of 21 m  M");
  CHECK(place(22) == "lines 2-21 of 21 -: r");
  CHECK(place(23) == "q quit left");
  CHECK(board.press(kDown));
  CHECK(place(3) == "lines 2-2 of 21 -: r");
  CHECK(board.press(kPageDown));  // a page of one line
  CHECK(place(3) == "lines 3-3 of 21 t: t");
  CHECK(board.press('t'));
  CHECK(place(3) == "lines 1-1 of 21 left");
  CHECK(board.press(kEnd));
  CHECK(board.press('h'));
  CHECK(board.press('h'));
  CHECK(place(3) == "lines 1-1 of 21 left");
  for (const int key : {0, int{'z'}, int{'Q'}, 127, 300}) CHECK(!board.press(key));
}

TEST_CASE("lot top says what is in each segment, and which one is damaged or has no process") {
  const Room room;
  auto options = room.options("alone");
  options.persist = true;
  { const lot::ShmEngine gone(options); }
  const lot::ShmEngine engine(room.options("one"));
  std::filesystem::copy(room.path() + "/one", room.path() + "/zero");
  std::filesystem::copy(room.path() + "/one.lock", room.path() + "/zero.lock");
  std::filesystem::resize_file(room.path() + "/zero", 8192);
  std::filesystem::copy(room.path() + "/one", room.path() + "/torn");
  std::filesystem::copy(room.path() + "/one.lock", room.path() + "/torn.lock");
  const auto table = lot::segment::Geometry::of(capacity_of(room.path() + "/torn")).participants;
  write_word(room.path() + "/torn", table + 64, 7);
  Watch watch({room.path(), "", {}});
  watch.refresh();
  REQUIRE(watch.segments().size() == 4);
  Board board;
  std::string all;
  for (const Line& line : board.screen(watch, 200, 10)) all += styled(line) + "\n";
  CAPTURE(all);
  const auto& seen = watch.segments();
  const auto fill = [&](std::size_t n) { return fill_text(seen[n].seen) + "]\n"; };
  const std::string expected =
      "[alone: " + fill(0) + "W[alone: no process lives in it]\n[one: " + fill(1) +
      "[torn: " + fill(2) +
      "W[torn: damaged: process 1: its state is 7]\nW[zero: damaged: " + seen[3].sight.reason +
      "]\n\nH[PROCESS";
  CHECK(all.find("]\n" + expected) != all.npos);
}

TEST_SUITE_END();
