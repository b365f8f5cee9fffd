// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct Message {
  ~Message() = delete;
  int stamp;
};

static_assert(lot::assert_message<Message>());
