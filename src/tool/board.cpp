// SPDX-License-Identifier: Apache-2.0
#include "tool/board.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <iterator>
#include <optional>

#include "tool/rows.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

/// A column: one more is one line of kColumns.
struct Column {
  char key;                  ///< sorts by it
  const char* topic_head;    ///< nullptr: the table of topics has no such column
  const char* process_head;  ///< as well
  std::size_t rank;          ///< where there is no room, columns of a higher rank go first
  std::size_t least;         ///< characters; so columns stay where they are
  bool is_text;              ///< else a number, at the right of its column, the largest one first
  std::string (*text)(const Watched&, const Activity&);
  double (*number)(const Activity&);
  const char* means;
};

/// Of a sum that is measured: two digits. So rows that are alike do not change places.
double coarse(double value) {
  if (!(value > 0)) return 0;
  const double unit = std::pow(10, std::floor(std::log10(value)) - 1);
  return std::round(value / unit) * unit;
}
double number(std::uint64_t n) { return static_cast<double>(n); }
std::string unless_zero(std::uint64_t n) { return n != 0 ? count_text(n) : ""; }

constexpr Column kColumns[] = {
    {'n', "TOPIC", "PROCESS", 0, 10, true,
     [](const Watched&, const Activity& a) { return printable(a.name, 100); }, nullptr,
     "the topic, or the index and the name of the process"},
    {'g', "SEGMENT", "SEGMENT", 6, 7, true,
     [](const Watched& w, const Activity&) { return printable(w.sight.name, 24); }, nullptr,
     "the segment, where there are several"},
    {'r', "RATE", "RATE", 1, 8, false,
     [](const Watched&, const Activity& a) { return text_of(a.rate); },
     [](const Activity& a) { return coarse(a.rate.per_second.value_or(0)); },
     "messages published, a second"},
    {'b', "BANDWIDTH", "BANDWIDTH", 2, 10, false,
     [](const Watched&, const Activity& a) {
       return a.bytes_per_second ? bandwidth_text(*a.bytes_per_second) : "";
     },
     [](const Activity& a) { return coarse(a.bytes_per_second.value_or(0)); },
     "bytes of the messages published, a second"},
    {'m', "MEMORY", "MEMORY", 3, 8, false,
     [](const Watched&, const Activity& a) { return bytes_text(a.memory); },
     [](const Activity& a) { return number(a.memory); },
     "of all messages made for the topic, or by the process"},
    {'l', "LAG", "LAG", 4, 5, false,
     [](const Watched&, const Activity& a) { return unless_zero(a.lag); },
     [](const Activity& a) { return number(a.lag); },
     "messages not read yet, of the subscriber that is furthest behind"},
    {'o', "LOST", "LOST", 5, 5, false,
     [](const Watched&, const Activity& a) { return unless_zero(a.lost); },
     [](const Activity& a) { return number(a.lost); },
     "messages of such a lag that are overwritten already"},
    {'d', "DELAY", "DELAY", 5, 8, false,
     [](const Watched&, const Activity& a) { return a.delay ? span_text(*a.delay) : ""; },
     [](const Activity& a) { return coarse(a.delay.value_or(0)); },
     "how long the oldest message of such a lag has been waiting, where publishers stamp"},
    {'u', "PUB", "PUB", 8, 3, false,
     [](const Watched&, const Activity& a) { return unless_zero(a.publishers); },
     [](const Activity& a) { return number(a.publishers); },
     "publishers of the topic, or topics that the process publishes on"},
    {'s', "SUB", "SUB", 8, 3, false,
     [](const Watched&, const Activity& a) { return unless_zero(a.subscribers); },
     [](const Activity& a) { return number(a.subscribers); },
     "subscribers of the topic, or topics that the process subscribes to"},
    {'i', nullptr, "PID", 9, 5, false,
     [](const Watched&, const Activity& a) { return std::to_string(a.pid); },
     [](const Activity& a) { return static_cast<double>(a.pid); },
     "process id, in the process's own namespace"},
    {'e', "STATE", "STATE", 7, 14, true,
     [](const Watched&, const Activity& a) { return printable(a.state, 100); }, nullptr,
     "what is wrong: who waits for whom, who loses messages"},
};
constexpr std::size_t kName = 0;
constexpr std::size_t kSegment = 1;
constexpr std::size_t kBandwidth = 3;
constexpr std::size_t kDelay = 7;
constexpr std::size_t kState = std::size(kColumns) - 1;
static_assert(kColumns[kBandwidth].key == 'b' && kColumns[kDelay].key == 'd' &&
              kColumns[kState].key == 'e');

