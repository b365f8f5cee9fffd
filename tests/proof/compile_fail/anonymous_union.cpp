// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct Message {
  int stamp;
  union {
    int i;
    float f;
  };
};

static_assert(lot::assert_message<Message>());
