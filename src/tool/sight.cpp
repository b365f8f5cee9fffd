// SPDX-License-Identifier: Apache-2.0
#include "tool/sight.hpp"

#include <cerrno>

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

Sight sight(const std::string& directory, const std::string& name) {
  using segment::Segment;
  Sight s;
  s.name = name;
  s.path = directory + "/" + name;
  try {
    const auto fit = Segment::inspect(s.path, s.reason);
    if (fit == Segment::Fit::Absent) s.reason = "it has just gone";
    if (fit == Segment::Fit::Absent || fit == Segment::Fit::Foreign) {
      s.condition = Sight::Condition::Damaged;
      return s;
    }
    s.window = std::make_unique<Window>(s.path);
    if (fit == Segment::Fit::Fits) return s;
    // Whoever maps it does not look at the boot.
    s.window.reset();
    s.condition = Sight::Condition::OtherBoot;
  } catch (const Error& e) {
    s.condition = e.error_number() == EACCES || e.error_number() == EPERM
                      ? Sight::Condition::Unreadable
                      : Sight::Condition::Damaged;
    if (s.reason.empty()) s.reason = e.what();
  }
  return s;
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