constexpr const char* kKeys[][2] = {
    {"left, right", "sort by another column; or type its letter"},
    {"-", "reverses the order"},
    {"t", "topics, processes, or both"},
    {"space, p", "pauses, and goes on"},
    {"up, down", "scroll, as page up and page down"},
    {"home, end", "to the first line, or to the last one of all that come"},
    {"h, ?", "this help, and back"},
    {"q, Ctrl-C", "ends"},
};
constexpr const char* kShortHelp = "q quit  h help  t tables  left/right sort  - reverse  p pause";

/// Adds the text in lines of the width, broken between words where that can be.
void add_wrapped(const std::string& text, std::size_t width, Style style,
                 std::vector<Line>& lines) {
  std::size_t at = 0;
  while (at < text.size()) {
    std::size_t n = std::min(width, text.size() - at);
    if (at + n < text.size()) {
      const std::size_t blank = text.rfind(' ', at + n);
      if (blank != text.npos && blank > at) n = blank - at;
    }
    lines.push_back({{text.substr(at, n), style}});
    at += n;
    while (at < text.size() && text[at] == ' ') ++at;
  }
}

std::string alone(const Watched& w) {
  const bool any_alive = std::any_of(w.seen.processes.begin(), w.seen.processes.end(),
                                     [](const Process& p) { return p.alive; });
  return any_alive ? "" : ": no process lives in it";
}

void add_segment(const Watched& w, std::size_t width, std::vector<Line>& lines) {
  const std::string name = printable(w.sight.name);
  if (w.sight.window == nullptr) {
    add_wrapped(
        name + ": " + to_string(w.sight.condition) + ": " + printable(w.sight.reason, kLine), width,
        Style::Wrong, lines);
    return;
  }
  add_wrapped(name + ": " + fill_text(w.seen), width, Style::Plain, lines);
  if (!alone(w).empty()) add_wrapped(name + alone(w), width, Style::Wrong, lines);
  for (const auto& what : w.seen.damage) {
    add_wrapped(name + ": damaged: " + printable(what, 200), width, Style::Wrong, lines);
  }
}

}  // namespace

std::string text_of(const Line& line) {
  std::string text;
  for (const auto& piece : line) text += piece.text;
  text.erase(text.find_last_not_of(' ') + 1);
  return text;
}

namespace {

/// True: a publisher of some topic notes when it pushes.
bool has_stamps(const std::vector<Watched>& segments) {
  return std::any_of(segments.begin(), segments.end(), [](const Watched& w) {
    return std::any_of(w.topics.begin(), w.topics.end(),
                       [](const Activity& topic) { return topic.has_stamps; });
  });
}

}  // namespace

/// A table whose cells are text, and how wide its columns are; a column of width 0 is not shown.
struct Board::Cells {
  std::vector<std::vector<std::string>> rows = {{}};  ///< the head first
  std::vector<bool> are_wrong = {false};              ///< for each row
  std::vector<bool> has = std::vector<bool>(std::size(kColumns));
  std::vector<std::size_t> widths = std::vector<std::size_t>(std::size(kColumns));

  std::size_t widest(std::size_t column) const {
    std::size_t width = kColumns[column].least;
    for (const auto& row : rows) width = std::max(width, row[column].size());
    return width;
  }

  /// `name`: how wide the names would like to be. Drops columns until the others fit, and gives the
  /// room that is left to the names, then to what is said of them.
  void fit(std::size_t width, std::size_t name) {
    std::vector<std::size_t> wanted(widths.size());
    std::size_t all = 0;
    for (std::size_t c = 0; c < widths.size(); ++c) {
      if (!has[c]) continue;
      wanted[c] = c == kName ? name : widest(c);
      widths[c] = c == kName || c == kState ? std::min(wanted[c], kColumns[c].least) : wanted[c];
      all += widths[c] + kGap;
    }
    while (all > width + kGap) {
      std::size_t last = kName;
      for (std::size_t c = 0; c < widths.size(); ++c) {
        if (widths[c] != 0 && kColumns[c].rank >= kColumns[last].rank) last = c;
      }
      if (last == kName) break;
      all -= widths[last] + kGap;
      widths[last] = 0;
    }
    for (const std::size_t c : {kName, kState}) {
      if (widths[c] == 0 || all > width + kGap) continue;
      const std::size_t more = std::min(width + kGap - all, wanted[c] - widths[c]);
      widths[c] += more;
      all += more;
    }
  }

