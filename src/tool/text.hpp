// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

/// What people read: aligned columns and human units.
namespace lot::tool {

/// So many bytes of an error are printed: its end says what to do.
constexpr std::size_t kLine = 2000;

/// Columns as wide as their widest cell, and a table that fits a screen. Cells of the last columns
/// may be left out.
class Table {
 public:
  /// `elastic`: columns whose cells are cut where the table would be wider than kWidth.
  explicit Table(std::vector<std::string> head, std::vector<std::size_t> elastic)
      : rows_{std::move(head)}, elastic_(std::move(elastic)) {}
  static constexpr std::size_t kWidth = 100;

  void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  /// A line of its own, above the rows that follow.
  void add_line(std::string text) { rows_.push_back({std::move(text)}); }
  bool empty() const { return rows_.size() == 1; }
  std::string text(const std::string& indent = "  ") const;

 private:
  std::vector<std::size_t> widths(std::size_t indent) const;

  std::vector<std::vector<std::string>> rows_;
  std::vector<std::size_t> elastic_;
};

/// "312 MiB"
std::string bytes_text(std::uint64_t bytes);
/// "30 MiB/s"
std::string bandwidth_text(double bytes_per_second);
/// "1.2M"
std::string count_text(std::uint64_t count);
/// "30.0/s", "0.25/s"
std::string rate_text(double per_second);
/// "29.97/s", "1.000M/s": four digits.
std::string precise_rate_text(double per_second);
/// "32.1 ms", "-450 ns": three digits, or whole nanoseconds.
std::string span_text(double seconds);
/// "< 2/s": never less than the number.
std::string below_text(double per_second);
/// "12 s", "3 min"
std::string age_text(double seconds);
/// Replaces the bytes that a terminal would obey: names come from other processes. Cuts a long name
/// in the middle.
std::string printable(const std::string& text, std::size_t most = 60);
/// "1 process", "2 processes"
std::string plural(std::uint64_t n, const std::string& one, const std::string& many);

}  // namespace lot::tool
