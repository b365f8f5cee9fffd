// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct Message {
  int stamp;
  int& target;
};

static_assert(lot::assert_message<Message>());
