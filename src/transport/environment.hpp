// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "lot/options.hpp"

#include "segment/trust.hpp"

/// What the variables of the environment say (docs/api.md, Variables). Each function throws
/// lot::Error that names a variable with a bad value.
namespace lot::transport {

/// A variable of the environment. Null when it is not set or empty, or when the program has rights
/// that its caller lacks (secure_getenv).
const char* environment(const char* name);

/// The options with what the environment says in their place. Throws also where an option of the
/// caller is out of range.
EngineOptions with_environment(EngineOptions options);

/// The trust of a process whose code does not state one: what the environment says.
segment::Trust trust_of_environment();

/// The queue engine that LOT_QUEUE in the environment names, else the one that the code asks for.
QueueEngine queue_engine(QueueEngine asked);

/// Whether publishers stamp: what LOT_STAMP in the environment says, else what the code asks for.
bool stamps(bool asked);

/// Whether small messages travel in the queue: what LOT_FAST_LANE in the environment says, else
/// what the code asks for.
bool fast_lane(bool asked);

}  // namespace lot::transport
