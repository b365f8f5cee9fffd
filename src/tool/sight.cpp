// SPDX-License-Identifier: Apache-2.0
#include "tool/sight.hpp"

#include <cerrno>
#include <optional>
#include <string_view>
#include <utility>

#include "lot/error.hpp"

#include "liveness/lock_file.hpp"

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
    case Sight::Condition::Untrusted:
      return "not trusted";
  }
  return "?";
}

namespace {

/// What an error says, without the path where that is the segment's own: it stands before.
std::string reason_of(const Error& e, const std::string& path) {
  std::string_view text = e.what();
  for (const std::string& begin : {std::string("lot: "), path + ": "}) {
    if (text.starts_with(begin)) text.remove_prefix(begin.size());
  }
  return std::string(text);
}

/// Looks at a segment. Nothing: the segment was not there, or went meanwhile.
std::optional<Sight> try_sight(const Where& where, const std::string& name) {
  using segment::Segment;
  Sight s;
  s.name = name;
  s.path = path_of(where, name);
  try {
    const std::string lock = s.path + ".lock";
    liveness::LockProbe(lock).require(where.trust, lock);
    const auto fit = Segment::inspect(s.path, where.trust, s.reason);
    if (fit == Segment::Fit::Absent) return std::nullopt;
    if (fit == Segment::Fit::Foreign) {
      s.condition = Sight::Condition::Damaged;
      return s;
    }
    s.window = std::make_unique<Window>(s.path, where.trust);
    if (fit == Segment::Fit::Fits) return s;
    // Window maps the segment of any boot: the tool drops it.
    s.window.reset();
    s.condition = Sight::Condition::OtherBoot;
  } catch (const Error& e) {
    if (e.error_number() == ENOENT) return std::nullopt;
    s.condition = segment::means_damage(e)    ? Sight::Condition::Damaged
                  : e.error_number() == EPERM ? Sight::Condition::Untrusted
                                              : Sight::Condition::Unreadable;
    if (s.reason.empty()) s.reason = reason_of(e, s.path);
  }
  return s;
}

}  // namespace

Sight sight(const Where& where, const std::string& name) {
  const std::string path = path_of(where, name);
  for (;;) {
    auto s = try_sight(where, name);
    if (s) return std::move(*s);
    if (exists(path)) continue;  // another process has made a new one meanwhile
    return {name, path, Sight::Condition::Damaged, "it has just gone", nullptr};
  }
}

bool was_left(const Sight& sight) {
  return sight.window != nullptr && !sight.window->segment().is_at_its_path();
}

std::vector<Hindrance> hindrances(const Where& where, const std::vector<Sight>& found) {
  std::vector<Hindrance> all;
  for (const Sight& s : found) {
    if (s.window != nullptr) continue;
    all.push_back({s.path, to_string(s.condition) + (": " + s.reason),
                   "`lot doctor` and `lot ls` say what to do",
                   s.condition == Sight::Condition::Damaged});
  }
  for (const auto& obstacle : find_places(where).obstacles) {
    all.push_back({obstacle.path, obstacle.advice(), "", false});
  }
  return all;
}

std::vector<Sight> sights(const Where& where) {
  std::vector<Sight> found;
  for (const auto& name : find_places(where).segments) {
    Sight s = sight(where, name);
    if (s.condition == Sight::Condition::Damaged && !exists(s.path)) continue;  // gone meanwhile
    found.push_back(std::move(s));
  }
  return found;
}

}  // namespace lot::tool
