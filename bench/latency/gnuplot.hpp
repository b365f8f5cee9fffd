// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <limits>
#include <string>
#include <utility>
#include <vector>

/// What all figures are made with: names and colours, axes, scripts, and gnuplot itself.
namespace ab {

/// As figures say it: "LOT", "TCP with Nagle".
std::string label_of(const std::string& transport);
std::string colour_of(const std::string& transport);  ///< "#rrggbb"
/// The k-th of n shades of a transport's colour, from itself towards white.
std::string shade_of(const std::string& transport, std::size_t k, std::size_t n);

/// Errors: std::runtime_error with the file's name.
void write_file(const std::filesystem::path& path, const std::string& text);

/// A string of gnuplot's, in which nothing is special.
std::string quoted(const std::string& text);

/// Title and subtitle at the top, the legend in one line at the bottom.
std::string frame(const std::string& title, const std::string& subtitle);

struct Range {
  double low = std::numeric_limits<double>::max();
  double high = 0;
  void add(double value);
};
/// A logarithmic axis of microseconds whose marks are read without counting zeros.
std::string time_axis(const Range&);

/// The script NAME.gp: `body` is drawn once for each format.
std::string script_of(const std::string& name, unsigned width, unsigned height,
                      const std::string& body);

/// Lets gnuplot draw NAME.gp in `dir`, and returns the line that says so (or why it did not).
std::string drawn_line(const std::filesystem::path& dir, const std::string& name,
                       const std::string& title);
/// The line of a figure that cannot be drawn. One of an earlier run must not pass for one of this,
/// so it is removed.
std::string left_out(const std::filesystem::path& dir, const std::string& name,
                     const std::string& why);

/// Curves over the same axes, one panel for each condition, and one legend for all.
class Panels {
 public:
  explicit Panels(std::string name) : name_(std::move(name)) {}

  void add_panel(const std::string& caption) { panels_.push_back({caption, {}}); }
  /// To the last panel; `style` as in "lines linewidth 2".
  void add_curve(const std::string& transport, const std::string& style, const std::string& rows);
  bool empty() const { return panels_.empty(); }
  /// Writes NAME.tsv and NAME.gp; `axes` is said once for all panels.
  void write_to(const std::filesystem::path& dir, const std::string& title,
                const std::string& subtitle, const std::string& axes) const;

 private:
  struct Panel {
    std::string caption;
    std::string plot;
  };
  std::string name_;
  std::vector<Panel> panels_;
  std::vector<std::string> legend_;
  std::string data_;
  std::size_t index_ = 0;
};

}  // namespace ab
