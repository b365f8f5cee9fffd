// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

using Message = int[];

static_assert(lot::assert_message<Message>());
