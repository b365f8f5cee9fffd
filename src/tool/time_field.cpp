// SPDX-License-Identifier: Apache-2.0
#include "tool/time_field.hpp"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <string_view>

#include "lot/error.hpp"

#include "tool/field_path.hpp"

namespace lot::tool {
namespace {

using std::chrono::nanoseconds;

/// So that no difference of two times overflows: the year 2116.
constexpr long double kMost = 0x1p62L;

nanoseconds in_nanoseconds(long double ns) {
  if (std::isnan(ns)) return nanoseconds(0);
  return nanoseconds(static_cast<std::int64_t>(std::llround(std::clamp(ns, -kMost, kMost))));
}

/// The place of the first field of a struct that has one of these names and a whole number.
std::optional<std::size_t> part(const Description& all, const Description::Type& type,
                                std::initializer_list<std::string_view> names) {
  for (std::size_t i = 0; i < type.fields.size(); ++i) {
    if (std::find(names.begin(), names.end(), type.fields[i].name) == names.end()) continue;
    const Kind kind = all.types[type.fields[i].type].kind;
    if (kind == Kind::Int || kind == Kind::UInt) return i;
  }
  return std::nullopt;
}

/// The clock whose time is nearer.
TimeField::Clock nearer(nanoseconds time, const TimeField::Now& now) {
  const auto distance = [&](nanoseconds clock) {
    return std::abs(static_cast<long double>(clock.count()) -
                    static_cast<long double>(time.count()));
  };
  return distance(now.steady) < distance(now.system) ? TimeField::Clock::Steady
                                                     : TimeField::Clock::System;
}

}  // namespace

TimeField::Now TimeField::Now::now() {
  return {std::chrono::system_clock::now().time_since_epoch(),
          std::chrono::steady_clock::now().time_since_epoch()};
}

void TimeField::begin(const Description& description) {
  const Description::Type& type = description.types[type_at(description, path_)];
  clock_ = Clock::Unknown;
  has_parts_ = false;
  if (type.kind == Kind::TimePoint) {
    clock_ = type.name == "steady_clock" ? Clock::Steady : Clock::System;
    if (clock_ == Clock::Steady || type.name == "system_clock") return;
    throw Error(EINVAL, "--field " + path_,
                "it is a time point of a clock of its program: " + type.name,
                "use std::chrono::system_clock or std::chrono::steady_clock there");
  }
  if (type.kind == Kind::Duration) return;
  const auto seconds = part(description, type, {"sec", "secs", "tv_sec", "seconds"});
  const auto rest = part(description, type, {"nsec", "nsecs", "nanosec", "tv_nsec", "nanoseconds"});
  if (!seconds || !rest) {
    throw Error(EINVAL, "--field " + path_, "it is no time",
                "name a time point, a duration, or a struct of sec and nsec");
  }
  has_parts_ = true;
  seconds_ = *seconds;
  nanoseconds_ = *rest;
}

std::optional<nanoseconds> TimeField::age(const Value& message, const Now& now) {
  const Value value = message.at(path_).target();
  const long double ns =
      has_parts_ ? value[seconds_].as<long double>() * 1e9L + value[nanoseconds_].as<long double>()
                 : value.as<std::chrono::duration<long double, std::nano>>().count();
  const nanoseconds time = in_nanoseconds(ns);
  if (time == nanoseconds(0)) return std::nullopt;
  if (clock_ == Clock::Unknown) clock_ = nearer(time, now);
  return (clock_ == Clock::Steady ? now.steady : now.system) - time;
}

}  // namespace lot::tool