  std::string cell(std::size_t row, std::size_t column) const {
    std::string text = printable(rows[row][column], widths[column]);
    const std::string room(widths[column] - text.size(), ' ');
    return kColumns[column].is_text ? text + room : room + text;
  }

  static constexpr std::size_t kGap = 2;
};

Board::Board() : column_(kBandwidth) {}

std::vector<Board::Row> Board::rows(const std::vector<Watched>& segments, Kind kind) const {
  std::vector<Row> rows;
  for (const auto& segment : segments) {
    for (const auto& a : kind == Kind::Topic ? segment.topics : segment.processes) {
      rows.push_back({&segment, &a});
    }
  }
  const Column& by = kColumns[column_];
  // Rows that are equal are in the order of their names, and then as they were found.
  std::sort(rows.begin(), rows.end(), [&](const Row& a, const Row& b) {
    const Row& first = by.is_text && reversed_ ? b : a;
    const Row& second = by.is_text && reversed_ ? a : b;
    if (!by.is_text && by.number(*a.activity) != by.number(*b.activity)) {
      return (by.number(*a.activity) > by.number(*b.activity)) != reversed_;
    }
    if (by.is_text) {
      const std::string one = by.text(*first.segment, *first.activity);
      const std::string other = by.text(*second.segment, *second.activity);
      if (one.empty() != other.empty()) return other.empty();
      if (one != other) return one < other;
    }
    if (a.activity->name != b.activity->name) return a.activity->name < b.activity->name;
    return a.segment != b.segment ? a.segment < b.segment : a.activity < b.activity;
  });
  return rows;
}

/// The table of all segments together, with its head; nothing when it has no row.
std::optional<Board::Cells> Board::cells(const std::vector<Watched>& segments, Kind kind) const {
  Cells cells;
  for (std::size_t c = 0; c < std::size(kColumns); ++c) {
    const char* head = kind == Kind::Topic ? kColumns[c].topic_head : kColumns[c].process_head;
    cells.has[c] = head != nullptr && (c != kSegment || segments.size() > 1) &&
                   (c != kDelay || has_stamps(segments));
    cells.rows.front().push_back(head != nullptr ? head : "");
  }
  for (const Row& row : rows(segments, kind)) {
    std::vector<std::string> texts;
    for (const auto& column : kColumns) texts.push_back(column.text(*row.segment, *row.activity));
    cells.rows.push_back(std::move(texts));
    cells.are_wrong.push_back(row.activity->is_wrong);
  }
  if (cells.rows.size() == 1) return std::nullopt;
  return cells;
}

void Board::add(const Cells& cells, std::vector<Line>& lines) {
  if (!lines.empty()) lines.push_back({});
  for (std::size_t r = 0; r < cells.rows.size(); ++r) {
    Line line;
    for (std::size_t c = 0; c < std::size(kColumns); ++c) {
      if (cells.widths[c] == 0) continue;
      if (r == 0) visible_.push_back(c);
      if (!line.empty()) line.push_back({"  ", r == 0 ? Style::Head : Style::Plain});
      const Style head = c == column_ ? Style::Sorted : Style::Head;
      const Style body = cells.are_wrong[r] ? Style::Wrong : Style::Plain;
      line.push_back({cells.cell(r, c), r == 0 ? head : body});
    }
    lines.push_back(std::move(line));
  }
}

std::vector<Line> Board::tables(const std::vector<Watched>& segments, std::size_t width) {
  std::vector<Cells> tables;
  for (const Kind kind : {Kind::Topic, Kind::Process}) {
    if (shown_ == (kind == Kind::Topic ? Shown::OnlyProcesses : Shown::OnlyTopics)) continue;
    if (auto table = cells(segments, kind)) tables.push_back(std::move(*table));
  }
  std::size_t name = 0;  // the columns of one table stand below those of the other
  for (const auto& table : tables) name = std::max(name, table.widest(kName));
  std::vector<Line> lines;
  visible_.clear();
  for (auto& table : tables) {
    table.fit(width, name);
    add(table, lines);
  }
  std::sort(visible_.begin(), visible_.end());
  visible_.erase(std::unique(visible_.begin(), visible_.end()), visible_.end());
  return lines;
}

