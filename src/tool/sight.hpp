// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "tool/observation.hpp"
#include "tool/places.hpp"

namespace lot::tool {

/// A segment as the tool finds it in its directory.
struct Sight {
  enum class Condition {
    Sound,
    OtherBoot,   ///< whole, but made before the system was started: no process lives in it
    Damaged,     ///< no segment to this build: another version, cut short, overwritten
    Unreadable,  ///< another user's, or the tool lacks room to look (a limit, memory)
    Untrusted    ///< another user's, or open to too many: the tool could read it, and does not
  };
  std::string name;
  std::string path;
  Condition condition = Condition::Sound;
  std::string reason;              ///< why it is not sound
  std::unique_ptr<Window> window;  ///< set for a sound one only
};
const char* to_string(Sight::Condition condition);

/// Looks at the segment of that name, whatever `where` names.
Sight sight(const Where& where, const std::string& name);
/// Looks at all segments that `where` names. Throws lot::Error when the directory can not be read.
std::vector<Sight> sights(const Where& where);
/// Something that keeps the tool from looking at what `where` names.
struct Hindrance {
  std::string path;
  std::string reason;  ///< "not trusted: it belongs to ..."
  std::string advice;  ///< what says more; empty: the reason has all
  bool is_damaged = false;
};
/// The segments that it has found and not looked into, and what lies in the place of one. Throws as
/// sights().
std::vector<Hindrance> hindrances(const Where& where, const std::vector<Sight>& found);
/// Whether a segment that it has looked into does not lie there any more: its last process has left
/// it, or its file was removed.
bool was_left(const Sight& sight);

/// How a command ends (docs/tool.md).
enum Exit : int { kWell = 0, kWrong = 1, kUsage = 2, kDamaged = 3 };
/// The graver of two: damage, then what is wrong.
constexpr Exit graver(Exit a, Exit b) { return a < b ? b : a; }

}  // namespace lot::tool
