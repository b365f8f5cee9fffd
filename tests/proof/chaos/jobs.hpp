// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "inlet.hpp"
#include "job.hpp"
#include "outlet.hpp"

namespace lot::chaos {

using Jobs = std::vector<std::unique_ptr<Job>>;

/// What a node does in this life. Jobs that need no engine of the node's own reset it.
Jobs make_jobs(Life& life, std::optional<ShmEngine>& engine);

/// A publisher of a topic that is no queue of items for one, whatever it carries.
std::unique_ptr<Job> make_publisher(Life& life, ShmEngine& engine, std::uint32_t topic);
/// A subscription to a topic, whatever it carries; of a queue whose items are for one, a taker
/// or a finisher.
std::unique_ptr<Job> make_inlet(Life& life, ShmEngine& engine, std::uint32_t topic,
                                Role role = Role::Read);

}  // namespace lot::chaos
