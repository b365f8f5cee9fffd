// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "tool/watch.hpp"

/// The screen of `lot top` as lines of text, whatever shows them.
namespace lot::tool {

enum class Style { Plain, Title, Head, Sorted, Wrong };
struct Piece {
  std::string text;
  Style style = Style::Plain;
};
using Line = std::vector<Piece>;
std::string text_of(const Line& line);

/// Keys that are no characters.
enum Key : int { kLeft = 256, kRight, kUp, kDown, kPageUp, kPageDown, kBegin, kEnd, kResize };

/// Which rows and columns there are, in which order, and which part of it a screen shows.
///
/// Threads: one.
class Board {
 public:
  static constexpr std::size_t kNarrowest = 20;  ///< columns

  Board();

  /// True when the key means something here.
  bool press(int key);
  bool is_paused() const { return paused_; }

  /// A screen of this size. Notes which columns it has: left and right choose among them.
  std::vector<Line> screen(const Watch& watch, std::size_t width, std::size_t height);
  /// The tables alone, in their whole length.
  std::vector<Line> tables(const std::vector<Watched>& segments, std::size_t width);

 private:
  enum class Shown { Both, OnlyTopics, OnlyProcesses };
  enum class Kind { Topic, Process };
  struct Row {
    const Watched* segment;
    const Activity* activity;
  };
  struct Cells;

  std::vector<Row> rows(const std::vector<Watched>& segments, Kind kind) const;
  std::optional<Cells> cells(const std::vector<Watched>& segments, Kind kind) const;
  void add(const Cells& cells, std::vector<Line>& lines);
  std::vector<Line> body(const Watch& watch, std::size_t width);
  Line title(std::size_t width) const;
  Line foot(std::size_t lines, std::size_t width) const;
  void choose(std::size_t column);
  void step(int by);
  void to_begin();

  Shown shown_ = Shown::Both;
  std::size_t column_;
  bool reversed_ = false;
  bool paused_ = false;
  bool helps_ = false;
  std::size_t first_ = 0;             ///< line of the body at the top
  bool at_end_ = false;               ///< the last line stays in sight, also when more come
  std::size_t room_ = 1;              ///< lines of the body on the screen
  std::vector<std::size_t> visible_;  ///< columns of the last screen
};

}  // namespace lot::tool
