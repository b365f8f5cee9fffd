// SPDX-License-Identifier: Apache-2.0
#include "tool/terminal.hpp"

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <poll.h>
#include <string>
#include <unistd.h>

#include <termios.h>

#define NCURSES_NOMACROS
#include <ncurses.h>

#include "lot/error.hpp"

#include "tool/text.hpp"

namespace lot::tool {
namespace {

volatile std::sig_atomic_t was_interrupted = 0;
volatile std::sig_atomic_t has_gone = 0;

/// What the signal handler needs to give the terminal back: ncurses may not be called there.
termios settings_before{};
char restoring[256];
std::size_t restoring_bytes = 0;

void on_end(int signal) {
  // A terminal that was stopped (Ctrl-S) takes nothing. The results do not matter: the process
  // ends.
  pollfd output{STDOUT_FILENO, POLLOUT, 0};
  if (poll(&output, 1, 0) == 1 && ::write(STDOUT_FILENO, restoring, restoring_bytes) == -1) {
    has_gone = 1;
  }
  tcsetattr(STDOUT_FILENO, TCSANOW, &settings_before);
  std::signal(signal, SIG_DFL);
  raise(signal);
}

/// The first one ends the loop, at its next turn. A second one ends the process, as ncurses may
/// wait for a terminal that takes nothing.
void on_interrupt(int signal) {
  if (was_interrupted != 0) on_end(signal);
  was_interrupted = 1;
}

/// SIGBUS is not among them: Window has it, for segments that are cut short.
constexpr int kEndings[] = {SIGTERM, SIGHUP, SIGQUIT, SIGABRT, SIGSEGV, SIGFPE, SIGILL};

void set_handler(int signal, void (*handler)(int)) {
  struct sigaction action {};
  action.sa_handler = handler;
  sigaction(signal, &action, nullptr);
}

/// The bytes that make the terminal visible again: the usual screen, the cursor, plain letters.
void note_restoring() {
  restoring_bytes = 0;
  for (const char* name : {"sgr0", "cnorm", "rmkx", "rmcup"}) {
    const char* const text = tigetstr(name);
    if (text == nullptr || text == reinterpret_cast<const char*>(-1)) continue;
    const std::size_t n = std::strlen(text);
    if (restoring_bytes + n > sizeof(restoring)) continue;
    std::memcpy(restoring + restoring_bytes, text, n);
    restoring_bytes += n;
  }
}

constexpr short kWrongPair = 1;
constexpr short kHeadPair = 2;

chtype colour(int pair) { return has_colors() ? static_cast<chtype>(COLOR_PAIR(pair)) : 0; }

chtype attributes(Style style) {
  switch (style) {
    case Style::Plain:
      return A_NORMAL;
    case Style::Title:
      return A_REVERSE;
    case Style::Head:
      return colour(kHeadPair) | A_BOLD;
    case Style::Sorted:
      return colour(kHeadPair) | A_BOLD | A_REVERSE;
    case Style::Wrong:
      return colour(kWrongPair) | A_BOLD;
  }
  return A_NORMAL;
}

std::optional<int> translated(int key) {
  switch (key) {
    case ERR:
      return std::nullopt;
    case KEY_LEFT:
      return kLeft;
    case KEY_RIGHT:
      return kRight;
    case KEY_UP:
      return kUp;
    case KEY_DOWN:
      return kDown;
    case KEY_PPAGE:
      return kPageUp;
    case KEY_NPAGE:
      return kPageDown;
    case KEY_HOME:
      return kBegin;
    case KEY_END:
      return kEnd;
    case KEY_RESIZE:
      return kResize;
    default:
      return key < 256 ? key : 0;  // 0: a key without a meaning
  }
}

}  // namespace

struct Terminal::Screen {
  SCREEN* screen;
};

Terminal::Terminal() : screen_(nullptr) {
  tcgetattr(STDOUT_FILENO, &settings_before);
  const char* const type = std::getenv("TERM");
  SCREEN* const screen = newterm(nullptr, stdout, stdin);
  if (screen == nullptr) {
    throw Error(0, "TERM=" + printable(type != nullptr ? type : ""),
                "ncurses does not know this terminal",
                "set TERM to one that it knows, or use `lot top --once`");
  }
  screen_ = new Screen{screen};
  cbreak();
  noecho();
  nodelay(stdscr, true);
  keypad(stdscr, true);
  set_escdelay(50);
  curs_set(0);
  if (has_colors()) {
    start_color();
    use_default_colors();
    init_pair(kWrongPair, COLOR_RED, -1);
    init_pair(kHeadPair, COLOR_CYAN, -1);
  }
  note_restoring();
  was_interrupted = 0;
  set_handler(SIGINT, on_interrupt);
  for (const int signal : kEndings) set_handler(signal, on_end);
}

Terminal::~Terminal() {
  endwin();
  for (const int signal : kEndings) set_handler(signal, SIG_DFL);
  set_handler(SIGINT, SIG_DFL);
  delscreen(screen_->screen);
  delete screen_;
}

std::size_t Terminal::width() const { return static_cast<std::size_t>(getmaxx(stdscr)); }
std::size_t Terminal::height() const { return static_cast<std::size_t>(getmaxy(stdscr)); }

std::optional<int> Terminal::key(std::chrono::milliseconds most) {
  const auto waiting = translated(getch());  // ncurses may have it already
  if (waiting) return waiting;
  pollfd input{STDIN_FILENO, POLLIN, 0};
  const int n = poll(&input, 1, static_cast<int>(most.count()));
  if (n == 1 && (input.revents & (POLLHUP | POLLERR | POLLNVAL)) != 0) has_gone = 1;
  return translated(getch());
}

bool Terminal::has_ended() const { return was_interrupted != 0 || has_gone != 0; }

void Terminal::show(const std::vector<Line>& lines) {
  erase();
  const int rows = getmaxy(stdscr);
  const int columns = getmaxx(stdscr);
  for (int y = 0; y < std::min(rows, static_cast<int>(lines.size())); ++y) {
    move(y, 0);
    int left = columns;
    for (const Piece& piece : lines[static_cast<std::size_t>(y)]) {
      attrset(static_cast<int>(attributes(piece.style)));
      addnstr(piece.text.c_str(), left);
      left -= std::min(left, static_cast<int>(piece.text.size()));
      if (left == 0) break;
    }
  }
  attrset(A_NORMAL);
  refresh();
}

}  // namespace lot::tool
