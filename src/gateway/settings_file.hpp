// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "gateway/settings.hpp"

namespace lot::gateway {

/// Adds what a file of YAML says to the settings:
///
///     domain: 0
///     interface: eth0
///     max_size_mib: 64
///     out:
///       - /camera/*
///       - topics: /map
///         durability: transient_local
///     in:
///       - topics: /cmd_vel
///         type: geometry_msgs/msg/Twist
///         max_rate: 100
///
/// Throws lot::Error: EINVAL for what it does not know or understand, with the line; what the
/// system says of the file. Then `settings` may have a part of it.
void read_settings(const std::string& file, Settings& settings);

}  // namespace lot::gateway
