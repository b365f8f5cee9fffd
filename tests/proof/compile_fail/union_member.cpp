// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

union Value {
  int i;
  float f;
};
struct Message {
  int stamp;
  Value value;
};

static_assert(lot::assert_message<Message>());
