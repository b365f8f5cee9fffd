// SPDX-License-Identifier: Apache-2.0
#include "tool/nearest.hpp"

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "lot/error.hpp"

#include "record/pattern.hpp"
#include "record/stream.hpp"
#include "tool/onlooker.hpp"
#include "tool/sight.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

/// A name with as many other letters may be meant.
constexpr std::size_t kNear = 2;
/// So many names are listed.
constexpr std::size_t kListed = 4;

std::string name_of(const std::string& name) { return printable(name, 100); }

/// "there is LOTROS", "there are /a, /b and 12 more"; empty: there is none.
std::string list_of(const std::vector<std::string>& names) {
  std::string text;
  const std::size_t listed = std::min(names.size(), kListed);
  for (std::size_t i = 0; i < listed; ++i) text += (i == 0 ? "" : ", ") + name_of(names[i]);
  if (names.size() > listed) text += " and " + std::to_string(names.size() - listed) + " more";
  if (text.empty()) return text;
  return (names.size() == 1 ? "there is " : "there are ") + text;
}

/// What keeps the pattern from being one; empty: nothing.
std::string fault_of(const std::string& pattern) {
  for (std::size_t i = 0; i < pattern.size(); ++i) {
    if (pattern[i] == '\\') {
      ++i;  // what it stands before is meant itself
      if (i == pattern.size()) return "it ends with a backslash";
      continue;
    }
    if (pattern[i] != '[') continue;
    std::size_t first = i + 1;
    if (first < pattern.size() && (pattern[first] == '!' || pattern[first] == '^')) ++first;
    const std::size_t end = pattern.find(']', first + 1);  // the first one may be meant itself
    if (end == std::string::npos) return "its [ has no ]";
    i = end;
  }
  return "";
}

}  // namespace

std::size_t letters_apart(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t corner = std::exchange(row[0], i);
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t changed = corner + (a[i - 1] != b[j - 1] ? 1 : 0);
      corner = row[j];
      row[j] = std::min({changed, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row.back();
}

std::vector<std::string> topics_there(const Where& where) {
  std::vector<std::string> names;
  try {
    for (const Sight& s : sights(where)) {
      if (s.window == nullptr) continue;
      for (const Topic& topic : observe(*s.window).topics) {
        if (topic.used) names.push_back(lot::record::name_in_file(topic.name));
      }
    }
  } catch (const Error&) {
    // why_no_segment() says it.
  }
  sort_out(names);
  return names;
}

void sort_out(std::vector<std::string>& names) {
  std::ranges::sort(names);
  const auto twice = std::ranges::unique(names);
  names.erase(twice.begin(), twice.end());
}

std::string why_no_segment(const Where& where) {
  const std::string directory = printable(where.directory, 200);
  std::error_code ignored;
  if (!std::filesystem::is_directory(where.directory, ignored)) {
    return "there is no directory " + directory;
  }
  std::vector<std::string> names;
  try {
    for (const Sight& s : sights({where.directory, "", where.trust})) {
      const bool is_meant = where.name.empty() || s.name == where.name;
      if (s.window != nullptr && is_meant) return "";
      if (s.window != nullptr) names.push_back(s.name);
    }
  } catch (const Error& e) {
    return printable(reason_of(e), kLine);
  }
  if (where.name.empty()) return "there is no segment in " + directory;
  const std::string list = list_of(names);
  return "there is no segment " + name_of(where.name) + " in " + directory +
         (list.empty() ? "" : "; " + list);
}

std::string advice_for(const std::string& wanted, const std::vector<std::string>& there) {
  if (record::is_pattern(wanted)) {
    if (const std::string fault = fault_of(wanted); !fault.empty()) return fault;
  }
  const std::string other = wanted.starts_with('/') ? wanted.substr(1) : "/" + wanted;
  for (const std::string& name : there) {
    if (name == other) return "there is " + name_of(name);
    if (lot::record::matches(other, name)) return name_of(other) + " fits " + name_of(name);
  }
  if (!record::is_pattern(wanted) && !there.empty()) {
    const auto far = [&](const std::string& name) { return letters_apart(name, wanted); };
    const auto nearest = std::ranges::min_element(there, {}, far);
    if (far(*nearest) <= std::min(kNear, wanted.size() / 2)) return "there is " + name_of(*nearest);
  }
  return list_of(there);
}

}  // namespace lot::tool
