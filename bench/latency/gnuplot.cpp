// SPDX-License-Identifier: Apache-2.0
#include "gnuplot.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <sys/wait.h>
#include <unistd.h>

#include <spawn.h>

namespace ab {
namespace {

namespace fs = std::filesystem;

/// Colours of Okabe and Ito: told apart also by who does not see red and green.
unsigned colour(const std::string& transport) {
  static const std::map<std::string, unsigned> colours{{"ring", 0x0072b2},
                                                       {"mutex", 0x56b4e9},
                                                       {"lot2021", 0x999999},
                                                       {"tcp", 0xd55e00},
                                                       {"udp", 0xcc79a7},
                                                       {"uds", 0xe69f00},
                                                       {"tcp-nagle", 0xe69f00},
                                                       {"tzc", 0x009e73},
                                                       {"iceoryx", 0x009e73},
                                                       {"fastdds", 0xcc79a7},
                                                       {"lot2021-direct", 0x4d4d4d},
                                                       {"fastdds-loan", 0xe69f00},
                                                       {"udp-65507", 0xf0e442},
                                                       {"ros-lot", 0x0072b2},
                                                       {"ros-lot-mutex", 0x56b4e9},
                                                       {"ros-tcp", 0xd55e00},
                                                       {"ros-tcp-nodelay", 0xe69f00},
                                                       {"ros-udp", 0xcc79a7},
                                                       {"ros-tzc", 0x009e73},
                                                       {"ros-intra", 0x999999}};
  const auto known = colours.find(transport);
  return known == colours.end() ? 0x666666 : known->second;
}

std::string colour_word(unsigned rgb) {
  std::array<char, 16> text{};
  std::snprintf(text.data(), text.size(), "#%06x", rgb);
  return text.data();
}

/// Runs gnuplot in `dir`. Empty: it drew; else what it said.
std::string gnuplot(const fs::path& dir, const std::string& name) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addchdir_np(&actions, dir.c_str());
  posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
  const std::string log = name + ".log";
  posix_spawn_file_actions_addopen(&actions, 1, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  posix_spawn_file_actions_adddup2(&actions, 1, 2);
  std::string program = "gnuplot";
  std::string script = name + ".gp";
  char* arguments[] = {program.data(), script.data(), nullptr};
  pid_t child = 0;
  const int error = posix_spawnp(&child, program.c_str(), &actions, nullptr, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  std::string said;
  if (error != 0) {
    said = "gnuplot did not start (" + std::string(std::strerror(error)) +
           "; Debian package gnuplot-nox)";
  } else {
    int status = 0;
    while (waitpid(child, &status, 0) < 0 && errno == EINTR) continue;
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
      std::ifstream file(dir / log);
      std::string line;
      while (std::getline(file, line)) {
        if (!line.empty()) said += (said.empty() ? "" : " ") + line;
      }
      if (said.empty()) said = "gnuplot failed";
    }
  }
  std::error_code ignored;
  fs::remove(dir / log, ignored);
  return said;
}

/// 1, 2 or 5 times a power of ten: the nearest one below (or above).
double round_mark(double value, bool up) {
  const double power = std::pow(10, std::floor(std::log10(value)));
  double mark = up ? 10 * power : power;
  for (const double step : {5.0, 2.0, 1.0}) {
    if (up && step * power >= value) mark = step * power;
    if (!up && step * power <= value) return step * power;
  }
  return mark;
}

}  // namespace

std::string label_of(const std::string& transport) {
  static const std::map<std::string, std::string> names{{"ring", "LOT"},
                                                        {"mutex", "LOT, mutex"},
                                                        {"lot2021", "LOT of 2021"},
                                                        {"lot2021-direct", "LOT of 2021, direct"},
                                                        {"udp-65507", "UDP, 65507 B"},
                                                        {"fastdds-loan", "Fast DDS, loans"},
                                                        {"tcp", "TCP"},
                                                        {"tcp-nagle", "TCP with Nagle"},
                                                        {"udp", "UDP"},
                                                        {"uds", "UDS"},
                                                        {"tzc", "TZC"},
                                                        {"iceoryx", "iceoryx"},
                                                        {"fastdds", "Fast DDS"},
                                                        {"ros-lot", "LOT in ROS"},
                                                        {"ros-lot-mutex", "LOT in ROS, mutex"},
                                                        {"ros-tcp", "TCPROS"},
                                                        {"ros-tcp-nodelay", "TCPROS, no delay"},
                                                        {"ros-udp", "UDPROS"},
                                                        {"ros-tzc", "TZC in ROS"},
                                                        {"ros-intra", "one ROS process"}};
  const auto known = names.find(transport);
  return known == names.end() ? transport : known->second;
}

std::string colour_of(const std::string& transport) { return colour_word(colour(transport)); }

std::string shade_of(const std::string& transport, std::size_t k, std::size_t n) {
  const unsigned rgb = colour(transport);
  if (n < 2) return colour_of(transport);
  const double white = 0.65 * static_cast<double>(k) / static_cast<double>(n - 1);
  unsigned result = 0;
  for (const int shift : {16, 8, 0}) {
    const auto part = static_cast<double>((rgb >> shift) & 0xff);
    result |= static_cast<unsigned>(std::lround(part + (255 - part) * white)) << shift;
  }
  return colour_word(result);
}

void write_file(const fs::path& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  file.close();
  if (!file) throw std::runtime_error(path.string() + ": cannot be written");
}

std::string quoted(const std::string& text) {
  std::string result = "'";
  for (const char c : text) {
    if (c == '\'') result += '\'';
    result += static_cast<unsigned char>(c) < ' ' ? ' ' : c;
  }
  return result + "'";
}

std::string frame(const std::string& title, const std::string& subtitle) {
  std::ostringstream text;
  text << "set label 1 " << quoted(title) << " at screen 0.5,0.955 center font ',19'\n"
       << "set label 2 " << quoted(subtitle)
       << " at screen 0.5,0.9 center font ',12' textcolor '#606060'\n"
       << "set border 3 linecolor '#404040'\n"
       << "set tics nomirror out textcolor '#202020'\n"
       << "set grid ytics linecolor '#e2e2e2' linetype 1 linewidth 0.8\n"
       << "set key at screen 0.5,0.035 center center horizontal maxrows 1 reverse Left samplen 1.5 "
          "width 1 font ',14'\n";
  return text.str();
}

void Range::add(double value) {
  low = std::min(low, std::max(value, 1e-3));  // a logarithm's axis has no zero
  high = std::max(high, value);
}

std::string time_axis(const Range& range) {
  const double low = round_mark(range.low / 1.1, false);
  const double high = round_mark(range.high * 1.1, true);
  static const char* const kMarks[] = {"1 ns", "10 ns", "100 ns", "1 µs", "10 µs", "100 µs",
                                       "1 ms", "10 ms", "100 ms", "1 s",  "10 s",  "100 s"};
  std::ostringstream axis;
  axis << "set logscale y 10\nset mytics 10\nset ytics (";
  double at = 1e-3;
  for (std::size_t i = 0; i < std::size(kMarks); ++i, at *= 10) {
    axis << (i == 0 ? "" : ", ") << '\'' << kMarks[i] << "' " << at;
  }
  // Between powers of ten where few of them are seen.
  for (double power = 1e-3; power < 1e8; power *= 10) {
    for (int step = 2; step < 10; ++step) axis << ", '' " << step * power << " 1";
  }
  axis << ")\n";
  if (high / low < 30) {  // too few powers of ten
    for (double power = 1e-3; power < 1e8; power *= 10) {
      for (const int step : {2, 5}) {
        const double value = step * power;
        if (value < low || value > high) continue;
        const char* unit = value < 1 ? " ns" : value < 1e3 ? " µs" : value < 1e6 ? " ms" : " s";
        const double shown = value < 1     ? value * 1e3
                             : value < 1e3 ? value
                             : value < 1e6 ? value / 1e3
                                           : value / 1e6;
        axis << "set ytics add ('" << shown << unit << "' " << value << ")\n";
      }
    }
  }
  axis << "set yrange [" << low << ':' << high << "]\n";
  return axis.str();
}

std::string script_of(const std::string& name, unsigned width, unsigned height,
                      const std::string& body) {
  const std::string size = std::to_string(width) + "," + std::to_string(height);
  const std::string twice = std::to_string(2 * width) + "," + std::to_string(2 * height);
  std::ostringstream script;
  script << "# Draws " << name << ".svg and " << name << ".png: gnuplot " << name << ".gp\n"
         << "set encoding utf8\n"
         << "do for [format in 'svg png'] {\n"
         << "reset\n"
         << "if (format eq 'svg') {\n"
         << "  set terminal svg size " << size
         << " font 'DejaVu Sans,15' background 'white' noenhanced\n"
         << "} else {\n"
         << "  set terminal pngcairo size " << twice
         << " font 'DejaVu Sans,15' fontscale 1.5 linewidth 2 noenhanced\n"
         << "}\n"
         << "set output '" << name << ".'.format\n"
         << body << "unset output\n}\n";
  return script.str();
}

std::string drawn_line(const fs::path& dir, const std::string& name, const std::string& title) {
  const std::string error = gnuplot(dir, name);
  if (!error.empty()) return name + ": " + title + ": only " + name + ".gp and .tsv: " + error;
  return name + ": " + title + ": " + (dir / (name + ".svg")).string() + ", .png";
}

std::string left_out(const fs::path& dir, const std::string& name, const std::string& why) {
  for (const char* ending : {".tsv", ".gp", ".svg", ".png", ".md"})
    fs::remove(dir / (name + ending));
  return name + ": left out: " + why;
}

void Panels::add_curve(const std::string& transport, const std::string& style,
                       const std::string& rows) {
  data_ += (index_ == 0 ? "" : "\n\n") + std::string("# ") + panels_.back().caption + ", " +
           transport + "\n" + rows;
  std::string& plot = panels_.back().plot;
  plot += plot.empty() ? "plot " : ", \\\n  ";
  plot += '\'' + name_ + ".tsv' index " + std::to_string(index_++) + " using 1:2 with " + style +
          " linecolor '" + colour_of(transport) + "' notitle";
  if (std::find(legend_.begin(), legend_.end(), transport) == legend_.end()) {
    legend_.push_back(transport);
  }
}

void Panels::write_to(const fs::path& dir, const std::string& title, const std::string& subtitle,
                      const std::string& axes) const {
  std::ostringstream body;
  body << "set multiplot layout 1," << panels_.size()
       << " margins 0.095,0.98,0.24,0.78 spacing 0.08\n"
       << frame(title, subtitle) << axes << "unset key\n";
  // A key of gnuplot's own would be no wider than one panel.
  const double step = std::min(0.2, 0.9 / static_cast<double>(legend_.size()));
  double x = 0.5 - step * static_cast<double>(legend_.size()) / 2 + 0.03;
  for (std::size_t i = 0; i < legend_.size(); ++i, x += step) {
    body << "set label " << 10 + i << ' ' << quoted(label_of(legend_[i])) << " at screen " << x
         << ",0.05 left point pointtype 5 pointsize 1.6 linecolor '" << colour_of(legend_[i])
         << "' offset 1.2,0 font ',14'\n";
  }
  for (std::size_t p = 0; p < panels_.size(); ++p) {
    body << "set label 3 " << quoted(panels_[p].caption) << " at graph 0.5,1.06 center font ',15'\n"
         << panels_[p].plot;
    if (p == 0) body << "\nunset ylabel\nunset label";
    body << '\n';
  }
  body << "unset multiplot\n";
  write_file(dir / (name_ + ".tsv"), "# " + title + "; " + subtitle + "\n" + data_);
  write_file(dir / (name_ + ".gp"), script_of(name_, 1200, 520, body.str()));
}

}  // namespace ab