std::vector<Line> Board::body(const Watch& watch, std::size_t width) {
  std::vector<Line> lines;
  if (helps_) {
    for (const auto& [keys, does] : kKeys) {
      add_wrapped(std::string(keys) + ": " + does, width, Style::Plain, lines);
    }
    lines.push_back({});
    for (const auto& column : kColumns) {
      const char* const head =
          column.topic_head != nullptr ? column.topic_head : column.process_head;
      add_wrapped(std::string(1, column.key) + "  " + head + ": " + column.means, width,
                  Style::Plain, lines);
    }
    return lines;
  }
  for (const auto& segment : watch.segments()) add_segment(segment, width, lines);
  for (const auto& news : watch.news()) add_wrapped(news, width, Style::Wrong, lines);
  const auto all = tables(watch.segments(), width);
  if (!all.empty()) lines.push_back({});
  lines.insert(lines.end(), all.begin(), all.end());
  return lines;
}

Line Board::title(std::size_t width) const {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  localtime_r(&now, &parts);
  char clock[16];
  std::strftime(clock, sizeof(clock), "%H:%M:%S", &parts);
  const Column& by = kColumns[column_];
  std::string text = std::string("lot top  ") + (paused_ ? "paused" : clock) + "  by " +
                     (by.topic_head != nullptr ? by.topic_head : by.process_head) +
                     (reversed_ ? ", reversed" : "");
  text.resize(width, ' ');
  return {{text, Style::Title}};
}

Line Board::foot(std::size_t lines, std::size_t width) const {
  std::string text = kShortHelp;
  if (lines > room_) {
    const std::string place = "lines " + std::to_string(first_ + 1) + "-" +
                              std::to_string(std::min(lines, first_ + room_)) + " of " +
                              std::to_string(lines);
    text = place + "  " + text;
  }
  text.resize(width, ' ');
  return {{text, Style::Title}};
}

std::vector<Line> Board::screen(const Watch& watch, std::size_t width, std::size_t height) {
  if (width < kNarrowest) {
    std::vector<Line> lines;
    add_wrapped("too narrow: it needs " + std::to_string(kNarrowest) + " columns",
                std::max<std::size_t>(width, 1), Style::Wrong, lines);
    lines.resize(std::min(lines.size(), std::max<std::size_t>(height, 1)));
    return lines;
  }
  std::vector<Line> all = body(watch, width);
  room_ = height > 2 ? height - 2 : 1;
  const std::size_t last = all.size() > room_ ? all.size() - room_ : 0;
  first_ = at_end_ ? last : std::min(first_, last);
  std::vector<Line> lines;
  if (height > 1) lines.push_back(title(width));
  for (std::size_t i = first_; i < std::min(all.size(), first_ + room_); ++i) {
    lines.push_back(std::move(all[i]));
  }
  if (height > 2) {
    lines.resize(height - 1);
    lines.push_back(foot(all.size(), width));
  }
  return lines;
}

void Board::choose(std::size_t column) {
  if (column != column_) reversed_ = false;
  column_ = column;
}

/// To the next visible column on one side, and from the last one to the first.
void Board::step(int by) {
  if (visible_.empty()) return;
  const auto next = by > 0 ? std::upper_bound(visible_.begin(), visible_.end(), column_)
                           : std::lower_bound(visible_.begin(), visible_.end(), column_);
  if (by > 0) return choose(next != visible_.end() ? *next : visible_.front());
  choose(next != visible_.begin() ? *std::prev(next) : visible_.back());
}

void Board::to_begin() {
  first_ = 0;
  at_end_ = false;
}

bool Board::press(int key) {
  const std::size_t page = std::max<std::size_t>(room_, 2) - 1;
  switch (key) {
    case 'h':
    case '?':
      helps_ = !helps_;
      to_begin();
      return true;
    case 'p':
    case ' ':
      paused_ = !paused_;
      return true;
    case 't':
      shown_ = shown_ == Shown::Both         ? Shown::OnlyTopics
               : shown_ == Shown::OnlyTopics ? Shown::OnlyProcesses
                                             : Shown::Both;
      to_begin();
      return true;
    case '-':
      reversed_ = !reversed_;
      return true;
    case kLeft:
    case kRight:
      step(key == kRight ? 1 : -1);
      return true;
    case kUp:
    case kPageUp:
    case kBegin:
      at_end_ = false;
      first_ -= std::min(first_, key == kBegin ? first_ : key == kUp ? 1 : page);
      return true;
    case kDown:
    case kPageDown:
      first_ += key == kDown ? 1 : page;  // screen() brings it back from behind the end
      return true;
    case kEnd:
      at_end_ = true;
      return true;
    case kResize:
      return true;
    default:
      break;
  }
  const auto* const column = std::find_if(std::begin(kColumns), std::end(kColumns),
                                          [key](const Column& c) { return c.key == key; });
  if (column == std::end(kColumns)) return false;
  choose(static_cast<std::size_t>(column - std::begin(kColumns)));
  return true;
}

}  // namespace lot::tool
