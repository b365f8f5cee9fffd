// SPDX-License-Identifier: Apache-2.0

// The tables of `lot top`, of activities that the test makes up.

#include "tool/board.hpp"

#include <algorithm>
#include <set>
#include <string>
#include <vector>

#include <doctest/doctest.h>

namespace {

using namespace lot::tool;

Activity activity(const std::string& name, double per_second, double bytes) {
  Activity a;
  a.name = name;
  a.rate.per_second = per_second;
  a.bytes_per_second = bytes;
  a.memory = static_cast<std::uint64_t>(bytes);
  a.publishers = 1;
  return a;
}

std::vector<Watched> segments() {
  std::vector<Watched> all(2);
  all[0].sight.name = "one";
  all[1].sight.name = "two";
  all[0].topics = {activity("/b", 29.96, 3e6), activity("/c", 30.04, 2e6)};
  all[1].topics = {activity("/a_name_that_is_longer_than_a_narrow_screen/image_raw", 1e6, 1e9)};
  all[1].topics[0].lag = 123456;
  all[1].topics[0].state = "12 a_process_with_a_long_name waits for 13 another_one";
  all[1].topics[0].is_wrong = true;
  all[0].processes = {activity("1 camera", 60, 5e6)};
  all[0].processes[0].pid = 4711;
  return all;
}

std::string text(const std::vector<Line>& lines) {
  std::string all;
  for (const auto& line : lines) all += text_of(line) + "\n";
  return all;
}

/// The heads of the first table.
std::set<std::string> heads_at(std::size_t width) {
  Board board;
  const auto lines = board.tables(segments(), width);
  std::set<std::string> heads;
  for (const auto& piece : lines.front()) {
    std::string head = piece.text;
    head.erase(std::remove(head.begin(), head.end(), ' '), head.end());
    if (!head.empty()) heads.insert(head);
  }
  return heads;
}

/// The topics in their order, by the first letters of their names.
std::string order(Board& board) {
  std::string letters;
  for (const auto& line : board.tables(segments(), 200)) {
    const std::string row = text_of(line);
    if (row.size() > 1 && row[0] == '/') letters += row[1];
  }
  return letters;
}

}  // namespace

TEST_SUITE_BEGIN("board");

TEST_CASE("a wide table has all that is wrong") {
  Board board;
  const std::string all = text(board.tables(segments(), 200));
  CHECK(all.find("12 a_process_with_a_long_name waits for 13 another_one\n") != all.npos);
}

TEST_CASE("tables of lot top fit each width, and a wider one has no column less") {
  std::set<std::string> before = {"TOPIC"};
  for (std::size_t width = Board::kNarrowest; width <= 200; ++width) {
    CAPTURE(width);
    Board board;
    for (const auto& line : board.tables(segments(), width)) CHECK(text_of(line).size() <= width);
    const auto heads = heads_at(width);
    CHECK(std::includes(heads.begin(), heads.end(), before.begin(), before.end()));
    before = heads;
  }
  CHECK(heads_at(20) == std::set<std::string>{"TOPIC", "RATE"});
  CHECK(before.size() == 10);  // all but PID
}

TEST_CASE("lot top has DELAY where a publisher stamps, and sorts by it") {
  auto all = segments();
  CHECK(heads_at(200).count("DELAY") == 0);
  all[0].topics[1].has_stamps = true;
  all[0].topics[1].delay = 0.25;
  all[1].topics[0].delay = 0.0321;
  Board board;
  CHECK(board.press('d'));
  const std::string table = text(board.tables(all, 200));
  CHECK(table.find("DELAY") != std::string::npos);
  CHECK(table.find("250 ms") < table.find("32.1 ms"));
  CHECK(table.find("32.1 ms") != std::string::npos);
  for (std::size_t width = Board::kNarrowest; width <= 200; ++width) {
    for (const auto& line : board.tables(all, width)) CHECK(text_of(line).size() <= width);
  }
}

TEST_CASE("lot top sorts by the column that is chosen; rates that are alike stay where they are") {
  Board board;
  CHECK(order(board) == "abc");  // by bandwidth
  CHECK(board.press('r'));
  CHECK(order(board) == "abc");  // 29.96 and 30.04 are alike: by name
  CHECK(board.press('-'));
  CHECK(order(board) == "bca");
  CHECK(board.press('n'));
  CHECK(order(board) == "abc");
  CHECK(board.press('-'));
  CHECK(order(board) == "cba");
  CHECK(board.press('g'));
  CHECK(order(board) == "bca");  // of segment one, and of two
  CHECK(!board.press('z'));
  CHECK(!board.press(0));
  CHECK(order(board) == "bca");
}

TEST_CASE("a rate below one comes before none") {
  std::vector<Watched> all(1);
  all[0].topics = {activity("/never", 0, 0), activity("/seldom", 0.1, 0)};
  Board board;
  board.press('r');
  const std::string rows = text(board.tables(all, 200));
  CHECK(rows.find("/seldom") < rows.find("/never"));
}

TEST_CASE("left and right go round the columns that are on the screen") {
  Board board;
  (void)board.tables(segments(), 20);
  std::set<std::string> sorted;
  for (int n = 0; n < 4; ++n) {
    CHECK(board.press(n < 2 ? kRight : kLeft));
    const auto lines = board.tables(segments(), 20);
    for (const auto& piece : lines.front()) {
      if (piece.style == Style::Sorted)
        sorted.insert(piece.text.substr(piece.text.find_first_not_of(' '), 4));
    }
  }
  CHECK(sorted == std::set<std::string>{"TOPI", "RATE"});
}

TEST_CASE("control bytes of names and segments do not reach the screen") {
  auto all = segments();
  const std::string hostile = "\033[2J\x9b\n\r\t\xff\x7f";
  for (auto& segment : all) {
    segment.sight.name += hostile;
    for (auto* list : {&segment.topics, &segment.processes}) {
      for (auto& a : *list) {
        a.name += hostile;
        a.state += hostile;
      }
    }
  }
  Board board;
  for (const auto& line : board.tables(all, 300)) {
    for (const char c : text_of(line)) {
      const bool is_harmless = c >= ' ' && c <= '~';
      REQUIRE(is_harmless);
    }
  }
  CHECK(text(board.tables(all, 300)).find("?[2J?") != std::string::npos);
}

TEST_SUITE_END();
