// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct Message {
  int stamp;
  void (*callback)(int);
};

static_assert(lot::assert_message<Message>());
