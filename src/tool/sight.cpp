// SPDX-License-Identifier: Apache-2.0
#include "tool/sight.hpp"

#include <cerrno>
#include <optional>
#include <utility>

#include "lot/error.hpp"

namespace lot::tool {

const char* to_string(Sight::Condition condition) {
  switch (condition) {
    case Sight::Condition::Sound:
      return "sound";
    case Sight::Condition::OtherBoot:
      return "other boot";
    case Sight::Condition::Damaged:
      return "damaged";
    case Sight::Condition::Unreadable:
      return "unreadable";
  }
  return "?";
}

namespace {

/// Nothing: it was not there, or went meanwhile.
std::optional<Sight> try_sight(const std::string& directory, const std::string& name) {
  using segment::Segment;
  Sight s;
  s.name = name;
  s.path = directory + "/" + name;
  try {
    const auto fit = Segment::inspect(s.path, s.reason);
    if (fit == Segment::Fit::Absent) return std::nullopt;
    if (fit == Segment::Fit::Foreign) {
      s.condition = Sight::Condition::Damaged;
      return s;
    }
    s.window = std::make_unique<Window>(s.path);
    if (fit == Segment::Fit::Fits) return s;
    // Whoever maps it does not look at the boot.
    s.window.reset();
    s.condition = Sight::Condition::OtherBoot;
  } catch (const Error& e) {
    if (e.error_number() == ENOENT) return std::nullopt;
    s.condition = e.error_number() == EACCES || e.error_number() == EPERM
                      ? Sight::Condition::Unreadable
                      : Sight::Condition::Damaged;
    if (s.reason.empty()) s.reason = e.what();
  }
  return s;
}

}  // namespace

Sight sight(const std::string& directory, const std::string& name) {
  for (;;) {
    auto s = try_sight(directory, name);
    if (s) return std::move(*s);
    if (exists(directory + "/" + name)) continue;  // another has been made meanwhile
    return {name, directory + "/" + name, Sight::Condition::Damaged, "it has just gone", nullptr};
  }
}

std::vector<Sight> sights(const Where& where) {
  std::vector<Sight> found;
  for (const auto& name : find_places(where).segments) {
    Sight s = sight(where.directory, name);
    if (s.condition == Sight::Condition::Damaged && !exists(s.path)) continue;  // gone meanwhile
    found.push_back(std::move(s));
  }
  return found;
}

}  // namespace lot::tool
