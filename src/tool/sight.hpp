// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "tool/observation.hpp"
#include "tool/places.hpp"

namespace lot::tool {

/// A segment as found in its directory.
struct Sight {
  enum class Condition {
    Sound,
    OtherBoot,   ///< whole, but of a time before the system was started: nobody lives in it
    Damaged,     ///< not what this build calls a segment: another version, cut short, overwritten
    Unreadable,  ///< it belongs to another user, or there is no room to look (a limit, memory)
    Untrusted    ///< the same, or it gives others too much: it could be read, and is not
  };
  std::string name;
  std::string path;
  Condition condition = Condition::Sound;
  std::string reason;              ///< why it is not sound
  std::unique_ptr<Window> window;  ///< of a sound one
};
const char* to_string(Sight::Condition condition);

/// The segment of that name, whatever `where` names.
Sight sight(const Where& where, const std::string& name);
/// All that `where` names. Throws lot::Error when the directory can not be read.
std::vector<Sight> sights(const Where& where);

/// How a command ends (docs/tool.md).
enum Exit : int { kWell = 0, kWrong = 1, kUsage = 2, kDamaged = 3 };
/// The graver of two: damage, then what is wrong.
constexpr Exit graver(Exit a, Exit b) { return a < b ? b : a; }

}  // namespace lot::tool
