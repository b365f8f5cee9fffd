// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct Message {
  int id;
  __int128 number;
};

static_assert(lot::assert_message<Message>());
