// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <set>
#include <string>

#include "tool/sight.hpp"

namespace lot::tool {

/// Processes that look at what a publisher has published.
struct Audience {
  std::size_t observers = 0;  ///< ends that only look on
  std::size_t unread = 0;     ///< processes that have not read all of it
};

/// Stays until all that look at these topics have read what the participant `me` has published
/// there, a second at most. A subscriber gets the messages all the same; one that only observes
/// does not, once their publisher has left.
Audience linger(const Where& where, const std::string& segment, std::uint32_t me,
                const std::set<std::string>& topics);

/// Processes but for the participant `me` that publish on the topic: "3 camera".
std::set<std::string> publishers_of(const Where& where, const std::string& segment,
                                    std::uint32_t me, const std::string& topic);

}  // namespace lot::tool
