// SPDX-License-Identifier: Apache-2.0
// As C++17.
#include "described.hpp"

static_assert(__cplusplus < 202002L);

const lot::Description& described::frame_in_17() { return lot::describe<Frame>(); }
const lot::Description& described::nameless_in_17() { return lot::describe<Nameless>(); }
