// SPDX-License-Identifier: Apache-2.0
#pragma once

/// Everything of LOT's interface.
#include "lot/any_message.hpp"    // IWYU pragma: export
#include "lot/any_puller.hpp"     // IWYU pragma: export
#include "lot/any_pusher.hpp"     // IWYU pragma: export
#include "lot/any_queue.hpp"      // IWYU pragma: export
#include "lot/any_type.hpp"       // IWYU pragma: export
#include "lot/compliance.hpp"     // IWYU pragma: export
#include "lot/describe.hpp"       // IWYU pragma: export
#include "lot/description.hpp"    // IWYU pragma: export
#include "lot/duration.hpp"       // IWYU pragma: export
#include "lot/engine.hpp"         // IWYU pragma: export
#include "lot/envelope.hpp"       // IWYU pragma: export
#include "lot/error.hpp"          // IWYU pragma: export
#include "lot/message.hpp"        // IWYU pragma: export
#include "lot/mutable_value.hpp"  // IWYU pragma: export
#include "lot/options.hpp"        // IWYU pragma: export
#include "lot/pointers.hpp"       // IWYU pragma: export
#include "lot/puller.hpp"         // IWYU pragma: export
#include "lot/pusher.hpp"         // IWYU pragma: export
#include "lot/queue.hpp"          // IWYU pragma: export
#include "lot/service.hpp"        // IWYU pragma: export
#include "lot/signals.hpp"        // IWYU pragma: export
#include "lot/stop_token.hpp"     // IWYU pragma: export
#include "lot/type_identity.hpp"  // IWYU pragma: export
#include "lot/value.hpp"          // IWYU pragma: export
#include "lot/wait_set.hpp"       // IWYU pragma: export
