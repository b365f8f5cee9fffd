// SPDX-License-Identifier: Apache-2.0
#include "tool/text.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace lot::tool {
namespace {

std::string with(const char* format, double value, const char* unit) {
  char text[64];
  std::snprintf(text, sizeof(text), format, value, unit);
  return text;
}

std::string in_bytes(double value, const char* end) {
  static constexpr const char* kUnits[] = {"B", "KiB", "MiB", "GiB", "TiB"};
  std::size_t unit = 0;
  for (; std::round(value) >= 1024 && unit + 1 < std::size(kUnits); ++unit) value /= 1024;
  return with(value >= 9.95 || value == std::floor(value) ? "%.0f %s" : "%.1f %s", value,
              kUnits[unit]) +
         end;
}

}  // namespace

std::vector<std::size_t> Table::widths(std::size_t indent) const {
  static constexpr std::size_t kNarrowest = 9;
  std::vector<std::size_t> width;
  for (const auto& row : rows_) {
    if (row.size() == 1) continue;  // a line of its own
    width.resize(std::max(width.size(), row.size()));
    for (std::size_t i = 0; i < row.size(); ++i) width[i] = std::max(width[i], row[i].size());
  }
  std::size_t all = indent;
  for (const std::size_t w : width) all += w + (w != 0 ? 2 : 0);
  for (; all > kWidth + 2; --all) {
    const auto widest = std::max_element(elastic_.begin(), elastic_.end(),
                                         [&](auto a, auto b) { return width[a] < width[b]; });
    if (widest == elastic_.end() || width[*widest] <= kNarrowest) break;
    --width[*widest];
  }
  return width;
}

std::string Table::text(const std::string& indent) const {
  const auto width = widths(indent.size());
  std::string out;
  for (const auto& row : rows_) {
    std::string line = indent;
    for (std::size_t i = 0; i < row.size(); ++i) {
      const std::string cell = row.size() == 1 ? row[i] : printable(row[i], width[i]);
      line += cell +
              std::string(row.size() == 1 || width[i] == 0 ? 0 : width[i] - cell.size() + 2, ' ');
    }
    line.erase(line.find_last_not_of(' ') + 1);
    out += line + "\n";
  }
  return out;
}

std::string bytes_text(std::uint64_t bytes) { return in_bytes(static_cast<double>(bytes), ""); }

std::string bandwidth_text(double bytes_per_second) {
  return in_bytes(std::round(bytes_per_second), "/s");
}
std::string count_text(std::uint64_t count) {
  const auto value = static_cast<double>(count);
  if (count < 100000) return std::to_string(count);
  if (count < 999500) return with("%.0f%s", value / 1e3, "k");
  if (count < 999950000) return with("%.1f%s", value / 1e6, "M");
  return with("%.1f%s", value / 1e9, "G");
}

std::string rate_text(double per_second) {
  if (per_second < 0.95) return with("%.2f%s", per_second, "/s");
  if (per_second < 999.95) return with("%.1f%s", per_second, "/s");
  if (per_second < 999950) return with("%.1f%s", per_second / 1e3, "k/s");
  return with("%.1f%s", per_second / 1e6, "M/s");
}

std::string precise_rate_text(double per_second) {
  static constexpr const char* kUnits[] = {"/s", "k/s", "M/s", "G/s"};
  std::size_t unit = 0;
  for (; per_second >= 999.95 && unit + 1 < std::size(kUnits); ++unit) per_second /= 1000;
  const char* const format = per_second >= 999.95   ? "%.0f%s"
                             : per_second >= 99.995 ? "%.1f%s"
                             : per_second >= 9.9995 ? "%.2f%s"
                             : per_second >= 0.9999 ? "%.3f%s"
                                                    : "%.4f%s";
  return with(format, per_second, kUnits[unit]);
}

std::string span_text(double seconds) {
  static constexpr const char* kUnits[] = {"ns", "us", "ms", "s"};
  double value = seconds * 1e9;
  std::size_t unit = 0;
  for (; std::abs(value) >= 999.5 && unit + 1 < std::size(kUnits); ++unit) value /= 1000;
  const double size = std::abs(value);
  const char* const format = unit == 0 || size >= 99.95 ? "%.0f %s"
                             : size >= 9.995            ? "%.1f %s"
                                                        : "%.2f %s";
  return with(format, value, kUnits[unit]);
}

std::string below_text(double per_second) {
  double unit = 1;
  while (per_second / unit >= 1000 && unit < 1e6) unit *= 1000;
  const double tenths = std::ceil(per_second / unit * 10 - 1e-9) / 10;
  const std::string number = with(tenths == std::floor(tenths) ? "%.0f%s" : "%.1f%s", tenths, "");
  return "< " + number + (unit == 1 ? "/s" : unit == 1e3 ? "k/s" : "M/s");
}

std::string age_text(double seconds) {
  if (seconds < 120) return with("%.0f %s", std::floor(seconds), "s");
  if (seconds < 2 * 3600) return with("%.0f %s", std::floor(seconds / 60), "min");
  if (seconds < 48 * 3600) return with("%.0f %s", std::floor(seconds / 3600), "h");
  return with("%.0f %s", std::floor(seconds / 86400), "days");
}

std::string printable(const std::string& text, std::size_t most) {
  std::string out = text;
  for (char& c : out) {
    if (c < ' ' || c > '~') c = '?';
  }
  if (out.size() > most) {  // the two ends of a name say most
    const std::size_t half = (most - 2) / 2;
    out = out.substr(0, half) + ".." + out.substr(out.size() - half);
  }
  return out;
}

std::string plural(std::uint64_t n, const std::string& one, const std::string& many) {
  return std::to_string(n) + " " + (n == 1 ? one : many);
}

}  // namespace lot::tool
