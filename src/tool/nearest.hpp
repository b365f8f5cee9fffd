// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "tool/places.hpp"

/// What a user may have meant who has named something that is not there.
namespace lot::tool {

/// How many letters to change, add or take away.
std::size_t letters_apart(std::string_view a, std::string_view b);

/// Names of the topics that processes use in the segments that `where` names, without that of a
/// ROS graph. Of segments that cannot be looked into: nothing. Throws nothing but std::bad_alloc.
std::vector<std::string> topics_there(const Where& where);

/// In their order, each one once.
void sort_out(std::vector<std::string>& names);

/// Why no segment is there that can be looked into, but for hindrances(); empty: one is. Throws
/// nothing but std::bad_alloc.
std::string why_no_segment(const Where& where);

/// For a name or pattern that none of those that are there fits: "there is /pose"; what is wrong
/// with the pattern; or some of those that are there. Empty: there are none.
std::string advice_for(const std::string& wanted, const std::vector<std::string>& there);

}  // namespace lot::tool
