// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct alignas(8192) Message {
  int stamp;
};

static_assert(lot::assert_message<Message>());
